"""Minor loops as recordings show them: plays behind functions, where they predict better.

What plays with dead zones and an envelope leave of a ceramic is the shape of minor loops. Plays
behind rising functions of their states follow any loops that close [Krejci 1996]. With thresholds
and edges on a lattice the functions are all that is free, and what the fitted axis knows besides,
extensions, lag and poles, is linear in them:

    min |L sum_i phi_i(z_i) + c - y|^2 + lambda |D phi|^2,   phi_i not falling

is a convex program. Its shape is the smallest that predicts recordings left out as well as the
largest. The inverse of plays with dead zones has a bound of its error and this one has none: it is
taken where it predicts better by half.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.optimize import least_squares

from piezoid.errors import IdentificationError
from piezoid.identification.extensions.rate_dependence import RateDependence
from piezoid.identification.hysteresis.pieces import MINIMUM_SAMPLES
from piezoid.identification.model import AxisModel, PieceStart
from piezoid.identification.simulation import simulate_recording, starts_of, where_of, zero_of
from piezoid.numerics.arrays import Array
from piezoid.numerics.quadratic_program import bounded_step
from piezoid.operators.play import play_columns
from piezoid.operators.preisach_plays import PreisachPlays
from piezoid.readable import told
from piezoid.records.recording import Recording

EDGE_STEPS = 4  # thresholds from edge to edge: more edges brought nothing on the zoo
SHAPES = (4, 6, 8)  # pieces of a function; twice as many plays
CLOSE = 1.03  # as of the other shapes: nobody would notice
WORTH = 1.5  # times the error of plays with dead zones: less is not worth its bound
LEAST_SLOPE = 0.2  # of the mean one, of a branch right behind a turn: see coordinates.py
RIDGE = 1e-3  # on differences of rises between neighbours; a tenth or ten times it: no difference
ROWS = 3000  # of a recording
STEPS = 20  # of the search for first states
BEGINNING = 0.1  # weight of what states from before a recording are in: they are fitted as well
WIPED = 0.95  # of the range of a recording: then what was before it is forgotten
BEYOND = 0.1  # of half the range, that a recording left out may go further than the others


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
            away_V = np.clip(states[:, i], low, high) - np.clip(0.0, low, high)
            yield away_V / (edge_V[1] - edge_V[0])


@dataclass(frozen=True, kw_only=True, eq=False)
class Rows:
    """One piece of a recording.

    columns  (samples, cells)  what each rise adds to it
    target   (samples,)        what it shows
    counts   (samples,)        whether what was before the recording is forgotten
    """

    recording: str
    columns: Array
    target: Array
    counts: Array
    reach: tuple[float, float]

    def half(self) -> "Rows":
        """Return its first half."""
        count = len(self.target) // 2
        return replace(
            self,
            columns=self.columns[:count],
            target=self.target[:count],
            counts=self.counts[:count],
        )

    def weighed(self) -> tuple[Array, Array]:
        """Return columns and target without their means, weighed."""
        weight = np.where(self.counts, 1.0, BEGINNING)[:, None]
        rows = np.column_stack([self.columns, self.target])
        rows = weight * (rows - np.average(rows, axis=0, weights=weight[:, 0] ** 2))
        return rows[:, :-1], rows[:, -1]


def with_minor_loops(axis: AxisModel, recordings: Sequence[Recording]) -> AxisModel:
    """Return the axis with plays behind functions where they predict its recordings better.

    recordings  of the fit; one that the model does not know is passed over
    """
    bare = replace(axis, minor_loops=None)
    if any(isinstance(extension, RateDependence) for extension in axis.extensions):
        return bare  # walls that come late are not linear in the functions
    low_V, high_V = axis.voltage_V

    def tried(pieces: int) -> tuple[float, Lattice, list[Rows]]:
        lattice = Lattice(
            centre_V=0.5 * (low_V + high_V), reach_V=0.5 * (high_V - low_V), pieces=pieces
        )
        rows = [part for r in recordings for part in _rows(bare, r, lattice)]
        return (_left_out(rows, lattice, axis) if rows else np.inf), lattice, rows

    largest, plain = tried(SHAPES[-1]), axis.quality.held_out_rms_m
    if WORTH * largest[0] > plain:
        return bare
    smaller = (shape for shape in map(tried, SHAPES[:-1]) if shape[0] <= CLOSE * largest[0])
    error, lattice, rows = next(smaller, largest)
    said = (
        f"on recordings left out, {lattice.plays} plays behind functions of {lattice.pieces} "
        f"pieces leave {told(error, 'm')} where plays with dead zones leave {told(plain, 'm')}: "
        "the controller inverts the former, and no bound of its error is known"
    )
    verdict = replace(axis.verdict, remarks=(*axis.verdict.remarks, said))
    rise_m = rises_of(rows, lattice, axis.quality.range_m)
    beside_m = [float(np.mean(part.target - part.columns @ rise_m)) for part in rows]
    offset_m = axis.hysteresis.displacement_offset_m + float(np.mean(beside_m))
    found = functions_of(rise_m, lattice, offset_m)
    return _restarted(replace(bare, verdict=verdict, minor_loops=found), recordings)


def _restarted(axis: AxisModel, recordings: Sequence[Recording]) -> AxisModel:
    """Return the axis with the first states that suit the functions.

    z_i(0) = z_0(0) + sum_(j<=i) d_j s_j, -1 <= s_j <= 1, d_j between thresholds: admissible.
    """
    gap_V = np.diff(axis.hysteresis.plays.threshold)
    by_name = {recording.name: recording for recording in recordings}
    seen: dict[str, int] = {}
    starts = []
    for start in axis.starts:
        number = seen[start.recording] = seen.get(start.recording, -1) + 1
        recording = by_name.get(start.recording)
        if recording is not None:
            parts = [p for p in recording.pieces if p.stop - p.start >= MINIMUM_SAMPLES]
            start = _restarted_piece(axis, recording, parts[number], start, gap_V)
        starts.append(start)
    return replace(axis, starts=tuple(starts))


def _restarted_piece(
    axis: AxisModel, recording: Recording, part: slice, start: PieceStart, gap_V: Array
) -> PieceStart:
    where = where_of(recording, axis.axis, part)
    voltage_V = recording.voltage_V(axis.axis)[part]
    zero_m, measured_m = zero_of(start, where.samples), recording.displacement_m(axis.axis)[part]
    every = max(len(voltage_V) // ROWS, 1)

    def memory_V(slope: Array) -> Array:
        away_V = np.concatenate([[0.0], np.cumsum(gap_V * slope)])
        return np.asarray(start.memory_V[0] + away_V)

    def left(slope: Array) -> Array:
        moved_m = zero_m + axis.moved(voltage_V, memory_V(slope), where)
        error = (axis.read(moved_m) - measured_m)[::every] / axis.quality.range_m
        return np.asarray(error - error.mean())

    begun = np.clip(np.diff(start.memory_V) / gap_V, -WIPED, WIPED)
    found = least_squares(left, begun, bounds=(-1.0, 1.0), diff_step=1e-2, max_nfev=STEPS)
    moved_m = axis.read(zero_m + axis.moved(voltage_V, memory_V(found.x), where))
    beside_m = float(np.mean(measured_m - moved_m))
    return replace(start, memory_V=memory_V(found.x), zero_m=start.zero_m + beside_m)


def _rows(axis: AxisModel, recording: Recording, lattice: Lattice) -> Iterator[Rows]:
    """Yield the pieces of one recording."""
    try:
        simulated_m = simulate_recording(axis, recording)
    except IdentificationError:
        return
    parts = [p for p in recording.pieces if p.stop - p.start >= MINIMUM_SAMPLES]
    voltage_V = recording.voltage_V(axis.axis)
    left_m = recording.displacement_m(axis.axis) - simulated_m
    for part, start in zip(parts, starts_of(axis, recording), strict=True):
        where = where_of(recording, axis.axis, part)
        driven_V = axis.driven(voltage_V[part], where.rate_Hz)
        inner_V = np.ascontiguousarray(driven_V - lattice.centre_V)
        plain_m = axis.hysteresis_of(driven_V, start.memory_V, where.rate_Hz)
        plain_m = plain_m - axis.hysteresis.displacement_offset_m
        sample = np.arange(0, len(inner_V), max(len(inner_V) // ROWS, 1))
        followed = axis.behind(plain_m, where)[sample]
        memory_V = axis.memory_at(lattice.threshold_V, start.memory_V)
        states, _ = play_columns(inner_V, lattice.threshold_V, memory_V)
        columns = np.empty((len(sample), len(lattice.cells)), order="F")
        for column, risen in enumerate(lattice.risen(states)):
            columns[:, column] = axis.behind(risen, where)[sample]
        yield Rows(
            recording=recording.name,
            columns=columns,
            target=followed + axis.polarity * left_m[part][sample],
            counts=_is_forgotten(inner_V)[sample],
            reach=(float(inner_V.min()), float(inner_V.max())),
        )


def _is_forgotten(drive: Array) -> Array:
    """Tell of each sample whether the drive has gone about as far as it ever does."""
    gone = np.maximum.accumulate(drive) - np.minimum.accumulate(drive)
    return np.asarray(gone >= WIPED * gone[-1])


def _left_out(rows: Sequence[Rows], lattice: Lattice, axis: AxisModel) -> float:
    """Return the rms that functions leave of recordings they were not fitted to.

    Of the only recording, and of one that goes further than the others, the first half stays.
    """
    found = []
    for name in dict.fromkeys(part.recording for part in rows):
        others = [part for part in rows if part.recording != name]
        own = [part for part in rows if part.recording == name]
        halves = [part.half() for part in own if not _is_covered(part, others, lattice)]
        rise = rises_of([*others, *halves], lattice, axis.quality.range_m)
        for part in own:
            seen = len(part.target) // 2 if not _is_covered(part, others, lattice) else 0
            error = (part.target - part.columns @ rise)[seen:][part.counts[seen:]]
            if len(error):
                found.append(error - error.mean())
    return float(np.sqrt(np.mean(np.concatenate(found) ** 2))) if found else np.inf


def _is_covered(part: Rows, others: Sequence[Rows], lattice: Lattice) -> bool:
    room = BEYOND * lattice.reach_V
    return any(
        other.reach[0] <= part.reach[0] + room and other.reach[1] >= part.reach[1] - room
        for other in others
    )


def rises_of(rows: Sequence[Rows], lattice: Lattice, stroke_m: float) -> Array:
    """Return what every function rises between edges, (cells,) m, beside a constant a piece."""
    cells = {cell: number for number, cell in enumerate(lattice.cells)}
    total = sum(len(part.target) for part in rows)
    near = [
        (a, cells[other])
        for (i, k), a in cells.items()
        for other in ((i, k + 1), (i + 1 if i else -1, k))  # phi_0 is of another kind
        if other in cells
    ]
    smooth = np.zeros((len(near), len(cells)))
    for row, (a, b) in enumerate(near):
        smooth[row, [a, b]] = np.sqrt(RIDGE * total), -np.sqrt(RIDGE * total)
    apart = [part.weighed() for part in rows]
    q, triangle = np.linalg.qr(np.concatenate([*(columns for columns, _ in apart), smooth]))
    target = np.concatenate([*(target for _, target in apart), np.zeros(len(near))]) / stroke_m
    least = np.array([LEAST_SLOPE / lattice.pieces if i == 0 else 0.0 for i, _ in cells])
    return stroke_m * bounded_step(triangle, q.T @ target, least, np.full(len(least), np.inf))


def functions_of(rise_m: Array, lattice: Lattice, offset_m: float) -> PreisachPlays:
    """Return the functions, 0 in the middle."""
    rises = rise_m.reshape(lattice.plays, lattice.pieces)
    value_m = np.concatenate([np.zeros((lattice.plays, 1)), np.cumsum(rises, axis=1)], axis=1)
    middle_m = value_m[:, lattice.pieces // 2, None]
    return PreisachPlays(
        step_V=lattice.step_V,
        edge_V=lattice.edge_V,
        value_m=value_m - middle_m,
        voltage_offset_V=lattice.centre_V,
        displacement_offset_m=offset_m,
    )
