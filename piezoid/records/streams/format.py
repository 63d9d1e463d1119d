"""BlockFormat: the contract of one format that is read in blocks, and how blocks are cut."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piezoid.records.readers.foreign import table_of
from piezoid.records.readers.reader import Reader
from piezoid.records.readers.source import Source
from piezoid.records.table import RawTable

Arrays = Mapping[str, NDArray[Any]]


@dataclass(frozen=True, kw_only=True)
class BlockFormat:
    """One format.

    reader  the reader of whole files of this format: the same file is recognised alike
    blocks  yields a file's table in parts of about so many rows. Every part begins with the last
            row of the part before, so that a gap between two parts is seen inside one.
    unpacks whether a file compressed by gzip is read as well: from front to back, without leaps
    """

    reader: Reader
    blocks: Callable[[Source, int], Iterator[RawTable]]
    unpacks: bool = False


def recut(pieces: Iterable[Arrays], rows: int) -> Iterator[tuple[int, Arrays]]:
    """Cut a sequence of pieces of any length into blocks of ``rows`` (>= 2) to ``2 rows`` rows.

    Yields the number of the block's first row, and the block; each block after the first begins
    with the last row of the one before.
    """
    held: Arrays = {}
    first, begun = 0, False
    for piece in pieces:
        held = _joined(held, piece) if held else piece
        while _length(held) >= 2 * rows:
            yield first, _part(held, slice(0, rows))
            held = _part(held, slice(rows - 1, None))
            first, begun = first + rows - 1, True
    if _length(held) > int(begun):
        yield first, held


def tables_of(
    source: Source,
    format_name: str,
    blocks: Iterable[tuple[int, Arrays]],
    *,
    units: Mapping[str, str] | None = None,
    sampling_rate_Hz: float | None = None,
) -> Iterator[RawTable]:
    """Make a table of every block as the format's reader makes one of the whole file."""
    for first_row, arrays in blocks:
        table = table_of(
            source, format_name, arrays, units=units, sampling_rate_Hz=sampling_rate_Hz
        )
        yield replace(table, first_row=first_row)


def _length(arrays: Arrays) -> int:
    return max((len(values) for values in arrays.values()), default=0)


def _joined(before: Arrays, after: Arrays) -> Arrays:
    return {name: np.concatenate([before[name], after[name]]) for name in before}


def _part(arrays: Arrays, rows: slice) -> Arrays:
    return {name: values[rows] for name, values in arrays.items()}
