"""Corners of a lateral family: fitted values move by their interval, declared values by 10 %."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.design.lateral_task import plant_family
from piezoid.design.plant import Plant
from piezoid.identification.extensions import CreepLadder, LinearMode, RateDependence
from piezoid.identification.loop_model import at_corner, lag_half_s, loop_model
from piezoid.identification.model import AxisModel, Lag
from tests.design.test_lateral_task import RIG, RATE_Hz, one_mode, rigged
from tests.identification.dynamics.stage import truth
from tests.reports.known_stage import axis_model
from tests.verification.known_fit import fitted

LAG_s = 1e-3
STD_s = 1e-4
HOLD_s = 1e-6  # delay of a sampled pole at rest beyond half a sample
DECLARED_s = 1.0 / (2.0 * np.pi * np.array([RIG.sensor_bandwidth_Hz, RIG.amplifier_bandwidth_Hz]))


def lagging(kind: str, time_s: float = LAG_s) -> AxisModel:
    """Return an axis whose lag has a standard deviation of 0.1 ms."""
    uncertainty = axis_model().uncertainty
    covariance = uncertainty.covariance.copy()
    index = uncertainty.names.index("lag_s")
    covariance[index, index] = STD_s**2
    widened = replace(uncertainty, covariance=covariance)
    return rigged(lag=Lag(kind=kind, time_s=time_s), uncertainty=widened)


def members(axis: AxisModel) -> tuple[Plant, dict[str, Plant]]:
    nominal, *corners = plant_family(axis, RATE_Hz).members
    return nominal, {corner.label: corner for corner in corners}


def time_constants_s(plant: Plant) -> list[float]:
    return sorted(-1.0 / (RATE_Hz * np.log(np.abs(plant.poles))))


def sign_of(label: str) -> float:
    return 1.0 if "slow" in label else -1.0


def test_a_fitted_pole_moves_by_the_interval_of_its_lag():
    axis = lagging("first_order")
    half_s = lag_half_s(axis)
    assert half_s == pytest.approx(1.96 * STD_s, rel=1e-4)
    nominal, corners = members(axis)
    assert time_constants_s(nominal) == pytest.approx([*DECLARED_s, LAG_s])
    for label, corner in corners.items():
        expected_s = [*DECLARED_s * (1.0 + 0.1 * sign_of(label)), LAG_s + sign_of(label) * half_s]
        assert time_constants_s(corner) == pytest.approx(expected_s)


def test_a_pole_with_a_wide_interval_keeps_a_positive_time_constant():
    """The half-width of the interval exceeds the time constant."""
    _, corners = members(lagging("first_order", STD_s))
    assert max(time_constants_s(corners["low gain, fast"])) == pytest.approx(
        max(0.1 * STD_s, 0.9 * max(DECLARED_s))
    )
    assert max(time_constants_s(corners["low gain, slow"])) == pytest.approx(
        2.96 * STD_s, rel=1e-4
    )


@pytest.mark.parametrize(("kind", "time_s"), [("delay", LAG_s), ("none", 0.0)])
def test_a_delay_moves_by_the_interval_of_its_lag_and_stays_causal(kind, time_s):
    axis = lagging(kind, time_s)
    nominal, corners = members(axis)
    for label, corner in corners.items():
        assert time_constants_s(corner) == pytest.approx(DECLARED_s * (1.0 + 0.1 * sign_of(label)))
        delay_s = max(time_s + sign_of(label) * lag_half_s(axis), 0.0)
        poles_s = 0.1 * sign_of(label) * DECLARED_s.sum()
        assert corner.rest_delay_s - nominal.rest_delay_s == pytest.approx(
            delay_s - time_s + poles_s, abs=HOLD_s
        )


def natural_Hz(plant: Plant) -> float:
    return float((RATE_Hz * np.abs(np.log(plant.poles)) / (2.0 * np.pi)).min())


def damping(plant: Plant) -> float:
    s = np.log(plant.poles)
    return float((-s.real / np.abs(s)).min())


def test_a_measured_mode_moves_by_its_interval_in_frequency_and_in_damping():
    axis = rigged(dynamics=one_mode(frequency_Hz=300.0, damping=0.04, delay_s=120e-6))
    _, corners = members(axis)
    assert len(corners) == 8  # gain, speed and sharpness
    for label in ("slow, sharp", "fast, damped"):
        assert corners[f"low gain, {label}"].gain < corners[f"high gain, {label}"].gain
    for label, corner in corners.items():
        # The fit gives 1.96 % of the frequency; the damping varies by a fifth at least.
        assert natural_Hz(corner) == pytest.approx(
            300.0 * (1.0 - 0.0196 * sign_of(label)), rel=1e-3
        )
        sharper = 1.0 if "sharp" in label else -1.0
        assert damping(corner) == pytest.approx(0.04 * 1.2165**-sharper, rel=2e-2)


def test_a_mode_from_a_diagnosis_is_in_every_member():
    mode = LinearMode(frequency_Hz=640.0, quality=30.0, std=(6.4, 3.0, 0.01))
    nominal, corners = members(rigged(extensions=(mode,)))
    assert natural_Hz(nominal) == pytest.approx(640.0, rel=1e-6)
    assert damping(nominal) == pytest.approx(1.0 / 60.0, rel=1e-6)
    frequencies_Hz = sorted(natural_Hz(corner) for corner in corners.values())
    assert frequencies_Hz[0] == pytest.approx(640.0 - 1.96 * 6.4, rel=1e-3)
    assert frequencies_Hz[-1] == pytest.approx(640.0 + 1.96 * 6.4, rel=1e-3)


def test_a_wide_interval_of_a_mode_has_intermediate_members():
    mode = LinearMode(frequency_Hz=640.0, quality=30.0, std=(16.0, 3.0, 0.01))
    _, corners = members(rigged(extensions=(mode,)))
    frequencies_Hz = sorted(
        {round(natural_Hz(c), 3) for label, c in corners.items() if "sharp" in label}
    )
    assert max(np.diff(frequencies_Hz)) < 2.0 * 640.0 / 30.0
    assert len(frequencies_Hz) > 2


def test_creep_and_rate_dependence_widen_the_interval_of_the_gain():
    nominal, corners = members(rigged())
    creep = CreepLadder(time_s=(0.1, 1.0), share=(0.03, 0.02))
    _, with_creep = members(rigged(extensions=(creep,)))
    highest = max(c.gain for c in corners.values())
    assert max(c.gain for c in with_creep.values()) == pytest.approx(1.05 * highest)
    extension = RateDependence(time_s=1e-3)
    _, with_rate_dependence = members(rigged(extensions=(extension,)))
    min_slope, max_slope = axis_model().hysteresis.slope_sector_m_per_V
    lowest = min(c.gain for c in corners.values())
    reversible = min_slope / (0.5 * (min_slope + max_slope))
    assert min(c.gain for c in with_rate_dependence.values()) == pytest.approx(reversible * lowest)
    assert nominal.gain == pytest.approx(0.5 * (min_slope + max_slope))


def test_a_lag_from_hysteresis_is_in_no_corner():
    """The wide interval of such a lag reaches the modes and would cancel them."""
    dynamics, middle = truth(), 0.5 * sum(fitted()["x"].hysteresis.slope_sector_m_per_V)
    share = dynamics.mode_gain_m_per_V / dynamics.mode_gain_m_per_V.sum()
    dynamics = replace(dynamics, mode_gain_m_per_V=middle * share)
    gain = dynamics.mode_gain_m_per_V.sum(keepdims=True)
    covariance = np.zeros((6, 6))
    covariance[4, 4] = 3.0**2  # of the logarithm of the lag's frequency
    with_lag = replace(
        dynamics,
        lag_frequency_Hz=np.array([1.2]),
        lag_gain_m_per_V=-0.99 * gain,
        shape_covariance=covariance,
    )
    axes = [
        replace(fitted()["x"], dynamics=axis_dynamics) for axis_dynamics in (dynamics, with_lag)
    ]
    for slower in (-1.0, 1.0):
        expected, poles = (
            np.linalg.eigvals(loop_model(at_corner(axis, slower, 1.0), RATE_Hz).behind.A)
            for axis in axes
        )
        assert np.sort_complex(poles) == pytest.approx(np.sort_complex(expected))
