"""Packed files that would be large: refused in proportion, before memory or disk is gone."""

import gzip
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from piezoid.errors import UnreadableFileError
from piezoid.records.chunked_reader import read_thinned
from piezoid.records.lab import Acquisition, Lab
from piezoid.records.readers import read_table, source
from piezoid.records.readers.source import MAX_COLUMNS, MAX_GROWTH, growth_limit
from tests.records.tables import said

LAB = Lab(acquisition=Acquisition(sampling_rate_Hz=1000.0))
FREE_SIZE = 1 << 22  # a sixteenth of that of the product, to be quick
MANY = FREE_SIZE // 8 + 1  # one double more than any file may hold


@pytest.fixture(autouse=True)
def small_free_size(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(source, "FREE_SIZE", FREE_SIZE)


def test_a_gzip_bomb_is_refused_in_proportion_to_its_size(tmp_path: Path) -> None:
    path = tmp_path / "bomb.csv.gz"
    path.write_bytes(gzip.compress(bytes(FREE_SIZE + 1), 1, mtime=0))
    assert growth_limit(path.stat().st_size) == FREE_SIZE
    assert f"at most {FREE_SIZE} bytes" in said(path)
    assert growth_limit(10 * FREE_SIZE // MAX_GROWTH) == 10 * FREE_SIZE // MAX_GROWTH * 200


def _npz(path: Path) -> None:
    # Of small integers too: every column becomes doubles.
    np.savez_compressed(path, voltage_V=np.zeros(MANY, dtype=np.int8))


def _hdf5(path: Path) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        file.create_dataset("v", shape=(MANY,), dtype="i1", chunks=(1 << 16,), compression="gzip")


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


BOMBS: dict[str, Callable[[Path], None]] = {
    "bomb.npz": _npz,
    "bomb.h5": _hdf5,
    "unwritten.h5": _unwritten_hdf5,
    "bomb.parquet": _parquet,
    "bomb.mat": _matlab,
    "inner.mat": _matlab_structure,
}


@pytest.mark.parametrize("name", BOMBS)
def test_an_archive_that_grows_out_of_proportion_is_refused(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    BOMBS[name](path)
    assert path.stat().st_size < FREE_SIZE // MAX_GROWTH
    assert "bytes once unpacked. Needed: at most" in said(path)
    if name.endswith((".h5", ".parquet")):  # in chunks no memory is lost, but the disk and the day
        expected = pytest.raises(UnreadableFileError, match="bytes once unpacked")
        with expected as told:
            read_thinned([path], LAB)
        assert "--stream" not in str(told.value)


def test_a_packed_text_is_read_in_blocks_up_to_its_limit(tmp_path: Path) -> None:
    path = tmp_path / "run.csv.gz"
    text, rows = _steady(FREE_SIZE)
    path.write_bytes(gzip.compress(text, 9))
    assert path.stat().st_size < FREE_SIZE // MAX_GROWTH
    (recording,) = read_thinned([path], LAB)
    assert recording.samples == rows
    path.write_bytes(gzip.compress(text + b"\n", 9))
    expected = pytest.raises(UnreadableFileError, match=f"at most {FREE_SIZE} bytes")
    with expected as told:
        read_thinned([path], LAB)
    assert "--stream" not in str(told.value)


def _steady(size: int) -> tuple[bytes, int]:
    """Return a text of so many bytes that packs to almost nothing, and how many rows it has."""
    heading, pair = b"voltage [V],position [um]\n", b"1.%0300d,2\n2.%0300d,1\n" % (0, 0)
    rest = size - len(heading)
    pairs = rest // len(pair) - 1
    last = b"1.%0*d,2\n" % (rest - pairs * len(pair) - len("1.,2\n"), 0)
    return heading + pair * pairs + last, 2 * pairs + 1


def test_texts_beside_the_numbers_of_a_parquet_file_are_never_unpacked(tmp_path: Path) -> None:
    import pyarrow as pa
    from pyarrow.parquet import write_table

    path = tmp_path / "run.parquet"
    rows = 3000
    texts = pa.DictionaryArray.from_arrays(np.zeros(rows, dtype=np.int32), ["x" * 1_000_000])
    write_table(pa.table({"voltage [V]": np.arange(rows) / 7, "remark": texts}), path)
    table = read_table(path)  # all of it would be three gigabytes
    assert [column.label for column in table.columns] == ["voltage [V]"]


def test_numbers_that_lie_in_other_files_are_not_fetched(tmp_path: Path) -> None:
    import h5py

    other = tmp_path / "other.bin"
    other.write_bytes(bytes(800))
    with h5py.File(tmp_path / "linked.h5", "w") as file:
        file.create_dataset("v", shape=(100,), dtype="f8", external=[(str(other), 0, 800)])
    assert "the numbers of v lie in other files" in said(tmp_path / "linked.h5")
    with h5py.File(tmp_path / "virtual.h5", "w") as file:
        layout = h5py.VirtualLayout(shape=(100,), dtype="f8")
        layout[:] = h5py.VirtualSource("linked.h5", "v", shape=(100,))
        file.create_virtual_dataset("v", layout)
    assert "the numbers of v lie in other files" in said(tmp_path / "virtual.h5")


def test_datasets_without_number_are_not_compared_with_one_another(tmp_path: Path) -> None:
    import h5py

    with h5py.File(tmp_path / "many.h5", "w") as file:
        for k in range(MAX_COLUMNS + 1):
            file[f"v{k}"] = 1.0
    assert f"more than {MAX_COLUMNS} datasets" in said(tmp_path / "many.h5")


def test_a_matlab_element_is_measured_without_being_kept(tmp_path: Path) -> None:
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    packed = zlib.compress(bytes(FREE_SIZE // 8 + 1))
    path = tmp_path / "bomb.mat"
    path.write_bytes(head + struct.pack("<II", 15, len(packed)) + packed)
    assert "bomb.mat: " in said(path)
