"""A mode with a hysteretic spring, against solvers that share nothing with the kernel."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.signal import lsim

from piezoid.operators.hysteretic_mode import (
    BoucWenSpring,
    HystereticMode,
    MaxwellSlip,
    fine_drive,
)

RATE_HZ = 800.0
NO_SPRING = MaxwellSlip(threshold=(), stiffness=())


def drive(samples: int = 500) -> np.ndarray:
    time_s = np.arange(samples) / RATE_HZ
    return 40.0 * np.sin(2 * np.pi * 31.0 * time_s) + 25.0 * np.sin(2 * np.pi * 9.0 * time_s + 1.0)


def moved(
    spring: BoucWenSpring | MaxwellSlip, steps: int, size_m: float = 1e-3, samples: int = 500
) -> np.ndarray:
    mode = HystereticMode(
        mass=2.0,
        damping=12.0,
        stiffness=6e4,
        quadratic=0.0,
        cubic=0.0,
        spring=spring,
        size_m=size_m,
    )
    stops = len(spring.threshold) if isinstance(spring, MaxwellSlip) else 0
    fine = fine_drive(drive(samples), RATE_HZ, steps, "band_limited")
    return mode.simulated(fine, np.zeros(3 + stops))[0]


@pytest.mark.parametrize(("gamma", "exponent"), [(-2.2, 1.0), (0.5, 1.0), (0.3, 1.8)])
def test_a_bouc_wen_spring_follows_its_differential_equation(
    gamma: float, exponent: float
) -> None:
    spring = BoucWenSpring(stiffness=4e4, beta=1.6, gamma=gamma, exponent=exponent)
    found = moved(spring, steps=8)
    time_s = np.arange(500) / RATE_HZ
    force = CubicSpline(np.arange(0, 500, 1 / 8) / RATE_HZ, _finer(8))

    def rate(t: float, x: np.ndarray) -> list[float]:
        y, v, z = x
        s = z / 1e-3
        grip = gamma + 1.6 * np.sign(s * v)
        return [
            v,
            (force(t) - 12.0 * v - 6e4 * y - 4e4 * z) / 2.0,
            v * (1 - abs(s) ** exponent * grip),
        ]

    solved = solve_ivp(
        rate, (0.0, time_s[-1]), [0, 0, 0], t_eval=time_s, rtol=1e-9, atol=1e-13, max_step=1e-3
    ).y[0]
    assert np.abs(found - solved).max() < 2e-4 * np.abs(solved).max()


def _finer(count: int) -> np.ndarray:
    fine = fine_drive(drive(), RATE_HZ, count // 2, "band_limited").values
    return np.concatenate([fine, np.full(count - 1, fine[-1])])


def test_slipping_springs_follow_their_definition_step_by_step() -> None:
    spring = MaxwellSlip(threshold=(0.1, 0.4), stiffness=(3e4, 1e4))
    found = moved(spring, steps=40, samples=150)
    fine = fine_drive(drive(150), RATE_HZ, 800, "band_limited").values
    step_s = 1.0 / (RATE_HZ * 1600)
    y, v = 0.0, 0.0
    stop = [0.0, 0.0]
    reference = np.empty(len(fine))
    for k, force in enumerate(fine):  # symplectic Euler, a thousand times finer
        reference[k] = y
        slip = 3e4 * stop[0] + 1e4 * stop[1]
        v += step_s * (force - 12.0 * v - 6e4 * y - slip) / 2.0
        y += step_s * v
        stop = [min(max(e + step_s * v, -r), r) for e, r in zip(stop, (1e-4, 4e-4), strict=True)]
    reference = reference[::1600]
    assert np.abs(found - reference).max() < 5e-4 * np.abs(reference).max()


def test_without_a_spring_it_is_a_linear_mode() -> None:
    given = drive()
    fine = fine_drive(given, RATE_HZ, 8, "zero_order")
    mode = HystereticMode(
        mass=2.0,
        damping=12.0,
        stiffness=6e4,
        quadratic=0.0,
        cubic=0.0,
        spring=NO_SPRING,
        size_m=1.0,
    )
    y, end = mode.simulated(fine, np.zeros(3))
    time_s = np.arange(500 * 20) / (20 * RATE_HZ)
    held = np.repeat(given, 20)
    _, solved, _ = lsim(([0.5], [1.0, 6.0, 3e4]), held, time_s, interp=False)
    np.testing.assert_allclose(y, solved[::20], atol=1e-6 * np.abs(solved).max())
    assert end[0] == y[-1]


def test_a_finer_integration_comes_closer() -> None:
    spring = BoucWenSpring(stiffness=4e4, beta=1.6, gamma=-2.2, exponent=1.0)
    truth = moved(spring, steps=64)
    errors = [np.abs(moved(spring, steps=steps) - truth).max() for steps in (1, 2, 4)]
    assert errors[1] < 0.5 * errors[0]
    assert errors[2] < 0.5 * errors[1]


def test_a_band_limited_drive_goes_on_between_its_samples() -> None:
    fine = fine_drive(drive(), RATE_HZ, 4, "band_limited").values
    time_s = np.arange(len(fine)) / (8 * RATE_HZ)
    truth = 40.0 * np.sin(2 * np.pi * 31.0 * time_s) + 25.0 * np.sin(
        2 * np.pi * 9.0 * time_s + 1.0
    )
    np.testing.assert_allclose(fine[::8], drive(), atol=1e-12)
    assert np.abs(fine - truth)[400:-400].max() < 1e-3
    held = fine_drive(drive(), RATE_HZ, 4, "zero_order").values
    np.testing.assert_array_equal(held[:16], np.repeat(drive()[:2], 8))


def test_a_spring_that_pushes_leaves_all_bounds_and_says_so() -> None:
    mode = HystereticMode(
        mass=1.0,
        damping=1.0,
        stiffness=-1e6,
        quadratic=0.0,
        cubic=0.0,
        spring=NO_SPRING,
        size_m=1e-3,
    )
    y, _ = mode.simulated(fine_drive(drive(), RATE_HZ, 4, "band_limited"), np.zeros(3))
    bounded = np.isfinite(y)
    assert bounded[0]
    assert not bounded[-1]
    assert np.all(np.isposinf(y[~bounded]))
