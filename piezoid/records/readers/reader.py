"""Reader: the protocol of one file format, and how rows are cut into chunks."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piezoid.records.readers.source import Source
from piezoid.records.table import RawTable

Arrays = Mapping[str, NDArray[Any]]


@dataclass(frozen=True, kw_only=True)
class Reader:
    """One file format.

    name         as `piezoid inspect` shows it
    suffixes     the usual endings of its files, for the documentation and for messages
    recognises   tells from the first bytes (between similar formats, the suffix) whether a file
                 has this format
    read         reads the file; anything wrong with it is an ``UnreadableFileError``
    read_chunks  yields the table in chunks of about the given number of rows, None where the
                 format is only read whole. Every chunk begins with the last row of the chunk
                 before, so that a gap between two chunks lies inside one of them.
    reads_gzip   whether chunks are also read from a file that gzip compressed: from front to
                 back, without seeking
    extra        the extra of the installation that the reader needs, empty for none
    is_written   whether ``separator``, ``decimal`` and ``heading_row`` of lab.toml apply
    """

    name: str
    suffixes: tuple[str, ...]
    recognises: Callable[[Source], bool]
    read: Callable[[Source], RawTable]
    read_chunks: Callable[[Source, int], Iterator[RawTable]] | None = None
    reads_gzip: bool = False
    extra: str = ""
    is_written: bool = False


def overlapping_chunks(pieces: Iterable[Arrays], rows: int) -> Iterator[tuple[int, Arrays]]:
    """Cut arrays that arrive in pieces of any length into chunks of ``rows`` to ``2 rows`` rows.

    Yields the number of the chunk's first row, and the chunk; each chunk after the first begins
    with the last row of the chunk before. ``rows`` is at least 2.
    """
    pending: Arrays = {}
    first, repeats = 0, False
    for piece in pieces:
        pending = _concatenated(pending, piece) if pending else piece
        while _length(pending) >= 2 * rows:
            yield first, _rows(pending, slice(0, rows))
            pending = _rows(pending, slice(rows - 1, None))
            first, repeats = first + rows - 1, True
    if _length(pending) > int(repeats):
        yield first, pending


def _length(arrays: Arrays) -> int:
    return max((len(values) for values in arrays.values()), default=0)


def _concatenated(before: Arrays, after: Arrays) -> Arrays:
    return {name: np.concatenate([before[name], after[name]]) for name in before}


def _rows(arrays: Arrays, rows: slice) -> Arrays:
    return {name: values[rows] for name, values in arrays.items()}
