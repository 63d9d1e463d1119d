"""Files that are wide, endless or no regular files are answered in limited time."""

import os
import resource
import subprocess
import sys
import tracemalloc
from pathlib import Path
from time import process_time

import pytest

from piezoid.errors import PiezoidError, UnreadableFileError
from piezoid.records.inspection import inspect_files
from piezoid.records.readers import read_table, reader
from piezoid.records.readers.numpy_files import NPY
from piezoid.records.readers.reader import library_errors, open_source, text_of
from tests.records.tables import HEADINGS, ROWS, refusal_of

HEADED = HEADINGS + "\n"


def with_stamps(*stamps: float) -> str:
    return HEADED + "".join(f"{at},{k % 7},{k % 5}\n" for k, at in enumerate(stamps))


def with_stray(stamp_s: float) -> str:
    return with_stamps(*(stamp_s if k == 20 else k / 1000 for k in range(40)))


# A naive parser needs from half a minute to days for some of these small texts.
HOSTILE = {
    "blanks": "# A = x" + " " * 60_000 + "y\n# DIM = 3\n# SEPARATOR = 44\n# END_HEADER\n" + ROWS,
    "round brackets": "a(" * 50_000 + "\n" + ROWS.replace(",", " "),
    "square brackets": "a[" * 50_000 + "\n" + ROWS.replace(",", " "),
    "header ends": "LabVIEW Measurement\t\n" + "***End_of_Header***\n" * 30_000,
    "wide rows": HEADED
    + "".join(f"{k},{k % 7},{k % 5}{',9' * (k % 5 == 0)}\n" for k in range(20_000)),
    "texts": HEADED + "".join(f"{k},{k % 7},{'x' if k % 5 == 0 else 1}\n" for k in range(60_000)),
    "a line without breaks": "1," * 100_000,
    "a number without end": "9" * 200_000 + ",1,2\n" + ROWS,
    "blank lines": "\n" * 200_000,
    "denormal stamps": with_stamps(*(k * 5e-324 for k in range(40))),
    "a stray stamp": with_stray(1e30),
    "a stray stamp below zero": with_stray(-1e30),
    "mostly rows of other lengths": "".join(f"{k},{k}{f',{k}' * (k > 60)}\n" for k in range(100)),
}
REASONS = {
    "a line without breaks": "100001 columns",
    "blank lines": "no row of numbers",
    "denormal stamps": "the steps of a clock",
    "mostly rows of other lengths": "rows hold text or too",
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_text_is_answered(name, tmp_path):
    path = tmp_path / "run.dat"
    path.write_text(HOSTILE[name])
    (inspection, *_) = inspect_files([path])
    assert inspection.refusal or inspection.sampling_rate_Hz
    assert REASONS.get(name, "") in (inspection.refusal or "")


@pytest.mark.parametrize(
    ("columns", "separator"), [(5_000, ","), (5_000, "\t"), (5_000, " "), (1_000_000, ";")]
)
def test_a_heading_of_too_many_columns_is_refused(columns, separator, tmp_path):
    path = tmp_path / "run.csv"
    path.write_text(separator.join(["c1"] * columns) + "\n" + ROWS.replace(",", separator))
    assert f"it has {columns} columns. Needed: at most 4096" in refusal_of(path)


def test_a_comment_may_have_any_width(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("# {" + "'key': 1, " * 40_000 + "}\n" + HEADED + ROWS)
    assert read_table(path).rows == 60


def test_a_reader_without_memory_is_named(tmp_path):
    (tmp_path / "run.csv").write_text(HEADED + ROWS)
    file_source = open_source(tmp_path / "run.csv")
    expected = pytest.raises(
        UnreadableFileError, match=r"stopped with MemoryError\. Needed: a whole npy"
    )
    with expected, library_errors(file_source, NPY):
        raise MemoryError


# Regular expressions with backtracking need minutes for 2000 of these characters.
RUNS = (
    "0", "01", "1.", "1,", "1 ", "+", "-", "1e", "1+", "(", "[", ")", "a(", "[a]", "(1", ",", ";",
    "1i", "1+1i ", "a, ", "_", "/",
)  # fmt: skip


@pytest.mark.parametrize("run", RUNS)
@pytest.mark.parametrize(
    "text",
    ["{}", "{}\n" + ROWS, HEADED + "{}\n" + ROWS, HEADED + "0,{},1\n" + ROWS, "# {}\n" + ROWS],
    ids=["alone", "heading", "row", "cell", "comment"],
)
def test_a_long_run_of_characters_is_answered_without_backtracking(run, text, tmp_path):
    path = tmp_path / "run.txt"
    path.write_text(text.format(run * (20_000 // len(run))))
    start_s = process_time()
    inspect_files([path])
    assert process_time() - start_s < 30.0  # backtracking would need hours, reading needs 2 s


def test_a_recording_beyond_the_memory_states_its_need_and_stream(tmp_path, monkeypatch):
    path = tmp_path / "run.csv"
    path.write_text(HEADED + ROWS * 20)
    monkeypatch.setattr(reader, "available_bytes", lambda: 20_000)
    with pytest.raises(UnreadableFileError, match=r"takes about .* GB of memory.*--stream"):
        read_table(path)
    monkeypatch.undo()
    assert reader.available_bytes() is not None


def test_a_command_without_memory_exits_with_3_and_names_stream(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text(HEADED + ROWS * 200_000)
    limit = (900 << 20, 900 << 20)
    result = subprocess.run(
        [Path(sys.executable).with_name("piezoid"), "fit", path, "--out", tmp_path / "out"],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "COLUMNS": "500"},
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, limit),
    )
    assert "--stream" in result.stdout + result.stderr
    assert "GB of memory" in result.stdout + result.stderr
    assert "MemoryError" not in result.stdout + result.stderr
    assert result.returncode == 3


def test_a_sparse_file_is_refused_at_its_first_zero_byte(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text(HEADED + ROWS)
    os.truncate(path, 1 << 27)
    file_source = open_source(path)
    tracemalloc.start()
    with pytest.raises(UnreadableFileError, match="line 62 holds a zero byte"):
        text_of(file_source)
    assert tracemalloc.get_traced_memory()[1] < 10 << 20
    tracemalloc.stop()
    path.write_text(HEADED.replace("volt", "vo\x00lt") + ROWS)
    assert "line 1 holds a zero byte (byte 12 of the file)" in refusal_of(path)


def test_a_file_too_large_or_empty_is_refused_unread(tmp_path):
    """The file is sparse; reading its 16 GiB takes half a minute."""
    path = tmp_path / "run.csv"
    path.write_text(HEADED + ROWS)
    os.truncate(path, 1 << 34)
    start_s = process_time()
    with pytest.raises(UnreadableFileError, match=f"at most {1 << 31} bytes"):
        open_source(path)
    assert process_time() - start_s < 1.0
    (tmp_path / "empty.csv").touch()
    with pytest.raises(UnreadableFileError, match="the file is empty"):
        open_source(tmp_path / "empty.csv")


def test_a_pipe_a_device_and_a_cyclic_link_are_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "loop.csv").symlink_to(tmp_path / "loop.csv")
    assert "a pipe or a device" in refusal_of(tmp_path / "pipe.csv")
    assert "a pipe or a device" in refusal_of(Path("/dev/zero"))
    assert "symbolic links" in refusal_of(tmp_path / "loop.csv")


@pytest.mark.parametrize("count", ["²", "9" * 5000, "-1", "1e3", ""])
def test_an_invalid_count_is_refused(count, tmp_path):
    path = tmp_path / "run.dat"
    path.write_text(f"# DIM = {count}\n# SEPARATOR = {count}\n# END_HEADER\n{ROWS}")
    assert f"DIM is {count[:100]}" in refusal_of(path)
    head = "***End_of_Header***\nChannels\t1\n" + f"Samples\t{count}\n" + "***End_of_Header***\n"
    path.write_text("LabVIEW Measurement\t\n" + head + "X_Value\tv [V]\n" + "0\t1\n1\t2\n")
    assert read_table(path).rows == 2


def test_messages_are_short_and_printable_for_any_name(tmp_path):
    error = PiezoidError("\x1b[31mred\udcff" + "x" * 10**6, needed="a\u202eb", remedy="c\nd")
    assert len(str(error)) < 3000
    assert str(error).startswith("\\x1b[31mred\\udcff")
    assert error.needed == "a\\u202eb"
    assert error.remedy == "c\nd"
    path = tmp_path / os.fsdecode(b"\xff.csv")
    path.write_text(HEADED + ROWS)
    assert open_source(path).name == "\\xff.csv"
    with pytest.raises(UnreadableFileError, match=r"\\udcfe"):
        read_table(tmp_path / os.fsdecode(b"\xfe.csv"))
