"""Whether the search trees of an HDF5 file end.

The nodes of a tree of the first kind name their neighbours. The library follows these names
without counting, and in compiled code, which nothing interrupts: from a damaged file whose node
names itself it never comes back. So the names are followed here first.
"""

from collections.abc import Iterator, Mapping
from typing import BinaryIO

SIGNATURE = b"\x89HDF\r\n\x1a\n"
_NODE = b"TREE"
_LINKS_AT = 8  # bytes of a node before the addresses of its left and its right neighbour
_FIRST_BASE = 512  # the file begins at 0 or, behind words of others, at 512, 1024, 2048 ...
_PIECE = 1 << 20


def check_trees(stream: BinaryIO) -> None:
    """Raise ``ValueError`` where a tree's nodes lead round in a ring."""
    base = _base(stream)
    stream.seek(base)
    head = stream.read(len(SIGNATURE) + 6)
    if len(head) < len(SIGNATURE) + 6:
        return  # the library says itself that this is no such file
    # Superblocks of version 2 and later have the width of an address where others have versions.
    width = head[13] if head[8] < 2 else head[9]
    ring = _ring(dict(_neighbours(stream, base, width)))
    if ring is not None:
        raise ValueError(f"the search tree at byte {base + ring} leads round in a ring")


def _base(stream: BinaryIO) -> int:
    """Return where the file's own bytes begin, from which its addresses count."""
    size = stream.seek(0, 2)
    base = 0
    while base < size:
        stream.seek(base)
        if stream.read(len(SIGNATURE)) == SIGNATURE:
            return base
        base = 2 * base or _FIRST_BASE
    return size


def _neighbours(stream: BinaryIO, base: int, width: int) -> Iterator[tuple[int, int]]:
    """Yield the address of each node, and that of its right neighbour."""
    length = _LINKS_AT + 2 * width
    stream.seek(base)
    held, address = b"", 0
    while piece := stream.read(_PIECE):
        held += piece
        place = held.find(_NODE)
        while 0 <= place <= len(held) - length:
            right = held[place + length - width : place + length]
            yield address + place, int.from_bytes(right, "little")
            place = held.find(_NODE, place + 1)
        done = max(len(held) - length, 0) if place < 0 else place
        held, address = held[done:], address + done


def _ring(right: Mapping[int, int]) -> int | None:
    """Return a node from which one comes round in a ring, None where every way ends."""
    known: set[int] = set()
    for first in right:
        way: set[int] = set()
        node = first
        while node in right and node not in known:
            if node in way:
                return node
            way.add(node)
            node = right[node]
        known |= way
    return None
