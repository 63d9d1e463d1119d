"""A mode with a hysteretic spring is found again from what it did, by a solver of its own."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

import piezoid
from piezoid.errors import ExcitationError, RecordingError
from piezoid.identification.restoring_force.fit import fit_restoring_force
from piezoid.identification.restoring_force.task import left_out_samples
from piezoid.operators.hysteretic_mode import BoucWenSpring, HystereticMode, MaxwellSlip

RATE_HZ = 2000.0
NOISE_M = 5e-9


def multisine(seed: int, samples: int = 4000) -> np.ndarray:
    rng = np.random.default_rng(seed)
    spectrum = np.zeros(samples // 2 + 1, dtype=complex)
    spectrum[10:400] = np.exp(2j * np.pi * rng.random(390))
    drive = np.fft.irfft(spectrum)
    return 50.0 * drive / np.abs(drive).max()


def moved(drive: np.ndarray, force_of: str) -> np.ndarray:
    """Integrate y'' + 30 y' + (500)^2 (y + z) = drive, with scipy."""
    time_s = np.arange(len(drive)) / RATE_HZ
    force = CubicSpline(time_s, drive)

    def rate(t: float, x: np.ndarray) -> list[float]:
        y, v, z = x
        s = z / 2e-4
        grown = {
            "bouc_wen": v * (1.0 - abs(s) ** 1.5 * (0.3 + 0.9 * np.sign(s * v))),
            "none": 0.0,
        }[force_of]
        return [v, force(t) - 30.0 * v - 2.5e5 * (y + 0.6 * z), grown]

    return solve_ivp(
        rate, (0.0, time_s[-1]), [0, 0, 0], t_eval=time_s, rtol=1e-8, atol=1e-11, max_step=1e-3
    ).y[0]


def slipped(drive: np.ndarray, finer: int = 100) -> np.ndarray:
    """Step y'' + 30 y' + (500)^2 (y + e_1 + e_2 / 2) = drive, with stops at 1e-5 and 8e-5 m."""
    time_s = np.arange(len(drive) * finer) / (finer * RATE_HZ)
    force = CubicSpline(np.arange(len(drive)) / RATE_HZ, drive)(time_s)
    y, v, e, f, step_s = 0.0, 0.0, 0.0, 0.0, time_s[1]
    found = np.empty(len(force))
    for k, pushed in enumerate(force.tolist()):
        found[k] = y
        v += step_s * (pushed - 30.0 * v - 2.5e5 * (y + e + 0.5 * f))
        y += step_s * v
        e = min(max(e + step_s * v, -1e-5), 1e-5)
        f = min(max(f + step_s * v, -8e-5), 8e-5)
    return found[::finer]


def recorded(force_of: str, seed: int = 1) -> piezoid.Recording:
    drive = multisine(seed)
    motion_m = slipped(drive) if force_of == "slip" else moved(drive, force_of)
    noise_m = NOISE_M * np.random.default_rng(seed + 100).standard_normal(len(drive))
    return piezoid.from_arrays(
        voltage_V=10.0 + drive,
        displacement_m=1e-6 + motion_m + noise_m,
        sampling_rate_Hz=RATE_HZ,
    )


@pytest.fixture(scope="module")
def bouc_wen() -> piezoid.RestoringForceModel:
    return piezoid.identify_restoring_force(recorded("bouc_wen"), hold="band_limited")


def test_a_bouc_wen_spring_is_found_with_its_numbers(
    bouc_wen: piezoid.RestoringForceModel,
) -> None:
    spring = bouc_wen.mode.spring
    assert bouc_wen.law == "bouc_wen"
    assert isinstance(spring, BoucWenSpring)
    size = (bouc_wen.mode.size_m / 2e-4) ** 1.5  # states are counted in sizes of the motion
    truth = {
        "mass": 1.0, "damping": 30.0, "stiffness": 2.5e5, "spring_stiffness": 1.5e5,
        "beta": 0.9 * size, "gamma": 0.3 * size, "exponent": 1.5,
    }  # fmt: skip
    for name, value in truth.items():
        low, high = bouc_wen.interval[name]
        margin = 0.2 * (high - low) + 1e-4 * value  # what two integrations differ by
        assert low - margin < value < high + margin, name
        assert high - low < 0.25 * abs(value), name
    assert bouc_wen.residual_rms_m == pytest.approx(NOISE_M, rel=0.05)
    assert bouc_wen.left_out_rms_m["bouc_wen"] < 0.2 * bouc_wen.left_out_rms_m["linear"]
    assert bouc_wen.natural_frequency_Hz == pytest.approx(500 * 1.6**0.5 / (2 * np.pi), rel=0.01)


def test_it_predicts_a_drive_that_it_has_not_seen(bouc_wen: piezoid.RestoringForceModel) -> None:
    drive = multisine(7)
    truth = moved(np.tile(drive, 2), "bouc_wen")
    from_rest = bouc_wen.simulate(10.0 + drive, RATE_HZ) - truth[: len(drive)]
    steady = bouc_wen.simulate(10.0 + drive, RATE_HZ, periodic=True) - truth[len(drive) :]
    size_m = truth.std()
    assert (from_rest - from_rest.mean())[200:].std() < 0.01 * size_m
    assert steady.std() < 0.005 * size_m
    assert steady.mean() == pytest.approx(1e-6, abs=2e-8)


def test_springs_that_slip_are_told_from_those_that_bend() -> None:
    model = piezoid.identify_restoring_force(recorded("slip"), hold="band_limited")
    assert model.law == "maxwell_slip"
    assert isinstance(model.mode.spring, MaxwellSlip)
    assert model.left_out_rms_m["maxwell_slip"] < 0.5 * model.left_out_rms_m["linear"]


def test_a_linear_mode_gets_no_spring_and_its_own_numbers() -> None:
    model = piezoid.identify_restoring_force(recorded("none"), hold="band_limited")
    assert model.law == "linear"
    assert model.mode.mass == pytest.approx(1.0, rel=1e-3)
    assert model.mode.damping == pytest.approx(30.0, rel=1e-2)
    assert model.mode.stiffness == pytest.approx(2.5e5, rel=1e-3)


def test_a_block_is_left_out_of_every_period_alike() -> None:
    period = multisine(3, samples=2000)
    out = left_out_samples(np.tile(period, 4))
    np.testing.assert_array_equal(out[:2000], out[2000:4000])
    assert out.mean() == pytest.approx(0.5, abs=0.01)
    once = left_out_samples(period)
    assert once.mean() == pytest.approx(0.5, abs=0.01)


def test_a_model_shows_its_numbers_with_their_intervals(
    bouc_wen: piezoid.RestoringForceModel,
) -> None:
    html = bouc_wen._repr_html_()
    assert "Bouc-Wen" in html
    low, _ = bouc_wen.interval["mass"]
    assert f"[{low:.5g}, " in html


def test_what_cannot_be_fitted_is_refused_with_what_to_do() -> None:
    drive = multisine(1)
    with pytest.raises(ExcitationError, match="both to move"):
        fit_restoring_force(drive, np.zeros(len(drive)), RATE_HZ)
    with pytest.raises(ExcitationError, match="at least 2000"):
        fit_restoring_force(drive[:1500], drive[:1500], RATE_HZ)
    whole = recorded("none")
    broken = piezoid.Recording(
        name="gap.csv", digest="", axis="x", sampling_rate_Hz=RATE_HZ,
        channels=whole.channels, breaks=(1000,),
    )  # fmt: skip
    with pytest.raises(RecordingError, match=r"gap.csv: 1 breaks, the first after 0.5 s.*seconds"):
        piezoid.identify_restoring_force(broken)


def test_a_drive_beyond_what_the_spring_bears_is_refused() -> None:
    mode = HystereticMode(
        mass=1.0, damping=1.0, stiffness=2.5e5, quadratic=0.0, cubic=0.0, size_m=1e-4,
        spring=BoucWenSpring(stiffness=-3e5, beta=0.0, gamma=0.0, exponent=1.0),
    )  # fmt: skip
    model = piezoid.RestoringForceModel(
        law="bouc_wen", mode=mode, bias=0.0, interval={}, residual_rms_m=0.0, left_out_rms_m={},
        hold="band_limited", samples=4000,
    )  # fmt: skip
    with pytest.raises(piezoid.PiezoidError, match="leaves all bounds after"):
        model.simulate(multisine(1), RATE_HZ)
