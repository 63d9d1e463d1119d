"""Small files that would be large, wide or endless: one message, before time or memory is gone."""

import gzip
import os
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from piezoid.errors import PiezoidError, UnreadableFileError
from piezoid.records.inspection import inspect_file
from piezoid.records.lab import Acquisition, Lab
from piezoid.records.readers import hdf5, read_table
from piezoid.records.readers import source as readers_source
from piezoid.records.readers.source import FREE_SIZE, MOST_GROWTH, growth_limit, open_source
from piezoid.records.streams.spool import spooled

ROWS = "".join(f"{k / 1000},{k % 7},{k % 5}\n" for k in range(60))
HEADED = "time [s],voltage [V],position [um]\n"
MANY = FREE_SIZE // 8 + 1  # one double more than any file may hold


def _said(path: Path) -> str:
    (inspection, *_) = inspect_file(path)
    return inspection.refusal or ""


# Each of these took from half a minute to days, at a size that any mail carries.
@pytest.mark.parametrize(
    "text",
    [
        "# A = x" + " " * 60_000 + "y\n# DIM = 3\n# SEPARATOR = 44\n# END_HEADER\n" + ROWS,
        "a(" * 50_000 + "\n" + ROWS.replace(",", " "),
        "a[" * 50_000 + "\n" + ROWS.replace(",", " "),
        "LabVIEW Measurement\t\n" + "***End_of_Header***\n" * 30_000,
        HEADED + "".join(f"{k},{k % 7},{k % 5}{',9' * (k % 5 == 0)}\n" for k in range(20_000)),
        HEADED + "".join(f"{k},{k % 7},{'x' if k % 5 == 0 else 1}\n" for k in range(60_000)),
    ],
    ids=["blanks", "round brackets", "square brackets", "header ends", "wide rows", "texts"],
)
def test_a_text_that_invites_to_search_for_ever_is_answered(text: str, tmp_path: Path) -> None:
    path = tmp_path / "run.dat"
    path.write_text(text)
    (inspection, *_) = inspect_file(path)
    assert inspection.refusal or inspection.sampling_rate_Hz


@pytest.mark.parametrize("columns", [5_000, 1_000_000])
@pytest.mark.parametrize("separator", [",", "\t", ";", " "])
def test_a_heading_of_too_many_columns_is_refused_with_their_number(
    columns: int, separator: str, tmp_path: Path
) -> None:
    path = tmp_path / "run.csv"
    path.write_text(separator.join(["c1"] * columns) + "\n" + ROWS.replace(",", separator))
    assert f"it has {columns} columns; at most 4096" in _said(path)


def test_a_heading_of_ten_million_columns_is_refused_with_their_number(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("c," * 10_000_000 + "\n" + ROWS)
    assert "it has 10000001 columns; at most 4096" in _said(path)


def test_a_comment_may_be_as_wide_as_it_likes(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("# {" + "'key': 1, " * 40_000 + "}\n" + HEADED + ROWS)
    assert read_table(path).rows == 60


def test_a_gzip_bomb_is_refused_in_proportion_to_its_size(tmp_path: Path) -> None:
    path = tmp_path / "bomb.csv.gz"
    path.write_bytes(gzip.compress(bytes(FREE_SIZE + 1), 1, mtime=0))
    assert growth_limit(path.stat().st_size) == FREE_SIZE
    assert f"at most {FREE_SIZE} bytes" in _said(path)
    assert growth_limit(10 * FREE_SIZE // MOST_GROWTH) == 10 * FREE_SIZE // MOST_GROWTH * 200


def _npz(path: Path) -> None:
    # Of small integers too: every column becomes doubles.
    np.savez_compressed(path, voltage_V=np.zeros(MANY, dtype=np.int8))


def _hdf5(path: Path) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        file.create_dataset("v", shape=(MANY,), dtype="i1", chunks=(1 << 20,), compression="gzip")


def _unwritten_hdf5(path: Path) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        file.create_dataset("voltage", shape=(10**12,), dtype="f8", chunks=(1024,))


def _parquet(path: Path) -> None:
    import pyarrow as pa
    from pyarrow.parquet import write_table

    write_table(pa.table({"voltage [V]": np.zeros(MANY)}), path)


def _matlab(path: Path) -> None:
    from scipy.io import savemat

    savemat(path, {"v": np.zeros(MANY, dtype=np.int8)}, do_compression=True)


def _matlab_structure(path: Path) -> None:
    from scipy.io import savemat

    inner = {"a": {"v": np.zeros(MANY, dtype=np.int8)}}
    savemat(path, {"stage": inner}, do_compression=True)


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("bomb.npz", _npz),
        ("bomb.h5", _hdf5),
        ("unwritten.h5", _unwritten_hdf5),
        ("bomb.parquet", _parquet),
        ("bomb.mat", _matlab),
        ("inner.mat", _matlab_structure),
    ],
)
def test_an_archive_that_grows_out_of_proportion_is_refused(
    name: str, write: Callable[[Path], None], tmp_path: Path
) -> None:
    write(tmp_path / name)
    assert (tmp_path / name).stat().st_size < FREE_SIZE // MOST_GROWTH
    assert "bytes once unpacked; at most" in _said(tmp_path / name)


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("bomb.csv.gz", lambda path: path.write_bytes(gzip.compress(_steady(400_000), 1))),
        ("bomb.h5", _hdf5),
        ("unwritten.h5", _unwritten_hdf5),
        ("bomb.parquet", _parquet),
    ],
)
def test_read_in_blocks_an_archive_may_grow_no_further(
    name: str, write: Callable[[Path], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No memory is lost there, but the disk and the day."""
    monkeypatch.setattr(readers_source, "FREE_SIZE", 1 << 20)
    monkeypatch.setattr(readers_source, "MOST_GROWTH", 20)
    write(tmp_path / name)
    lab = Lab(acquisition=Acquisition(sampling_rate_Hz=1000.0))
    with (
        pytest.raises(UnreadableFileError, match="bytes once unpacked; at most") as told,
        spooled([tmp_path / name], lab),
    ):
        pass
    assert "--stream" not in str(told.value)


def test_a_packed_text_is_read_in_blocks_up_to_its_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = _steady(20_000)
    (tmp_path / "run.csv.gz").write_bytes(gzip.compress(text, 1))
    monkeypatch.setattr(readers_source, "MOST_GROWTH", 20)
    monkeypatch.setattr(readers_source, "FREE_SIZE", len(text))
    lab = Lab(acquisition=Acquisition(sampling_rate_Hz=1000.0))
    with spooled([tmp_path / "run.csv.gz"], lab, rows=1024) as spool:
        assert sum(piece.samples for piece in spool.pieces["x"]) == 20_000
    monkeypatch.setattr(readers_source, "FREE_SIZE", len(text) - 1)
    with (
        pytest.raises(UnreadableFileError, match=f"at most {len(text) - 1} bytes"),
        spooled([tmp_path / "run.csv.gz"], lab, rows=1024),
    ):
        pass


def _steady(rows: int) -> bytes:
    """A text that packs to almost nothing."""
    return b"voltage [V],position [um]\n" + b"1,2\n2,1\n" * (rows // 2)


def test_texts_beside_the_numbers_of_a_parquet_file_are_never_unpacked(tmp_path: Path) -> None:
    import pyarrow as pa
    from pyarrow.parquet import write_table

    path = tmp_path / "run.parquet"
    rows = 3000
    texts = pa.DictionaryArray.from_arrays(np.zeros(rows, dtype=np.int32), ["x" * 1_000_000])
    write_table(pa.table({"voltage [V]": np.arange(rows) / 7, "remark": texts}), path)
    table = read_table(path)  # all of it would be three gigabytes
    assert [column.label for column in table.columns] == ["voltage [V]"]


def test_a_matlab_element_is_measured_without_being_kept(tmp_path: Path) -> None:
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    packed = zlib.compress(bytes(FREE_SIZE // 8 + 1))
    path = tmp_path / "bomb.mat"
    path.write_bytes(head + struct.pack("<II", 15, len(packed)) + packed)
    assert "bomb.mat: " in _said(path)


def test_numbers_that_lie_in_other_files_are_not_fetched(tmp_path: Path) -> None:
    import h5py

    other = tmp_path / "other.bin"
    other.write_bytes(bytes(800))
    with h5py.File(tmp_path / "linked.h5", "w") as file:
        file.create_dataset("v", shape=(100,), dtype="f8", external=[(str(other), 0, 800)])
    assert "the numbers of v lie in other files" in _said(tmp_path / "linked.h5")
    with h5py.File(tmp_path / "virtual.h5", "w") as file:
        layout = h5py.VirtualLayout(shape=(100,), dtype="f8")
        layout[:] = h5py.VirtualSource("linked.h5", "v", shape=(100,))
        file.create_virtual_dataset("v", layout)
    assert "the numbers of v lie in other files" in _said(tmp_path / "virtual.h5")


def test_datasets_without_number_are_not_compared_with_one_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import h5py

    monkeypatch.setattr(hdf5, "MOST_COLUMNS", 8)
    with h5py.File(tmp_path / "many.h5", "w") as file:
        for k in range(9):
            file[f"v{k}"] = 1.0
    assert "more than 8 datasets" in _said(tmp_path / "many.h5")


def test_a_pipe_a_device_and_a_link_to_itself_are_no_recordings(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "loop.csv").symlink_to(tmp_path / "loop.csv")
    assert "a pipe or a device" in _said(tmp_path / "pipe.csv")
    assert "a pipe or a device" in _said(Path("/dev/zero"))
    assert "symbolic links" in _said(tmp_path / "loop.csv")


@pytest.mark.parametrize("count", ["²", "9" * 5000, "-1", "1e3", ""])
def test_a_count_that_is_none_is_no_crash(count: str, tmp_path: Path) -> None:
    path = tmp_path / "run.dat"
    path.write_text(f"# DIM = {count}\n# SEPARATOR = {count}\n# END_HEADER\n{ROWS}")
    assert f"DIM is {count[:100]}" in _said(path)
    head = "***End_of_Header***\nChannels\t1\n" + f"Samples\t{count}\n" + "***End_of_Header***\n"
    path.write_text("LabVIEW Measurement\t\n" + head + "X_Value\tv [V]\n" + "0\t1\n1\t2\n")
    assert read_table(path).rows == 2


def test_a_message_stays_a_message_whatever_names_it_holds() -> None:
    error = PiezoidError("\x1b[31mred\udcff" + "x" * 10**6, needed="a\u202eb", remedy="c\nd")
    assert len(str(error)) < 3000
    assert str(error).startswith("\\x1b[31mred\\udcff")
    assert error.needed == "a\\u202eb"
    assert error.remedy == "c\nd"


def test_a_file_name_of_bytes_that_are_no_text_is_shown(tmp_path: Path) -> None:
    path = tmp_path / os.fsdecode(b"\xff.csv")
    path.write_text(HEADED + ROWS)
    assert open_source(path).name == "\\xff.csv"
    with pytest.raises(UnreadableFileError, match=r"\\udcfe"):
        read_table(tmp_path / os.fsdecode(b"\xfe.csv"))
