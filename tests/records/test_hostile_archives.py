"""Compressed files that expand too much and cyclic HDF5 trees are refused."""

import gzip
import io
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pytest
from pyarrow.parquet import write_table
from scipy.io import savemat

from piezoid.errors import UnreadableFileError
from piezoid.records.chunked_reader import read_thinned
from piezoid.records.lab import Acquisition, Lab
from piezoid.records.readers import read_table, reader
from piezoid.records.readers.hdf5 import SIGNATURE, check_trees
from piezoid.records.readers.reader import MAX_COLUMNS, MAX_GROWTH, growth_limit
from tests.records.formats import hdf5, mat73
from tests.records.tables import refusal_of

LAB = Lab(acquisition=Acquisition(sampling_rate_Hz=1000.0))
FREE_SIZE = 1 << 22  # a sixteenth of the limit of the product
MANY = FREE_SIZE // 8 + 1  # a double more than a file may contain


@pytest.fixture(autouse=True)
def small_free_size(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reader, "FREE_SIZE", FREE_SIZE)


def test_a_gzip_bomb_is_refused_in_proportion_to_its_size(tmp_path):
    path = tmp_path / "bomb.csv.gz"
    path.write_bytes(gzip.compress(bytes(FREE_SIZE + 1), 1, mtime=0))
    assert growth_limit(path.stat().st_size) == FREE_SIZE
    assert f"at most {FREE_SIZE} bytes" in refusal_of(path)
    assert growth_limit(10 * FREE_SIZE // MAX_GROWTH) == 10 * FREE_SIZE // MAX_GROWTH * 200


def _npz(path: Path) -> None:
    # Every column becomes doubles, also small integers.
    np.savez_compressed(path, voltage_V=np.zeros(MANY, dtype=np.int8))


def _hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file.create_dataset("v", shape=(MANY,), dtype="i1", chunks=(1 << 16,), compression="gzip")


def _unwritten_hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file.create_dataset("voltage", shape=(10**12,), dtype="f8", chunks=(1024,))


def _parquet(path: Path) -> None:
    write_table(pa.table({"voltage [V]": np.zeros(MANY)}), path)


def _matlab(path: Path) -> None:
    savemat(path, {"v": np.zeros(MANY, dtype=np.int8)}, do_compression=True)


def _matlab_structure(path: Path) -> None:
    inner = {"v": np.zeros(MANY, dtype=np.int8)}
    savemat(path, {"stage": {"a": inner}}, do_compression=True)


BOMBS: dict[str, Callable[[Path], None]] = {
    "bomb.npz": _npz,
    "bomb.h5": _hdf5,
    "unwritten.h5": _unwritten_hdf5,
    "bomb.parquet": _parquet,
    "bomb.mat": _matlab,
    "inner.mat": _matlab_structure,
}


@pytest.mark.parametrize("name", BOMBS)
def test_an_archive_that_expands_too_much_is_refused(name, tmp_path):
    path = tmp_path / name
    BOMBS[name](path)
    assert path.stat().st_size < FREE_SIZE // MAX_GROWTH
    assert "bytes once unpacked. Needed: at most" in refusal_of(path)
    if name.endswith((".h5", ".parquet")):
        with pytest.raises(UnreadableFileError, match="bytes once unpacked") as refusal:
            read_thinned([path], LAB)
        assert "--stream" not in str(refusal.value)


def test_a_compressed_text_is_read_up_to_the_limit(tmp_path):
    path = tmp_path / "run.csv.gz"
    text, rows = compressible_table(FREE_SIZE)
    path.write_bytes(gzip.compress(text, 9))
    assert path.stat().st_size < FREE_SIZE // MAX_GROWTH
    (recording,) = read_thinned([path], LAB)
    assert recording.samples == rows
    path.write_bytes(gzip.compress(text + b"\n", 9))
    with pytest.raises(UnreadableFileError, match=f"at most {FREE_SIZE} bytes") as refusal:
        read_thinned([path], LAB)
    assert "--stream" not in str(refusal.value)


def compressible_table(size: int) -> tuple[bytes, int]:
    """Return a highly compressible text of ``size`` bytes, and its number of rows."""
    heading, pair = b"voltage [V],position [um]\n", b"1.%0300d,2\n2.%0300d,1\n" % (0, 0)
    remaining = size - len(heading)
    pairs = remaining // len(pair) - 1
    last_row = b"1.%0*d,2\n" % (remaining - pairs * len(pair) - len("1.,2\n"), 0)
    return heading + pair * pairs + last_row, 2 * pairs + 1


def test_texts_of_a_parquet_file_are_not_unpacked(tmp_path):
    path = tmp_path / "run.parquet"
    rows = 3000
    texts = pa.DictionaryArray.from_arrays(np.zeros(rows, dtype=np.int32), ["x" * 1_000_000])
    write_table(pa.table({"voltage [V]": np.arange(rows) / 7, "remark": texts}), path)
    table = read_table(path)  # the complete file would be three gigabytes
    assert [column.label for column in table.columns] == ["voltage [V]"]


def test_external_numbers_and_too_many_datasets_are_refused(tmp_path):
    external = tmp_path / "other.bin"
    external.write_bytes(bytes(800))
    with h5py.File(tmp_path / "linked.h5", "w") as file:
        file.create_dataset("v", shape=(100,), dtype="f8", external=[(str(external), 0, 800)])
    assert "the numbers of v lie in other files" in refusal_of(tmp_path / "linked.h5")
    with h5py.File(tmp_path / "virtual.h5", "w") as file:
        layout = h5py.VirtualLayout(shape=(100,), dtype="f8")
        layout[:] = h5py.VirtualSource("linked.h5", "v", shape=(100,))
        file.create_virtual_dataset("v", layout)
    assert "the numbers of v lie in other files" in refusal_of(tmp_path / "virtual.h5")
    with h5py.File(tmp_path / "many.h5", "w") as file:
        for k in range(MAX_COLUMNS + 1):
            file[f"v{k}"] = 1.0
    assert f"more than {MAX_COLUMNS} datasets" in refusal_of(tmp_path / "many.h5")


def test_a_large_matlab_element_is_refused(tmp_path):
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    packed = zlib.compress(bytes(FREE_SIZE // 8 + 1))
    path = tmp_path / "bomb.mat"
    path.write_bytes(head + struct.pack("<II", 15, len(packed)) + packed)
    assert "bomb.mat: " in refusal_of(path)


def test_a_matlab_element_of_unknown_type_is_refused(tmp_path):
    """SciPy ends the process on such a file."""
    path = tmp_path / "run.mat"
    savemat(path, {"v": np.linspace(0.0, 1.0, 50)})
    content = path.read_bytes()
    tag = struct.pack("<II", 9, 400)  # of the fifty numbers
    assert tag in content
    path.write_bytes(content.replace(tag, struct.pack("<II", 82, 400)))
    assert "run.mat: it is damaged: an element has an unknown type" in refusal_of(path)


RIGHT_OFFSET = 16  # bytes of a node before the address of its right neighbour


def with_ring(path: Path, base: int) -> Path:
    """Make the first node of the first tree of a file its own neighbour."""
    content = bytearray(path.read_bytes())
    offset = content.index(b"TREE", base)
    struct.pack_into("<Q", content, offset + RIGHT_OFFSET, offset - base)
    path.write_bytes(content)
    return path


def test_a_cyclic_search_tree_is_refused_with_its_offset(tmp_path):
    hdf5(tmp_path / "run.h5")
    mat73(tmp_path / "run.mat")
    for path in (with_ring(tmp_path / "run.h5", 0), with_ring(tmp_path / "run.mat", 512)):
        offset = path.read_bytes().index(b"TREE")
        assert f"the search tree at byte {offset} leads round in a ring" in refusal_of(path)
    with pytest.raises(UnreadableFileError, match="in a ring"):
        read_thinned([tmp_path / "run.h5"], Lab())


def tree_node(right: int, width: int = 8) -> bytes:
    return b"TREE\x00\x00\x01\x00" + bytes(width) + right.to_bytes(width, "little")


def file_of_nodes(*nodes: bytes, version: int = 0, width: int = 8) -> io.BytesIO:
    """Return a header with the width of addresses, and nodes from byte 40."""
    widths = bytes([version, width]) if version > 1 else bytes([version, 0, 0, 0, 0, width])
    return io.BytesIO((SIGNATURE + widths).ljust(40, b"\x00") + b"".join(nodes))


@pytest.mark.parametrize(("version", "width"), [(0, 8), (1, 4), (2, 8), (3, 2)])
def test_only_a_cycle_of_nodes_is_refused(version, width):
    size = 8 + 2 * width
    no_address = 2 ** (8 * width) - 1  # the address of no node
    right = (40 + size, 40 + 2 * size, no_address)
    nodes = [tree_node(address, width) for address in right]
    check_trees(file_of_nodes(*nodes, version=version, width=width))
    nodes[2] = tree_node(40 + size, width)
    with pytest.raises(ValueError, match=f"at byte {40 + size} leads"):
        check_trees(file_of_nodes(*nodes, version=version, width=width))


def test_a_cycle_across_blocks_of_the_file_is_refused():
    """The reader searches a file in blocks of a mebibyte."""
    for distance in range(0, 70, 3):
        first = (1 << 20) - distance
        ring = tree_node(first + 24)
        with pytest.raises(ValueError, match=f"at byte {first + 24} leads"):
            check_trees(file_of_nodes(bytes(first - 40), ring, ring, b"TREE"))


def test_a_file_of_many_groups_and_chunks_is_read(tmp_path):
    path = tmp_path / "many.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("voltage", data=np.arange(20_000.0), chunks=(10,))
        for k in range(100):
            file.create_group(f"empty {k}")
    assert path.read_bytes().count(b"TREE") > 10
    assert read_table(path).rows == 20_000
