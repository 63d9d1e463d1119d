"""Levels: a mode that softens with the drive is followed down to no drive."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import linregress

from benchmarks.amplitude_dependence import extrapolate_mode
from piezoid.errors import ExcitationError
from piezoid.identification.dynamics.modal import LinearDynamics
from tests.identification.dynamics.stage import FREQUENCY_HZ, truth


def at_level(level_V: float, softening_per_V: float, std: float = 1e-5) -> LinearDynamics:
    base = truth()
    softer = np.array(FREQUENCY_HZ) * np.exp(-softening_per_V * level_V)
    return replace(
        base,
        mode_frequency_Hz=softer,
        drive_rms_V=np.array([level_V]),
        shape_covariance=std**2 * np.eye(5),
    )


@pytest.mark.parametrize("levels", [(0.1, 0.3), (0.3, 0.1, 0.2)])
def test_the_frequency_at_no_drive_and_its_softening_come_back(levels: tuple[float, ...]) -> None:
    found = extrapolate_mode([at_level(v, 0.05) for v in levels], 640)
    assert found.frequency.at_zero == pytest.approx(630, rel=1e-9)
    assert found.frequency.change_per_V == pytest.approx(-0.05, rel=1e-6)
    assert found.frequency.is_significant
    assert not found.damping_trend.is_significant
    assert found.drive_rms_V.tolist() == sorted(levels)


def test_uncertainty_grows_on_the_way_to_zero() -> None:
    """Two points of equal standard deviation s at 0.1 and 0.3 V: s sqrt(2.5) at zero."""
    found = extrapolate_mode([at_level(v, 0.0) for v in (0.1, 0.3)], 630)
    low, high = found.frequency.at_zero_interval
    assert np.log(high / low) / (2 * 1.96) == pytest.approx(1e-5 * np.sqrt(2.5), rel=1e-3)


def test_each_number_of_a_mode_has_its_own_uncertainty() -> None:
    """The second of two modes, equal standard deviations s at 0.1 and 0.3 V: s sqrt(2.5)."""
    std = np.array([1e-5, 2e-5, 3e-4, 4e-4, 1.0])
    levels = [replace(at_level(v, 0.0), shape_covariance=np.diag(std**2)) for v in (0.1, 0.3)]
    found = extrapolate_mode(levels, FREQUENCY_HZ[1])
    for trend, own in ((found.frequency, std[1]), (found.damping_trend, std[3])):
        low, high = trend.at_zero_interval
        assert np.log(high / low) / (2 * 1.96) == pytest.approx(own * np.sqrt(2.5), rel=1e-3)


def test_levels_that_lie_on_no_line_make_the_interval_of_a_regression() -> None:
    level_V, off = np.linspace(0.1, 0.5, 5), np.array([3.0, -4.0, 2.0, -3.0, 2.0]) * 1e-3
    found = extrapolate_mode([at_level(v, w / v) for v, w in zip(level_V, off, strict=True)], 630)
    line = linregress(level_V, -off)
    low, high = found.frequency.change_interval
    assert found.frequency.change_per_V == pytest.approx(line.slope)
    assert (high - low) / (2 * 1.96) == pytest.approx(line.stderr, rel=1e-3)


def test_one_level_is_no_trend() -> None:
    with pytest.raises(ExcitationError, match="two different levels"):
        extrapolate_mode([at_level(0.1, 0.0)] * 2, 630)
