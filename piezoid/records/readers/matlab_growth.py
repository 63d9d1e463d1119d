"""How large the variables of a MATLAB file, version 5 to 7, would be: counted, and not kept."""

import struct
import zlib
from collections.abc import Iterator
from typing import BinaryIO

from piezoid.records.readers.source import Source, check_growth

_HEADER = 128
_PACKED = 15
_PIECE = 1 << 20


def check_matlab_growth(source: Source) -> None:
    """Refuse a file whose variables, those inside structures too, grow out of all proportion."""
    total = 0
    with source.open() as stream:
        for piece in _unpacked_pieces(stream):
            total += piece
            # Numbers stand in the smallest type that holds them, and come out as doubles.
            check_growth(source, 8 * total)


def _unpacked_pieces(stream: BinaryIO) -> Iterator[int]:
    """Return the bytes of each piece of the file's elements, unpacked where they are packed."""
    order = ">" if stream.read(_HEADER)[126:128] == b"MI" else "<"
    while len(tag := stream.read(8)) == 8:
        kind, size = struct.unpack(f"{order}II", tag)
        inflate = zlib.decompressobj()
        while size > 0 and (content := stream.read(min(size, _PIECE))):
            size -= len(content)
            if kind != _PACKED:
                yield len(content)
                continue
            while content and not inflate.eof:
                yield len(inflate.decompress(content, _PIECE))
                content = inflate.unconsumed_tail
