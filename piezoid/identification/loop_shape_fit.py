"""Fit loop shape: the wide class of hysteresis, to what plays with dead zones leave.

    y - y_plays = F(X w) + sum_k a_k D_k + zero + sum_j t_j dy/dp_j + e

X are the columns of ``operators.wide_hysteresis`` along the drive, F the filters behind the
hysteresis, D_k the change that another history of the drive makes in the response of the model,
and t_j the errors of the numbers p_j of lag and extensions. The zero moves between the knots of
the fit of the plays. Ridge regression with one prior variance for each family of columns gives the
coefficients. D_k and the derivatives depend on the last estimate: rounds are made until the
numbers are at rest (Gauss-Newton with the linear coefficients eliminated).

Families are made free of redundancy: each keeps only what the families before it cannot represent.
Otherwise friction and Bouc-Wen states cancel each other with contributions of a thousand times the
displacement, and left-out blocks are missed by as much.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import pairwise
from operator import add

import numpy as np
from numpy.typing import NDArray

from piezoid.identification.extensions.extension import Extension, Free, Where, free
from piezoid.identification.hysteresis.pieces import MINIMUM_SAMPLES
from piezoid.identification.loop_shape import (
    LoopShape,
    PlainFit,
    histories,
    history_of,
    remembered,
)
from piezoid.identification.model import AxisModel
from piezoid.identification.piece_start import PieceStart
from piezoid.identification.quality import BLOCKS, IN_SAMPLE
from piezoid.identification.simulation import starts_of, where_of, zero_of
from piezoid.numerics.arrays import Array
from piezoid.numerics.family_ridge import FamilyRidge, Moments
from piezoid.operators.play import turns_of, way_to
from piezoid.operators.wide_hysteresis import (
    CHUNK,
    EDGES,
    WIDTHS,
    HysteresisStates,
    States,
    class_columns,
    coefficients,
    smooth_count,
)
from piezoid.records.recording import Recording

ROWS = 10_000  # of all pieces together
FEWEST_ROWS = 500
FEWEST_ROUNDS, MOST_ROUNDS = 3, 8
FOLDS = 5
BLOCKS_OF_A_PIECE = 15
# Of the noise variance in the final solve: neighbouring residuals of a class that is slightly
# wrong are correlated. On 5 s of one sweep the error on another drive falls from 0.83 % of the
# range at 1 to 0.33 % at 30 and 0.23 % at 100 (0.11 % without loop shape). On five stages of laws
# that are no sums of plays 1 and 10 explain the same to 4 %, but for one (2.30 and 1.38 times the
# noise); at 100 such laws are explained to 1.35 times the noise only.
NOISE_FACTOR = 10.0
COVERED = 0.97  # of the range of a piece: before, its initial state is unresolved
WORTH = 0.97  # each of both errors over that without loop shape: less gain is not worth the class
WORSE = 1.02  # noise variance over the least: lag and extensions no longer improve it
STEP_WORTH = 0.9  # held-out error with a step of the zero over that without
STEP_PLACES = 60  # of a piece, at which a step of the zero is tried
SHRINK = (1.0, 0.1, 0.01, 0.001)  # common factors of the prior variances
FAR = 7.0  # robust standard deviations
JUMP = 0.03  # half ranges in one sample, four times the neighbouring steps: an isolated step
JITTER = 1e-7  # of the mean diagonal: what is smaller is redundant
SHIFT = 0.02  # of the residual: a larger change by lag and extensions makes columns anew
FILTERED = 0.02  # of the motion, rms: less than this a delay may miss of the filters
MANY_HISTORIES = 120  # columns of initial states of all pieces together
UNPENALISED = ("zero", "number", "step")
LAG_s = 1e-6  # step for the derivative
NEVER = -1  # number of the fold of rows that no fold leaves out


@dataclass(frozen=True, kw_only=True, eq=False)
class _Piece:
    """One piece of a recording with the rows that are used.

    drive_V  (samples,)  V, in front of the hysteresis
    rows     (rows,)     samples
    fold     (rows,)     the fold that leaves a row out, or ``NEVER``
    """

    where: Where
    voltage_V: Array
    measured_m: Array
    drive_V: Array
    start: PieceStart
    rows: NDArray[np.intp]
    fold: NDArray[np.intp]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Columns:
    """What lag and extensions determine.

    x          (rows, columns)   the wide class, scaled
    scale      (columns,)        what the columns were divided by
    change     (columns, columns)  from coefficients without redundancy to those of ``x``
    family     (columns,)        name of each column's family
    paths      path of each piece's drive to its first rows, for other histories
    """

    x: Array
    scale: Array
    change: Array
    family: tuple[str, ...]
    paths: tuple["_Path", ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Path:
    """A drive at the rows that may remember its initial state, with its states after histories.

    drive_V   (rows,)
    plays_m   (rows, 1 + histories)  response of the plays: of the fitted memory, of each history
    states    of the wide class, likewise
    """

    drive: Array
    plays_m: Array
    states: tuple[States, ...]

    def changes_m(self, shape: LoopShape) -> Array:
        """Return by how much every history changes the response, (rows, histories)."""
        made = [shape.of_states(self.drive, states) for states in self.states]
        total_m = self.plays_m + np.stack(made, axis=1)
        return np.asarray(total_m[:, 1:] - total_m[:, :1])


@dataclass(frozen=True, kw_only=True, eq=False)
class _Regression:
    """Rows of the regression, with their sums fold by fold.

    design  (rows, columns)  scaled
    target  (rows,)          in units of half the stroke
    family  (columns,)       name of each column's family
    change  (columns, columns)
    use     (rows,)          whether a row counts
    fold    (rows,)
    value, lower, upper  (numbers,)  of lag and extensions, with their bounds
    step    (numbers,)       their changes by coefficients of 1
    prior   sums of what is known of them beforehand
    """

    design: Array
    target: Array
    family: tuple[str, ...]
    change: Array
    use: NDArray[np.bool_]
    fold: NDArray[np.intp]
    value: Array
    lower: Array
    upper: Array
    step: Array
    prior: Moments | None = None

    @property
    def number_places(self) -> NDArray[np.intp]:
        """Return the columns of lag and extensions."""
        return self.places("number")

    def outward(self, coefficient: Array) -> NDArray[np.bool_]:
        """Return which columns would move a number beyond the bound at which it is."""
        step = self.step * coefficient[self.number_places]
        outward = np.zeros(len(self.family), dtype=bool)
        outward[self.number_places] = ((self.value <= self.lower) & (step < 0.0)) | (
            (self.value >= self.upper) & (step > 0.0)
        )
        return outward

    def without(self, columns: NDArray[np.bool_]) -> "_Regression":
        """Return the regression in which some columns are 0."""
        return replace(self, design=np.where(columns, 0.0, self.design))

    def moments(self) -> tuple[Moments, ...]:
        """Return the sums of every fold, and at the end of the rows that are never left out."""
        sums = []
        for number in (*range(FOLDS), NEVER):
            rows = (self.fold == number) & self.use
            x, y = self.design[rows], self.target[rows]
            gram = self.change.T @ (x.T @ x) @ self.change
            moment = self.change.T @ (x.T @ y)
            sums.append(Moments(gram=gram, moment=moment, square=float(y @ y), count=len(y)))
        return tuple(sums) if self.prior is None else (*sums[:-1], sums[-1] + self.prior)

    @property
    def labels(self) -> tuple[str, ...]:
        """Return the families in their order."""
        return tuple(dict.fromkeys(self.family))

    def places(self, name: str) -> NDArray[np.intp]:
        """Return the columns of one family."""
        return np.flatnonzero(np.array(self.family) == name)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Estimate:
    """Loop shape, initial states, zeros, lag and extensions after some rounds.

    model       with loop shape, lag and extensions
    weights     (histories,) of every piece
    zeros       (knots,) of every piece, m
    wide        (columns,)  coefficients of the wide class, of unscaled columns
    coefficient (columns,)  of all columns of the last regression
    shift       of the reading by the last change of lag and extensions, of the residual
    variance    prior variance by family; noise, too
    parameters  effective number of them
    residual_m  (rows,)
    use         (rows,)  whether a row is no outlier
    rows        of every piece
    """

    model: AxisModel
    weights: tuple[Array, ...]
    zeros: tuple[Array, ...]
    wide: Array
    coefficient: Array
    shift: float
    variance: dict[str, float]
    noise: float
    parameters: float
    residual_m: Array
    use: NDArray[np.bool_]
    rows: tuple[int, ...]


def with_loop_shape(axis: AxisModel, recordings: Sequence[Recording]) -> AxisModel:
    """Return the axis with loop shape where that predicts left-out blocks better.

    recordings  of the fit; a recording that the model does not know is ignored
    """
    if axis.loop_shape is not None:
        raise ValueError(f"axis {axis.axis} has loop shape already")
    pieces = _pieces(axis, recordings)
    if sum(len(piece.rows) for piece in pieces) < FEWEST_ROWS:
        return axis
    columns = _columns(axis, pieces)
    estimate = _first(axis, pieces, columns)
    plain = _plain_errors(axis, _regression(estimate, pieces, columns))
    best = estimate, pieces, columns
    for number in range(MOST_ROUNDS):
        regression = _regression(estimate, pieces, columns)
        improved = _improved(estimate, pieces, columns, regression)
        settled = replace(improved, model=_with_numbers_of(estimate.model, improved.model))
        if number < FEWEST_ROUNDS - 1 or settled.noise < best[0].noise:
            best = settled, pieces, columns
        elif settled.noise > WORSE * best[0].noise:
            break
        if improved.shift > SHIFT:
            pieces = _driven(improved.model, pieces)
            columns = _columns(improved.model, pieces)
            estimate = improved
        else:
            estimate = settled
            if number + 1 >= FEWEST_ROUNDS:
                break
    estimate, pieces, columns = best
    return _accepted(axis, estimate, pieces, columns, plain)


def _with_numbers_of(estimated: AxisModel, model: AxisModel) -> AxisModel:
    """Return a model with lag and extensions of the estimate before."""
    return replace(model, lag=estimated.lag, extensions=estimated.extensions)


def _driven(axis: AxisModel, pieces: Sequence[_Piece]) -> tuple[_Piece, ...]:
    """Return the pieces with the drive that reaches the hysteresis of a model."""
    return tuple(
        replace(piece, drive_V=axis.forward.driven_V(piece.voltage_V, piece.where.rate_Hz))
        for piece in pieces
    )


def _pieces(axis: AxisModel, recordings: Sequence[Recording]) -> tuple[_Piece, ...]:
    """Return the pieces whose start is known, thinned to ``ROWS`` rows together."""
    most = max(1, ROWS // max(len(axis.starts), 1))
    low_V, high_V = axis.voltage_V
    pieces: list[_Piece] = []
    for recording in recordings:
        starts = starts_of(axis, recording)
        parts = [p for p in recording.pieces if p.stop - p.start >= MINIMUM_SAMPLES]
        if len(starts) != len(parts):
            continue
        bridged = np.array(recording.bridged, dtype=np.intp)
        for part, start in zip(parts, starts, strict=True):
            where = where_of(recording, axis.axis, part)
            voltage_V = recording.voltage_V(axis.axis)[part]
            level = 2.0 * (voltage_V - low_V) / (high_V - low_V) - 1.0
            unknown = np.concatenate([bridged - part.start, _after_jumps(level)])
            stride = max(1, -(-(start.last - start.first) // most))
            rows = np.setdiff1d(np.arange(start.first, start.last, stride), unknown)
            pieces.append(
                _Piece(
                    where=where,
                    voltage_V=voltage_V,
                    measured_m=recording.displacement_m(axis.axis)[part],
                    drive_V=axis.forward.driven_V(voltage_V, where.rate_Hz),
                    start=start,
                    rows=rows,
                    fold=_folds(level, rows, len(pieces)),
                )
            )
    return tuple(piece for piece in pieces if len(piece.rows))


def _after_jumps(level: Array) -> NDArray[np.intp]:
    """Return the two samples after every isolated step: its instant within a sample is unknown."""
    step = np.abs(np.diff(level))
    padded = np.pad(step, 3)
    neighbour = np.maximum(padded[:-6], padded[6:])
    jumps = np.flatnonzero((step > JUMP) & (step > 4.0 * neighbour))
    return np.concatenate([jumps + 1, jumps + 2])


def _folds(level: Array, rows: NDArray[np.intp], number: int) -> NDArray[np.intp]:
    """Return the fold of every row: blocks of whole cycles in turn, from piece to piece others."""
    span = np.maximum.accumulate(level) - np.minimum.accumulate(level)
    middle = 0.5 * (level.max() + level.min())
    rises = np.flatnonzero((level[:-1] < middle) & (level[1:] >= middle))
    edges = np.linspace(0, len(level), BLOCKS_OF_A_PIECE + 1)[1:-1]
    if len(rises) >= BLOCKS_OF_A_PIECE:
        edges = np.unique(rises[np.abs(rises[:, None] - edges).argmin(axis=0)])
    block = np.searchsorted(edges, rows, side="right")
    settled = (span >= COVERED * span[-1])[rows]
    return np.where(settled, (block + number) % FOLDS, NEVER)


def _columns(axis: AxisModel, pieces: Sequence[_Piece]) -> _Columns:
    """Return everything that depends on lag and extensions."""
    shape, forward = _empty(axis), axis.forward
    tables, paths = [], []
    number = min(len(histories(0.0)), max(3, MANY_HISTORIES // len(pieces)))
    for piece in pieces:
        late = forward.late_s(piece.where.rate_Hz) * piece.where.rate_Hz
        static_m = axis.invertible_m(piece.drive_V, piece.start.memory_V, piece.where.rate_Hz)
        zero_m = zero_of(piece.start, piece.where.samples)
        read_m = forward.read(forward.position(static_m, piece.where, zero_m)) - zero_m
        moved_m = read_m[piece.rows]
        drive_V, places = _path(piece.drive_V, piece.rows, late)
        history = history_of(axis.hysteresis, piece.start.memory_V, shape)
        delayed_m = axis.invertible_m(drive_V, piece.start.memory_V, piece.where.rate_Hz)[places]
        is_late_only = np.std(moved_m - axis.polarity * delayed_m) < FILTERED * np.std(moved_m)
        if is_late_only or forward.is_memoryless:
            table = _delayed_columns(shape.scaled(piece.drive_V), piece.rows, late, history)
        else:
            everywhere = np.arange(int(piece.rows[-1]) + 1)
            unfiltered = class_columns(*_states(shape.scaled(piece.drive_V), everywhere, history))
            table = {
                name: forward.behind(x, piece.where, instant=True)[piece.rows]
                for name, x in unfiltered.items()
            }
        tables.append({name: x * _gain(axis, piece) for name, x in table.items()})
        paths.append(_remembering_path(axis, shape, drive_V, places, piece.start, number))
    family = tuple(name for name, x in tables[0].items() for _ in range(x.shape[1]))
    x = np.concatenate([np.hstack(list(table.values())) for table in tables])
    scale, change = _without_redundancy(x, np.array(family))
    return _Columns(
        x=x / scale,
        scale=scale,
        change=change,
        family=family,
        paths=tuple(paths),
    )


def _gain(axis: AxisModel, piece: _Piece) -> Array | float:
    """Return the factor of the displacement at the rows, (rows, 1)."""
    gain: Array | float = 1.0
    for extension in axis.extensions:
        gain = gain * extension.gain(piece.where)
    return gain if isinstance(gain, float) else gain[piece.rows, None]


def _empty(axis: AxisModel) -> LoopShape:
    low_V, high_V = axis.voltage_V
    return LoopShape(
        centre_V=0.5 * (low_V + high_V),
        reach_V=0.5 * (high_V - low_V),
        density_m=np.zeros((len(WIDTHS), len(EDGES) - 1)),
        smooth_m=np.zeros(smooth_count()),
        plain=PlainFit(
            lag_s=axis.lag.time_s,
            rms_m=0.0,
            held_out_rms_m=0.0,
            quality=axis.quality,
            starts=axis.starts,
        ),
    )


def _path(drive_V: Array, rows: NDArray[np.intp], late: float) -> tuple[Array, NDArray[np.intp]]:
    """Return the turns of a drive with its values ``late`` samples before rows; their places."""
    at = np.maximum(rows - late, 0.0)
    turns = np.flatnonzero(turns_of(drive_V))
    turns = turns[turns <= at[-1]]
    order = np.argsort(np.concatenate([turns, at]), kind="stable")
    values = np.concatenate([drive_V[turns], np.interp(at, np.arange(len(drive_V)), drive_V)])
    places = np.empty(len(order), dtype=np.intp)
    places[order] = np.arange(len(order))
    return values[order], places[len(turns) :]


def _states(
    drive: Array, places: NDArray[np.intp], history: Sequence[float]
) -> tuple[Array, States]:
    """Return a scaled drive and the states of the wide class at some samples of it."""
    states = HysteresisStates((*history, float(drive[0])))
    parts: list[States] = []
    for first in range(0, len(drive), CHUNK):
        followed = states.follow(drive[first : first + CHUNK])
        rows = places[(places >= first) & (places < first + CHUNK)] - first
        parts.append((followed[0][rows], followed[1][rows], followed[2][rows]))
    plays, friction, bouc_wen = (np.concatenate(kind) for kind in zip(*parts, strict=True))
    return drive[places], (plays, friction, bouc_wen)


def _delayed_columns(
    drive: Array, rows: NDArray[np.intp], late: float, history: Sequence[float]
) -> dict[str, Array]:
    """Return the columns ``late`` samples before rows, straight between samples as in a delay."""
    whole = int(np.floor(late))
    newer = np.maximum(rows - whole, 0)
    older = np.maximum(newer - 1, 0)
    both = np.union1d(newer, older)
    path, places = way_to(drive, both)
    level, states = _states(path, places, history)
    share = late - whole
    table: dict[str, Array] = {}
    for weight, at in ((1.0 - share, newer), (share, older)):
        place = np.searchsorted(both, at)
        chosen = (states[0][place], states[1][place], states[2][place])
        for name, x in class_columns(level[place], chosen).items():
            table[name] = weight * x + table.get(name, np.zeros(1))
    return table


def _remembering_path(
    axis: AxisModel,
    shape: LoopShape,
    drive_V: Array,
    places: NDArray[np.intp],
    start: PieceStart,
    number: int,
) -> _Path:
    """Follow histories for as long as they show."""
    drive_V = drive_V[: remembered(shape.scaled(drive_V))]
    places = places[places < len(drive_V)]
    drive = shape.scaled(drive_V)
    memories = [(start.memory_V, history_of(axis.hysteresis, start.memory_V, shape))]
    tried = histories(float(drive[0]))[:number]
    memories += [(axis.memory_after(shape.turns_V(history)), history) for history in tried]
    plays_m = [axis.invertible_m(drive_V, memory_V, 1.0)[places] for memory_V, _ in memories]
    states = [_states(drive, places, history)[1] for _, history in memories]
    return _Path(drive=drive[places], plays_m=np.stack(plays_m, axis=1), states=tuple(states))


def _without_redundancy(x: Array, family: NDArray[np.str_]) -> tuple[Array, Array]:
    """Return scales of the columns, and the change that makes families free of redundancy."""
    scale = np.sqrt((x**2).mean(axis=0))
    for name in set(family):
        if name.startswith("density"):  # the prior fixes the relative size of its components
            scale[family == name] = scale[family == name].max()
    scale[scale < 1e-12] = 1.0
    z = (x - x.mean(axis=0)) / scale
    gram, change, before = z.T @ z, np.eye(len(family)), np.zeros(0, dtype=np.intp)
    for name in dict.fromkeys(family):
        place = np.flatnonzero(family == name)
        if len(before):
            known = gram[np.ix_(before, before)]
            known = known + JITTER * np.trace(known) / len(before) * np.eye(len(before))
            change[np.ix_(before, place)] = -np.linalg.solve(known, gram[np.ix_(before, place)])
        before = np.concatenate([before, place])
    return scale, change


def _first(axis: AxisModel, pieces: Sequence[_Piece], columns: _Columns) -> _Estimate:
    """Return the estimate of the plays alone."""
    rows = len(columns.x)
    return _Estimate(
        model=replace(axis, loop_shape=_empty(axis)),
        weights=tuple(np.zeros(path.plays_m.shape[1] - 1) for path in columns.paths),
        zeros=tuple(np.array(piece.start.zero_m) for piece in pieces),
        wide=np.zeros(len(columns.scale)),
        coefficient=np.zeros(0),
        shift=0.0,
        variance={},
        noise=0.0,
        parameters=0.0,
        residual_m=np.zeros(rows),
        use=np.ones(rows, dtype=bool),
        rows=tuple(len(piece.rows) for piece in pieces),
    )


def _regression(
    estimate: _Estimate, pieces: Sequence[_Piece], columns: _Columns, *, has_numbers: bool = True
) -> _Regression:
    """Return the rows whose coefficients are the next estimate; zeros are those of the pieces.

    The target is the error of the present estimate and what its linear coefficients contribute.

    has_numbers  whether lag and extensions may change
    """
    axis = estimate.model
    shape = axis.loop_shape
    assert shape is not None
    scale_m, is_first = _scale_m(axis), not estimate.variance
    rows = np.cumsum([0, *estimate.rows])
    sizes = [len(zero_m) for zero_m in estimate.zeros]
    first = np.cumsum([0, *sizes])
    zeros = np.zeros((rows[-1], first[-1]))
    histories_of = [np.zeros((rows[-1], 0 if is_first else len(w))) for w in estimate.weights]
    numbers_m, error_m = [], []
    for k, piece in enumerate(pieces):
        span = slice(rows[k], rows[k + 1])
        start = replace(piece.start, zero_m=estimate.zeros[k])
        knots = np.eye(sizes[k])
        for j in range(sizes[k]):
            hat = replace(start, zero_m=knots[j])
            zeros[span, first[k] + j] = zero_of(hat, piece.where.samples)[piece.rows]
        if not is_first:
            changes = columns.paths[k].changes_m(shape) / abs(scale_m)
            histories_of[k][rows[k] : rows[k] + len(changes)] = changes
            start = replace(start, history_weight=estimate.weights[k])
        static_m = axis.static_m(piece.drive_V, start.memory_V, piece.where.rate_Hz)
        if not is_first:
            changes_m = axis.history_changes_m(piece.drive_V, start.memory_V, piece.where.rate_Hz)[
                :, : len(estimate.weights[k])
            ]
            static_m = static_m + changes_m @ estimate.weights[k]
        read_m = _read_m(axis, piece, start, static_m)
        error_m.append(piece.measured_m[piece.rows] - read_m)
        if has_numbers:
            numbers_m.append(_changes_m(axis, piece, start, static_m, read_m))
    numbers = _numbers(axis) if has_numbers else free([], [], [], [])
    slopes = np.concatenate(numbers_m) / scale_m if has_numbers else np.zeros((rows[-1], 0))
    size = np.sqrt((slopes**2).mean(axis=0))
    size[size < 1e-12] = 1.0
    step, slopes = numbers.step / size, slopes / size
    local = {
        "initial state": np.hstack(histories_of),
        "zero": zeros,
        "number": slopes,
    }
    design = np.hstack([columns.x, *local.values()])
    names = [name for name, table in local.items() for _ in range(table.shape[1])]
    change = np.eye(design.shape[1])
    change[: len(columns.scale), : len(columns.scale)] = columns.change
    target = np.concatenate(error_m) / scale_m + columns.x @ (estimate.wide * columns.scale)
    target = target + zeros @ (np.concatenate(estimate.zeros) / scale_m)
    if not is_first:
        target = target + local["initial state"] @ np.concatenate(estimate.weights)
    return _Regression(
        design=design,
        target=target,
        family=(*columns.family, *names),
        change=change,
        use=estimate.use,
        fold=np.concatenate([piece.fold for piece in pieces]),
        value=numbers.value,
        lower=numbers.lower,
        upper=numbers.upper,
        step=step,
        prior=_prior(axis, step, design.shape[1]) if has_numbers else None,
    )


def _read_m(axis: AxisModel, piece: _Piece, start: PieceStart, static_m: Array) -> Array:
    """Return the reading at the rows of a piece, (rows,)."""
    forward = axis.forward
    zero_m = zero_of(start, piece.where.samples)
    return forward.read(forward.position(static_m, piece.where, zero_m))[piece.rows]


def _numbers(axis: AxisModel) -> Free:
    """Return the lag, where the model has one, and the numbers of all extensions."""
    late = free(axis.lag.time_s, 0.0, np.inf, LAG_s)
    frees = [] if axis.lag.kind == "none" else [late]
    frees += [extension.free() for extension in axis.extensions]
    value, lower, upper, step = (
        np.concatenate([np.zeros(0), *(getattr(numbers, name) for numbers in frees)])
        for name in ("value", "lower", "upper", "step")
    )
    return Free(value=value, lower=lower, upper=upper, step=step)


def _at(axis: AxisModel, values: Array) -> AxisModel:
    """Return the model with these numbers of lag and extensions."""
    lag, extensions = axis.lag, []
    if lag.kind != "none":
        lag, values = replace(lag, time_s=float(values[0])), values[1:]
    for extension in axis.extensions:
        count = len(extension.free().value)
        extensions.append(replace(extension.moved_to(values[:count]), std=extension.std))
        values = values[count:]
    return replace(axis, lag=lag, extensions=tuple(extensions))


def _changes_m(
    axis: AxisModel, piece: _Piece, start: PieceStart, static_m: Array, read_m: Array
) -> Array:
    """Return the change of the reading by a step of every number, (rows, numbers)."""
    numbers = _numbers(axis)
    changes = np.zeros((len(piece.rows), len(numbers.value)))
    parts: list[Extension | None] = [] if axis.lag.kind == "none" else [None]
    for extension in axis.extensions:
        parts += [extension] * len(extension.free().value)
    for k, (part, step) in enumerate(zip(parts, numbers.step, strict=True)):
        sign = 1.0 if numbers.value[k] + step <= numbers.upper[k] else -1.0
        values = numbers.value.copy()
        values[k] += sign * step
        changed, changed_m = _at(axis, values), static_m
        if part is not None and not _is_behind_hysteresis(part):
            drive_V = changed.forward.driven_V(piece.voltage_V, piece.where.rate_Hz)
            changed_m = changed.static_m(drive_V, start.memory_V, piece.where.rate_Hz)
        changes[:, k] = sign * (_read_m(changed, piece, start, changed_m) - read_m)
    return changes


def _is_behind_hysteresis(extension: Extension) -> bool:
    kind = type(extension)
    return kind.drive is Extension.drive and kind.irreversible is Extension.irreversible


def _prior(axis: AxisModel, steps: Array, count: int) -> Moments:
    """Return the sums of what is known of the extensions' numbers beforehand, one row each.

    steps  (numbers,)  what a coefficient of 1 means
    count  of all columns
    """
    gram, moment, square, rows = np.zeros((count, count)), np.zeros(count), 0.0, 0
    first = int(axis.lag.kind != "none")
    for extension in axis.extensions:
        last = first + len(extension.free().value)
        relations = extension.prior() / (abs(_scale_m(axis)) if extension.in_metres else 1.0)
        if len(relations):
            span = slice(count - len(steps) + first, count - len(steps) + last)
            change, value = relations * steps[first:last], relations @ extension.free().value
            gram[span, span] += change.T @ change
            moment[span] -= change.T @ value
            square, rows = square + float(value @ value), rows + len(relations)
        first = last
    return Moments(gram=gram, moment=moment, square=square, count=rows)


def _scale_m(axis: AxisModel) -> float:
    """Return half the range of the displacement, negative where it falls as the drive rises."""
    return axis.polarity * 0.5 * axis.quality.range_m


def _improved(
    estimate: _Estimate,
    pieces: Sequence[_Piece],
    columns: _Columns,
    regression: _Regression,
    steps: int = 40,
) -> _Estimate:
    """Return the next estimate: variances by marginal likelihood, coefficients, lag, outliers.

    steps  of the fixed point of the variances
    """
    axis, scale_m = estimate.model, _scale_m(estimate.model)
    total = _sum(regression.moments())
    ridge = _ridge(estimate, regression, total)
    outward = regression.outward(regression.change @ ridge.mean(total))
    if outward.any():
        regression = regression.without(outward)
        total = _sum(regression.moments())
    bounded = np.array([name == "initial state" for name in regression.labels])
    ceiling = np.where(bounded, 1.0, np.inf)
    ridge, reduced, parameters = ridge.maximised(total, ceiling=ceiling, steps=steps)
    coefficient = regression.change @ reduced
    residual = regression.target - regression.design @ coefficient
    wide = coefficient[: len(columns.scale)]
    places = regression.number_places
    change_m = regression.design[:, places] @ coefficient[places]
    if len(places):
        values = regression.value + regression.step * coefficient[places]
        axis = _at(axis, np.clip(values, regression.lower, regression.upper))
    density, smooth = coefficients(wide / columns.scale)
    shape = replace(
        axis.loop_shape or _empty(axis),
        density_m=abs(scale_m) * density,
        smooth_m=abs(scale_m) * smooth,
    )
    histories_weight = coefficient[regression.places("initial state")]
    counts = [len(weight) for weight in estimate.weights]
    weights = estimate.weights
    if len(histories_weight):
        weights = tuple(np.split(histories_weight, np.cumsum(counts)[:-1]))
    knots = np.cumsum([len(piece.start.zero_m) for piece in pieces])[:-1]
    use = estimate.use
    if estimate.variance:
        far = np.abs(residual) > FAR * 1.4826 * np.median(np.abs(residual))
        use = ~(far & ~np.roll(far, 1) & ~np.roll(far, -1))  # several in a row are no outliers
    return _Estimate(
        model=replace(axis, loop_shape=shape),
        weights=weights,
        zeros=tuple(np.split(scale_m * coefficient[regression.places("zero")], knots)),
        wide=wide / columns.scale,
        coefficient=coefficient,
        shift=float(np.sqrt(np.mean(change_m[use] ** 2) / np.mean(residual[use] ** 2))),
        variance=dict(zip(regression.labels, ridge.variance.tolist(), strict=True)),
        noise=ridge.noise,
        parameters=parameters,
        residual_m=scale_m * residual,
        use=use,
        rows=estimate.rows,
    )


def _sum(folds: Sequence[Moments]) -> Moments:
    return reduce(add, folds)


def _ridge(estimate: _Estimate, regression: _Regression, total: Moments) -> FamilyRidge:
    """Return the ridge from which the fixed point starts: that of the last round."""
    labels, power = regression.labels, total.square / total.count
    first = {name: 0.1 * power for name in labels} | {"initial state": 0.3}
    first |= estimate.variance | dict.fromkeys(UNPENALISED, np.inf)
    return FamilyRidge(
        family=np.array([labels.index(name) for name in regression.family]),
        variance=np.array([first[name] for name in labels]),
        noise=estimate.noise or 0.01 * power,
    )


def _accepted(
    axis: AxisModel,
    estimate: _Estimate,
    pieces: Sequence[_Piece],
    columns: _Columns,
    plain: "_Errors",
) -> AxisModel:
    """Return the axis with loop shape, or without where left-out blocks gain too little."""
    regression = _regression(estimate, pieces, columns, has_numbers=False)
    errors, factor = _errors(estimate, regression)
    stepped = _with_step(estimate, regression)
    if stepped is not None:
        errors_with_step, factor_with_step = _errors(estimate, stepped)
        if errors_with_step.held_out < STEP_WORTH * errors.held_out:
            regression, factor = stepped, factor_with_step
            plain, errors = _plain_errors(axis, stepped), errors_with_step
    if errors.held_out > WORTH * plain.held_out or errors.explained > WORTH * plain.explained:
        return replace(axis, loop_shape=None)
    shrunk = replace(
        estimate,
        variance=_shrunk(estimate.variance, factor),
        noise=NOISE_FACTOR * estimate.noise,
    )
    final = _improved(shrunk, pieces, columns, regression, steps=0)
    regression = _again(final, pieces, columns, regression)
    final = _improved(final, pieces, columns, regression, steps=0)
    scale_m = abs(_scale_m(axis))
    explained_m = final.residual_m[final.use]
    step = regression.places("step")
    if len(step):  # the model that ships has no step
        moved = regression.design[:, step] @ final.coefficient[step]
        moved = moved - np.mean(moved[final.use])
        explained_m = explained_m + _scale_m(axis) * moved[final.use]
    shape = final.model.loop_shape
    assert shape is not None
    rms_m = float(np.sqrt(np.mean(explained_m**2)))
    held_out_m = float(np.hypot(scale_m * errors.held_out, _step_m(final, explained_m)))
    tested = axis.quality.is_tested  # blocks of a single loop leave nothing that is like them
    quality = replace(
        axis.quality,
        rms_m=rms_m,
        held_out_rms_m=held_out_m if tested else rms_m,
        held_out_kind=BLOCKS if tested else IN_SAMPLE,
        rows=len(explained_m),
        effective_parameters=final.parameters,
    )
    return replace(
        final.model,
        loop_shape=replace(
            shape,
            plain=PlainFit(
                lag_s=axis.lag.time_s,
                rms_m=scale_m * plain.explained,
                held_out_rms_m=scale_m * plain.held_out,
                quality=axis.quality,
                starts=axis.starts,
            ),
        ),
        quality=quality,
        starts=_starts(final, pieces),
    )


def _again(
    estimate: _Estimate,
    pieces: Sequence[_Piece],
    columns: _Columns,
    regression: _Regression,
) -> _Regression:
    """Return the regression with the histories' columns of the new estimate, and the same step."""
    fresh = _regression(estimate, pieces, columns, has_numbers=False)
    step = regression.places("step")
    return _beside(fresh, regression.design[:, step[0]]) if len(step) else fresh


def _beside(regression: _Regression, step: Array) -> _Regression:
    """Return the regression with a step of the zero as last column."""
    size = len(regression.family)
    change = np.eye(size + 1)
    change[:size, :size] = regression.change
    return replace(
        regression,
        design=np.column_stack([regression.design, step]),
        family=(*regression.family, "step"),
        change=change,
    )


def _step_m(final: _Estimate, explained_m: Array) -> float:
    """Return what a step of the zero adds to the residual, rms, m."""
    without = float(np.mean(final.residual_m[final.use] ** 2))
    return float(np.sqrt(max(float(np.mean(explained_m**2)) - without, 0.0)))


def _starts(final: _Estimate, pieces: Sequence[_Piece]) -> tuple[PieceStart, ...]:
    """Return the starts of all pieces with their zeros and histories."""
    known = {
        id(piece.start): replace(piece.start, zero_m=zero_m, history_weight=weight)
        for piece, zero_m, weight in zip(pieces, final.zeros, final.weights, strict=True)
    }
    return tuple(known.get(id(start), start) for start in final.model.starts)


@dataclass(frozen=True, kw_only=True)
class _Errors:
    """Errors in units of half the stroke.

    explained  in sample, corrected for the number of parameters of loop shape
    held_out   on left-out blocks
    """

    explained: float
    held_out: float


def _plain_errors(axis: AxisModel, regression: _Regression) -> _Errors:
    """Return the errors of the plays with dead zones.

    The plays were fitted to all blocks. What leaving blocks out adds to their error is known from
    their own fit: on the bundled axis y 16.4 nm become 17.5, and loop shape leaves 16.6. It stands
    on the same plays, so that on a stage of plays its error of left-out blocks is below theirs as
    well; only the error in sample shows that it adds nothing.
    """
    free = np.isin(regression.family, ("zero", "step"))
    zeros = replace(
        regression,
        design=regression.design[:, free],
        family=tuple(np.array(regression.family)[free].tolist()),
        change=np.eye(int(free.sum())),
        value=regression.value[:0],
        lower=regression.lower[:0],
        upper=regression.upper[:0],
        step=regression.step[:0],
        prior=None,
    )
    folds = zeros.moments()
    total = _sum(folds)
    labels = zeros.labels
    ridge = FamilyRidge(
        family=np.array([labels.index(name) for name in zeros.family]),
        variance=np.full(len(labels), np.inf),
        noise=1e-6 * total.square / total.count,
    )
    error = zeros.target - zeros.design @ ridge.mean(total)
    explained = float(np.sqrt(np.mean(error[zeros.use] ** 2)))
    quality = axis.quality
    optimism = quality.held_out_rms_m / quality.rms_m if quality.is_tested else 1.0
    held_out = max(optimism, 1.0) * _error(zeros, folds, total, ridge)
    return _Errors(explained=explained, held_out=held_out)


def _errors(estimate: _Estimate, regression: _Regression) -> tuple[_Errors, float]:
    """Return the errors with loop shape, and the common factor of the prior variances.

    Where the class is wrong, less freedom predicts better than marginal likelihood says.
    """
    folds = regression.moments()
    total = _sum(folds)
    tried = {}
    for factor in SHRINK:
        shrunk = replace(
            estimate,
            variance=_shrunk(estimate.variance, factor),
            noise=NOISE_FACTOR * estimate.noise,
        )
        tried[factor] = _error(regression, folds, total, _ridge(shrunk, regression, total))
    factor = min(SHRINK, key=tried.__getitem__)
    coefficient = regression.change @ _ridge(estimate, regression, total).mean(total)
    residual = (regression.target - regression.design @ coefficient)[regression.use]
    free = max(len(residual) - estimate.parameters, 1.0)
    explained = float(np.sqrt(np.sum(residual**2) / free))
    return _Errors(explained=explained, held_out=tried[factor]), factor


def _shrunk(variance: dict[str, float], factor: float) -> dict[str, float]:
    """Return the variances with those of the wide class times a factor."""
    local = (*UNPENALISED, "initial state", "step")
    return {name: v if name in local else factor * v for name, v in variance.items()}


def _error(
    regression: _Regression, folds: Sequence[Moments], total: Moments, ridge: FamilyRidge
) -> float:
    """Return the error on left-out blocks, rms."""
    squares, count = 0.0, 0
    for number in range(FOLDS):
        rows = (regression.fold == number) & regression.use
        if rows.any():
            fitted = regression.change @ ridge.mean(total - folds[number])
            error = regression.target[rows] - regression.design[rows] @ fitted
            squares, count = squares + float(error @ error), count + len(error)
    return float(np.sqrt(squares / max(count, 1)))


def _with_step(estimate: _Estimate, regression: _Regression) -> _Regression | None:
    """Return the regression with a step of the zero where that gains most.

    A wide class follows a jump of the zero by hysteresis that does not exist. The gain of a step H
    beside everything else is (r'H)^2 / H'(I - X P^-1 X') H, with P the posterior precision.
    """
    total = _sum(regression.moments())
    ridge = _ridge(estimate, regression, total)
    scale = np.sqrt(np.minimum(ridge.variance, 1e4 * total.square / total.count))[ridge.family]
    inverse = np.linalg.inv(
        total.gram * (scale[:, None] * scale) / ridge.noise + np.eye(len(scale))
    )
    residual = np.where(estimate.use, estimate.residual_m / _scale_m(estimate.model), 0.0)
    best, gain = None, 0.0
    edges = np.cumsum([0, *estimate.rows])
    for first, last in pairwise(edges):
        places = np.linspace(first, last, STEP_PLACES + 2)[1:-1].astype(int)
        for place in np.unique(places):
            step = np.zeros(len(residual))
            step[place:last] = estimate.use[place:last]
            h = scale * (regression.change.T @ (step[place:last] @ regression.design[place:last]))
            free = float(step @ step - h @ inverse @ h / ridge.noise)
            tried = float(residual @ step) ** 2 / max(free, 1e-9 * float(step @ step) + 1e-300)
            if tried > gain:
                best, gain = step, tried
    return None if best is None else _beside(regression, best)
