"""Levels: a mode that softens with the drive is followed down to no drive."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.errors import ExcitationError
from piezoid.identification.dynamics.amplitude import extrapolate_mode
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


def test_one_level_is_no_trend() -> None:
    with pytest.raises(ExcitationError, match="two different levels"):
        extrapolate_mode([at_level(0.1, 0.0)] * 2, 630)
