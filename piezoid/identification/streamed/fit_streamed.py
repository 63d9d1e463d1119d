"""Recordings larger than memory in, one ActuatorModel out.

What is fitted is what ``fit`` fits at its core: plays, dead zones, a delay, the zero and the
initial memory of every piece, by output error. What takes all of a recording at once is left
out and said so: dynamics, envelopes, kinds of lag, transients, diagnosis.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

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
from piezoid.identification.streamed.survey import (
    Survey,
    lag_s_of,
    longest_lag_s,
    survey,
    tried_lags_s,
)
from piezoid.identification.streamed.thinned import (
    lags_beside,
    thinned,
    window_of,
    worth_thinning,
)
from piezoid.numerics.arrays import Array
from piezoid.records.lab import Lab
from piezoid.records.streams.excerpts import compared
from piezoid.records.streams.piece import Piece
from piezoid.records.streams.spool import Spool

THIN_ROWS = 60_000
ROWS = 2_000_000  # of the convex program and of the last passes; states see every sample
SETTLING = 8  # passes for everything but the thresholds
SEARCHING = 30
POLISHING = 4


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
