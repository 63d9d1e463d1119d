"""Minor loops: plays behind functions, selected if they predict better.

What plays with dead zones and an envelope leave of a ceramic is the shape of minor loops. Plays
behind rising functions of their states follow any loops that close [Krejci 1996]. With thresholds
and edges on a lattice the functions are all that is free, and what the fitted axis knows besides,
extensions, lag and poles, is linear in them:

    min |L sum_i phi_i(z_i) + c - y|^2 + lambda |D phi|^2,   phi_i not falling

is a convex program. Its shape is the smallest that predicts recordings left out as well as the
largest. It is taken where it predicts these better by half than plays with dead zones do, for its
inverse takes more instructions. Fits without one block of time each say how well the functions are
known, and the distance of two of them over all drives is exact: model and inverse have bounds as
those of plays with dead zones have.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import least_squares

from piezoid.errors import IdentificationError
from piezoid.formatting import with_unit
from piezoid.identification.extensions.rate_dependence import RateDependence
from piezoid.identification.hysteresis.pieces import MINIMUM_SAMPLES
from piezoid.identification.hysteresis.uncertainty import BLOCKS, DRAWS, SEED
from piezoid.identification.minor_loops_known import Believed, FunctionOrder, MinorLoops
from piezoid.identification.model import AxisModel
from piezoid.identification.piece_start import PieceStart
from piezoid.identification.quality import OTHER_RECORDINGS, SECOND_HALF, WIDEST_HALVED
from piezoid.identification.simulation import simulate_recording, starts_of, where_of, zero_of
from piezoid.numerics.arrays import Array
from piezoid.numerics.quadratic_program import bounded_step
from piezoid.operators.play import play_columns
from piezoid.operators.preisach_bounds import farthest_apart_m
from piezoid.operators.preisach_plays import PreisachPlays
from piezoid.records.recording import Recording

EDGE_STEPS = 4  # thresholds from edge to edge: more edges gave no improvement on the zoo
SHAPES = (4, 6, 8)  # pieces of a function; twice as many plays
CLOSE = 1.03  # times the error of larger shapes: not noticeable
WORTH = 1.5  # times the error of plays with dead zones: less is not worth its instructions
LEAST_SLOPE = 0.2  # of the mean one, of a branch right behind a turn: see coordinates.py
RIDGE = 1e-3  # on differences of rises between neighbours; a tenth or ten times it: no difference
ROWS = 3000  # of a recording
STEPS = 20  # of the search for first states
BEGINNING = 0.1  # weight of rows that depend on the fitted initial states
WIPED = 0.95  # of the range of a recording: the initial state is then forgotten
ROUNDING = 1e-13  # of the trace: cells that no drive reached hang on their neighbours alone
BEYOND = 0.1  # of half the range by which a held-out recording may exceed the others


@dataclass(frozen=True, kw_only=True, eq=False)
class Lattice:
    """Where plays and edges are, over the range of the recorded drive.

    centre_V, reach_V  of the drive: it goes by the reach to either side
    pieces             of a function, an even number
    """

    centre_V: float
    reach_V: float
    pieces: int

    @property
    def plays(self) -> int:
        """How many plays there are, that of no width among them."""
        return self.pieces * EDGE_STEPS // 2

    @property
    def step_V(self) -> float:
        """By how much half-widths differ."""
        return self.reach_V / self.plays

    @property
    def threshold_V(self) -> Array:
        """Half-widths, (plays,)."""
        return np.asarray(self.step_V * np.arange(self.plays))

    @property
    def edge_V(self) -> Array:
        """Edges, from the centre, (pieces + 1,)."""
        return np.asarray(self.step_V * (EDGE_STEPS * np.arange(self.pieces + 1) - self.plays))

    @property
    def cells(self) -> list[tuple[int, int]]:
        """Play and piece of every rise.

        Those that the drive does not move by itself hold the states from before a recording.
        """
        return list(product(range(self.plays), range(self.pieces)))

    def risen(self, states: Array) -> Iterator[Array]:
        """Yield for every cell which part of its rise is done, from the centre on, (samples,).

        states  (samples, plays)  V, of the drive from the centre
        """
        edge_V = self.edge_V
        for i, k in self.cells:
            low = -np.inf if k == 0 else edge_V[k]
            high = np.inf if k + 1 == self.pieces else edge_V[k + 1]
            above_edge_V = np.clip(states[:, i], low, high) - np.clip(0.0, low, high)
            yield above_edge_V / (edge_V[1] - edge_V[0])


@dataclass(frozen=True, kw_only=True, eq=False)
class Rows:
    """One piece of a recording.

    columns  (samples, cells)  what each rise adds to it
    target   (samples,)        what it shows
    plain_m  (samples,)        residual of plays with dead zones
    counts   (samples,)        whether what was before the recording is forgotten
    """

    recording: str
    columns: Array
    target: Array
    plain_m: Array
    counts: Array
    reach: tuple[float, float]

    def first_rows(self, stop: int) -> "Rows":
        """Return its first rows."""
        return replace(
            self,
            columns=self.columns[:stop],
            target=self.target[:stop],
            plain_m=self.plain_m[:stop],
            counts=self.counts[:stop],
        )

    def products(self, blocks: int = 1) -> Array:
        """Return [columns, target]'[columns, target] of blocks, (blocks, cells + 1, cells + 1).

        Without their means over the piece, weighed.
        """
        weight = np.where(self.counts, 1.0, BEGINNING)[:, None]
        rows = np.column_stack([self.columns, self.target])
        rows = weight * (rows - np.average(rows, axis=0, weights=weight[:, 0] ** 2))
        return np.array([part.T @ part for part in np.array_split(rows, blocks)])


def with_minor_loops(axis: AxisModel, recordings: Sequence[Recording]) -> AxisModel:
    """Return the axis with plays behind functions if these predict its recordings better.

    recordings  of the fit; recordings that the model does not contain are skipped
    """
    without_functions = axis.without_loop_shape()
    is_late = any(
        isinstance(extension, RateDependence) for extension in without_functions.extensions
    )
    if (
        is_late or not without_functions.quality.is_tested
    ):  # delayed domain walls are not linear in the functions
        return without_functions
    low_V, high_V = without_functions.voltage_V
    half_V = 0.5 * (high_V - low_V)

    def cross_validate(pieces: int) -> "_Trial":
        lattice = Lattice(centre_V=low_V + half_V, reach_V=half_V, pieces=pieces)
        rows = [part for r in recordings for part in _rows(without_functions, r, lattice)]
        return _cross_validated(rows, lattice, without_functions.quality.range_m)

    largest = cross_validate(SHAPES[-1])
    if not len(largest.error_m):
        return without_functions
    trials, best = [largest], None
    if largest.is_better_than(without_functions.quality.held_out_rms_m):
        best = largest
        for pieces in SHAPES[:-1]:
            trials.append(cross_validate(pieces))
            if trials[-1].rms_m <= CLOSE * largest.rms_m:
                best = trials[-1]
                break
    orders = tuple(
        FunctionOrder(
            plays=trial.lattice.plays,
            pieces=trial.lattice.pieces,
            held_out_rms_m=trial.rms_m,
            plain_rms_m=_rms(trial.plain_m),
        )
        for trial in trials
    )
    axis = replace(without_functions, function_orders=orders)
    return axis if best is None else _restarted(_with_functions(axis, best), recordings)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Trial:
    """A lattice, and the residuals of its functions in held-out recordings.

    error_m  (rows,)  of functions, in recordings they were not fitted to
    plain_m  (rows,)  of plays with dead zones, which were fitted to these rows
    kind     which rows they are
    """

    lattice: Lattice
    rows: Sequence[Rows]
    error_m: Array
    plain_m: Array
    kind: str

    @property
    def rms_m(self) -> float:
        return _rms(self.error_m)

    def is_better_than(self, held_out_rms_m: float) -> bool:
        """Tell whether functions predict clearly better than plays do.

        Never where they predict worse than plays fit the same rows: what plays fail to predict is
        then no shape of loops.
        """
        return self.rms_m <= min(held_out_rms_m / WORTH, _rms(self.plain_m))


def _rms(error_m: Array) -> float:
    return float(np.sqrt(np.mean(error_m**2)))


def _cross_validated(rows: Sequence[Rows], lattice: Lattice, stroke_m: float) -> _Trial:
    """Leave out every recording; of one that goes further than others the second half."""
    names = list(dict.fromkeys(part.recording for part in rows))
    products = {name: sum(p.products()[0] for p in rows if p.recording == name) for name in names}
    counts = {name: sum(len(p.target) for p in rows if p.recording == name) for name in names}
    room = BEYOND * lattice.reach_V
    errors, plain_errors, is_halved = [], [], False
    for name in names:
        product = sum(products.values()) - products[name]
        count = sum(counts.values()) - counts[name]
        trained_rows = []  # of each part of the recording that is left out
        for part in (p for p in rows if p.recording == name):
            is_covered = any(
                p.reach[0] <= part.reach[0] + room and p.reach[1] >= part.reach[1] - room
                for p in rows
                if p.recording != name
            )
            stop = 0 if is_covered else len(part.target) // 2
            trained_rows.append((part, stop))
            if stop:
                is_halved, count = True, count + stop
                product = product + part.first_rows(stop).products()[0]
        rise_m = rises_of(product, count, lattice, stroke_m)
        for part, stop in trained_rows:
            unseen = np.flatnonzero(part.counts[stop:]) + stop
            if len(unseen):
                error_m = part.target[unseen] - part.columns[unseen] @ rise_m
                errors.append(error_m - error_m.mean())
                plain_errors.append(part.plain_m[unseen] - part.plain_m[unseen].mean())
    kind = WIDEST_HALVED if is_halved else OTHER_RECORDINGS
    return _Trial(
        lattice=lattice,
        rows=rows,
        error_m=np.concatenate([np.zeros(0), *errors]),
        plain_m=np.concatenate([np.zeros(0), *plain_errors]),
        kind=kind if len(names) > 1 else SECOND_HALF,
    )


def _with_functions(axis: AxisModel, trial: _Trial) -> AxisModel:
    """Return the axis with functions fitted to all rows, and their uncertainty."""
    lattice, rows, quality = trial.lattice, trial.rows, axis.quality
    total = sum(len(part.target) for part in rows)
    products = np.concatenate(
        [part.products(max(round(BLOCKS * len(part.target) / total), 1)) for part in rows]
    )
    product, blocks = products.sum(axis=0), len(products)
    rise_m = rises_of(product, total, lattice, quality.range_m)
    fewer = total * (blocks - 1) // blocks
    without_m = [
        rises_of(product - block, fewer, lattice, quality.range_m).reshape(lattice.plays, -1)
        for block in products
    ]
    residuals_m = [part.target - part.columns @ rise_m for part in rows]
    zero_m = float(np.mean([residual_m.mean() for residual_m in residuals_m]))
    pairs = zip(residuals_m, rows, strict=True)
    fit_m = np.concatenate([(r - r.mean())[part.counts] for r, part in pairs])
    minor_loops = MinorLoops(
        operator=functions_of(rise_m, lattice, axis.hysteresis.displacement_offset_m + zero_m),
        without_m=np.array(without_m),
        least_rise_m=LEAST_SLOPE * quality.range_m / lattice.pieces,
        plain=Believed(
            rms_m=quality.rms_m,
            held_out_rms_m=quality.held_out_rms_m,
            held_out_kind=quality.held_out_kind,
            certificate=axis.certificate,
            starts=axis.starts,
        ),
    )
    draws = minor_loops.draw(np.random.default_rng(SEED), DRAWS)
    distance_m = farthest_apart_m(minor_loops.operator, draws, axis.certificate.reach_V)
    likely_m = float(np.quantile(distance_m, 0.95))
    remark = (
        f"on rows left out {lattice.plays} plays behind functions of {lattice.pieces} pieces "
        f"leave {with_unit(trial.rms_m, 'm')}, where plays with dead zones leave "
        f"{with_unit(quality.held_out_rms_m, 'm')}: the controller inverts the former"
    )
    return replace(
        axis,
        minor_loops=minor_loops,
        verdict=replace(axis.verdict, remarks=(*axis.verdict.remarks, remark)),
        quality=replace(
            quality, rms_m=_rms(fit_m), held_out_rms_m=trial.rms_m, held_out_kind=trial.kind
        ),
        certificate=replace(
            axis.certificate,
            plays_m=likely_m,
            dead_zones_m=0.0,
            remainder_m=float(np.quantile(np.abs(trial.error_m), 0.999)),
            found_m=likely_m,  # a drive through the states of the extremes attains it
        ),
    )


def _restarted(axis: AxisModel, recordings: Sequence[Recording]) -> AxisModel:
    """Return the axis with the first states that suit the functions.

    z_i(0) = z_0(0) + sum_(j<=i) d_j s_j, -1 <= s_j <= 1, d_j between thresholds: admissible.
    """
    gap_V = np.diff(axis.hysteresis.plays.threshold)
    by_name = {recording.name: recording for recording in recordings}
    numbers: dict[str, int] = {}
    starts = []
    for start in axis.starts:
        number = numbers[start.recording] = numbers.get(start.recording, -1) + 1
        recording = by_name.get(start.recording)
        if recording is not None:
            parts = [p for p in recording.pieces if p.stop - p.start >= MINIMUM_SAMPLES]
            start = _restarted_piece(axis, recording, parts[number], start, gap_V)
        starts.append(start)
    return replace(axis, starts=tuple(starts))


def _restarted_piece(
    axis: AxisModel, recording: Recording, part: slice, start: PieceStart, gap_V: Array
) -> PieceStart:
    voltage_V = recording.voltage_V(axis.axis)[part]
    measured_m = recording.displacement_m(axis.axis)[part]
    zero_m = zero_of(start, len(voltage_V))
    # Behind its first swing a recording says nothing of them: as much again tells the zero.
    swing = int(np.argmax(_is_forgotten(voltage_V)))
    head = slice(part.start, min(part.start + max(2 * swing, ROWS), part.stop))

    def memory_V(slope: Array) -> Array:
        return np.asarray(start.memory_V[0] + np.append(0.0, np.cumsum(gap_V * slope)))

    def residual_m(slope: Array, rows: slice) -> Array:
        count, where = rows.stop - rows.start, where_of(recording, axis.axis, rows)
        moved_m = axis.moved(voltage_V[:count], memory_V(slope), where)
        return np.asarray(measured_m[:count] - axis.forward.read(zero_m[:count] + moved_m, where))

    def scaled_residual(slope: Array) -> Array:
        error_m = residual_m(slope, head)[:: max((head.stop - head.start) // ROWS, 1)]
        return np.asarray((error_m - error_m.mean()) / axis.quality.range_m)

    first = np.clip(np.diff(start.memory_V) / gap_V, -WIPED, WIPED)
    slope = least_squares(
        scaled_residual, first, bounds=(-1.0, 1.0), diff_step=1e-2, max_nfev=STEPS
    ).x
    zero_change_m = float(np.mean(residual_m(slope, part)))
    return replace(start, memory_V=memory_V(slope), zero_m=start.zero_m + zero_change_m)


def _rows(axis: AxisModel, recording: Recording, lattice: Lattice) -> Iterator[Rows]:
    """Yield the pieces of one recording."""
    try:
        simulated_m = simulate_recording(axis, recording)
    except IdentificationError:
        return
    parts = [p for p in recording.pieces if p.stop - p.start >= MINIMUM_SAMPLES]
    voltage_V = recording.voltage_V(axis.axis)
    residual_m = recording.displacement_m(axis.axis) - simulated_m
    for part, start in zip(parts, starts_of(axis, recording), strict=True):
        where = where_of(recording, axis.axis, part)
        forward = axis.forward
        driven_V = forward.driven_V(voltage_V[part], where.rate_Hz)
        inner_V = np.ascontiguousarray(driven_V - lattice.centre_V)
        plain_m = axis.static_m(driven_V, start.memory_V, where.rate_Hz)
        sample = np.arange(0, len(inner_V), max(len(inner_V) // ROWS, 1))
        followed = forward.behind(plain_m, where)[sample]
        memory_V = axis.memory_at(lattice.threshold_V, start.memory_V)
        states, _ = play_columns(inner_V, lattice.threshold_V, memory_V)
        columns = np.empty((len(sample), len(lattice.cells)), order="F")
        for column, risen in enumerate(lattice.risen(states)):
            columns[:, column] = forward.behind(risen, where)[sample]
        yield Rows(
            recording=recording.name,
            columns=columns,
            target=followed + axis.polarity * residual_m[part][sample],
            plain_m=residual_m[part][sample],
            counts=_is_forgotten(inner_V)[sample],
            reach=(float(inner_V.min()), float(inner_V.max())),
        )


def _is_forgotten(drive: Array) -> Array:
    """Tell for each sample whether the drive has covered most of its range."""
    gone = np.maximum.accumulate(drive) - np.minimum.accumulate(drive)
    return np.asarray(gone >= WIPED * gone[-1])


def rises_of(product: Array, count: int, lattice: Lattice, stroke_m: float) -> Array:
    """Return what every function rises between edges, (cells,) m, beside a constant a piece.

    product  (cells + 1, cells + 1)  of the rows, see ``Rows.products``
    count    of the rows
    """
    cells = {cell: number for number, cell in enumerate(lattice.cells)}
    neighbours = [
        (number, cells[neighbour])
        for (i, k), number in cells.items()
        for neighbour in ((i, k + 1), (i + 1 if i else -1, k))  # phi_0 is of another kind
        if neighbour in cells
    ]
    pairs = np.array(neighbours)
    smooth = np.zeros((len(pairs), len(cells)))
    smooth[np.arange(len(pairs)), pairs[:, 0]] = 1.0
    smooth[np.arange(len(pairs)), pairs[:, 1]] = -1.0
    normal = product[:-1, :-1] + RIDGE * count * (smooth.T @ smooth)
    normal += ROUNDING * np.trace(normal) * np.eye(len(normal))
    lower = np.linalg.cholesky(normal)
    target = solve_triangular(lower, product[:-1, -1] / stroke_m, lower=True)
    floor = np.array([LEAST_SLOPE / lattice.pieces if i == 0 else 0.0 for i, _ in cells])
    unbounded = np.full(len(floor), np.inf)
    return stroke_m * bounded_step(np.asarray(lower.T), target, floor, unbounded)


def functions_of(rise_m: Array, lattice: Lattice, offset_m: float) -> PreisachPlays:
    """Return the functions, 0 in the middle."""
    rises_m = rise_m.reshape(lattice.plays, lattice.pieces)
    straight = PreisachPlays(
        step_V=lattice.step_V,
        edge_V=lattice.edge_V,
        value_m=np.tile(lattice.edge_V, (lattice.plays, 1)),
        voltage_offset_V=lattice.centre_V,
        displacement_offset_m=offset_m,
    )
    return straight.with_rises(rises_m)
