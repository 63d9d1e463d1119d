"""Corners of a lateral family: what was found moves by its interval, what was declared by 10 %."""

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
HELD_s = 1e-6  # what a hold adds to a pole's delay at rest, beside half a sample
DECLARED_s = 1.0 / (2.0 * np.pi * np.array([RIG.sensor_bandwidth_Hz, RIG.amplifier_bandwidth_Hz]))


def lagging(kind: str, time_s: float = LAG_s) -> AxisModel:
    """An axis whose lag is known to a standard deviation of a tenth of a millisecond."""
    known = axis_model().uncertainty
    covariance = known.covariance.copy()
    place = known.names.index("lag_s")
    covariance[place, place] = STD_s**2
    uncertainty = replace(known, covariance=covariance)
    return rigged(lag=Lag(kind=kind, time_s=time_s), uncertainty=uncertainty)


def members(axis: AxisModel) -> tuple[Plant, dict[str, Plant]]:
    nominal, *corners = plant_family(axis, RATE_Hz).members
    return nominal, {corner.label: corner for corner in corners}


def time_constants_s(plant: Plant) -> list[float]:
    return sorted(-1.0 / (RATE_Hz * np.log(np.abs(plant.poles))))


def way_of(label: str) -> float:
    return 1.0 if "slow" in label else -1.0


def test_a_fitted_pole_moves_by_the_interval_of_its_lag() -> None:
    axis = lagging("first_order")
    half_s = lag_half_s(axis)
    assert half_s == pytest.approx(1.96 * STD_s, rel=1e-4)
    nominal, corners = members(axis)
    assert time_constants_s(nominal) == pytest.approx([*DECLARED_s, LAG_s])
    for label, corner in corners.items():
        moved_s = [*DECLARED_s * (1.0 + 0.1 * way_of(label)), LAG_s + way_of(label) * half_s]
        assert time_constants_s(corner) == pytest.approx(moved_s)


def test_a_pole_whose_interval_reaches_zero_keeps_a_tenth_of_its_time() -> None:
    """Less than the interval's half: a pole needs some time constant."""
    _, corners = members(lagging("first_order", STD_s))
    assert max(time_constants_s(corners["low gain, fast"])) == pytest.approx(
        max(0.1 * STD_s, 0.9 * max(DECLARED_s))
    )
    assert max(time_constants_s(corners["low gain, slow"])) == pytest.approx(
        2.96 * STD_s, rel=1e-4
    )


@pytest.mark.parametrize(("kind", "time_s"), [("delay", LAG_s), ("none", 0.0)])
def test_a_delay_moves_by_the_interval_of_the_lag_and_never_ahead(
    kind: str, time_s: float
) -> None:
    axis = lagging(kind, time_s)
    nominal, corners = members(axis)
    for label, corner in corners.items():
        assert time_constants_s(corner) == pytest.approx(DECLARED_s * (1.0 + 0.1 * way_of(label)))
        delay_s = max(time_s + way_of(label) * lag_half_s(axis), 0.0)
        poles_s = 0.1 * way_of(label) * DECLARED_s.sum()
        assert corner.rest_delay_s - nominal.rest_delay_s == pytest.approx(
            delay_s - time_s + poles_s, abs=HELD_s
        )


def natural_Hz(plant: Plant) -> float:
    return float((RATE_Hz * np.abs(np.log(plant.poles)) / (2.0 * np.pi)).min())


def damping(plant: Plant) -> float:
    s = np.log(plant.poles)
    return float((-s.real / np.abs(s)).min())


def test_a_measured_mode_moves_by_its_interval_in_frequency_and_in_damping() -> None:
    axis = rigged(dynamics=one_mode(frequency_Hz=300.0, damping=0.04, delay_s=120e-6))
    _, corners = members(axis)
    assert len(corners) == 8  # gain, speed and sharpness
    for label in ("slow, sharp", "fast, damped"):
        assert corners[f"low gain, {label}"].gain < corners[f"high gain, {label}"].gain
    for label, corner in corners.items():
        # of the frequency 1.96 % from the fit, of the damping a fifth at least
        assert natural_Hz(corner) == pytest.approx(
            300.0 * (1.0 - 0.0196 * way_of(label)), rel=1e-3
        )
        sharper = 1.0 if "sharp" in label else -1.0
        assert damping(corner) == pytest.approx(0.04 * 1.2165**-sharper, rel=2e-2)


def test_a_mode_that_a_diagnosis_found_is_in_every_member() -> None:
    mode = LinearMode(frequency_Hz=640.0, quality=30.0, std=(6.4, 3.0, 0.01))
    nominal, corners = members(rigged(extensions=(mode,)))
    assert natural_Hz(nominal) == pytest.approx(640.0, rel=1e-6)
    assert damping(nominal) == pytest.approx(1.0 / 60.0, rel=1e-6)
    ends = sorted(natural_Hz(corner) for corner in corners.values())
    assert ends[0] == pytest.approx(640.0 - 1.96 * 6.4, rel=1e-3)
    assert ends[-1] == pytest.approx(640.0 + 1.96 * 6.4, rel=1e-3)


def test_between_the_ends_of_a_wide_interval_members_are_no_farther_apart_than_wide() -> None:
    mode = LinearMode(frequency_Hz=640.0, quality=30.0, std=(16.0, 3.0, 0.01))
    _, corners = members(rigged(extensions=(mode,)))
    sharp = sorted({round(natural_Hz(c), 3) for label, c in corners.items() if "sharp" in label})
    assert max(np.diff(sharp)) < 2.0 * 640.0 / 30.0
    assert len(sharp) > 2


def test_what_creeps_and_what_is_late_widen_the_interval_of_the_gain() -> None:
    plain, still = members(rigged())
    creep = CreepLadder(time_s=(0.1, 1.0), share=(0.03, 0.02))
    _, crept = members(rigged(extensions=(creep,)))
    highest = max(c.gain for c in still.values())
    assert max(c.gain for c in crept.values()) == pytest.approx(1.05 * highest)
    late = RateDependence(time_s=1e-3)
    _, slowed = members(rigged(extensions=(late,)))
    least, greatest = axis_model().hysteresis.slope_sector_m_per_V
    lowest = min(c.gain for c in still.values())
    reversible = least / (0.5 * (least + greatest))
    assert min(c.gain for c in slowed.values()) == pytest.approx(reversible * lowest)
    assert plain.gain == pytest.approx(0.5 * (least + greatest))


def test_a_lag_that_hysteresis_draws_stays_out_of_every_corner() -> None:
    """Its wide interval ends among the modes, where it would cancel them."""
    known, middle = truth(), 0.5 * sum(fitted()["x"].hysteresis.slope_sector_m_per_V)
    share = known.mode_gain_m_per_V / known.mode_gain_m_per_V.sum()
    known = replace(known, mode_gain_m_per_V=middle * share)
    gain = known.mode_gain_m_per_V.sum(keepdims=True)
    covariance = np.zeros((6, 6))
    covariance[4, 4] = 3.0**2  # of the logarithm of the lag's frequency
    drawn = replace(
        known,
        lag_frequency_Hz=np.array([1.2]),
        lag_gain_m_per_V=-0.99 * gain,
        shape_covariance=covariance,
    )
    axes = [replace(fitted()["x"], dynamics=dynamics) for dynamics in (known, drawn)]
    for slower in (-1.0, 1.0):
        without, having = (
            np.linalg.eigvals(loop_model(at_corner(axis, slower, 1.0), RATE_Hz).behind.A)
            for axis in axes
        )
        assert np.sort_complex(having) == pytest.approx(np.sort_complex(without))
