"""Files read in blocks: what a whole reading finds, gap for gap and refusal for refusal."""

import gzip
import itertools
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from piezoid.errors import LabFileError, PiezoidError, RecordingError, UnreadableFileError
from piezoid.records.ingest import ingest
from piezoid.records.lab import Lab, RecordingEntry
from piezoid.records.readers import read_table
from piezoid.records.readers.source import open_source
from piezoid.records.streams import FORMATS, excerpts
from piezoid.records.streams.excerpts import Compared, compared
from piezoid.records.streams.piece import Piece
from piezoid.records.streams.spool import spooled
from tests.records.formats import RATE_Hz
from tests.records.tables import lab_with, table

IN_BLOCKS = (
    "run.csv", "run.csv.gz", "run.tsv", "german.csv", "run.txt", "run.h5", "run.parquet",
    "run.tdms",
)  # fmt: skip
SAMPLES = 3000
TIME_s = np.arange(SAMPLES) / 1000
VOLTAGE_V = 50 + 40 * np.sin(2 * np.pi * 7 * TIME_s)
RESPONSE = 3 * np.sin(2 * np.pi * 7 * TIME_s - 0.1) + 0.02 * TIME_s
ROWS = 1024  # of a block, the least
HEADINGS = "time [s],voltage [V],position [um]"


def drive_and_response(piece: Piece, rows: int = 77) -> np.ndarray:
    return np.hstack(list(map(np.array, piece.read(rows))))


def refused(paths: list[Path], lab: Lab | None = None, rows: int = 64) -> None:
    """Read, for whoever expects that to fail."""
    with spooled(paths, lab, rows=rows):
        pass


def assert_as_a_whole(path: Path, rows: int, lab: Lab | None = None) -> None:
    """The spooled pieces are, bit for bit, those of the whole recording."""
    whole = ingest(path, lab)
    expected = np.array([whole.voltage_V(), whole.displacement_m()])
    with spooled([path], lab, rows=rows) as spool:
        ((_, pieces),) = spool.pieces.items()
        found = np.hstack([drive_and_response(p) for p in pieces])
    assert [p.samples for p in pieces] == [p.stop - p.start for p in whole.pieces]
    np.testing.assert_array_equal(found, expected)
    assert {p.sampling_rate_Hz for p in pieces} == {whole.sampling_rate_Hz}


@pytest.mark.parametrize("rows", [1, 100_000])
@pytest.mark.parametrize("name", IN_BLOCKS)
def test_every_format_reads_in_blocks_as_it_reads_whole(
    name: str, rows: int, write: Callable[[str], Path]
) -> None:
    assert_as_a_whole(write(name), rows)


@pytest.mark.parametrize("rows", [2, 7, 199, 200])
@pytest.mark.parametrize("name", IN_BLOCKS)
def test_each_block_begins_with_the_last_row_of_the_one_before(
    name: str, rows: int, write: Callable[[str], Path]
) -> None:
    whole, source = read_table(write(name)), open_source(write(name), whole=False)
    known = next(known for known in FORMATS if known.reader.recognises(source))
    blocks = list(known.blocks(source, rows))
    assert blocks[0].first_row == 0
    for before, after in itertools.pairwise(blocks):
        assert after.first_row == before.first_row + before.rows - 1
    for k, column in enumerate(whole.columns):
        parts = [block.columns[k].values[1:] for block in blocks[1:]]
        joined = np.concatenate([blocks[0].columns[k].values, *parts])
        np.testing.assert_array_equal(joined, column.values)
        assert blocks[-1].columns[k].place == column.place


@pytest.mark.parametrize("name", ["run.h5", "run.parquet", "run.tdms"])
def test_what_is_packed_and_cannot_be_leapt_in_is_refused_with_the_way_out(
    name: str, write: Callable[[str], Path]
) -> None:
    packed = write(name).with_name(f"{name}.gz")
    packed.write_bytes(gzip.compress(write(name).read_bytes()))
    with pytest.raises(UnreadableFileError, match=r"packed by gzip.* gunzip") as refusal:
        refused([packed])
    assert "damaged" not in str(refusal.value)
    assert "Copy" not in str(refusal.value)


def test_there_is_a_file_for_every_format_of_blocks() -> None:
    suffixes = {"." + name.split(".")[1] for name in IN_BLOCKS}
    assert all(suffixes & set(known.reader.suffixes) for known in FORMATS)


@pytest.mark.parametrize("lost", [1, 2, 50])
@pytest.mark.parametrize("at", [2, 1022, 1023, 1024, 2046, 2950])
def test_a_gap_is_one_wherever_the_blocks_are_cut(at: int, lost: int, tmp_path: Path) -> None:
    keep = np.r_[0:at, at + lost : SAMPLES]
    columns = [c[keep] for c in (TIME_s, VOLTAGE_V, RESPONSE)]
    assert_as_a_whole(table(tmp_path, HEADINGS, *columns), ROWS)


@pytest.mark.parametrize("at", [0, 1023, 1024, 2000, SAMPLES - 3])
@pytest.mark.parametrize("count", [1, 1500])
def test_missing_numbers_break_a_recording_wherever_they_are(
    at: int, count: int, tmp_path: Path
) -> None:
    holed = RESPONSE.copy()
    holed[at : at + count] = np.nan
    if at == 0:
        holed[:3] = RESPONSE[:3]  # a first block without any number is refused
    assert_as_a_whole(table(tmp_path, HEADINGS, TIME_s, VOLTAGE_V, holed), ROWS)


def test_a_part_of_a_file_is_the_part_of_the_whole(tmp_path: Path) -> None:
    path = table(tmp_path, HEADINGS, TIME_s, VOLTAGE_V, RESPONSE)
    assert_as_a_whole(path, 50, lab_with(start_s=0.5, stop_s=2.25))
    with pytest.raises(LabFileError, match="holds 0 of 3000 samples"):
        refused([path], lab_with(start_s=99.0), rows=50)


@pytest.mark.parametrize(
    "headings",
    [
        "time [s],voltage,displacement [um]",
        "time [s],CH 1 (V),CH 2 (V)",
        "time [s],pos A [um],pos B [um]",
        "time [s],foo,bar",
        "voltage [V],displacement [um],foo",
        "time [s],voltage [V],sensor voltage [V]",
    ],
)
def test_what_a_whole_reading_refuses_is_refused_in_the_same_words(
    headings: str, tmp_path: Path
) -> None:
    path = table(tmp_path, headings, TIME_s, VOLTAGE_V, RESPONSE)
    with pytest.raises(PiezoidError) as whole:
        ingest(path)
    with pytest.raises(PiezoidError) as blocks:
        refused([path], rows=40)
    assert type(blocks.value) is type(whole.value)
    assert str(blocks.value) == str(whole.value)


def test_a_rate_that_changes_on_the_way_is_refused(tmp_path: Path) -> None:
    stamps = np.where(TIME_s < 2, TIME_s, 2 + 2 * (TIME_s - 2))
    with pytest.raises(RecordingError, match="at 1000 Hz at its beginning and at"):
        refused([table(tmp_path, HEADINGS, stamps, VOLTAGE_V, RESPONSE)], rows=50)


def test_columns_that_come_to_hold_numbers_later_are_refused(tmp_path: Path) -> None:
    late = np.where(TIME_s < 2, np.nan, 293.0)
    path = table(tmp_path, HEADINGS + ",temp [K]", TIME_s, VOLTAGE_V, RESPONSE, late)
    with pytest.raises(RecordingError, match="other columns hold numbers"):
        refused([path], rows=50)


def test_a_damaged_line_is_told_by_its_number_in_the_file(tmp_path: Path) -> None:
    path = table(tmp_path, HEADINGS, TIME_s, VOLTAGE_V, RESPONSE)
    lines = path.read_text().split("\n")
    lines[1500] = "broken,by,hand"
    path.write_text("\n".join(lines))
    with spooled([path], rows=50) as spool:
        places = {problem.place for _, problem in spool.problems}
    assert any(place.startswith("line 1501") for place in places)


def test_dates_and_formats_without_blocks_are_refused(write: Callable[[str], Path]) -> None:
    with pytest.raises(UnreadableFileError, match="holds dates from line"):
        refused([write("logger.csv")])
    with pytest.raises(UnreadableFileError, match="it is MATLAB"):
        refused([write("run5.mat")])


def test_a_line_without_end_does_not_fill_the_memory(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("time [s],voltage [V],position [um]\n0,1,2\n1,2,3\n" + "9" * 3_000_000)
    with pytest.raises(UnreadableFileError, match="more than a million characters"):
        refused([path], rows=50)


def test_one_name_twice_and_a_recording_in_shreds_are_refused(tmp_path: Path) -> None:
    whole = table(tmp_path, HEADINGS, TIME_s, VOLTAGE_V, RESPONSE)
    with pytest.raises(RecordingError, match="more than one recording is named"):
        refused([whole, whole])
    time_s = np.arange(6006) / RATE_Hz
    holed = np.where(np.arange(6006) % 6 == 5, np.nan, np.sin(40 * time_s))
    with pytest.raises(RecordingError, match="interrupted more than 1000 times"):
        refused([table(tmp_path, HEADINGS, time_s, np.sin(9 * time_s), holed)])


def test_extremes_and_covariance_are_those_of_all_samples(tmp_path: Path) -> None:
    path = table(tmp_path, HEADINGS, TIME_s, VOLTAGE_V, RESPONSE)
    entry = RecordingEntry(file="run.csv", axis="y")
    with spooled([path], Lab(recordings=(entry,)), rows=37) as spool:
        (piece,) = spool.pieces["y"]
        u, y = drive_and_response(piece)
    assert piece.voltage_V == (u.min(), u.max())
    assert piece.displacement_m == (y.min(), y.max())
    assert piece.step_V == np.abs(np.diff(u)).max()
    assert piece.covariance == pytest.approx((u - u.mean()) @ (y - y.mean()), rel=1e-12)


def _compared(paths: list[Path], samples: int = excerpts.SAMPLES) -> Compared:
    with spooled(paths, rows=ROWS) as spool:
        return compared(spool.pieces["x"], "x", samples=samples)


@pytest.mark.parametrize("samples", [SAMPLES, 400, 1 << 20])
@pytest.mark.parametrize(
    ("factors", "reason"),
    [
        ((1e-3, 1), "1000 times as much: the drive is in another unit"),
        ((1 / 15, 1), "its drive is the output of a monitor, 1/15,"),
        ((-1, 1), "drive or sensor is of the other polarity"),
    ],
)
def test_files_that_do_not_fit_are_refused_in_blocks_too(
    factors: tuple[float, float],
    reason: str,
    samples: int,
    tmp_path: Path,
) -> None:
    noise_um = np.random.default_rng(1).normal(0, 0.01, (2, SAMPLES))
    first = table(tmp_path, HEADINGS, TIME_s, VOLTAGE_V, RESPONSE + noise_um[0], name="first.csv")
    odd = VOLTAGE_V * factors[0], RESPONSE * factors[1] + noise_um[1]
    other = table(tmp_path, HEADINGS, TIME_s, *odd, name="other.csv")
    with pytest.raises(RecordingError, match=reason) as caught:
        _compared([first, other], samples)
    assert 'file = "other.csv"' in caught.value.remedy


def test_a_copy_and_a_file_that_hardly_moves_are_told_in_blocks_too(tmp_path: Path) -> None:
    noise_um = np.random.default_rng(1).normal(0, 0.01, (2, SAMPLES))
    held = RESPONSE + noise_um[0]
    first = table(tmp_path, HEADINGS, TIME_s, VOLTAGE_V, held, name="first.csv")
    in_nm = "time [s],voltage [V],position [nm]"
    again = table(tmp_path, in_nm, TIME_s, VOLTAGE_V, 1e3 * held, name="again.csv")
    rest = table(tmp_path, HEADINGS, TIME_s, 50 + VOLTAGE_V / 500, noise_um[1], name="rest.csv")
    found = _compared([first, again, rest])
    assert [piece.name for piece in found.pieces] == ["first.csv", "rest.csv"]
    assert found.remarks[0].startswith("again.csv holds the same samples as first.csv")
    assert found.remarks[1].startswith("rest.csv: the drive of axis x moves by 160 mV")
    assert len(found.remarks) == 2


def test_headings_among_the_rows_cut_or_end_a_file_in_blocks_too(tmp_path: Path) -> None:
    path = table(tmp_path, HEADINGS, TIME_s, VOLTAGE_V, RESPONSE)
    rows = path.read_text().splitlines()
    path.write_text("\n".join([*rows[:2000], HEADINGS, *rows[2000:]]) + "\n")
    assert_as_a_whole(path, ROWS)
    other = HEADINGS.replace("[V]", "[mV]")
    path.write_text("\n".join([*rows[:2000], other, *rows[2000:]]) + "\n")
    with pytest.raises(UnreadableFileError, match="line 2001 heads the columns anew"):
        refused([path], rows=ROWS)


@pytest.mark.parametrize("before", [1024, 1025, 2047, 2500])
def test_a_counter_that_begins_anew_goes_on_in_blocks_too(before: int, tmp_path: Path) -> None:
    counts = (2**16 - before + np.arange(SAMPLES)) % 2**16
    path = table(tmp_path, "t [ms],voltage [V],position [um]", counts, VOLTAGE_V, RESPONSE)
    assert_as_a_whole(path, ROWS)
    with spooled([path], rows=ROWS) as spool:
        assert [problem.kind for _, problem in spool.problems] == ["wrapped_clock"]


def test_counts_stay_counts_in_blocks(tmp_path: Path) -> None:
    counts = np.round(1e3 * RESPONSE)
    raw = table(tmp_path, HEADINGS.replace("um", "LSB"), TIME_s, VOLTAGE_V, counts)
    assert_as_a_whole(raw, ROWS)
    known = table(tmp_path, HEADINGS, TIME_s, VOLTAGE_V, RESPONSE, name="known.csv")
    with spooled([raw], rows=ROWS) as spool:
        assert spool.counted == ("displacement",)
    with pytest.raises(RecordingError, match="one unit in all recordings"):
        refused([raw, known], rows=ROWS)
