"""Kuhnen's program on one triangle: every order, both halves, the choice among them.

    E[k] = sum_i w_i z_i[k] - sum_j w'_j s_j(y[k + lag]) + c_p[k]

c_p is the zero of a piece: a constant, or knots joined by straight lines where it may move.

The columns of all orders are gathered in one pass, one triangle for each half of the data. The
triangle of some of the columns is made of the same columns of R, and that of both halves is
gathered from the two, so that trying an order costs no further look at the data.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezoid.identification.hysteresis.coordinates import Shape
from piezoid.identification.hysteresis.order import CLOSE, ORDERS
from piezoid.identification.hysteresis.placement import group_centres
from piezoid.identification.hysteresis.rows import offset_columns
from piezoid.identification.hysteresis.start import (
    Start,
    optimum_of,
    placed_zones,
    recentred,
)
from piezoid.identification.streamed.stream import Stream
from piezoid.numerics.arrays import Array
from piezoid.numerics.quadratic_program import Optimum
from piezoid.numerics.triangle import empty_triangle, gather
from piezoid.operators.dead_zone import DeadZones
from piezoid.operators.play import play_columns


@dataclass(frozen=True, kw_only=True, eq=False)
class Grid:
    """The columns of all orders.

    threshold  (plays,)  scaled, from 0
    zone       (zones,)  scaled, with 0 among them
    knots      (pieces,) of each piece's zero
    """

    threshold: Array
    zone: Array
    knots: tuple[int, ...]

    @property
    def columns(self) -> int:
        """How many columns plays and dead zones have; those of the zeros follow."""
        return len(self.threshold) + len(self.zone)

    @property
    def width(self) -> int:
        """How many columns there are."""
        return self.columns + sum(self.knots)

    def zeros_of(self, piece: int) -> slice:
        """Return where the zero of a piece stands."""
        first = self.columns + sum(self.knots[:piece])
        return slice(first, first + self.knots[piece])

    def places(self, threshold: Array, zone: Array) -> NDArray[np.int_]:
        """Return which columns an order uses, with the zeros of all pieces."""
        plays = np.searchsorted(self.threshold, threshold)
        zones = len(self.threshold) + np.searchsorted(self.zone, zone)
        return np.concatenate([plays, zones, np.arange(self.columns, self.width)])


@dataclass(frozen=True, kw_only=True, eq=False)
class Tried:
    """One order and what its program left on the half it did not see.

    shape     what was fitted
    held_out  rms of E there, in units of half the drive's range
    """

    shape: Shape
    held_out: float


def thresholds_of(plays: int) -> Array:
    """Return evenly spread thresholds, from 0."""
    return np.asarray(np.arange(plays + 1) / (plays + 1))


def grid_of(
    streams: Sequence[Stream],
    knots: tuple[int, ...],
    orders: Sequence[tuple[int, int]] = ORDERS,
) -> Grid:
    """Return the union of the thresholds of all orders."""
    low, high = _limits(streams)
    shapes = [Shape(plays=plays, below=zones, above=zones) for plays, zones in orders]
    return Grid(
        threshold=np.unique(np.concatenate([thresholds_of(s.plays) for s in shapes])),
        zone=np.unique(np.concatenate([placed_zones(low, high, s) for s in shapes])),
        knots=knots,
    )


def _limits(streams: Sequence[Stream]) -> tuple[float, float]:
    ends = [
        (metres - stream.centre_m) / stream.scales.displacement_m
        for stream in streams
        for metres in stream.held.displacement_m
    ]
    return min(ends), max(ends)


def halves(
    streams: Sequence[Stream], grid: Grid, lag_s: float, *, rows: int
) -> tuple[tuple[Array, int], tuple[Array, int]]:
    """Return triangle and rows of both halves: by turns of recordings, or of the only one.

    rows  at most about so many in all; the states of the plays see every sample
    """
    numbers = sorted({stream.held.recording for stream in streams})
    stride = max(1, sum(stream.samples for stream in streams) // rows)
    found = [(empty_triangle(grid.width), 0), (empty_triangle(grid.width), 0)]
    for index, stream in enumerate(streams):
        piece = stream.described()
        for first, sample, rows_here in _blocks(stream, grid, lag_s, stride):
            late = int(first >= stream.samples // 2)
            half = numbers.index(stream.held.recording) % 2 if len(numbers) > 1 else late
            wide = np.zeros((len(sample), grid.width), order="F")
            wide[:, : grid.columns] = rows_here
            wide[:, grid.zeros_of(index)] = offset_columns(sample, piece, grid.knots[index])
            triangle, count = found[half]
            found[half] = gather(triangle, wide), count + len(wide)
    return found[0], found[1]


def _blocks(
    stream: Stream, grid: Grid, lag_s: float, stride: int
) -> Iterator[tuple[int, NDArray[np.int_], Array]]:
    """Yield first sample, samples and rows [z | -s(y later by the lag)] of every chunk.

    Behind the last sample the displacement stays where it is.
    """
    unit = DeadZones(threshold=grid.zone, weight=np.ones(len(grid.zone)))
    later = lag_s * stream.rate_Hz
    reach = int(np.ceil(later))
    memory: Array | None = None
    held_u, held_y, first = np.empty(0), np.empty(0), 0
    for drive, response in stream.chunks():
        held_u, held_y = np.concatenate([held_u, drive]), np.concatenate([held_y, response])
        is_last = first + len(held_u) == stream.samples
        rows = len(held_u) if is_last else len(held_u) - reach
        if rows <= 0:
            continue
        memory = np.full(len(grid.threshold), held_u[0]) if memory is None else memory
        states, memory = play_columns(held_u[:rows], grid.threshold, memory)
        place = np.arange(-first % stride, rows, stride)
        advanced = np.interp(place + later, np.arange(len(held_y)), held_y)
        yield first, first + place, np.hstack([states[place], -unit.columns(advanced)])
        first, held_u, held_y = first + rows, held_u[rows:], held_y[rows:]


def choose(
    streams: Sequence[Stream],
    grid: Grid,
    parts: tuple[tuple[Array, int], tuple[Array, int]],
    orders: Sequence[tuple[int, int]] = ORDERS,
) -> tuple[Shape, tuple[Tried, ...]]:
    """Return the smallest order within 3 % of the least error on the half that was not fitted."""
    low, high = _limits(streams)
    zeros = sum(grid.knots)
    tried = []
    for plays, zones in orders:
        shape = Shape(plays=plays, below=zones, above=zones)
        zone = placed_zones(low, high, shape)
        (seen, _), (unseen, count) = parts
        lengths = []
        for threshold in candidates(seen, grid, plays, zone):
            places = grid.places(threshold, zone)
            tested = unseen[:, places]
            error = tested @ _solved(seen[:, places], threshold, zone).x
            own = tested[:, -zeros:]  # where the zero goes in rows that were not fitted is open
            error -= own @ np.linalg.lstsq(own, error, rcond=None)[0]
            lengths.append(float(np.linalg.norm(error)))
        held_out = min(lengths) / float(np.sqrt(max(count, 1)))
        tried.append(Tried(shape=shape, held_out=held_out))
    least = min(one.held_out for one in tried)
    return next(t.shape for t in tried if t.held_out <= CLOSE * least), tuple(tried)


def candidates(triangle: Array, grid: Grid, plays: int, zone: Array) -> tuple[Array, ...]:
    """Return thresholds for so many plays: spread evenly, and where all of the grid's put weight.

    The second are the grid's own, nearest to the centres of the groups.
    """
    places = grid.places(grid.threshold, zone)
    weight = _solved(triangle[:, places], grid.threshold, zone).x[1 : len(grid.threshold)]
    centres = group_centres(grid.threshold[1:], np.maximum(weight, 0.0), plays)
    nearest = 1 + np.abs(centres[:, None] - grid.threshold[1:]).argmin(axis=1)
    rank = np.arange(plays)
    apart = np.maximum.accumulate(nearest - rank) + rank
    chosen = np.minimum(apart, len(grid.threshold) - 1 - rank[::-1])
    return thresholds_of(plays), grid.threshold[np.concatenate([[0], chosen])]


def starts_of_program(
    streams: Sequence[Stream],
    grid: Grid,
    parts: tuple[tuple[Array, int], tuple[Array, int]],
    shape: Shape,
    lag_s: float,
) -> tuple[Start, ...]:
    """Solve the program of one order on all rows, from each of its candidates."""
    whole = gather(np.asfortranarray(parts[0][0]), parts[1][0])
    zone = placed_zones(*_limits(streams), shape)
    return tuple(
        start_of(whole, grid, threshold, zone, lag_s)
        for threshold in candidates(whole, grid, shape.plays, zone)
    )


def start_of(triangle: Array, grid: Grid, threshold: Array, zone: Array, lag_s: float) -> Start:
    """Solve the program for some of the grid's thresholds."""
    optimum = _solved(triangle[:, grid.places(threshold, zone)], threshold, zone)
    plays, zones = len(threshold), len(zone)
    inverse = DeadZones(threshold=zone, weight=optimum.x[plays : plays + zones])
    operator, offset = recentred(
        threshold,
        np.maximum(optimum.x[:plays], 0.0),
        inverse.inverse(),
        float(np.mean(optimum.x[plays + zones :])),
        lag_s,
    )
    return Start(operator=operator, offset=offset, kkt_gap=optimum.kkt_gap)


def _solved(triangle: Array, threshold: Array, zone: Array) -> Optimum:
    return optimum_of(gather(empty_triangle(triangle.shape[1]), triangle), threshold, zone)
