"""A damaged HDF5 file ends the reading of it: trees that lead round in a ring are refused."""

import io
from pathlib import Path

import h5py
import numpy as np
import pytest

from piezoid.errors import UnreadableFileError
from piezoid.records.chunked_reader import read_thinned
from piezoid.records.lab import Lab
from piezoid.records.readers import read_table
from piezoid.records.readers.hdf5 import SIGNATURE, check_trees
from tests.records.formats import hdf5, mat73
from tests.records.tables import said

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
