"""Recordings larger than memory in, one ActuatorModel out.

What is fitted is what ``fit`` fits at its core: plays, dead zones, a delay, the zero and the
initial memory of every piece, by output error. What takes all of a recording at once is left
out and said so: dynamics, envelopes, kinds of lag, transients, diagnosis.

What one pass over a piece tells: its lag, how often it turns, where its cycles begin.

All lags share one triangle. The rows [z(u) | u^2 u^3 1 | y advanced by 0, 1, 2, 3, 4, 6, ...] are
gathered once; the error of each lag is then a small problem in the columns of R.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from piezoid.counts import in_counts, refusing_in_counts
from piezoid.errors import ExcitationError
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.fit import rig_of
from piezoid.identification.hysteresis.coordinates import Coordinates, Shape, vector_of
from piezoid.identification.hysteresis.jackknife import BLOCKS
from piezoid.identification.hysteresis.order import ORDERS
from piezoid.identification.hysteresis.pieces import Rig
from piezoid.identification.hysteresis.search import THRESHOLDS
from piezoid.identification.hysteresis.start import Start
from piezoid.identification.model import AxisModel
from piezoid.identification.streamed.axis_model import Found, axis_model
from piezoid.identification.streamed.convex import choose, grid_of, halves, starts_of_program
from piezoid.identification.streamed.descent import Reached, descend
from piezoid.identification.streamed.passes import Spread, Task
from piezoid.identification.streamed.stream import CHUNK, Stream, streams_of
from piezoid.identification.streamed.thinned import (
    lags_beside,
    thinned,
    window_of,
    worth_thinning,
)
from piezoid.numerics.arrays import Array
from piezoid.numerics.triangle import empty_triangle, gather
from piezoid.operators.play import play_columns
from piezoid.records.lab import Lab
from piezoid.records.streams.excerpts import compared
from piezoid.records.streams.piece import Piece
from piezoid.records.streams.spool import Spool

QUICK = np.linspace(0.0, 0.9, 10)  # thresholds of the quick model
SHIFTS = (0, 1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512, 768, 1024)
TURN = 0.02  # half the smallest turning back that counts
SURVEYED_ROWS = 100_000

THIN_ROWS = 60_000
ROWS = 2_000_000  # of the convex program and of the last passes; states see every sample
SETTLING = 8  # passes for everything but the thresholds
SEARCHING = 30
POLISHING = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class Survey:
    """One piece, looked over.

    triangle  of [quick model | displacement at every shift]
    turns     how often the drive turns back
    crossings first samples at which it passes its middle upwards, one behind each wanted edge
    cycles    how often it does
    """

    triangle: Array
    turns: int
    crossings: tuple[int, ...]
    cycles: int


def survey(stream: Stream, edges: Sequence[int]) -> Survey:
    """Look over a piece once.

    edges  samples behind which the next cycle's beginning is wanted
    """
    triangle = empty_triangle(len(QUICK) + 3 + len(SHIFTS))
    stride = max(1, stream.samples // SURVEYED_ROWS)
    held_u, held_y = np.empty(0), np.empty(0)
    memory: Array | None = None
    watch = _Watch(edges)
    first = 0
    for drive, response in stream.chunks():
        watch.see(drive)
        held_u, held_y = np.concatenate([held_u, drive]), np.concatenate([held_y, response])
        rows = len(held_u) - SHIFTS[-1]
        if rows <= 0 and watch.seen < stream.samples:
            continue
        rows = rows if rows > 0 else max(len(held_u) // 2, 1)
        memory = np.full(len(QUICK), held_u[0]) if memory is None else memory
        states, memory = play_columns(held_u[:rows], QUICK, memory)
        place = np.arange(-first % stride, rows, stride)
        triangle = gather(triangle, _rows(held_u, held_y, states, place))
        first += rows
        held_u, held_y = held_u[rows:], held_y[rows:]
    return Survey(
        triangle=triangle, turns=watch.turns, crossings=tuple(watch.found), cycles=watch.cycles
    )


def _rows(drive: Array, response: Array, states: Array, place: NDArray[np.int_]) -> Array:
    u = drive[place]
    quick = np.column_stack([states[place], u**2, u**3, np.ones(len(place))])
    last = len(response) - 1
    shifted = [response[np.minimum(place + shift, last)] for shift in SHIFTS]
    return np.column_stack([quick, *shifted])


class _Watch:
    """Counts turns and finds the beginnings of cycles while the drive passes."""

    def __init__(self, edges: Sequence[int]) -> None:
        self.wanted = list(edges)
        self.found: list[int] = []
        self.turns = self.cycles = self.seen = 0
        self.memory: Array | None = None
        self.direction = 0.0
        self.above = True

    def see(self, drive: Array) -> None:
        """Take in the next samples."""
        start = drive[:1] if self.memory is None else self.memory
        states, self.memory = play_columns(drive, np.array([TURN]), start)
        signs = np.sign(np.diff(states[:, 0], prepend=start[0]))
        signs = np.concatenate([[self.direction], signs[signs != 0.0]])
        self.turns += int(np.count_nonzero(signs[1:] * signs[:-1] < 0))
        self.direction = float(signs[-1])
        above = np.concatenate([[self.above], drive > 0.0])
        starts = self.seen + np.flatnonzero(~above[:-1] & above[1:])
        self.above = bool(above[-1])
        self.cycles += len(starts)
        while self.wanted and len(starts) and starts[-1] >= self.wanted[0]:
            self.found.append(int(starts[np.searchsorted(starts, self.wanted.pop(0))]))
        self.seen += len(drive)


def longest_lag_s(streams: Sequence[Stream], surveys: Sequence[Survey]) -> float:
    """Return the longest lag worth searching: a quarter of a mean branch of the drive."""
    duration_s = sum(stream.samples / stream.rate_Hz for stream in streams)
    branches = sum(found.turns + 1 for found in surveys)
    return max(10.0 / min(s.rate_Hz for s in streams), 0.25 * duration_s / branches)


def tried_lags_s(streams: Sequence[Stream], longest_s: float) -> list[float]:
    """Return the lags that are tried: the shifts of the fastest piece."""
    fastest_Hz = max(stream.rate_Hz for stream in streams)
    return [shift / fastest_Hz for shift in SHIFTS if shift / fastest_Hz <= longest_s]


def lag_s_of(streams: Sequence[Stream], surveys: Sequence[Survey], longest_s: float) -> float:
    """Return the lag, of those that were tried, at which the quick model leaves least."""
    tried_s = tried_lags_s(streams, longest_s)
    errors = [
        sum(_error(s, found, tau_s) for s, found in zip(streams, surveys, strict=True))
        for tau_s in tried_s
    ]
    return tried_s[int(np.argmin(errors))]


def _error(stream: Stream, found: Survey, tau_s: float) -> float:
    """Return the squared error a row of the quick model against the displacement tau_s later."""
    count = len(QUICK) + 3
    quick, shifted = found.triangle[:, :count], found.triangle[:, count:]
    samples = tau_s * stream.rate_Hz
    below = int(np.searchsorted(SHIFTS, samples, side="right")) - 1
    part = 0.0
    if below + 1 < len(SHIFTS):
        part = (samples - SHIFTS[below]) / (SHIFTS[below + 1] - SHIFTS[below])
    target = (1 - part) * shifted[:, below] + part * shifted[:, min(below + 1, len(SHIFTS) - 1)]
    free = quick[:, len(QUICK) :]
    size = float(np.sum(target**2)) or 1.0
    return float(nnls(np.hstack([quick, -free]), target)[1] ** 2 / size)


def fit_streamed(
    spool: Spool,
    *,
    lab: Lab | None = None,
    rows: int = ROWS,
    chunk: int = CHUNK,
    workers: int = 2,
    orders: Sequence[tuple[int, int]] = ORDERS,
    spread: Spread | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> ActuatorModel:
    """Fit every axis of spooled recordings, with memory that does not grow with their length.

    rows     that count at most in the last passes; the plays follow every sample
    chunk    samples that are in memory at one time; the numbers agree to rounding
    workers  parts that are followed side by side; the numbers are the same
    spread   (work, items) -> results in their order, done by other processes or machines that see
             the scratch files of ``spooled(..., named=True)``; the numbers are the same
    orders   (plays, dead zones per side) to choose from

    Raises ``ExcitationError`` where no recording has both a drive and a displacement, and
    ``RecordingError`` where recordings do not fit each other.
    """
    declared = lab or Lab()
    if not spool.pieces:
        raise ExcitationError(
            f"{', '.join(spool.sources)}: no axis has a drive and a displacement",
            needed="both, for a fit in blocks; a tunnelling loop must fit into memory",
            remedy="Name the columns in lab.toml, or fit without --stream.",
        )
    progress("comparing the recordings")
    with refusing_in_counts(spool.counted):
        beside = {axis: compared(pieces, axis) for axis, pieces in spool.pieces.items()}
        return ActuatorModel(
            stage=declared.name or next(iter(spool.sources)).partition(".")[0],
            axes={
                axis: _fit_axis(
                    _Asked(
                        axis, rig_of(declared, axis), rows, chunk, workers, tuple(orders), spread
                    ),
                    found.pieces,
                    lambda text, axis=axis: progress(f"axis {axis}: {text}"),  # type: ignore[misc]
                ).told_in_counts(spool.counted)
                for axis, found in beside.items()
            },
            sources=spool.sources,
            lab=declared.digest or None,
            remarks=(
                *(f"{name}: {problem.text}" for name, problem in spool.problems),
                *(
                    in_counts(text, spool.counted)
                    for found in beside.values()
                    for text in found.remarks
                ),
            ),
            controller_rate_Hz=declared.acquisition.sampling_rate_Hz,
        )


@dataclass(frozen=True)
class _Asked:
    axis: str
    rig: Rig
    rows: int
    chunk: int
    workers: int
    orders: tuple[tuple[int, int], ...]
    spread: Spread | None


def _fit_axis(asked: _Asked, held: Sequence[Piece], told: Callable[[str], None]) -> AxisModel:
    streams = streams_of(held, asked.axis, asked.rig, asked.chunk)
    total = sum(stream.samples for stream in streams)
    told("looking for lag and cycles")
    surveys = [survey(stream, _edges(stream, total)) for stream in streams]
    longest_s = longest_lag_s(streams, surveys)
    lag_s = lag_s_of(streams, surveys, longest_s)
    told("convex programs")
    knots = tuple(1 + min(found.cycles // 4, 12) for found in surveys)
    grid = grid_of(streams, knots, asked.orders)
    parts = halves(streams, grid, lag_s, rows=asked.rows)
    shape, tried = choose(streams, grid, parts, asked.orders)
    starts = starts_of_program(streams, grid, parts, shape, lag_s)
    told(f"search with {shape.plays} plays")
    reached, task, start = _searched(asked, streams, surveys, starts, longest_s, knots)
    told("error on what was left out")
    found = Found(
        axis=asked.axis,
        start=start,
        reached=reached,
        task=task,
        tried=tried,
        turns=tuple(one.turns for one in surveys),
        left_out=len(held) - len(streams),
    )
    return axis_model(found)


def _edges(stream: Stream, total: int) -> list[int]:
    """Return where blocks should begin; every piece has at least two."""
    count = max(2, round(BLOCKS * stream.samples / total))
    return [int(edge) for edge in np.linspace(0, stream.samples, count + 1)[1:-1]]


def _searched(
    asked: _Asked,
    streams: Sequence[Stream],
    surveys: Sequence[Survey],
    starts: Sequence[Start],
    longest_s: float,
    knots: tuple[int, ...],
) -> tuple[Reached, Task, Start]:
    """Weights first, then thresholds on thinned rows, then everything on all that may count."""
    total = sum(stream.samples for stream in streams)
    pieces = tuple(stream.described() for stream in streams)
    task = Task(
        streams=streams,
        pieces=pieces,
        edges=tuple(_block_edges(s, f, total) for s, f in zip(streams, surveys, strict=True)),
        coordinates=Coordinates(shape=_shape_of(starts[0]), offsets=knots),
        sensor_pole_Hz=asked.rig.sensor_bandwidth_Hz,
        stride=max(1, total // THIN_ROWS),
        longest_lag_s=longest_s,
        workers=asked.workers,
        spread=asked.spread,
    )
    short = _thinned(task, asked.rig, starts[0].operator.lag_s)
    held = replace(short, held=THRESHOLDS)
    begun = [descend(_vector_of(start, task), held, passes=SETTLING) for start in starts]
    best = min(range(len(starts)), key=lambda k: begun[k].rms)
    reached = descend(begun[best].theta, short, passes=SEARCHING)
    lag_s = float(reached.theta[task.coordinates.slices["lag"]][0])
    if lag_s in short.lag_s:  # it wants to go further than what was kept
        reached = descend(reached.theta, task, passes=SEARCHING)
    fine = replace(task, stride=max(1, total // asked.rows))
    if fine.stride < task.stride:
        return descend(reached.theta, fine, passes=POLISHING), fine, starts[best]
    return reached, task, starts[best]


def _thinned(task: Task, rig: Rig, lag_s: float) -> Task:
    """Return the task on what is left of its streams, where that is worth a pass."""
    limits_s = lags_beside(
        lag_s, tried_lags_s(task.streams, task.longest_lag_s), max(s.rate_Hz for s in task.streams)
    )
    windows = [window_of(rig, stream.rate_Hz, limits_s) for stream in task.streams]
    if not worth_thinning(windows, task.stride):
        return task
    with ThreadPoolExecutor(task.workers) as side_by_side:
        left = list(
            side_by_side.map(
                lambda pair: thinned(pair[0], task.stride, pair[1]),
                zip(task.streams, windows, strict=True),
            )
        )
    return replace(task, thinned=left, lag_s=limits_s)


def _vector_of(start: Start, task: Task) -> Array:
    """Return a start as the vector of a fit: every knot of every zero at its offset."""
    theta = vector_of(start.operator, task.coordinates)
    for index in range(len(task.streams)):
        theta[task.coordinates.offset_slice(index)] = start.offset
    return theta


def _shape_of(start: Start) -> Shape:
    zero = start.operator.zero
    return Shape(
        plays=len(start.operator.gap), below=zero, above=len(start.operator.knot) - zero - 1
    )


def _block_edges(stream: Stream, found: Survey, total: int) -> list[int]:
    """Return the blocks' edges: where cycles begin, or evenly where the drive has too few."""
    wanted = _edges(stream, total)
    inner = found.crossings if len(set(found.crossings)) == len(wanted) else wanted
    return [0, *inner, stream.samples]
