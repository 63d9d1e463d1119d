"""Fit minor loops: plays behind functions, selected if they predict better.

Plays with dead zones and an envelope cannot represent every shape of minor loops. Plays behind
rising functions of their states represent any loops that close [Krejci 1996]. With thresholds and
edges on a lattice only the functions are unknown. Extensions, lag and declared poles keep their
fitted values and act linearly on the functions, so that

    min |L sum_i phi_i(z_i) + c - y|^2 + lambda |D phi|^2,   phi_i non-decreasing

is a convex program. The smallest shape is selected that predicts left-out recordings as well as
the largest. It replaces plays with dead zones only if its error is smaller by a third, because its
inverse takes more instructions. Refits without each block of time give the uncertainty of the
functions. The largest difference of two such operators over all drives is known exactly, so that
model and inverse have bounds like those of plays with dead zones.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from piezoid.formatting import with_unit
from piezoid.identification.extensions.rate_dependence import RateDependence
from piezoid.identification.hysteresis.pieces import PieceStart, where_of
from piezoid.identification.hysteresis.uncertainty import BLOCKS, DRAWS, SEED
from piezoid.identification.minor_loops import FunctionOrder, MinorLoops, PlaysFit
from piezoid.identification.model import AxisModel
from piezoid.identification.quality import OTHER_RECORDINGS, SECOND_HALF, WIDEST_HALVED
from piezoid.identification.simulation import (
    FittedPiece,
    fit_start,
    fitted_pieces,
    zero_of,
)
from piezoid.numerics.arrays import Array
from piezoid.numerics.quadratic_program import bounded_step
from piezoid.operators.play import play_columns
from piezoid.operators.preisach_plays import PreisachPlays, farthest_apart_m
from piezoid.records.recording import Recording

EDGE_STEPS = 4  # thresholds from edge to edge: more edges gave no improvement on the zoo
SHAPES = (4, 6, 8)  # pieces of a function; twice as many plays
SIMILAR = 1.03  # times the error of the largest shape: not noticeable
MIN_GAIN = 1.5  # error of plays with dead zones over that of functions: less is not worth the cost
MIN_SLOPE = 0.2  # of the mean slope, for a branch right behind a reversal: see coordinates.py
RIDGE = 1e-3  # on differences of rises between neighbours; a tenth or ten times it: no difference
MAX_ROWS = 3000  # of a recording
INITIAL_WEIGHT = 0.1  # of rows that depend on the fitted initial states
COVERED = 0.95  # of the range of a recording: the initial state is then forgotten
ROUNDING = 1e-13  # of the trace: cells that no drive reached depend on their neighbours alone
MARGIN = 0.1  # of half the range, by which a held-out recording may exceed the others


def lattice_of(voltage_V: tuple[float, float], pieces: int) -> PreisachPlays:
    """Return the plays of a shape over a range of the drive, each behind the identity.

    pieces  of each function, an even number
    """
    low_V, high_V = voltage_V
    half_V, plays = 0.5 * (high_V - low_V), pieces * EDGE_STEPS // 2
    step_V = half_V / plays
    edge_V = np.asarray(step_V * (EDGE_STEPS * np.arange(pieces + 1) - plays), dtype=np.float64)
    return PreisachPlays(
        step_V=step_V,
        edge_V=edge_V,
        value_m=np.tile(edge_V, (plays, 1)),
        voltage_offset_V=low_V + half_V,
    )


def rise_columns(lattice: PreisachPlays, states: Array) -> Iterator[Array]:
    """Yield for every piece of every function the fraction of its rise that a play has passed.

    states  (samples, plays)  V, of the drive relative to the centre
    """
    edge_V = lattice.edge_V
    bounds_V = [-np.inf, *edge_V[1:-1], np.inf]
    for state in states.T:
        for low_V, high_V in pairwise(bounds_V):
            above_edge_V = np.clip(state, low_V, high_V) - np.clip(0.0, low_V, high_V)
            yield above_edge_V / (edge_V[1] - edge_V[0])


@dataclass(frozen=True, kw_only=True, eq=False)
class Rows:
    """Regression rows of one piece of a recording.

    columns           (rows, cells)  response to a rise of 1 in each cell
    target            (rows,)        measured displacement, without zero and sensor error, m
    plays_residual_m  (rows,)        residual of plays with dead zones
    is_settled        (rows,)        whether the initial state is forgotten
    drive_range_V     lowest and highest drive relative to the centre
    """

    recording: str
    columns: Array
    target: Array
    plays_residual_m: Array
    is_settled: NDArray[np.bool_]
    drive_range_V: tuple[float, float]

    def first_rows(self, stop: int) -> "Rows":
        """Return the rows in front of ``stop``."""
        return replace(
            self,
            columns=self.columns[:stop],
            target=self.target[:stop],
            plays_residual_m=self.plays_residual_m[:stop],
            is_settled=self.is_settled[:stop],
        )

    def products(self, blocks: int = 1) -> Array:
        """Return [columns, target]'[columns, target] of blocks, (blocks, cells + 1, cells + 1).

        The weighted mean over the piece is subtracted from each column.
        """
        weight = np.where(self.is_settled, 1.0, INITIAL_WEIGHT)[:, None]
        rows = np.column_stack([self.columns, self.target])
        rows = weight * (rows - np.average(rows, axis=0, weights=weight[:, 0] ** 2))
        return np.array([block.T @ block for block in np.array_split(rows, blocks)])


def with_minor_loops(axis: AxisModel, recordings: Sequence[Recording]) -> AxisModel:
    """Return the axis with plays behind functions if these predict its recordings better.

    recordings  of the fit; recordings that the model does not contain are skipped
    """
    plays_axis = axis.without_loop_shape()
    quality = plays_axis.quality
    # Delayed domain walls are not linear in the functions.
    has_delayed_walls = any(isinstance(e, RateDependence) for e in plays_axis.extensions)
    if has_delayed_walls or not quality.is_tested:
        return plays_axis
    lattices = [lattice_of(plays_axis.voltage_V, pieces) for pieces in SHAPES]
    largest = _cross_validated(plays_axis, recordings, lattices[-1])
    if not len(largest.error_m):
        return plays_axis
    trials, best = [largest], None
    # If functions predict worse than plays fit the same rows, the prediction error of the plays
    # has another cause than the shape of loops.
    max_rms_m = min(quality.held_out_rms_m / MIN_GAIN, _rms(largest.plays_residual_m))
    if largest.rms_m <= max_rms_m:
        best = largest
        for lattice in lattices[:-1]:
            trials.append(_cross_validated(plays_axis, recordings, lattice))
            if trials[-1].rms_m <= SIMILAR * largest.rms_m:
                best = trials[-1]
                break
    orders = tuple(
        FunctionOrder(
            plays=trial.lattice.rise_m.shape[0],
            pieces=trial.lattice.rise_m.shape[1],
            held_out_rms_m=trial.rms_m,
            plain_rms_m=_rms(trial.plays_residual_m),
        )
        for trial in trials
    )
    axis = replace(plays_axis, function_orders=orders)
    if best is None:
        return axis
    axis = _with_functions(axis, best)
    refitted = {
        id(piece.start): _fitted_start(axis, recording, piece)
        for recording in recordings
        for piece in fitted_pieces(axis, recording)
    }
    return replace(axis, starts=tuple(refitted.get(id(start), start) for start in axis.starts))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Trial:
    """A lattice, and the residuals of its functions on held-out rows.

    error_m           (rows,)  of functions, which were not fitted to these rows
    plays_residual_m  (rows,)  of plays with dead zones, which were fitted to these rows
    held_out_kind     as in ``FitQuality``
    """

    lattice: PreisachPlays
    rows: Sequence[Rows]
    error_m: Array
    plays_residual_m: Array
    held_out_kind: str

    @property
    def rms_m(self) -> float:
        return _rms(self.error_m)


def _rms(error_m: Array) -> float:
    return float(np.sqrt(np.mean(error_m**2)))


def _cross_validated(
    axis: AxisModel, recordings: Sequence[Recording], lattice: PreisachPlays
) -> _Trial:
    """Predict each recording by a fit of the others.

    If a recording exceeds the drive range of all others, the fit includes its first half.
    """
    rows = [piece for recording in recordings for piece in _rows(axis, recording, lattice)]
    names = list(dict.fromkeys(piece.recording for piece in rows))
    products = {name: sum(p.products()[0] for p in rows if p.recording == name) for name in names}
    counts = {name: sum(len(p.target) for p in rows if p.recording == name) for name in names}
    margin_V = MARGIN * lattice.edge_V[-1]
    errors, plays_errors, is_halved = [], [], False
    for name in names:
        product = sum(products.values()) - products[name]
        count = sum(counts.values()) - counts[name]
        held_out = []  # pieces of this recording, each with the first row that is not fitted
        for piece in (p for p in rows if p.recording == name):
            low_V, high_V = piece.drive_range_V
            is_covered = any(
                p.drive_range_V[0] <= low_V + margin_V and p.drive_range_V[1] >= high_V - margin_V
                for p in rows
                if p.recording != name
            )
            first = 0 if is_covered else len(piece.target) // 2
            held_out.append((piece, first))
            if first:
                is_halved, count = True, count + first
                product = product + piece.first_rows(first).products()[0]
        rise_m = fit_rises(product, count, lattice, axis.quality.range_m)
        for piece, first in held_out:
            unseen = np.flatnonzero(piece.is_settled[first:]) + first
            if len(unseen):
                error_m = piece.target[unseen] - piece.columns[unseen] @ rise_m
                plays_m = piece.plays_residual_m[unseen]
                errors.append(error_m - error_m.mean())
                plays_errors.append(plays_m - plays_m.mean())
    kind = WIDEST_HALVED if is_halved else OTHER_RECORDINGS
    return _Trial(
        lattice=lattice,
        rows=rows,
        error_m=np.concatenate([np.zeros(0), *errors]),
        plays_residual_m=np.concatenate([np.zeros(0), *plays_errors]),
        held_out_kind=kind if len(names) > 1 else SECOND_HALF,
    )


def _with_functions(axis: AxisModel, trial: _Trial) -> AxisModel:
    """Return the axis with functions fitted to all rows, and their uncertainty."""
    lattice, rows, quality = trial.lattice, trial.rows, axis.quality
    total = sum(len(piece.target) for piece in rows)
    products = np.concatenate(
        [piece.products(max(round(BLOCKS * len(piece.target) / total), 1)) for piece in rows]
    )
    product, blocks = products.sum(axis=0), len(products)
    rise_m = fit_rises(product, total, lattice, quality.range_m)
    count_without = total * (blocks - 1) // blocks
    plays, pieces = lattice.rise_m.shape
    without_m = [
        fit_rises(product - block, count_without, lattice, quality.range_m).reshape(plays, pieces)
        for block in products
    ]
    residuals_m = [piece.target - piece.columns @ rise_m for piece in rows]
    zero_m = float(np.mean([residual_m.mean() for residual_m in residuals_m]))
    pairs = zip(residuals_m, rows, strict=True)
    settled_m = np.concatenate([(r - r.mean())[piece.is_settled] for r, piece in pairs])
    offset_m = axis.hysteresis.displacement_offset_m + zero_m
    minor_loops = MinorLoops(
        operator=replace(lattice, displacement_offset_m=offset_m).with_rises(
            rise_m.reshape(plays, pieces)
        ),
        without_m=np.array(without_m),
        least_rise_m=MIN_SLOPE * quality.range_m / pieces,
        plain=PlaysFit(
            rms_m=quality.rms_m,
            held_out_rms_m=quality.held_out_rms_m,
            held_out_kind=quality.held_out_kind,
            certificate=axis.certificate,
            starts=axis.starts,
        ),
    )
    draws = minor_loops.draw(np.random.default_rng(SEED), DRAWS)
    distance_m = farthest_apart_m(minor_loops.operator, draws, axis.certificate.reach_V)
    bound_m = float(np.quantile(distance_m, 0.95))
    remark = (
        f"the held-out error is {with_unit(trial.rms_m, 'm')} with {plays} plays behind "
        f"functions of {pieces} pieces, and {with_unit(quality.held_out_rms_m, 'm')} with "
        "plays with dead zones: the controller inverts the former"
    )
    return replace(
        axis,
        minor_loops=minor_loops,
        verdict=replace(axis.verdict, remarks=(*axis.verdict.remarks, remark)),
        quality=replace(
            quality,
            rms_m=_rms(settled_m),
            held_out_rms_m=trial.rms_m,
            held_out_kind=trial.held_out_kind,
        ),
        certificate=replace(
            axis.certificate,
            plays_m=bound_m,
            dead_zones_m=0.0,
            remainder_m=float(np.quantile(np.abs(trial.error_m), 0.999)),
            found_m=bound_m,  # a drive through the states of the extremes attains it
        ),
    )


def _fitted_start(axis: AxisModel, recording: Recording, piece: FittedPiece) -> PieceStart:
    """Fit the initial states of one piece to its first swings."""
    start, voltage_V = piece.start, piece.voltage_V
    measured_m = recording.displacement_m(axis.axis)[piece.samples]
    zero_m = zero_of(start, len(voltage_V))
    # After the first swing a recording no longer depends on them: as much again fixes the zero.
    swing = int(np.argmax(_is_settled(voltage_V)))
    count = min(max(2 * swing, MAX_ROWS), len(voltage_V))
    first = piece.samples.start
    memory_V, _ = fit_start(
        axis,
        voltage_V[:count],
        measured_m[:count],
        where_of(recording, axis.axis, slice(first, first + count)),
        [np.diff(start.memory_V) / axis.hysteresis.gap],
        zero_m[:count],
    )
    position_m = zero_m + axis.motion_m(voltage_V, memory_V, piece.where)
    zero_change_m = float(np.mean(measured_m - axis.forward.read(position_m, piece.where)))
    return replace(start, memory_V=memory_V, zero_m=start.zero_m + zero_change_m)


def _rows(axis: AxisModel, recording: Recording, lattice: PreisachPlays) -> Iterator[Rows]:
    """Yield the regression rows of each piece of a recording, thinned."""
    forward = axis.forward
    for piece in fitted_pieces(axis, recording):
        where, start = piece.where, piece.start
        measured_m = recording.displacement_m(axis.axis)[piece.samples]
        residual_m = measured_m - piece.simulate(axis)
        driven_V = forward.driven_V(piece.voltage_V, where.rate_Hz)
        inner_V = np.ascontiguousarray(driven_V - lattice.voltage_offset_V)
        plays_m = axis.static_m(driven_V, start.memory_V, where.rate_Hz)
        sample = np.arange(0, len(inner_V), max(len(inner_V) // MAX_ROWS, 1))
        filtered_m = forward.linear_response(plays_m, where)[sample]
        memory_V = axis.memory_at(lattice.threshold_V, start.memory_V)
        states, _ = play_columns(inner_V, lattice.threshold_V, memory_V)
        columns = np.empty((len(sample), lattice.rise_m.size), order="F")
        for cell, column in enumerate(rise_columns(lattice, states)):
            columns[:, cell] = forward.linear_response(column, where)[sample]
        yield Rows(
            recording=recording.name,
            columns=columns,
            target=filtered_m + axis.polarity * residual_m[sample],
            plays_residual_m=residual_m[sample],
            is_settled=_is_settled(inner_V)[sample],
            drive_range_V=(float(inner_V.min()), float(inner_V.max())),
        )


def _is_settled(drive: Array) -> NDArray[np.bool_]:
    """Return for each sample whether the drive has covered most of its range before it."""
    span = np.maximum.accumulate(drive) - np.minimum.accumulate(drive)
    return np.asarray(span >= COVERED * span[-1])


def fit_rises(product: Array, count: int, lattice: PreisachPlays, stroke_m: float) -> Array:
    """Fit the rises of all functions between edges, (cells,) m, with a constant for each piece.

    product  (cells + 1, cells + 1)  of the rows, see ``Rows.products``
    count    of the rows
    """
    (plays, pieces), count_of_cells = lattice.rise_m.shape, lattice.rise_m.size
    cells = np.eye(count_of_cells).reshape(plays, pieces, -1)
    # Neighbours in position and in width; the play of zero width is reversible, the others not.
    differences = np.concatenate(
        [
            np.diff(cells, axis=1).reshape(-1, count_of_cells),
            np.diff(cells[1:], axis=0).reshape(-1, count_of_cells),
        ]
    )
    normal = product[:-1, :-1] + RIDGE * count * (differences.T @ differences)
    normal += ROUNDING * np.trace(normal) * np.eye(len(normal))
    lower = np.linalg.cholesky(normal)
    target = solve_triangular(lower, product[:-1, -1] / stroke_m, lower=True)
    min_rise = np.zeros(count_of_cells)
    min_rise[:pieces] = MIN_SLOPE / pieces
    unbounded = np.full(count_of_cells, np.inf)
    return stroke_m * bounded_step(np.asarray(lower.T), target, min_rise, unbounded)
