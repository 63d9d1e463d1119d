"""Discovery: in which coordinate that is left lives which no effect of the catalogue stands for.

The remainder of the final model is what neither the nuisance class nor the tangents of any
effect can follow: with these it is made orthogonal,

    r = M y,   M = I - C (C'C)^-1 C',   C = [nuisance, selected effects, tangents of the others],

so that it is not just their error. Curves along one coordinate at a time are then fitted beside C
to blocks of whole stretches of the recordings and judged on the blocks left out,

    gain = sum_b (2 r_b' X_b beta_-b - |X_b beta_-b|^2) / |r|^2,       X = M (curve's columns).

The null of a curve along a signal is the same remainder, shifted by chance along each recording:
it keeps its power and its correlation, and loses its place. The null of a line is the power of
the spectrum around it. What one coordinate explains beyond its null may still be hysteresis that
the nuisance class does not follow: hence a least part as well, from healthy stages.

Source: Arlot & Celisse (2010) on blocks; Percival & Walden (1993) on lines; Phipson & Smyth (2010)
on p-values that count permutations.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil, exp, floor, log, sqrt

import numpy as np
from scipy.special import chdtrc

from piezoid.diagnosis.blocked_regression import FOLDS, Null
from piezoid.diagnosis.coordinate_bases import (
    TIME_KNOTS,
    Basis,
    Signals,
    along_reading,
    along_signals,
    along_time,
    every,
    in_time,
    travelled,
    waves,
)
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.signals import GRIDS_Hz
from piezoid.numerics.arrays import Array

SHIFTS = 99  # remainders in another place
READINGS = 5  # readings with another remainder in them
RIDGE = 1e-3  # of a column's length
LEFT = 1e-3  # of its length: what the null must leave of a column
PERIODS = 4.0  # that a recording must show of a line
LINES = 3  # of each recording that are tried in all, at most
DRIVEN = 4.0  # times what is around it: a line of the stage's own motion
RESOLVED = 0.9  # periods in a recording between it and a line; 1 separates two waves
AROUND = 12  # frequencies on either side that a line is compared with
LONGEST_PERIOD = 128  # samples
ROWS_A_CELL = 6
ROUNDS = 12  # of a course in time and everything else
CHUNKS = 5  # of the time between two knots: every chunk is in another fold
HARMONICS, LINE_HARMONICS = 6, 12
GRID_OFF_Hz = 0.15  # how far a grid is off its nominal frequency
BY_HARMONICS = 1.15  # times the gain of one wave: what repeats, and is no sine


@dataclass(frozen=True, kw_only=True, eq=False)
class CoordinateScore:
    """What a curve along one coordinate makes of a remainder.

    basis        of the curve
    gain         part of the remainder's power on blocks left out
    p_value      of such a gain where the remainder lives anywhere else; 1 where none is known
    coefficient  (columns,)
    followed     (rows,)  what of the remainder it follows
    """

    basis: Basis
    gain: float
    p_value: float
    coefficient: Array
    followed: Array

    @property
    def coordinate(self) -> str:
        """Return the coordinate's name."""
        return self.basis.coordinate


@dataclass(frozen=True, kw_only=True, eq=False)
class Remainder:
    """What is left of a view, and the null that it is orthogonal to."""

    view: View
    null: Null

    @classmethod
    def of(cls, view: View, tangents: Sequence[Array]) -> "Remainder":
        """Return what neither the view nor these tangents follow."""
        if not tangents:
            return cls(view=view, null=view.null)
        more = np.hstack([view.selected, *tangents])
        known = view.nuisance.gram
        null = Null(
            columns=view.null.columns,
            response=view.response,
            block=view.block,
            more=more,
            known=known,
        )
        return cls(view=view, null=null)

    @property
    def left(self) -> Array:
        """Return the remainder, (rows,)."""
        return self.null.residual

    def rows(self, k: int) -> slice:
        """Return the rows of a track."""
        edges = self.view.nuisance.edges
        return slice(int(edges[k]), int(edges[k + 1]))

    def across(self, columns: Array) -> tuple[Array, Array]:
        """Return what the null leaves of columns, each of length 1, and their lengths."""
        whole = np.sqrt(np.einsum("ij,ij->j", columns, columns))
        rest = self.null.without(columns)
        length = np.sqrt(np.einsum("ij,ij->j", rest, rest))
        length = np.where(length > LEFT * whole, length, np.inf)
        return rest / length, length

    def shifted(self, chance: np.random.Generator) -> Array:
        """Return remainders that lost their place, (rows, shifts), of the same power."""
        moved = np.empty((len(self.left), SHIFTS))
        for k in range(len(self.view.tracks)):
            own = self.left[self.rows(k)]
            for j in range(SHIFTS):
                moved[self.rows(k), j] = np.roll(own, chance.integers(1, max(len(own), 2)))
        moved = self.null.without(moved)
        power = np.einsum("ij,ij->j", moved, moved)
        return np.asarray(moved * np.sqrt(np.sum(self.left**2) / power))

    def held(self, across: Array, values: Array) -> Array:
        """Return the part of the power of values, (rows, n), on blocks left out, (n,)."""
        null = self.null
        gram = np.array([across[part].T @ across[part] for part in null.parts])
        right = np.array([across[part].T @ values[part] for part in null.parts])
        total, every_right = gram.sum(axis=0), right.sum(axis=0)
        ridge, gained = RIDGE * np.eye(across.shape[1]), np.zeros(values.shape[1])
        for fold in range(FOLDS):
            out = null.fold == fold
            own, own_right = gram[out].sum(axis=0), right[out].sum(axis=0)
            beta = np.linalg.solve(total - own + ridge, every_right - own_right)
            gained += np.sum((2.0 * own_right - own @ beta) * beta, axis=0)
        return np.asarray(gained / np.maximum(np.sum(values**2, axis=0), 1e-300))

    def lives(self, basis: Basis, p_value: float = 1.0) -> CoordinateScore:
        """Return what a curve makes of the remainder."""
        return self.lives_beside(basis, np.zeros((len(self.left), 0)), p_value)[0]

    def lives_beside(
        self, basis: Basis, moved: Array, p_value: float = 1.0
    ) -> tuple[CoordinateScore, Array]:
        """Return what a curve makes of the remainder, and its gains on remainders moved away."""
        across, length = self.across(basis.columns)
        gains = self.held(across, np.column_stack([self.left, moved]))
        ridge = RIDGE * np.eye(across.shape[1])
        beta = np.linalg.solve(across.T @ across + ridge, across.T @ self.left)
        found = CoordinateScore(
            basis=basis,
            gain=float(gains[0]),
            p_value=p_value,
            coefficient=beta / length,
            followed=across @ beta,
        )
        return found, gains[1:]


def everywhere(remainder: Remainder, seed: int = 0) -> tuple[CoordinateScore, ...]:
    """Return what a curve along each coordinate makes of the remainder, the best first.

    The p-value of a curve along a signal is the part of the shifted remainders of which any signal
    explains as much; that of a line or a cell is of its power beside that of its surroundings.
    """
    chance = np.random.default_rng(seed)
    moved, view = remainder.shifted(chance), remainder.view
    tried = [remainder.lives_beside(basis, moved) for basis in along_signals(view)]
    most = np.max([gains for _, gains in tried], axis=0)
    found = [*(lives for lives, _ in tried), _of_reading(remainder, moved)]
    found = [
        replace(one, p_value=(1.0 + float(np.sum(most >= one.gain))) / (1.0 + SHIFTS))
        for one in found
    ]
    found.append(_in_time(remainder, chance))
    # the reading itself holds what is left: a wave as short as the noise would follow that
    repeating = (
        _line(remainder),
        _of_index(remainder),
        _of_way(remainder, "distance_travelled", travelled(view), "half strokes"),
        _of_way(remainder, "reading", view.static, "half strokes"),
    )
    found += [one for one in repeating if one]
    return tuple(sorted(found, key=lambda lives: -lives.gain))


def _of_reading(remainder: Remainder, moved: Array) -> CoordinateScore:
    """Judge the reading by what it explains beyond readings with another remainder in them.

    Whatever is left is in the reading as well, so that a large one lies where readings are large.
    """
    view = remainder.view
    found = remainder.lives(along_reading(view))
    others = []
    for j in range(READINGS):
        across, _ = remainder.across(along_reading(view, moved[:, j]).columns)
        others.append(float(remainder.held(across, moved[:, j : j + 1])[0]))
    return replace(found, gain=found.gain - max(*others, 0.0))


def _in_time(remainder: Remainder, chance: np.random.Generator) -> CoordinateScore:
    """Judge a curve in time of every recording's own on chunks of time left out.

    Its p-value is of chunks whose signs are chance: of a remainder that is not correlated for
    longer than a fifth of the distance of two knots, which that of hysteresis may well be.
    """
    gained, coefficients, followed = np.zeros(1 + SHIFTS), [], []
    for k in range(len(remainder.view.tracks)):
        own = remainder.left[remainder.rows(k)]
        columns = along_time(remainder.view, k)
        chunk = np.arange(len(own)) * TIME_KNOTS * CHUNKS // max(len(own), 1)
        signs = chance.choice([-1.0, 1.0], (TIME_KNOTS * CHUNKS, SHIFTS))[chunk]
        values = np.column_stack([own, own[:, None] * signs])
        ridge = RIDGE * len(own) / TIME_KNOTS * np.eye(TIME_KNOTS)
        for out in range(CHUNKS):
            here = chunk % CHUNKS == out
            rest = columns[~here]
            made = columns[here] @ np.linalg.solve(rest.T @ rest + ridge, rest.T @ values[~here])
            gained += np.sum((2.0 * values[here] - made) * made, axis=0)
        coefficients.append(np.linalg.solve(columns.T @ columns + ridge, columns.T @ own))
        followed.append(columns @ coefficients[-1])
    gains = gained / max(float(np.sum(remainder.left**2)), 1e-300)
    return CoordinateScore(
        basis=in_time(remainder.view),
        gain=float(gains[0]),
        p_value=(1.0 + float(np.sum(gains[1:] >= gains[0]))) / (1.0 + SHIFTS),
        coefficient=np.concatenate(coefficients),
        followed=np.concatenate(followed),
    )


def course(remainder: Remainder, lives: CoordinateScore) -> CoordinateScore:
    """Return a course in time fitted beside the null, round after round of one and the other."""
    view, null = remainder.view, remainder.null
    columns = [along_time(view, k) for k in range(len(view.tracks))]
    total = np.zeros((len(columns), TIME_KNOTS))
    curve = np.zeros(len(view.response))
    for _ in range(ROUNDS):
        left = null.without(view.response - curve)
        for k, own in enumerate(columns):
            ridge = RIDGE * len(own) / TIME_KNOTS * np.eye(TIME_KNOTS)
            rows = remainder.rows(k)
            more = np.linalg.solve(own.T @ own + ridge, own.T @ left[rows])
            total[k] += more
            curve[rows] += own @ more
    return replace(lives, coefficient=total.ravel(), followed=null.without(curve))


def _line(remainder: Remainder) -> CoordinateScore | None:
    """Return what waves of one frequency make of the remainder, in seconds or in samples.

    What repeats with the index of the sample is another frequency in a recording of another rate.
    """
    view = remainder.view
    seconds = tuple(track.time_s for track in view.tracks)
    samples = tuple(np.arange(len(track.drive), dtype=np.float64) for track in view.tracks)
    peaks, driven = [], []
    for k, track in enumerate(view.tracks):
        step_Hz = track.rate_Hz / len(track.drive)
        spectrum, lines = _spectrum(remainder, k), _driven(view.static[k], view.noise)
        for line in lines:
            spectrum[ceil(line - RESOLVED) : floor(line + RESOLVED) + 1] = 0.0
        spectrum[: int(PERIODS)] = 0.0
        peaks += [(x, p, j * step_Hz, k) for x, p, j in highest(spectrum)]
        driven.append(lines * step_Hz)
    best: CoordinateScore | None = None
    for _, p_value, near_Hz, k in sorted(peaks, reverse=True)[: 2 * LINES]:
        p_value = min(1.0, p_value * len(view.tracks))
        found = _wave(remainder, "frequency", seconds, "s", near_Hz, k, p_value)
        off_Hz = np.abs(driven[k] - found.basis.per_unit)
        if off_Hz.min(initial=np.inf) * float(seconds[k][-1]) < RESOLVED:
            continue
        near = near_Hz / view.tracks[k].rate_Hz
        other = _wave(remainder, "sample_index", samples, "samples", near, k, p_value)
        if other.gain > BY_HARMONICS * found.gain:
            found = other
        if best is None or found.gain > best.gain:
            best = found
    return None if best is None else _with_harmonics(remainder, best)


def _wave(
    remainder: Remainder,
    name: str,
    along: Signals,
    unit: str,
    near: float,
    k: int,
    p_value: float,
) -> CoordinateScore:
    """Return what a wave near a frequency that was seen in track k makes of all tracks."""
    per_unit = _refined(remainder, along, near, 1.0 / float(along[k][-1]))
    return remainder.lives(waves(remainder.view, name, along, per_unit, unit), p_value)


def _with_harmonics(remainder: Remainder, line: CoordinateScore) -> CoordinateScore:
    """Return the line, or what repeats with its frequency, or with the grid's, and is no sine."""
    best, basis = line, line.basis
    tried = [(basis.coordinate, basis.per_unit, HARMONICS)]
    grid_Hz = of_grid(basis.per_unit) if basis.coordinate == "frequency" else 0.0
    if grid_Hz:
        tried.append(("line_phase", grid_Hz, LINE_HARMONICS))
    for name, per_unit, count in tried:
        more = waves(remainder.view, name, basis.place, per_unit, basis.unit, count)
        found = remainder.lives(more, line.p_value)
        if found.gain > BY_HARMONICS * best.gain:
            best = found
    return best


def of_grid(frequency_Hz: float) -> float:
    """Return the frequency of the grid that a line is a multiple of, 0 where it is none."""
    for nominal_Hz in GRIDS_Hz:
        order = round(frequency_Hz / nominal_Hz)
        if order and abs(frequency_Hz / order - nominal_Hz) < GRID_OFF_Hz:
            return frequency_Hz / order
    return 0.0


def _spectrum(remainder: Remainder, k: int) -> Array:
    """Return the power of the remainder of a track at whole periods of it, rows being spread."""
    track, own = remainder.view.tracks[k], remainder.left[remainder.rows(k)]
    spread = np.zeros(len(track.drive))
    spread[track.place] = own - own.mean()
    return np.asarray(np.abs(np.fft.rfft(spread)) ** 2 / len(own))


def _driven(static: Array, noise: float) -> Array:
    """Return where the stage's own motion has lines, in periods of the recording.

    The place of a line is that of the vertex through the three highest values of its lobe.
    """
    from scipy.ndimage import median_filter

    count = len(static)
    lines = 4.0 * np.abs(np.fft.rfft((static - static.mean()) * np.hanning(count))) / count
    least = 2.0 * noise / sqrt(count)
    around = np.maximum(median_filter(lines, 2 * AROUND + 1, mode="nearest"), least)
    top = np.flatnonzero(lines[1:-1] >= np.maximum(lines[:-2], lines[2:])) + 1
    top = top[lines[top] > DRIVEN * around[top]]
    below, here, above = (np.log(np.maximum(lines[top + j], 1e-300)) for j in (-1, 0, 1))
    return np.asarray(top + 0.5 * (below - above) / np.minimum(below - 2.0 * here + above, -1e-9))


def highest(spectrum: Array) -> list[tuple[float, float, float]]:
    """Return the highest lines: power, p-value of the power around it [exponential], place."""
    found, power = [], spectrum.copy()
    count = max(int(np.sum(power > 0.0)), 1)
    for _ in range(LINES):
        j = int(np.argmax(power))
        if power[j] <= 0.0:
            break
        low = max(j - 4 * AROUND, 0)
        around = spectrum[low : j + 4 * AROUND + 1]
        level = float(np.median(around[around > 0.0])) / log(2.0)
        p_value = min(1.0, count * exp(-min(power[j] / max(level, 1e-300), 700.0)))
        found.append((float(power[j]), p_value, float(j)))
        power[max(j - 2, 0) : j + 3] = 0.0
    return found


def _refined(remainder: Remainder, along: Sequence[Array], near: float, width: float) -> float:
    """Return the frequency within a width at which all tracks together follow a wave best."""
    view = remainder.view
    longest = max(float(one[-1]) for one in along)
    count = int(np.clip(8.0 * longest * width, 9, 161)) | 1
    tried = near + width * np.linspace(-1.0, 1.0, count)
    power = np.zeros(count)
    for k, track in enumerate(view.tracks):
        own, place = remainder.left[remainder.rows(k)], along[k][track.place]
        if float(along[k][-1]) * near < PERIODS:
            continue
        wave = own * np.exp(2j * np.pi * tried[0] * place)
        slow = np.exp(2j * np.pi * (tried[1] - tried[0]) * place)
        for j in range(count):
            power[j] += abs(wave.sum()) ** 2 / len(own)
            wave = wave * slow
    return float(tried[int(np.argmax(power))])


def _of_index(remainder: Remainder) -> CoordinateScore | None:
    """Return what cells that repeat with the index of the sample make of the remainder."""
    view = remainder.view
    score = np.zeros(LONGEST_PERIOD + 1)
    for period in range(2, LONGEST_PERIOD + 1):
        for k, track in enumerate(view.tracks):
            own = remainder.left[remainder.rows(k)]
            if len(own) < ROWS_A_CELL * period:
                continue
            cell = track.place % period
            count = np.bincount(cell, minlength=period)
            total = np.bincount(cell, own, minlength=period)
            power = float(np.sum(total**2 / np.maximum(count, 1)))
            score[period] += power / max(float(np.mean(own**2)), 1e-300) - period
        score[period] /= sqrt(2.0 * period)
    best = int(np.argmax(score))
    if score[best] <= 0.0:
        return None
    freedom = best * len(view.tracks)
    value = score[best] * sqrt(2.0 * best) + freedom
    p_value = min(1.0, LONGEST_PERIOD * float(chdtrc(freedom, value)))
    return remainder.lives(every(view, best), p_value)


def _of_way(
    remainder: Remainder, coordinate: str, along: Signals, unit: str
) -> CoordinateScore | None:
    """Return what waves of one period along a signal make of the remainder."""
    view = remainder.view
    begins = [float(one.min()) for one in along]
    ways = [one - low for one, low in zip(along, begins, strict=True)]
    longest = max(float(one.max()) for one in ways)
    cells = 1 << 14
    tried = np.arange(4, cells // 8) / (2.0 * longest)
    power = np.zeros(len(tried))
    for k, way in enumerate(ways):
        own, place = remainder.left[remainder.rows(k)], way[view.tracks[k].place]
        cell = np.minimum((place / longest * cells).astype(int), cells - 1)
        wave = np.fft.rfft(np.bincount(cell, own - own.mean(), cells), 2 * cells)
        shown = float(way.max()) * tried > PERIODS
        power += np.where(shown, np.abs(wave[4 : 4 + len(tried)]) ** 2 / len(own), 0.0)
    peaks = highest(power)
    if not peaks:
        return None
    _, p_value, j = peaks[0]
    basis = waves(view, coordinate, along, float(tried[int(j)]), unit)
    return _with_harmonics(remainder, remainder.lives(basis, p_value))
