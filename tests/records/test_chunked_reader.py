"""Files read in chunks give the recording of a full reading, or the same refusal."""

import gzip
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from piezoid.errors import LabFileError, RecordingError, UnitError, UnreadableFileError
from piezoid.operators.play import play_columns
from piezoid.records.chunked_reader import Thinning, read_thinned
from piezoid.records.collection import collect
from piezoid.records.lab import Lab
from piezoid.records.readers import READERS
from piezoid.records.recording import Recording
from tests.records.formats import RATE_Hz
from tests.records.tables import HEADINGS, lab_with, table

IN_CHUNKS = (
    "run.csv", "run.csv.gz", "run.tsv", "german.csv", "run.txt", "run.h5", "run.parquet",
    "run.tdms",
)  # fmt: skip
SAMPLES = 3000
TIME_s = np.arange(SAMPLES) / 1000
VOLTAGE_V = 50 + 40 * np.sin(2 * np.pi * 7 * TIME_s)
RESPONSE = 3 * np.sin(2 * np.pi * 7 * TIME_s - 0.1) + 0.02 * TIME_s
ROWS = 1024  # of the smallest chunk


def read_one(path: Path, lab: Lab | None = None, rows: int = ROWS) -> Recording:
    (recording,) = read_thinned([path], lab, chunk_rows=rows)
    return recording


def assert_equals_full_reading(path: Path, rows: int, lab: Lab | None = None) -> None:
    """Assert that the recording is bit for bit that of the full file."""
    expected, recording = collect([path], lab)[0], read_one(path, lab, rows)
    np.testing.assert_array_equal(recording.voltage_V(), expected.voltage_V())
    np.testing.assert_array_equal(recording.displacement_m(), expected.displacement_m())
    assert recording.breaks == expected.breaks
    assert recording.sampling_rate_Hz == expected.sampling_rate_Hz
    assert (recording.name, recording.digest) == (expected.name, expected.digest)
    assert recording.counted == expected.counted


def table_with_gaps(folder: Path, missing: Sequence[int], empty: Sequence[int]) -> Path:
    """Write the recording without some rows and without some readings."""
    readings = RESPONSE.copy()
    readings[list(empty)] = np.nan
    rows = np.setdiff1d(np.arange(SAMPLES), missing)
    return table(folder, HEADINGS, TIME_s[rows], VOLTAGE_V[rows], readings[rows])


@pytest.mark.parametrize(
    ("missing", "empty"),
    [
        *(([], [row]) for row in (1022, 1023, 1024, 2047)),
        *((range(at, at + count), []) for at in (2, 1022, 1023, 1024, 2950) for count in (1, 50)),
        *(([], range(at, at + 1500)) for at in (3, 1023, 1024)),
        ([], [SAMPLES - 3]),
    ],
)
def test_gaps_and_empty_cells_are_those_of_a_full_reading(missing, empty, tmp_path):
    assert_equals_full_reading(table_with_gaps(tmp_path, missing, empty), ROWS)


@pytest.mark.parametrize("row", [500, 1022, 1023])
def test_a_missing_cell_beside_a_lost_row_is_a_break(row, tmp_path):
    path = table_with_gaps(tmp_path, [row + 1], [row])
    recording = collect([path])[0]
    assert (recording.breaks, recording.bridged) == ((row,), ())
    assert_equals_full_reading(path, ROWS)


@pytest.mark.parametrize("name", IN_CHUNKS)
def test_every_format_reads_in_chunks_as_in_full(name, write):
    assert_equals_full_reading(write(name), 1)


def test_a_compressed_file_without_seeking_is_refused_with_a_remedy(write):
    packed = write("run.h5").with_name("run.h5.gz")
    packed.write_bytes(gzip.compress(write("run.h5").read_bytes()))
    with pytest.raises(UnreadableFileError, match=r"compressed by gzip.* gunzip"):
        read_one(packed)


def test_every_chunked_format_has_a_test_file():
    suffixes = {"." + name.split(".")[1] for name in IN_CHUNKS}
    assert all(suffixes & set(reader.usual_suffixes) for reader in READERS if reader.read_chunks)


def test_a_time_range_is_that_of_a_full_reading(tmp_path):
    path = table(tmp_path, HEADINGS, TIME_s, VOLTAGE_V, RESPONSE)
    assert_equals_full_reading(path, 50, lab_with(start_s=0.5, stop_s=2.25))
    with pytest.raises(LabFileError, match="holds 0 of 3000 samples"):
        read_one(path, lab_with(start_s=99.0), rows=50)


def test_a_refusal_is_that_of_a_full_reading(tmp_path):
    path = table(tmp_path, "time [s],CH 1 (V),CH 2 (V)", TIME_s, VOLTAGE_V, RESPONSE)
    with pytest.raises(UnitError) as expected:
        collect([path])
    with pytest.raises(UnitError) as chunks:
        read_one(path, rows=40)
    assert str(chunks.value) == str(expected.value)


def test_a_changing_rate_is_refused(tmp_path):
    stamps = np.where(TIME_s < 2, TIME_s, 2 + 2 * (TIME_s - 2))
    with pytest.raises(RecordingError, match="at 1000 Hz at its beginning and at"):
        read_one(table(tmp_path, HEADINGS, stamps, VOLTAGE_V, RESPONSE), rows=50)


def test_columns_with_late_numbers_are_refused(tmp_path):
    temperature_K = np.where(TIME_s < 2, np.nan, 293.0)
    path = table(tmp_path, HEADINGS + ",temp [K]", TIME_s, VOLTAGE_V, RESPONSE, temperature_K)
    with pytest.raises(RecordingError, match="other columns hold numbers"):
        read_one(path, rows=50)


def test_a_damaged_line_is_named_by_its_number(tmp_path):
    path = table(tmp_path, HEADINGS, TIME_s, VOLTAGE_V, RESPONSE)
    lines = path.read_text().split("\n")
    lines[1500] = "broken,by,hand"
    path.write_text("\n".join(lines))
    for recording in (collect([path])[0], read_one(path, rows=50)):
        locations = {problem.place for problem in recording.statements}
        assert {f"line 1501, column {k}" for k in (1, 2, 3)} <= locations


def test_dates_and_formats_without_chunks_are_refused(write):
    with pytest.raises(UnreadableFileError, match="holds dates from line"):
        read_one(write("logger.csv"))
    with pytest.raises(UnreadableFileError, match="it is MATLAB"):
        read_one(write("run5.mat"))


def test_an_endless_line_is_refused(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text(HEADINGS + "\n0,1,2\n1,2,3\n" + "9" * 3_000_000)
    with pytest.raises(UnreadableFileError, match="more than a million characters"):
        read_one(path, rows=50)


def test_a_fragmented_recording_or_one_without_drive_is_refused(tmp_path):
    time_s = np.arange(6006) / RATE_Hz
    holed = np.where(np.arange(6006) % 6 > 3, np.nan, np.sin(40 * time_s))
    with pytest.raises(RecordingError, match="interrupted more than 1000 times"):
        read_one(table(tmp_path, HEADINGS, time_s, np.sin(9 * time_s), holed))
    silent = table(tmp_path, "time [s],position [um]", TIME_s, RESPONSE)
    with pytest.raises(RecordingError, match="only displacement is recorded"):
        read_one(silent)


def test_headings_among_the_rows_are_read_in_chunks(tmp_path):
    path = table(tmp_path, HEADINGS, TIME_s, VOLTAGE_V, RESPONSE)
    rows = path.read_text().splitlines()
    path.write_text("\n".join([*rows[:2000], HEADINGS, *rows[2000:]]) + "\n")
    assert_equals_full_reading(path, ROWS)
    changed = HEADINGS.replace("[V]", "[mV]")
    path.write_text("\n".join([*rows[:2000], changed, *rows[2000:]]) + "\n")
    with pytest.raises(UnreadableFileError, match="line 2001 heads the columns anew"):
        read_one(path, rows=ROWS)


@pytest.mark.parametrize("first_count", [1024, 1025, 2047, 2500])
def test_a_wrapping_counter_is_read_in_chunks(first_count, tmp_path):
    counts = (2**16 - first_count + np.arange(SAMPLES)) % 2**16
    path = table(tmp_path, "t [ms],voltage [V],position [um]", counts, VOLTAGE_V, RESPONSE)
    assert_equals_full_reading(path, ROWS)
    assert [problem.quantity for problem in read_one(path).statements] == ["wrapped_clock"]
    counted = "t [ms],voltage [V],position [LSB]"
    assert_equals_full_reading(
        table(tmp_path, counted, counts, VOLTAGE_V, np.round(RESPONSE)), ROWS
    )


def test_two_axes_of_a_file_are_two_recordings(tmp_path):
    headings = "time [s],voltage x [V],position x [um],voltage y [V],position y [um]"
    path = table(tmp_path, headings, TIME_s, VOLTAGE_V, RESPONSE, VOLTAGE_V / 2, RESPONSE / 3)
    x, y = read_thinned([path], chunk_rows=ROWS)
    assert (x.axis, y.axis, x.axes, y.axes) == ("x", "y", ("x",), ("y",))
    np.testing.assert_allclose(y.voltage_V(), VOLTAGE_V / 2, atol=1e-6)


def swelling_drive(cycles: int, rows_per_cycle: int) -> np.ndarray:
    """Return cycles of changing amplitude, with minor loops at all levels."""
    phase = np.arange(cycles * rows_per_cycle) / rows_per_cycle
    swell = 0.2 + 0.8 * np.abs(np.cos(np.pi * phase / 11))
    return np.asarray(swell * np.sin(2 * np.pi * phase))


def thin(drive: np.ndarray, max_rows: int, cuts: tuple[int, ...] = ()) -> np.ndarray:
    thinning = Thinning(max_rows)
    for part in np.split(drive, cuts):
        thinning.append(part, 2 * part, is_new_piece=False)
    return thinning.result()[0]


def test_thinned_rows_do_not_depend_on_the_chunks():
    drive = swelling_drive(20, 3000)
    rows = thin(drive, 1 << 13)
    assert 1 << 12 < rows.shape[1] <= 1 << 13
    np.testing.assert_array_equal(rows[1], 2 * rows[0])
    assert np.isin(rows[0], drive).all()
    np.testing.assert_array_equal(rows, thin(drive, 1 << 13, cuts=(1, 700, 701, 33_333)))


def test_thinning_keeps_turning_points_and_play_states():
    drive = swelling_drive(20, 3000)
    rows = thin(drive, 1 << 13)
    turns = 1 + np.flatnonzero(np.diff(np.sign(np.diff(drive))))
    assert np.isin(drive[turns], rows[0]).all()
    thresholds = np.array([0.05, 0.2, 0.45])
    exact, _ = play_columns(drive, thresholds, np.zeros(3))
    states, _ = play_columns(rows[0], thresholds, np.zeros(3))
    after_turns = np.isin(rows[0], drive[turns])
    assert after_turns.sum() == len(turns)
    inner = slice(1, -1)
    np.testing.assert_array_equal(states[after_turns][inner], exact[turns][inner])


def test_thinned_rows_have_a_constant_interval_except_at_turning_points():
    drive = swelling_drive(20, 3000)
    thinning = Thinning(1 << 13)
    thinning.append(drive, np.arange(len(drive), dtype=float), is_new_piece=True)
    rows, _starts, stride, _share = thinning.result()
    offset = rows[1] - stride * np.arange(rows.shape[1])
    turns = np.count_nonzero(np.diff(np.sign(np.diff(drive))))
    assert np.count_nonzero(offset) <= turns
    assert 0 <= offset.min() <= offset.max() < stride


def test_noise_of_the_drive_adds_no_turning_points(rng):
    noise = 0.002 * rng.standard_normal(60_000)
    rows = thin(swelling_drive(20, 3000) + noise, 1 << 13)
    smooth = thin(swelling_drive(20, 3000), 1 << 13)
    assert np.std(rows[0] - smooth[0]) < 0.003


def test_a_drive_too_fast_for_thinning_keeps_segments():
    drive = swelling_drive(4000, 30)
    thinning = Thinning(1 << 13)
    thinning.append(drive, drive, is_new_piece=True)
    rows, starts, stride, share = thinning.result()
    assert stride == 1
    assert 4 <= len(starts) <= 16
    assert rows.shape[1] <= 1 << 13
    assert share == pytest.approx(rows.shape[1] / len(drive))
    first_segment = rows[0, : starts[1]]
    np.testing.assert_array_equal(first_segment, drive[: len(first_segment)])


def test_gaps_are_kept_by_thinning():
    thinning = Thinning(1 << 13)
    drive = swelling_drive(10, 3000)
    for _ in range(3):
        thinning.append(drive, drive, is_new_piece=True)
    _rows, starts, stride, _share = thinning.result()
    assert stride > 1
    assert len(starts) == 3
    length = len(drive) // stride
    assert np.diff(starts) == pytest.approx(length, abs=2)


def test_a_thinned_recording_states_its_samples(tmp_path):
    path = table(tmp_path, HEADINGS, TIME_s, VOLTAGE_V, RESPONSE)
    (recording,) = read_thinned([path], max_rows=1 << 11)
    (problem,) = recording.statements
    assert problem.quantity == "thinned"
    assert f"{recording.samples} samples at 500 Hz of axis x" in problem.text
