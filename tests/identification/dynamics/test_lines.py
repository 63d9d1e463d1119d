"""Which lines a drive occupies: those well above the faintest, never rest or half the rate."""

import numpy as np
import pytest

from piezoid.identification.dynamics.axis_dynamics import STRUCTURES, _possible
from piezoid.identification.dynamics.periodic_estimate import EXCITED_FRACTION, PeriodicData
from tests.identification.dynamics.test_starting_shapes import measured


@pytest.mark.parametrize("samples", [100, 101])
def test_lines_above_a_share_of_the_largest_amplitude_are_occupied(samples: int) -> None:
    phase = 2 * np.pi * np.arange(samples) / samples
    faint = EXCITED_FRACTION * np.array([1.5, 0.5])
    drive_V = (
        7.0 + np.cos(3 * phase) + faint[0] * np.cos(10 * phase) + faint[1] * np.sin(20 * phase)
    )
    drive_V += 0.3 * (-1.0) ** np.arange(samples) * (samples % 2 == 0)
    periods = np.repeat(5.0 * drive_V[:, None, None, None], 2, axis=3)
    data = PeriodicData(
        sampling_rate_Hz=1e3,
        inputs=("x",),
        outputs=("x",),
        voltage_V=periods,
        displacement_m=periods,
    )
    assert data.excited_lines().tolist() == [3, 10]
    assert data.frequency_Hz(data.excited_lines()) == pytest.approx([3e3 / samples, 1e4 / samples])


@pytest.mark.parametrize("lines", [6, 8, 12, 16, 24, 40, 1000])
def test_a_structure_is_tried_where_its_parameters_are_a_quarter_of_the_values(lines: int) -> None:
    tried = _possible(measured(np.arange(1.0, lines + 1)))
    few = [s for s in STRUCTURES if s.columns + s.shapes <= 2 * lines / 4]
    assert list(tried) == few
