"""Packed files that would be large, and HDF5 trees that never end: refused in time."""

import gzip
import io
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from piezoid.errors import UnreadableFileError
from piezoid.records.chunked_reader import read_thinned
from piezoid.records.lab import Acquisition, Lab
from piezoid.records.readers import read_table, source
from piezoid.records.readers.hdf5 import SIGNATURE, check_trees
from piezoid.records.readers.source import MAX_COLUMNS, MAX_GROWTH, growth_limit
from tests.records.formats import hdf5, mat73
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


RIGHT_AT = 16  # bytes of a node before the address of its right neighbour


def _ringed(path: Path, base: int) -> Path:
    """Let the first node of a file's first tree name itself as its neighbour."""
    content = bytearray(path.read_bytes())
    place = content.index(b"TREE", base)
    content[place + RIGHT_AT : place + RIGHT_AT + 8] = (place - base).to_bytes(8, "little")
    path.write_bytes(content)
    return path


def test_a_tree_that_leads_round_in_a_ring_is_refused_by_its_place(tmp_path: Path) -> None:
    hdf5(tmp_path / "run.h5")
    mat73(tmp_path / "run.mat")
    for path in (_ringed(tmp_path / "run.h5", 0), _ringed(tmp_path / "run.mat", 512)):
        place = path.read_bytes().index(b"TREE")
        assert f"the search tree at byte {place} leads round in a ring" in said(path)
    with pytest.raises(UnreadableFileError, match="in a ring"):
        read_thinned([tmp_path / "run.h5"], Lab())


def _node(right: int, width: int = 8) -> bytes:
    return b"TREE\x00\x00\x01\x00" + bytes(width) + right.to_bytes(width, "little")


def _file(*nodes: bytes, version: int = 0, width: int = 8) -> io.BytesIO:
    """A head that names the width of an address, and nodes, the first of them at byte 40."""
    widths = bytes([version, width]) if version > 1 else bytes([version, 0, 0, 0, 0, width])
    return io.BytesIO((SIGNATURE + widths).ljust(40, b"\x00") + b"".join(nodes))


@pytest.mark.parametrize(("version", "width"), [(0, 8), (1, 4), (2, 8), (3, 2)])
def test_a_ring_of_several_nodes_is_found_and_a_row_that_ends_is_none(
    version: int, width: int
) -> None:
    size = 8 + 2 * width
    last = 2 ** (8 * width) - 1  # the address of no node
    row = [_node(40 + size, width), _node(40 + 2 * size, width), _node(last, width)]
    check_trees(_file(*row, version=version, width=width))
    row[2] = _node(40 + size, width)
    with pytest.raises(ValueError, match=f"at byte {40 + size} leads"):
        check_trees(_file(*row, version=version, width=width))


def test_a_node_is_found_wherever_the_pieces_of_a_file_part_it() -> None:
    """A file is searched a mebibyte at a time."""
    for before in range(0, 70, 3):
        first = (1 << 20) - before
        ring = _node(first + 24)
        with pytest.raises(ValueError, match=f"at byte {first + 24} leads"):
            check_trees(_file(bytes(first - 40), ring, ring, b"TREE"))


def test_a_file_of_many_groups_and_pieces_is_read(tmp_path: Path) -> None:
    path = tmp_path / "many.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("voltage", data=np.arange(20_000.0), chunks=(10,))
        for k in range(100):
            file.create_group(f"empty {k}")
    assert path.read_bytes().count(b"TREE") > 10
    assert read_table(path).rows == 20_000
