"""One pass over all pieces: the triangle of [J | e] of every block of time.

All that is carried from chunk to chunk are the states of the plays and of the filters, and the
triangle of the block that is being gathered. Pieces are independent of each other and may be run
side by side; the numbers do not depend on how many are.
"""

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial

import numpy as np

from piezoid.identification.hysteresis.coordinates import Coordinates
from piezoid.identification.hysteresis.pieces import Piece
from piezoid.identification.hysteresis.rows import chain_of, column_places, empty_block, finished
from piezoid.identification.streamed.stream import Stream
from piezoid.identification.streamed.thinned import Thinned
from piezoid.numerics.arrays import Array
from piezoid.numerics.triangle import empty_triangle, gather
from piezoid.operators.chain import Following, Samples

BATCH = 2048  # rows factorised together


@dataclass(frozen=True, kw_only=True, eq=False)
class Task:
    """What is to be minimised.

    streams        the data
    pieces         the same, as the formulas know them: first sample, length, rate
    edges          of each piece: where its blocks begin, and its length
    coordinates    what the vector means
    sensor_pole_Hz declared pole behind the operator, or None
    stride         every how many rows count; states see every sample
    longest_lag_s  upper bound of the lag
    workers        pieces that are run side by side
    held           names of shared numbers that may not move, such as ``gap``
    thinned        of each stream what its rows need, or nothing: then all of it is passed over
    lag_s          limits of the lag for which what is thinned suffices
    """

    streams: Sequence[Stream]
    pieces: Sequence[Piece]
    edges: Sequence[Sequence[int]]
    coordinates: Coordinates
    sensor_pole_Hz: float | None
    stride: int
    longest_lag_s: float
    workers: int = 1
    held: tuple[str, ...] = ()
    thinned: Sequence[Thinned] = ()
    lag_s: tuple[float, float] = (0.0, np.inf)

    def bounds(self) -> tuple[Array, Array]:
        """Return lower and upper bounds of every number."""
        lower, upper = self.coordinates.bounds(min(self.longest_lag_s, self.lag_s[1]))
        lower[self.coordinates.slices["lag"]] = self.lag_s[0]
        return lower, upper


@dataclass(frozen=True, kw_only=True, eq=False)
class Block:
    """Some rows of one piece, as least squares needs them.

    piece     its number
    triangle  of [tangents, as ``column_places`` says | residual]
    rows      how many
    """

    piece: int
    triangle: Array
    rows: int

    def wide(self, coordinates: Coordinates) -> Array:
        """Return the triangle with a column for every number of the vector, and the residual."""
        wide = np.zeros((len(self.triangle), coordinates.total + 1), order="F")
        wide[:, column_places(coordinates, self.piece)] = self.triangle[:, :-1]
        wide[:, -1] = self.triangle[:, -1]
        return wide


def blocks_of(theta: Array, task: Task) -> tuple[Block, ...]:
    """Return the blocks of all pieces, in their order."""
    numbers = range(len(task.streams))
    if task.workers == 1 or len(numbers) == 1:
        found = [_piece_blocks(theta, task, index) for index in numbers]
    else:
        with ThreadPoolExecutor(task.workers) as side_by_side:
            found = list(side_by_side.map(partial(_piece_blocks, theta, task), numbers))
    return tuple(block for blocks in found for block in blocks)


def rms_of(blocks: Sequence[Block]) -> float:
    """Return the rms of the residual: a triangle keeps the length of its columns."""
    squares = sum(float(block.triangle[:, -1] @ block.triangle[:, -1]) for block in blocks)
    return float(np.sqrt(squares / sum(block.rows for block in blocks)))


def gathered(blocks: Sequence[Block], coordinates: Coordinates) -> Array:
    """Return the triangle of all blocks."""
    whole = empty_triangle(coordinates.total + 1)
    for block in blocks:
        whole = gather(whole, block.wide(coordinates))
    return whole


def _piece_blocks(theta: Array, task: Task, index: int) -> list[Block]:
    inner = np.asarray(task.edges[index][1:-1])
    width = len(column_places(task.coordinates, index)) + 1
    gathering, now = _Gathering(width), 0
    found: list[Block] = []

    def close() -> None:
        nonlocal gathering
        if gathering.rows:
            triangle = gathering.triangle()
            found.append(Block(piece=index, triangle=triangle, rows=gathering.rows))
        gathering = _Gathering(width)

    for sample, values in rows_of_stream(theta, task, index):
        owner = np.searchsorted(inner, sample, side="right")
        for block in np.unique(owner):
            if block != now:
                close()
                now = int(block)
            gathering.add(values[owner == block])
    close()
    return found


class _Gathering:
    """The triangle of the rows of one block, while they pass.

    Memory that was forgotten and knots that are far away are columns of zeros, which are most of
    the work: only columns that were ever anything else are reflected.
    """

    def __init__(self, width: int) -> None:
        self._width = width
        self._seen = np.zeros(width, dtype=bool)
        self._triangle = empty_triangle(0)
        self._waiting: list[Array] = []
        self._count = 0
        self.rows = 0

    def add(self, rows: Array) -> None:
        self._waiting.append(rows)
        self._count += len(rows)
        self.rows += len(rows)
        if self._count >= BATCH:
            self._reflect()

    def triangle(self) -> Array:
        self._reflect()
        return _among(self._triangle, np.flatnonzero(self._seen), self._width)

    def _reflect(self) -> None:
        if not self._count:
            return
        rows = np.vstack(self._waiting)
        before, seen = np.flatnonzero(self._seen), self._seen | rows.any(axis=0)
        if len(before) < np.count_nonzero(seen):
            places = np.searchsorted(np.flatnonzero(seen), before)
            self._triangle = _among(self._triangle, places, int(np.count_nonzero(seen)))
            self._seen = seen
        used = np.asfortranarray(rows[:, self._seen])
        self._triangle = gather(self._triangle, used, spend=True)
        self._waiting, self._count = [], 0


def _among(triangle: Array, places: Samples, width: int) -> Array:
    """Return a triangle with columns, and rows, of zeros between its own."""
    wide = empty_triangle(width)
    wide[np.ix_(places, places)] = triangle
    return wide


def rows_of_stream(theta: Array, task: Task, index: int) -> Iterator[tuple[Samples, Array]]:
    """Yield the samples of the rows that count, and [tangents | residual], chunk by chunk."""
    if task.thinned:
        yield from _thinned_rows(theta, task, index)
        return
    coordinates, piece, stride = task.coordinates, task.pieces[index], task.stride
    chain, late = chain_of(theta, coordinates, index, piece, task.sensor_pole_Hz)
    following = Following(chain, float(piece.drive[0]))
    knots = theta[coordinates.offset_slice(index)]
    ahead, waiting = np.empty(0, dtype=int), empty_block(chain, 0, len(knots))
    first = 0
    for drive, response in task.streams[index].chunks():
        end = first + len(drive)
        begin = 0 if first == 0 else first + late
        sample = np.arange(-(-begin // stride) * stride, min(end + late, piece.last), stride)
        block = empty_block(chain, len(sample), len(knots))
        following.rows(drive, np.maximum(sample - late, 0) - first, block)
        # What is answered late belongs to a sample that may not have been read yet.
        if len(ahead):
            sample, block = np.concatenate([ahead, sample]), np.vstack([waiting, block])
        count = int(np.searchsorted(sample, end))
        ahead, waiting = sample[count:], block[count:]
        sample, measured = sample[:count], response[sample[:count] - first]
        rows = finished(block[:count], sample, measured, coordinates, knots, piece)
        yield rows.sample, rows.block
        first = end


def _thinned_rows(theta: Array, task: Task, index: int) -> Iterator[tuple[Samples, Array]]:
    """Yield what ``rows_of_stream`` yields, from what is left of the stream."""
    coordinates, piece, left = task.coordinates, task.pieces[index], task.thinned[index]
    chain, late = chain_of(theta, coordinates, index, piece, task.sensor_pole_Hz)
    following = Following(chain, float(piece.drive[0]))
    knots = theta[coordinates.offset_slice(index)]
    source, before = left.source(late), 0
    for first in range(0, len(source), BATCH):
        part = slice(first, first + BATCH)
        block = empty_block(chain, len(source[part]), len(knots))
        end = int(source[part][-1]) + 1
        following.rows(left.drive[before:end], source[part] - before, block)
        before = end
        rows = finished(block, left.sample[part], left.response[part], coordinates, knots, piece)
        yield rows.sample, rows.block
