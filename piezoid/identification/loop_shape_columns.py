"""Rows and columns of the regression for loop shape: the wide class of hysteresis along a drive.

Each family of columns is orthogonalised to the families before it, over the recordings and a drive
that visits the whole range. Otherwise friction and Bouc-Wen states cancel each other with
contributions of a thousand times the displacement, and the errors on left-out blocks are as large.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from piezoid.identification.extensions.linear_mode import ROWS_AFTER_STEP, rows_after_steps
from piezoid.identification.forward import MAX_ENTRIES
from piezoid.identification.hysteresis.pieces import cycle_edges
from piezoid.identification.loop_shape import (
    FitWithoutShape,
    LoopShape,
    histories,
    history_of,
    settling_samples,
)
from piezoid.identification.model import AxisModel
from piezoid.identification.quality import FOLDS, NEVER_OUT
from piezoid.identification.simulation import FittedPiece, fitted_pieces
from piezoid.numerics.arrays import Array, spread_rows
from piezoid.numerics.family_ridge import FamilyRidge, Moments
from piezoid.operators.play import thinned_drive, turns_of
from piezoid.operators.wide_hysteresis import (
    CHUNK,
    EDGES,
    WIDTHS,
    HysteresisStates,
    States,
    class_columns,
    class_families,
    mixed_columns,
    smooth_families,
)
from piezoid.records.recording import Recording

# Rows of all pieces. On healthy stages of thirteen laws (zoo, seeds 20266100) the geometric mean
# of the errors on left-out blocks over the noise is 1.334 with 10,000 rows, 1.293 with 14,000 and
# 1.289 with 20,000, in 107, 124 and 151 s.
MAX_ROWS = 14_000
BLOCKS_PER_PIECE = 15
COVERED = 0.97  # of the range of a piece: until then its rows depend on the initial state
JITTER = 1e-7  # of the mean diagonal, below which a component is redundant
MAX_HISTORIES = 120  # columns of initial states of all pieces together
TURNS, STEP = 150, 0.02  # of the reference drive, half ranges
PLAYS = "plays"  # family of the plays' remainder, which the class cannot approximate
# Share of the motion that may be lost to a delay instead of the filters if the columns at every
# sample exceed MAX_ENTRIES: 200,000 samples took 3.2 GB and 177 s, with a delay 1 GB and 24 s.
MAX_DELAY_ERROR = 0.02
MIN_WEIGHT = 1e-3  # of a history: smaller ones do not change the columns noticeably


@dataclass(frozen=True, kw_only=True, eq=False)
class PieceRows(FittedPiece):
    """One piece of a recording with its rows of the regression.

    measured_m  (samples,)
    drive_V     (samples,)  V, at the input of the hysteresis
    rows        (rows,)     samples
    fold        (rows,)     the fold that leaves a row out, or ``NEVER_OUT``
    """

    measured_m: Array
    drive_V: Array
    rows: NDArray[np.intp]
    fold: NDArray[np.intp]


@dataclass(frozen=True, kw_only=True, eq=False)
class _HistoryPath:
    """First rows of a piece, which depend on the initial state, with the states of each history.

    sample         (rows,)  at which the drive is taken: earlier than the row by a pure delay
    drive          (rows,)  scaled
    plays_m        (rows, 1 + histories)  response of the plays: fitted memory, then each history
    states         of the wide class, (1 + histories)
    is_pure_delay  whether the filters only delay
    """

    sample: Array
    drive: Array
    plays_m: Array
    states: tuple[States, ...]
    is_pure_delay: bool

    def changes_m(self, shape: LoopShape) -> Array:
        """Return the change of the response by every history, (rows, histories)."""
        shape_m = [shape.response_to_states(self.drive, states) for states in self.states]
        total_m = shape.plays_weight * self.plays_m + np.stack(shape_m, axis=1)
        return np.asarray(total_m[:, 1:] - total_m[:, :1])

    def column_changes(self, weight: Array, plays: Array, half_range_m: float) -> Array:
        """Return the change of the columns of the class by weighted histories.

        plays     (columns,)  as in ``Columns``
        returned  (rows, columns)  unscaled; the last is the remainder of the plays
        """
        histories = np.flatnonzero(np.abs(weight) > MIN_WEIGHT)
        mixture = np.concatenate([[-weight[histories].sum()], weight[histories]])
        states = [self.states[k] for k in (0, *(histories + 1))]
        of_class = mixed_columns(self.drive, states, mixture)
        plays_m = (self.plays_m[:, 1:] - self.plays_m[:, :1]) @ weight
        remainder = plays_m / half_range_m - of_class @ plays[:-1]
        return np.column_stack([of_class, remainder])

    def interpolated(self, change: Array, samples: int) -> Array:
        """Interpolate changes at all samples of the piece; after the last row they are 0."""
        if not len(self.sample):
            return np.zeros((samples, change.shape[1]))
        grid = np.arange(samples)
        columns = [np.interp(grid, self.sample, column, right=0.0) for column in change.T]
        return np.stack(columns).T

    def filtered(self, change: Array, axis: AxisModel, piece: PieceRows) -> Array:
        """Filter changes of the static response, (rows of the piece, changes) at the sensor."""
        if self.is_pure_delay:
            settled = np.zeros((len(piece.rows) - len(change), change.shape[1]))
            filtered = np.concatenate([change, settled])
        else:
            filtered = _at_sensor(axis, piece, self.interpolated(change, piece.where.samples))
        return _with_slow_response(axis, piece, filtered)


@dataclass(frozen=True, kw_only=True, eq=False)
class Columns:
    """Columns of the wide class for given lag and extensions.

    values     (rows, columns)   scaled
    scale      (columns,)        divisor of each column
    change     (columns, columns)  from orthogonalised coefficients to those of ``values``
    plays      (columns,)        coefficients that approximate the plays, see
                                 ``reference_columns``; the last column is the remainder
    family     (columns,)        name of each column's family
    paths      of each piece, for other histories
    """

    values: Array
    scale: Array
    change: Array
    plays: Array
    family: tuple[str, ...]
    paths: tuple[_HistoryPath, ...]


def piece_rows(axis: AxisModel, recordings: Sequence[Recording]) -> tuple[PieceRows, ...]:
    """Return the rows of all pieces with a fitted start, ``MAX_ROWS`` together."""
    max_rows = max(1, MAX_ROWS // max(len(axis.starts), 1))
    low_V, high_V = axis.voltage_V
    pieces: list[PieceRows] = []
    for recording in recordings:
        bridged = np.array(recording.bridged, dtype=np.intp)
        for piece in fitted_pieces(axis, recording):
            where, start, voltage_V = piece.where, piece.start, piece.voltage_V
            level = 2.0 * (voltage_V - low_V) / (high_V - low_V) - 1.0
            after_steps = rows_after_steps(
                level, where.rate_Hz, axis.extensions, min_rows=ROWS_AFTER_STEP
            )
            excluded = np.concatenate([bridged - piece.samples.start, after_steps])
            rows = start.first + spread_rows(start.last - start.first, max_rows)
            rows = np.setdiff1d(rows, excluded)
            # Folds are blocks of whole cycles in turn, shifted for each piece.
            span = np.maximum.accumulate(level) - np.minimum.accumulate(level)
            edges = cycle_edges(level, BLOCKS_PER_PIECE)[1:-1]
            fold = (np.searchsorted(edges, rows, side="right") + len(pieces)) % FOLDS
            is_settled = (span >= COVERED * span[-1])[rows]
            pieces.append(
                PieceRows(
                    **vars(piece),
                    measured_m=recording.displacement_m(axis.axis)[piece.samples],
                    drive_V=axis.forward.driven_V(voltage_V, where.rate_Hz),
                    rows=rows,
                    fold=np.where(is_settled, fold, NEVER_OUT),
                )
            )
    return tuple(piece for piece in pieces if len(piece.rows))


def columns_of(
    axis: AxisModel, pieces: Sequence[PieceRows], reference: tuple[Array, Array]
) -> Columns:
    """Compute the columns of the wide class along all pieces, behind lag and extensions.

    reference  of ``reference_columns``, which does not depend on lag and extensions
    """
    shape, forward = zero_loop_shape(axis), axis.forward
    reference_x, plays = reference
    tables, paths = [], []
    count = min(len(histories(0.0)), max(3, MAX_HISTORIES // len(pieces)))
    for piece in pieces:
        rate_Hz, memory_V = piece.where.rate_Hz, piece.start.memory_V
        delay = forward.group_delay_s(rate_Hz) * rate_Hz
        static_m = axis.invertible_m(piece.drive_V, memory_V, rate_Hz)
        plays_m = _at_sensor(axis, piece, static_m)
        drive_V, row_index = _drive_at_rows(piece.drive_V, piece.rows, delay)
        history = history_of(axis.hysteresis, memory_V, shape)
        delayed_m = axis.invertible_m(drive_V, memory_V, rate_Hz)[row_index]
        tolerated_m = axis.quality.noise_rms_m
        if len(plays) * int(piece.rows[-1]) > MAX_ENTRIES:
            tolerated_m = max(tolerated_m, MAX_DELAY_ERROR * float(np.std(plays_m)))
        is_memoryless = (
            forward.lag != "first_order" and forward.sensor_Hz is None and not forward.extensions
        )
        is_pure_delay = is_memoryless or bool(np.std(plays_m - delayed_m) < tolerated_m)
        if is_pure_delay:
            sample = np.maximum(piece.rows - delay, 0.0)
            table = _delayed_columns(shape.scaled(piece.drive_V), piece.rows, delay, history)
        else:
            sample = piece.rows.astype(float)
            samples = np.arange(int(piece.rows[-1]) + 1)
            static = class_columns(*_states_at(shape.scaled(piece.drive_V), samples, history))
            table = _at_sensor(axis, piece, static)
            drive_V, row_index = _drive_at_rows(piece.drive_V, piece.rows, 0.0)
        remainder = plays_m / (0.5 * axis.quality.range_m) - table @ plays[:-1]
        tables.append(_with_slow_response(axis, piece, np.column_stack([table, remainder])))
        paths.append(
            _history_path(axis, memory_V, drive_V, row_index, sample, count, is_pure_delay)
        )
    family = (*class_families(), PLAYS)
    x = np.concatenate(tables)
    scale, change = _orthogonalised([x, reference_x], np.array(family))
    return Columns(
        values=x / scale,
        scale=scale,
        change=change,
        plays=plays,
        family=family,
        paths=tuple(paths),
    )


def reference_columns(axis: AxisModel) -> tuple[Array, Array]:
    """Return the columns along the reference drive, (rows, columns), and the plays' coefficients.

    The reference drive visits the whole range. The coefficients, (columns,), approximate the plays
    by the wide class there, in half ranges of the displacement. The fit of loop shape returns to
    them where the recordings contain no information. Plays with dead zones have kinks that a
    smooth material does not have; the last column is this remainder.
    """
    reference = _reference()
    x, z, change = reference.columns, reference.design, reference.change
    shape = zero_loop_shape(axis)
    memory_V = axis.memory_after(shape.turns_V(()))
    drive_V = shape.centre_V + shape.reach_V * reference.drive
    plays = axis.invertible_m(drive_V, memory_V, 1.0) / (0.5 * axis.quality.range_m)
    families = int(reference.family.max())
    square = float(plays @ plays)
    sums = Moments(gram=reference.gram, moment=z.T @ plays, square=square, count=len(z))
    power = square / len(z)
    ridge = FamilyRidge(
        family=reference.family,
        variance=np.append(np.full(families, 0.1 * power), np.inf),
        noise=1e-4 * power,
    )
    _, coefficient, _ = ridge.maximised(sums, ceiling=np.full(families + 1, np.inf))
    smooth = np.asarray(change @ coefficient[:-1] / reference.scale)
    return np.column_stack([x, plays - x @ smooth]), np.append(smooth, 0.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Reference:
    """A drive through the whole range, and the columns of the wide class along it.

    drive    (samples,)  scaled
    columns  (samples, columns)
    scale    (columns,)  divisor of each column
    change   (columns, columns)  from orthogonalised coefficients to those of scaled columns
    design   (samples, columns + 1)  orthogonalised columns and a constant, with their gram
    family   (columns + 1,)  index of the family of each column of the design
    """

    drive: Array
    columns: Array
    scale: Array
    change: Array
    design: Array
    gram: Array
    family: NDArray[np.intp]


@cache
def _reference() -> _Reference:
    turns = np.random.default_rng(0).uniform(-1.0, 1.0, TURNS)
    runs = [np.arange(a, b, np.copysign(STEP, b - a)) for a, b in pairwise(turns)]
    drive = np.concatenate(runs)
    x = class_columns(drive, HysteresisStates((float(drive[0]),)).follow(drive))
    names = np.array(class_families())
    scale, change = _orthogonalised([x], names)
    design = np.column_stack([x / scale @ change, np.ones(len(x))])
    number = np.unique(names, return_inverse=True)[1]
    return _Reference(
        drive=drive,
        columns=x,
        scale=scale,
        change=change,
        design=design,
        gram=design.T @ design,
        family=np.append(number, number.max() + 1),
    )


def _at_sensor(axis: AxisModel, piece: PieceRows, static: Array) -> Array:
    """Filter a static response, (samples,) or (samples, columns), by fast extensions, at rows."""
    return axis.forward.linear_response(static, piece.where, fast_only=True)[piece.rows]


def _with_slow_response(axis: AxisModel, piece: PieceRows, change: Array) -> Array:
    """Add creep to changes of the response at rows, linear between them, and apply the gain."""
    for extension in axis.extensions:
        change = extension.slow_response(change, piece.rows / piece.where.rate_Hz)
    return np.asarray(change * axis.forward.gain_at(piece.rows, piece.where))


def zero_loop_shape(axis: AxisModel) -> LoopShape:
    """Return a loop shape with all coefficients 0."""
    low_V, high_V = axis.voltage_V
    return LoopShape(
        centre_V=0.5 * (low_V + high_V),
        reach_V=0.5 * (high_V - low_V),
        density_m=np.zeros((len(WIDTHS), len(EDGES) - 1)),
        smooth_m=np.zeros(len(smooth_families())),
        plays_weight=1.0,
        plain=FitWithoutShape(
            lag_s=axis.lag.time_s,
            rms_m=0.0,
            held_out_rms_m=0.0,
            quality=axis.quality,
            starts=axis.starts,
        ),
    )


def _drive_at_rows(
    drive_V: Array, rows: NDArray[np.intp], delay: float
) -> tuple[Array, NDArray[np.intp]]:
    """Return the reversals of a drive and its values ``delay`` samples before rows, in order.

    returned  also the indices of the rows in this drive, (rows,)
    """
    times = np.maximum(rows - delay, 0.0)
    turns = np.flatnonzero(turns_of(drive_V))
    turns = turns[turns <= times[-1]]
    order = np.argsort(np.concatenate([turns, times]), kind="stable")
    values = np.concatenate([drive_V[turns], np.interp(times, np.arange(len(drive_V)), drive_V)])
    index = np.empty(len(order), dtype=np.intp)
    index[order] = np.arange(len(order))
    return values[order], index[len(turns) :]


def _states_at(
    drive: Array, samples: NDArray[np.intp], history: Sequence[float]
) -> tuple[Array, States]:
    """Return a scaled drive and the states of the wide class at some of its samples."""
    states = HysteresisStates((*history, float(drive[0])))
    parts: list[States] = []
    for first in range(0, len(drive), CHUNK):
        plays, friction, bouc_wen = states.follow(drive[first : first + CHUNK])
        rows = samples[(samples >= first) & (samples < first + CHUNK)] - first
        parts.append((plays[rows], friction[rows], bouc_wen[rows]))
    plays, friction, bouc_wen = (np.concatenate(chunks) for chunks in zip(*parts, strict=True))
    return drive[samples], (plays, friction, bouc_wen)


def _delayed_columns(
    drive: Array, rows: NDArray[np.intp], delay: float, history: Sequence[float]
) -> Array:
    """Return the columns ``delay`` samples before rows, linear between samples."""
    whole_samples = int(np.floor(delay))
    newer = np.maximum(rows - whole_samples, 0)
    older = np.maximum(newer - 1, 0)
    samples = np.union1d(newer, older)
    level, (plays, friction, bouc_wen) = _states_at(*thinned_drive(drive, samples), history)
    share = delay - whole_samples
    columns = []
    for neighbour in (newer, older):
        k = np.searchsorted(samples, neighbour)
        columns.append(class_columns(level[k], (plays[k], friction[k], bouc_wen[k])))
    return np.asarray((1.0 - share) * columns[0] + share * columns[1])


def _history_path(
    axis: AxisModel,
    memory_V: Array,
    drive_V: Array,
    row_index: NDArray[np.intp],
    sample: Array,
    count: int,
    is_pure_delay: bool,
) -> _HistoryPath:
    """Simulate histories until the response no longer depends on them.

    memory_V   (plays,)    fitted
    drive_V    (samples,)  V, at its reversals and rows
    row_index  (rows,)     indices of the rows in the drive
    sample     (rows,)     samples of the piece at which the drive was taken
    count      number of histories
    """
    shape = zero_loop_shape(axis)
    drive_V = drive_V[: settling_samples(shape.scaled(drive_V))]
    row_index = row_index[row_index < len(drive_V)]
    drive = shape.scaled(drive_V)
    initial = [(memory_V, history_of(axis.hysteresis, memory_V, shape))]
    candidates = histories(float(drive[0]))[:count]
    initial += [(axis.memory_after(shape.turns_V(history)), history) for history in candidates]
    plays_m = [axis.invertible_m(drive_V, memory_V, 1.0)[row_index] for memory_V, _ in initial]
    states = [_states_at(drive, row_index, history)[1] for _, history in initial]
    return _HistoryPath(
        sample=sample[: len(row_index)],
        drive=drive[row_index],
        plays_m=np.stack(plays_m, axis=1),
        states=tuple(states),
        is_pure_delay=is_pure_delay,
    )


def _orthogonalised(drives: Sequence[Array], family: NDArray[np.str_]) -> tuple[Array, Array]:
    """Return scales of the columns, and the change that orthogonalises each family to the former.

    drives  the columns along each drive, (rows, columns), with equal weight for every drive

    Columns that are redundant along a few recorded loops are not redundant along others.
    Orthogonalised over the recordings alone, columns were small there and enormous elsewhere: with
    triangles of three amplitudes of a Bouc-Wen stage, the model's error at a fourth amplitude was
    92 times the noise, and 5.6 times with the reference drive; for a Duhem stage 112 and 19 times.
    """
    products = [x.T @ x / len(x) for x in drives]
    scale = np.sqrt(np.mean([np.diag(product) for product in products], axis=0))
    for name in set(family):
        if name.startswith("density"):  # the prior fixes the relative size of its components
            scale[family == name] = scale[family == name].max()
    scale[scale < 1e-12] = 1.0
    means = [x.mean(axis=0) for x in drives]
    centred = [p - np.outer(m, m) for p, m in zip(products, means, strict=True)]
    gram = np.mean(centred, axis=0) / np.outer(scale, scale)
    change, former = np.eye(len(family)), np.zeros(0, dtype=np.intp)
    for name in dict.fromkeys(family):
        members = np.flatnonzero(family == name)
        if len(former) and name != PLAYS:
            normal = gram[np.ix_(former, former)]
            normal = normal + JITTER * np.trace(normal) / len(former) * np.eye(len(former))
            cross = gram[np.ix_(former, members)]
            change[np.ix_(former, members)] = -np.linalg.solve(normal, cross)
        former = np.concatenate([former, members])
    return scale, change
