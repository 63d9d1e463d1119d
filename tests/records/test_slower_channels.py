"""Two sampling rates on one clock: the rows that every channel has make a recording."""

from pathlib import Path

import numpy as np
import pytest

from piezoid.records.collection import collect
from tests.records.tables import RESPONSE, SAMPLES, VOLTAGE_V, RATE_Hz, TIME_s, table

HEADINGS = "time [s],voltage [V],position [um]"


def blanked(step: int, first: int = 0) -> np.ndarray:
    """The response, measured in one of so many rows."""
    values = np.full(SAMPLES, np.nan)
    values[first::step] = RESPONSE[first::step]
    return values


@pytest.mark.parametrize(("step", "first"), [(2, 0), (4, 0), (4, 3), (10, 1)])
def test_cells_blank_at_a_fixed_interval_are_a_slower_channel(
    step: int, first: int, tmp_path: Path
) -> None:
    recording = collect([table(tmp_path, HEADINGS, TIME_s, VOLTAGE_V, blanked(step, first))])[0]
    assert recording.sampling_rate_Hz == pytest.approx(RATE_Hz / step)
    assert recording.breaks == ()
    np.testing.assert_allclose(
        recording.displacement_m(), 1e-6 * RESPONSE[first::step], atol=1e-14
    )
    np.testing.assert_allclose(recording.voltage_V(), VOLTAGE_V[first::step], atol=1e-7)
    (said,) = (s for s in recording.statements if s.quantity == "slower_channel")
    assert f"one of {step} rows" in said.text
    assert f"from line {first + 2} on" in said.text


def test_blanks_without_a_fixed_interval_stay_missing_values(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    values = RESPONSE.copy()
    values[rng.choice(SAMPLES, 30, replace=False)] = np.nan
    recording = collect([table(tmp_path, HEADINGS, TIME_s, VOLTAGE_V, values)])[0]
    assert recording.sampling_rate_Hz == RATE_Hz
    assert "missing_values" in {s.quantity for s in recording.statements}
    assert "slower_channel" not in {s.quantity for s in recording.statements}
