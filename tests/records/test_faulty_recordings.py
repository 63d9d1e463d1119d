"""Faults of a recording are reported, removed, bridged or refused."""

import numpy as np
import pytest

from piezoid.errors import RecordingError
from piezoid.records.collection import collect
from tests.records.tables import (
    HEADINGS,
    RESPONSE,
    SAMPLES,
    VOLTAGE_V,
    RATE_Hz,
    TIME_s,
    lab_with,
    quantities_of,
    statements_of,
    table,
)


def test_rows_without_a_number_are_removed_with_a_break(tmp_path):
    holed = RESPONSE.copy()
    holed[[0, 1, 100, 101, SAMPLES - 1]] = np.nan
    path = table(tmp_path, HEADINGS, TIME_s, VOLTAGE_V, holed)
    recording = collect([path])[0]
    assert recording.samples == SAMPLES - 5
    assert recording.breaks == (98,)
    (problem,) = recording.statements
    assert problem.quantity == "missing_values"
    assert problem.place == "line 2"
    assert "5 rows lack a number: 3 at the ends, 0 single" in problem.text
    assert "2 in 1 gaps" in problem.text


def test_a_missing_cell_is_bridged_and_a_blank_row_is_a_break(tmp_path):
    holed = RESPONSE.copy()
    holed[[100, 200]] = np.nan
    path = table(tmp_path, HEADINGS, TIME_s, VOLTAGE_V, holed)
    recording = collect([path])[0]
    assert recording.breaks == ()
    assert recording.bridged == (100, 200)
    assert recording.samples == SAMPLES
    assert np.allclose(recording.voltage_V(), VOLTAGE_V, atol=1e-3 * np.ptp(VOLTAGE_V))
    drive_V, holed = VOLTAGE_V.copy(), RESPONSE.copy()
    drive_V[100] = holed[100] = np.nan
    path = table(tmp_path, HEADINGS, TIME_s, drive_V, holed)
    assert collect([path])[0].breaks == (100,)


def test_single_missing_samples_are_interpolated(tmp_path):
    rows = np.delete(np.arange(SAMPLES), [*range(100, 110), 200, 202])
    columns = (TIME_s[rows], VOLTAGE_V[rows], RESPONSE[rows])
    path = table(tmp_path, HEADINGS, *columns)
    recording = collect([path])[0]
    assert recording.samples == SAMPLES - 10
    assert recording.breaks == (100,)
    assert recording.bridged == (190, 192)
    (gap,) = recording.statements
    assert (gap.quantity, gap.place, gap.value) == ("gap", "line 102", 12)
    assert "2 of single samples, bridged" in gap.text
    between = (VOLTAGE_V[199] + VOLTAGE_V[201]) / 2
    assert recording.voltage_V()[190] == pytest.approx(between, rel=1e-8)
    is_measured = np.delete(np.arange(SAMPLES - 10), [190, 192])
    np.testing.assert_allclose(recording.voltage_V()[is_measured], VOLTAGE_V[rows], rtol=1e-8)
    part = collect([path], lab_with(start_s=0.15, stop_s=0.2))[0]
    assert (part.breaks, part.bridged) == ((), (40, 42))


def test_empty_dead_clipped_and_equal_columns_are_reported(tmp_path):
    time_s = np.arange(4000) / RATE_Hz
    drive = 50 + 40 * np.sin(2 * np.pi * time_s)
    noisy = drive + np.random.default_rng(1).normal(0, 0.01, len(drive))
    clipped = np.clip(noisy, 20, 80)
    path = table(
        tmp_path, "time [s],voltage [V],pos [um],spare,aux,copy",
        time_s, drive, clipped, np.full(4000, np.nan), np.full(4000, 7), clipped,
    )  # fmt: skip
    kinds = {problem.quantity: problem.place for problem in collect([path])[0].statements}
    assert kinds == {
        "saturated": "column 3 'pos [um]'",
        "empty": "column 4 'spare'",
        "dead": "column 5 'aux'",
        "equal_columns": "column 6 'copy'",
    }


def test_a_recording_of_a_single_row_is_refused(tmp_path):
    path = table(tmp_path, HEADINGS, TIME_s[:1], VOLTAGE_V[:1], RESPONSE[:1])
    with pytest.raises(RecordingError, match="1 of 1 rows"):
        collect([path])[0]


def sparse_response(step: int, first: int = 0) -> np.ndarray:
    """Return the response with a reading in every ``step``-th row."""
    values = np.full(SAMPLES, np.nan)
    values[first::step] = RESPONSE[first::step]
    return values


@pytest.mark.parametrize(("step", "first"), [(2, 0), (4, 0), (4, 3), (10, 1)])
def test_cells_empty_at_a_fixed_interval_are_a_slower_channel(step, first, tmp_path):
    recording = collect(
        [table(tmp_path, HEADINGS, TIME_s, VOLTAGE_V, sparse_response(step, first))]
    )[0]
    assert recording.sampling_rate_Hz == pytest.approx(RATE_Hz / step)
    assert recording.breaks == ()
    np.testing.assert_allclose(
        recording.displacement_m(), 1e-6 * RESPONSE[first::step], atol=1e-14
    )
    np.testing.assert_allclose(recording.voltage_V(), VOLTAGE_V[first::step], atol=1e-7)
    (statement,) = statements_of(recording, "slower_channel")
    assert f"one of {step} rows" in statement.text
    assert f"from line {first + 2} on" in statement.text


def test_empty_cells_without_a_fixed_interval_are_missing_values(tmp_path, rng):
    values = RESPONSE.copy()
    values[rng.choice(SAMPLES, 30, replace=False)] = np.nan
    recording = collect([table(tmp_path, HEADINGS, TIME_s, VOLTAGE_V, values)])[0]
    assert recording.sampling_rate_Hz == RATE_Hz
    assert quantities_of(recording) == {"missing_values"}
