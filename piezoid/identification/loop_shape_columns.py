"""Rows and columns of the regression for loop shape: the wide class of hysteresis along a drive.

Families of columns are made free of redundancy: each keeps only what the families before it
cannot represent along the recordings and along a drive that visits the whole range. Otherwise
friction and Bouc-Wen states cancel each other with contributions of a thousand times the
displacement, and left-out blocks are missed by as much.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from piezoid.identification.extensions.extension import Where
from piezoid.identification.forward import LARGEST
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
from piezoid.identification.simulation import starts_of, where_of
from piezoid.identification.step_rows import rows_after_steps
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
    mixed_columns,
    smooth_count,
)
from piezoid.records.recording import Recording

ROWS = 20_000  # of all pieces together
FOLDS = 5
BLOCKS_OF_A_PIECE = 15
COVERED = 0.97  # of the range of a piece: before, its initial state is unresolved
JITTER = 1e-7  # of the mean diagonal: what is smaller is redundant
MANY_HISTORIES = 120  # columns of initial states of all pieces together
TURNS, STEP = 150, 0.02  # of the reference drive, half ranges
PLAYS = "plays"  # family of what the plays have beyond their approximation by the class
# Share of the motion that a delay in place of the filters may miss where the columns at every
# sample exceed LARGEST: 200,000 samples took 3.2 GB and 177 s, behind a delay 1 GB and 24 s.
FILTERED = 0.02
MIN_WEIGHT = 1e-3  # of a history whose change of the columns matters
NEVER = -1  # number of the fold of rows that no fold leaves out


@dataclass(frozen=True, kw_only=True, eq=False)
class Piece:
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
class _Path:
    """A drive at the rows that may remember its initial state, with its states after histories.

    place     (rows,)  in samples, as late as the filters make the rows where they only delay
    drive     (rows,)  scaled
    plays_m   (rows, 1 + histories)  response of the plays: of the fitted memory, of each history
    states    of the wide class, likewise
    is_late_only  whether the filters only delay
    """

    place: Array
    drive: Array
    plays_m: Array
    states: tuple[States, ...]
    is_late_only: bool

    def changes_m(self, shape: LoopShape) -> Array:
        """Return by how much every history changes the response, (rows, histories)."""
        made = [shape.of_states(self.drive, states) for states in self.states]
        total_m = shape.plays_weight * self.plays_m + np.stack(made, axis=1)
        return np.asarray(total_m[:, 1:] - total_m[:, :1])

    def column_changes(self, weight: Array, plays: Array, half_range_m: float) -> Array:
        """Return by how much weighted histories change the columns of the class.

        plays     (columns,)  as in ``Columns``
        returned  (rows, columns)  unscaled, what the plays have beyond the class at the end
        """
        histories = np.flatnonzero(np.abs(weight) > MIN_WEIGHT)
        mixture = np.concatenate([[-weight[histories].sum()], weight[histories]])
        states = [self.states[k] for k in (0, *(histories + 1))]
        of_class = np.hstack(list(mixed_columns(self.drive, states, mixture).values()))
        plays_m = (self.plays_m[:, 1:] - self.plays_m[:, :1]) @ weight
        beyond = plays_m / half_range_m - of_class @ plays[:-1]
        return np.column_stack([of_class, beyond])

    def interpolated(self, change: Array, samples: int) -> Array:
        """Return changes at all samples of the piece: linear between rows, 0 after the last."""
        if not len(self.place):
            return np.zeros((samples, change.shape[1]))
        every = np.arange(samples)
        columns = [np.interp(every, self.place, column, right=0.0) for column in change.T]
        return np.stack(columns).T

    def behind_filters(self, change: Array, axis: AxisModel, piece: Piece) -> Array:
        """Return changes of the response as they arrive at the sensor, (rows of the piece, n)."""
        if self.is_late_only:
            after = np.zeros((len(piece.rows) - len(change), change.shape[1]))
            arrived = np.concatenate([change, after])
        else:
            everywhere = self.interpolated(change, piece.where.samples)
            arrived = axis.forward.behind(everywhere, piece.where, instant=True)[piece.rows]
        return np.asarray(arrived * gain_of(axis, piece))


@dataclass(frozen=True, kw_only=True, eq=False)
class Columns:
    """What lag and extensions determine.

    x          (rows, columns)   the wide class, scaled
    scale      (columns,)        what the columns were divided by
    change     (columns, columns)  from coefficients without redundancy to those of ``x``
    plays      (columns,)        see ``reference_columns``; 0 for the last column, what the plays
                                 have beyond them
    family     (columns,)        name of each column's family
    paths      path of each piece's drive to its first rows, for other histories
    """

    x: Array
    scale: Array
    change: Array
    plays: Array
    family: tuple[str, ...]
    paths: tuple[_Path, ...]


def pieces_of(axis: AxisModel, recordings: Sequence[Recording]) -> tuple[Piece, ...]:
    """Return the pieces whose start is known, thinned to ``ROWS`` rows together."""
    most = max(1, ROWS // max(len(axis.starts), 1))
    low_V, high_V = axis.voltage_V
    pieces: list[Piece] = []
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
            after_steps = rows_after_steps(level, where.rate_Hz, axis.extensions, least=2)
            unknown = np.concatenate([bridged - part.start, after_steps])
            rows = start.first + spread_rows(start.last - start.first, most)
            rows = np.setdiff1d(rows, unknown)
            pieces.append(
                Piece(
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


def with_drive_of(axis: AxisModel, pieces: Sequence[Piece]) -> tuple[Piece, ...]:
    """Return the pieces with the drive that reaches the hysteresis of a model."""
    return tuple(
        replace(piece, drive_V=axis.forward.driven_V(piece.voltage_V, piece.where.rate_Hz))
        for piece in pieces
    )


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


def columns_of(axis: AxisModel, pieces: Sequence[Piece]) -> Columns:
    """Return everything that depends on lag and extensions."""
    shape, forward = no_loop_shape(axis), axis.forward
    reference, plays = reference_columns(axis)
    tables, paths = [], []
    number = min(len(histories(0.0)), max(3, MANY_HISTORIES // len(pieces)))
    for piece in pieces:
        late = forward.late_s(piece.where.rate_Hz) * piece.where.rate_Hz
        static_m = axis.invertible_m(piece.drive_V, piece.start.memory_V, piece.where.rate_Hz)
        plays_m = forward.behind(static_m, piece.where, instant=True)[piece.rows]
        drive_V, places = _path(piece.drive_V, piece.rows, late)
        history = history_of(axis.hysteresis, piece.start.memory_V, shape)
        delayed_m = axis.invertible_m(drive_V, piece.start.memory_V, piece.where.rate_Hz)[places]
        tolerated_m = axis.quality.noise_rms_m
        if len(plays) * int(piece.rows[-1]) > LARGEST:
            tolerated_m = max(tolerated_m, FILTERED * float(np.std(plays_m)))
        is_late_only = forward.is_memoryless or bool(np.std(plays_m - delayed_m) < tolerated_m)
        if is_late_only:
            table = _delayed_columns(shape.scaled(piece.drive_V), piece.rows, late, history)
        else:
            everywhere = np.arange(int(piece.rows[-1]) + 1)
            unfiltered = class_columns(*_states(shape.scaled(piece.drive_V), everywhere, history))
            table = {
                name: forward.behind(x, piece.where, instant=True)[piece.rows]
                for name, x in unfiltered.items()
            }
            drive_V, places = _path(piece.drive_V, piece.rows, 0.0)
        of_class = np.hstack(list(table.values())) @ plays[:-1]
        table[PLAYS] = (plays_m / (0.5 * axis.quality.range_m) - of_class)[:, None]
        tables.append({name: x * gain_of(axis, piece) for name, x in table.items()})
        place = np.maximum(piece.rows - late, 0.0) if is_late_only else piece.rows.astype(float)
        paths.append(
            _remembering_path(axis, drive_V, places, place, piece.start, number, is_late_only)
        )
    family = tuple(name for name, x in tables[0].items() for _ in range(x.shape[1]))
    x = np.concatenate([np.hstack(list(table.values())) for table in tables])
    scale, change = _without_redundancy([x, reference], np.array(family))
    return Columns(
        x=x / scale,
        scale=scale,
        change=change,
        plays=plays,
        family=family,
        paths=tuple(paths),
    )


def reference_columns(axis: AxisModel) -> tuple[Array, Array]:
    """Return the columns along the reference drive, (rows, columns), and the plays' coefficients.

    The reference drive visits the whole range. The coefficients, (columns,), are those with which
    the wide class comes closest to the plays there, in half ranges of the displacement: what the
    fit of loop shape falls back on where recordings say nothing. Plays with dead zones have kinks,
    which a smooth material has not; the last column is what they have beyond the class.
    """
    drive, family, x, scale, change = _reference()
    shape = no_loop_shape(axis)
    memory_V = axis.memory_after(shape.turns_V(()))
    drive_V = shape.centre_V + shape.reach_V * drive
    plays = axis.invertible_m(drive_V, memory_V, 1.0) / (0.5 * axis.quality.range_m)
    number = np.unique(family, return_inverse=True)[1]
    z, families = np.column_stack([x / scale @ change, np.ones(len(x))]), int(number.max()) + 1
    sums = Moments(gram=z.T @ z, moment=z.T @ plays, square=float(plays @ plays), count=len(z))
    power = sums.square / sums.count
    ridge = FamilyRidge(
        family=np.append(number, families),
        variance=np.append(np.full(families, 0.1 * power), np.inf),
        noise=1e-4 * power,
    )
    _, coefficient, _ = ridge.maximised(sums, ceiling=np.full(families + 1, np.inf))
    smooth = np.asarray(change @ coefficient[:-1] / scale)
    return np.column_stack([x, plays - x @ smooth]), np.append(smooth, 0.0)


@cache
def _reference() -> tuple[Array, NDArray[np.str_], Array, Array, Array]:
    """Return the reference drive, and its columns with their families, scales and change."""
    turns = np.random.default_rng(0).uniform(-1.0, 1.0, TURNS)
    runs = [np.arange(a, b, np.copysign(STEP, b - a)) for a, b in pairwise(turns)]
    drive = np.concatenate(runs)
    table = class_columns(drive, HysteresisStates((float(drive[0]),)).follow(drive))
    family = np.repeat(list(table), [block.shape[1] for block in table.values()])
    x = np.hstack(list(table.values()))
    return drive, family, x, *_without_redundancy([x], family)


def gain_of(axis: AxisModel, piece: Piece) -> Array | float:
    """Return the factor of the displacement at the rows, (rows, 1)."""
    gain: Array | float = 1.0
    for extension in axis.extensions:
        gain = gain * extension.gain(piece.where)
    return gain if isinstance(gain, float) else gain[piece.rows, None]


def no_loop_shape(axis: AxisModel) -> LoopShape:
    """Return loop shape of which all coefficients are 0."""
    low_V, high_V = axis.voltage_V
    return LoopShape(
        centre_V=0.5 * (low_V + high_V),
        reach_V=0.5 * (high_V - low_V),
        density_m=np.zeros((len(WIDTHS), len(EDGES) - 1)),
        smooth_m=np.zeros(smooth_count()),
        plays_weight=1.0,
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
    path, places = thinned_drive(drive, both)
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
    drive_V: Array,
    places: NDArray[np.intp],
    place: Array,
    start: PieceStart,
    number: int,
    is_late_only: bool,
) -> _Path:
    """Follow histories for as long as they show.

    drive_V    (samples,)  V, at its turns and rows
    places     (rows,)     of the rows in it
    place      (rows,)     in samples of the piece
    number     of histories
    """
    shape = no_loop_shape(axis)
    drive_V = drive_V[: remembered(shape.scaled(drive_V))]
    places = places[places < len(drive_V)]
    drive = shape.scaled(drive_V)
    memories = [(start.memory_V, history_of(axis.hysteresis, start.memory_V, shape))]
    tried = histories(float(drive[0]))[:number]
    memories += [(axis.memory_after(shape.turns_V(history)), history) for history in tried]
    plays_m = [axis.invertible_m(drive_V, memory_V, 1.0)[places] for memory_V, _ in memories]
    states = [_states(drive, places, history)[1] for _, history in memories]
    return _Path(
        place=place[: len(places)],
        drive=drive[places],
        plays_m=np.stack(plays_m, axis=1),
        states=tuple(states),
        is_late_only=is_late_only,
    )


def _without_redundancy(drives: Sequence[Array], family: NDArray[np.str_]) -> tuple[Array, Array]:
    """Return scales of the columns, and the change that makes families free of redundancy.

    drives  the columns along each drive, (rows, columns); every drive counts as much

    What is redundant along a few recorded loops is not along others. Freed of redundancy along
    the recordings alone, columns were small there and enormous elsewhere: with triangles of three
    amplitudes of a Bouc-Wen stage recorded, the model missed one of a fourth amplitude by 92 times
    the noise, 5.6 times with the reference drive beside them; a Duhem stage by 112 and 19 times.
    """
    scale = np.sqrt(np.mean([(x**2).mean(axis=0) for x in drives], axis=0))
    for name in set(family):
        if name.startswith("density"):  # the prior fixes the relative size of its components
            scale[family == name] = scale[family == name].max()
    scale[scale < 1e-12] = 1.0
    gram = np.mean([np.cov(x / scale, rowvar=False, bias=True) for x in drives], axis=0)
    change, before = np.eye(len(family)), np.zeros(0, dtype=np.intp)
    for name in dict.fromkeys(family):
        place = np.flatnonzero(family == name)
        if len(before) and name != PLAYS:
            known = gram[np.ix_(before, before)]
            known = known + JITTER * np.trace(known) / len(before) * np.eye(len(before))
            change[np.ix_(before, place)] = -np.linalg.solve(known, gram[np.ix_(before, place)])
        before = np.concatenate([before, place])
    return scale, change
