"""One pass over all pieces: the triangle of [J | e] of every block of time.

All that is carried from chunk to chunk are the states of the plays and of the filters, and the
triangle of the block that is being gathered. Blocks are followed side by side, in threads or on
other machines: the extremes that each leaves of its drive hand the states over, and triangles are
added up (TSQR). The numbers do not depend on who follows which.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np

from piezoid.identification.hysteresis.coordinates import Coordinates
from piezoid.identification.hysteresis.pieces import Piece
from piezoid.identification.hysteresis.rows import chain_of, column_places, empty_block, finished
from piezoid.identification.streamed.stream import Stream
from piezoid.identification.streamed.thinned import Thinned, window_of
from piezoid.numerics.arrays import Array
from piezoid.numerics.triangle import empty_triangle, gather
from piezoid.operators.chain import Following, Samples
from piezoid.operators.play import LastingExtremes

BATCH = 2048  # rows factorised together


Item = TypeVar("Item")
Result = TypeVar("Result")
Spread = Callable[[Callable[[Any], Any], Sequence[Any]], Iterable[Any]]


@dataclass(frozen=True, kw_only=True, eq=False)
class Part:
    """A stretch of a piece that can be followed without what lies before it.

    piece        its number
    begin, stop  samples whose rows it has
    reads_from   first sample that is read: the lag and the filters reach back as far
    before       drive that stands for all samples before that one
    """

    piece: int
    begin: int
    stop: int
    reads_from: int = 0
    before: Array = field(default_factory=lambda: np.empty(0))


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
    workers        parts that are run side by side here
    held           names of shared numbers that may not move, such as ``gap``
    thinned        of each stream what its rows need, or nothing: then all of it is passed over
    lag_s          limits of the lag for which what is thinned suffices
    spread         does work on items elsewhere, returns its results in their order; None: here
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
    spread: Spread | None = None

    @cached_property
    def parts(self) -> list[Part]:
        """All blocks of all pieces, each with what stands for the drive before it.

        Every part leaves the extremes that were not wiped out, wherever it was read; a scan over
        them, the product of the clamps of all plays at once, hands the states over.
        """
        found = [part for index in range(len(self.streams)) for part in self._bare_parts(index)]
        ends = [
            after.reads_from if after.piece == part.piece else part.reads_from
            for part, after in zip(found, [*found[1:], found[0]], strict=True)
        ]
        own = (self.spread or partial(side_by_side, workers=self.workers))(
            partial(_extremes, self.streams),
            [(p.piece, p.reads_from, end) for p, end in zip(found, ends, strict=True)],
        )
        parts: list[Part] = []
        so_far = LastingExtremes()
        for part, extremes in zip(found, own, strict=True):
            if parts and part.piece != parts[-1].piece:
                so_far = LastingExtremes()
            parts.append(replace(part, before=so_far.values))
            so_far.follow(extremes)
        return parts

    def _bare_parts(self, index: int) -> list[Part]:
        stream = self.streams[index]
        reach = window_of(stream.rig, stream.rate_Hz, (0.0, self.longest_lag_s)).first
        return [
            Part(piece=index, begin=begin, stop=stop, reads_from=max(begin - reach, 0))
            for begin, stop in pairwise(self.edges[index])
        ]

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
    if task.thinned:
        numbers = range(len(task.streams))
        whole = side_by_side(partial(_thinned_blocks, theta, task), numbers, task.workers)
        return tuple(block for blocks in whole for block in blocks)
    parts, alone = task.parts, replace(task, spread=None)
    found = (task.spread or partial(side_by_side, workers=task.workers))(
        partial(_block_of, theta, alone), parts
    )
    return tuple(block for block in found if block is not None)


def side_by_side(
    work: Callable[[Item], Result], items: Iterable[Item], workers: int
) -> list[Result]:
    """Return what ``work`` makes of every item, in their order, in so many threads."""
    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(work, items))


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


def _block_of(theta: Array, task: Task, part: Part) -> Block | None:
    """Return the triangle of one block; None where it has no row."""
    gathering = _Gathering(len(column_places(task.coordinates, part.piece)) + 1)
    for _, values in rows_of_part(theta, task, part):
        gathering.add(values)
    if not gathering.rows:
        return None
    return Block(piece=part.piece, triangle=gathering.triangle(), rows=gathering.rows)


def _thinned_blocks(theta: Array, task: Task, index: int) -> list[Block]:
    """Return the triangles of all blocks of one piece."""
    edges = np.asarray(task.edges[index])
    width = len(column_places(task.coordinates, index)) + 1
    gathered_of = [_Gathering(width) for _ in edges[1:]]
    for sample, values in _thinned_rows(theta, task, index):
        cuts = np.searchsorted(sample, edges)
        for number, (low, high) in enumerate(pairwise(cuts)):
            if low < high:
                gathered_of[number].add(values[low:high])
    return [
        Block(piece=index, triangle=one.triangle(), rows=one.rows)
        for one in gathered_of
        if one.rows
    ]


def _extremes(streams: Sequence[Stream], stretch: tuple[int, int, int]) -> Array:
    """Return what a stretch of a stream leaves of itself."""
    piece, begin, stop = stretch
    found = LastingExtremes()
    if begin < stop:
        for drive, _ in streams[piece].chunks(begin, stop):
            found.follow(drive)
    return found.values


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
    whole = Part(piece=index, begin=0, stop=task.pieces[index].last)
    yield from rows_of_part(theta, task, whole)


def rows_of_part(theta: Array, task: Task, part: Part) -> Iterator[tuple[Samples, Array]]:
    """Yield the same of a part of a stream, whoever has followed what lies before it."""
    coordinates, piece, stride = task.coordinates, task.pieces[part.piece], task.stride
    chain, late = chain_of(theta, coordinates, part.piece, piece, task.sensor_pole_Hz)
    following = Following(chain, float(piece.drive[0]))
    knots = theta[coordinates.offset_slice(part.piece)]
    if len(part.before):
        nothing = empty_block(chain, 0, len(knots))
        following.rows(part.before, np.empty(0, dtype=int), nothing)
    ahead, waiting = np.empty(0, dtype=int), empty_block(chain, 0, len(knots))
    first = part.reads_from
    for drive, response in task.streams[part.piece].chunks(first, part.stop):
        end = first + len(drive)
        # What lies before a part is no source of its rows.
        begin = part.begin if first == part.reads_from else max(first + late, part.begin)
        sample = np.arange(-(-begin // stride) * stride, min(end + late, part.stop), stride)
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
