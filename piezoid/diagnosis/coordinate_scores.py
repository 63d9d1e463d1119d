"""Find the coordinate (time, drive, position, ...) along which the residual is systematic.

The residual is orthogonal to the nuisance class, the selected effects and the tangents of all
other effects,

    r = M y,   M = I - C (C'C)^-1 C',   C = [nuisance, selected effects, tangents of the others].

A curve with columns X is fitted beside C to blocks of the recordings and scored on other blocks,

    gain = sum_b (2 r_b' X_b beta_-b - |X_b beta_-b|^2) / |r|^2,       X <- M X.

Curves along a signal are tested against surrogates: the same residual, shifted at random along
each recording, which keeps its power and correlation. A separate course of each recording in time
is tested against random signs of short intervals, and a periodic curve (in time, with the sample
index, or along a signal) against the spectrum around its frequency, whose power is exponentially
distributed in white noise. Hysteresis that the nuisance class cannot follow is systematic as well,
so the gain must also exceed that of healthy stages (``null_distribution``).

Source: Arlot & Celisse (2010) on blocks; Phipson & Smyth (2010) on p-values that count
permutations; Theiler et al., Physica D 58 (1992), on surrogates; Percival & Walden (1993) on
lines; Bretthorst (1988) on waves of unknown frequency.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil, exp, floor, log, sqrt

import numpy as np
from scipy.special import chdtrc

from piezoid.diagnosis.blocked_regression import FOLDS, Null
from piezoid.diagnosis.null_distribution import rank_p_value
from piezoid.diagnosis.residual_coordinates import (
    TIME_KNOTS,
    Basis,
    Signals,
    reading_basis,
    sample_index_basis,
    signal_bases,
    time_basis,
    time_spline,
    wave_basis,
)
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.signals import GRIDS_Hz
from piezoid.numerics.arrays import Array

SURROGATES = 99
RIDGE = 1e-3  # of a column's squared length
MIN_LENGTH = 1e-3  # of the length of a column: smallest part orthogonal to the null
READING_SURROGATES = 5
CHUNKS = 5  # of the time between two knots; neighbouring chunks are in different folds
ROUNDS = 12  # of fitting a course in time and the null in turn
MIN_PERIODS = 4.0  # of a wave in a recording
LINES = 3  # of each recording
MIN_LINE_RATIO = 4.0  # of a line of the motion of the stage, over the surrounding spectrum
RESOLVED = 0.9  # periods per recording between two lines; 1 separates two waves
AROUND = 12  # frequencies on either side that a line is compared with
MAX_PERIOD = 128  # samples
ROWS_PER_CELL = 6
CELLS = 1 << 14  # along a signal, for its spectrum
HARMONICS, MAINS_HARMONICS = 6, 12
MAINS_OFFSET_Hz = 0.15  # largest deviation of a power grid from its nominal frequency
MIN_GAIN_RATIO = 1.15  # of a periodic curve of another shape, over the gain of one wave


@dataclass(frozen=True, kw_only=True, eq=False)
class CoordinateScore:
    """Fit of a curve along one coordinate to the residual.

    basis         of the curve
    gain          share of the residual's power explained on left-out blocks
    p_value       of such a gain for a residual that does not depend on the coordinate
    coefficients  (columns,)
    fitted        (rows,)  part of the curve orthogonal to the null
    """

    basis: Basis
    gain: float
    p_value: float
    coefficients: Array
    fitted: Array

    @property
    def coordinate(self) -> str:
        """Return the name of the coordinate."""
        return self.basis.coordinate


@dataclass(frozen=True, kw_only=True, eq=False)
class Residual:
    """Residual of a view, with the null model that it is orthogonal to."""

    view: View
    null: Null

    @classmethod
    def of(cls, view: View, tangents: Sequence[Array] = ()) -> "Residual":
        """Return the residual of a view that is orthogonal to these tangents as well."""
        if not tangents:
            return cls(view=view, null=view.null)
        null = Null(
            columns=view.null.columns,
            response=view.response,
            block=view.block,
            extra=np.hstack([view.selected, *tangents]),
            column_gram=view.null.column_gram,
        )
        return cls(view=view, null=null)

    @property
    def values(self) -> Array:
        """Return the residual, (rows,)."""
        return self.null.residual

    def score(self, basis: Basis, p_value: float = 1.0) -> CoordinateScore:
        """Fit and cross-validate a curve."""
        score, _ = self._score(basis, np.zeros((len(self.values), 0)), p_value)
        return score

    def score_all(
        self, bases: Sequence[Basis], surrogates: Array
    ) -> tuple[list[CoordinateScore], Array]:
        """Fit and cross-validate curves; their p-values allow for the choice among them.

        Returns the scores, and for each surrogate the largest gain of any curve.
        """
        scored = [self._score(basis, surrogates) for basis in bases]
        largest = np.max([gains for _, gains in scored], axis=0)
        return [replace(s, p_value=rank_p_value(s.gain, largest)) for s, _ in scored], largest

    def _score(
        self, basis: Basis, surrogates: Array, p_value: float = 1.0
    ) -> tuple[CoordinateScore, Array]:
        columns, length = self.unit_columns(basis)
        gains = self.held_out_gains(columns, np.column_stack([self.values, surrogates]))
        ridge = RIDGE * np.eye(columns.shape[1])
        beta = np.linalg.solve(columns.T @ columns + ridge, columns.T @ self.values)
        score = CoordinateScore(
            basis=basis,
            gain=float(gains[0]),
            p_value=p_value,
            coefficients=beta / length,
            fitted=columns @ beta,
        )
        return score, gains[1:]

    def unit_columns(self, basis: Basis) -> tuple[Array, Array]:
        """Project the null out of the columns, and return unit columns and their lengths."""
        full_length = np.sqrt(np.einsum("ij,ij->j", basis.columns, basis.columns))
        columns = self.null.project_out(basis.columns)
        length = np.sqrt(np.einsum("ij,ij->j", columns, columns))
        length = np.where(length > MIN_LENGTH * full_length, length, np.inf)
        return columns / length, length

    def held_out_gains(self, columns: Array, values: Array) -> Array:
        """Return the share of power explained on left-out blocks, for each column of values."""
        null = self.null
        gram = np.array([columns[block].T @ columns[block] for block in null.parts])
        right = np.array([columns[block].T @ values[block] for block in null.parts])
        total_gram, total_right = gram.sum(axis=0), right.sum(axis=0)
        ridge, explained = RIDGE * np.eye(columns.shape[1]), np.zeros(values.shape[1])
        for fold in range(FOLDS):
            is_out = null.fold == fold
            out_gram, out_right = gram[is_out].sum(axis=0), right[is_out].sum(axis=0)
            beta = np.linalg.solve(total_gram - out_gram + ridge, total_right - out_right)
            explained += np.sum((2.0 * out_right - out_gram @ beta) * beta, axis=0)
        return np.asarray(explained / np.maximum(np.sum(values**2, axis=0), 1e-300))

    def surrogates(self, rng: np.random.Generator) -> Array:
        """Return randomly shifted residuals of the same power, (rows, surrogates)."""
        shifted = np.empty((len(self.values), SURROGATES))
        for k in range(len(self.view.tracks)):
            rows = self.view.track_rows(k)
            residual = self.values[rows]
            for j in range(SURROGATES):
                shifted[rows, j] = np.roll(residual, rng.integers(1, max(len(residual), 2)))
        shifted = self.null.project_out(shifted)
        power = np.einsum("ij,ij->j", shifted, shifted)
        return np.asarray(shifted * np.sqrt(np.sum(self.values**2) / power))


def score_coordinates(residual: Residual) -> tuple[CoordinateScore, ...]:
    """Score a curve along each coordinate, the largest gain first.

    The p-value of a curve along a signal is the share of surrogates for which a curve along any
    signal has as large a gain. That of a periodic curve compares its power with the spectrum
    around its frequency.

    Every residual is a part of the measured value and therefore correlated with it. The gain of
    the coordinate "reading" is thus relative to measured values with surrogate residuals, and a
    periodic curve along it is one of the static response, because a wave as short as the noise
    would follow the measured value.
    """
    view, rng = residual.view, np.random.default_rng(0)
    surrogates = residual.surrogates(rng)
    scores, largest = residual.score_all(signal_bases(view), surrogates)
    reading, surrogate_gains = residual.score(reading_basis(view)), [0.0]
    for j in range(READING_SURROGATES):
        columns, _ = residual.unit_columns(reading_basis(view, surrogates[:, j]))
        gains = residual.held_out_gains(columns, surrogates[:, j : j + 1])
        surrogate_gains.append(float(gains[0]))
    gain = reading.gain - max(surrogate_gains)
    scores.append(replace(reading, gain=gain, p_value=rank_p_value(gain, largest)))
    scores.append(_score_time(residual, rng))
    distance = tuple(np.cumsum(np.abs(np.diff(y, prepend=y[:1]))) for y in view.static)
    periodic = (
        _score_spectral_lines(residual),
        _score_sample_index(residual),
        _score_wave_along(residual, "distance_travelled", distance),
        _score_wave_along(residual, "reading", view.static),
    )
    scores += [score for score in periodic if score is not None]
    return tuple(sorted(scores, key=lambda score: -score.gain))


def _score_time(residual: Residual, rng: np.random.Generator) -> CoordinateScore:
    """Score a separate curve in time for each recording on left-out intervals.

    The null distribution comes from random signs of the intervals. It assumes that the residual is
    not correlated for longer than a fifth of the distance of two knots, which may not hold for
    hysteresis.
    """
    explained, coefficients, fitted = np.zeros(1 + SURROGATES), [], []
    for k, track in enumerate(residual.view.tracks):
        values = residual.values[residual.view.track_rows(k)]
        columns = time_spline(track)
        chunk = np.arange(len(values)) * TIME_KNOTS * CHUNKS // max(len(values), 1)
        signs = rng.choice([-1.0, 1.0], (TIME_KNOTS * CHUNKS, SURROGATES))[chunk]
        trials = np.column_stack([values, values[:, None] * signs])
        ridge = _time_ridge(values)
        for fold in range(CHUNKS):
            is_out = chunk % CHUNKS == fold
            training = columns[~is_out]
            beta = np.linalg.solve(training.T @ training + ridge, training.T @ trials[~is_out])
            predicted = columns[is_out] @ beta
            explained += np.sum((2.0 * trials[is_out] - predicted) * predicted, axis=0)
        coefficients.append(np.linalg.solve(columns.T @ columns + ridge, columns.T @ values))
        fitted.append(columns @ coefficients[-1])
    gains = explained / max(float(np.sum(residual.values**2)), 1e-300)
    return CoordinateScore(
        basis=time_basis(residual.view),
        gain=float(gains[0]),
        p_value=rank_p_value(float(gains[0]), gains[1:]),
        coefficients=np.concatenate(coefficients),
        fitted=np.concatenate(fitted),
    )


def fit_time_course(residual: Residual, score: CoordinateScore) -> CoordinateScore:
    """Fit the curves in time and the null alternately, which converges to the joint fit."""
    view, null = residual.view, residual.null
    columns = [time_spline(track) for track in view.tracks]
    coefficients = np.zeros((len(columns), TIME_KNOTS))
    course = np.zeros(len(view.response))
    for _ in range(ROUNDS):
        remaining = null.project_out(view.response - course)
        for k, spline in enumerate(columns):
            rows = view.track_rows(k)
            ridge = _time_ridge(remaining[rows])
            step = np.linalg.solve(spline.T @ spline + ridge, spline.T @ remaining[rows])
            coefficients[k] += step
            course[rows] += spline @ step
    return replace(score, coefficients=coefficients.ravel(), fitted=null.project_out(course))


def _time_ridge(values: Array) -> Array:
    return np.asarray(RIDGE * len(values) / TIME_KNOTS * np.eye(TIME_KNOTS))


def mains_frequency_Hz(frequency_Hz: float) -> float:
    """Return the mains frequency with a harmonic at this frequency, or 0."""
    for nominal_Hz in GRIDS_Hz:
        order = round(frequency_Hz / nominal_Hz)
        if order and abs(frequency_Hz / order - nominal_Hz) < MAINS_OFFSET_Hz:
            return frequency_Hz / order
    return 0.0


def strongest_peaks(spectrum: Array) -> list[tuple[float, float, int]]:
    """Return the strongest lines of a power spectrum, against the median power around each.

    Each is its power, the p-value of such power in white noise, and its index.
    """
    peaks, power = [], spectrum.copy()
    count = max(int(np.sum(power > 0.0)), 1)
    for _ in range(LINES):
        j = int(np.argmax(power))
        if power[j] <= 0.0:
            break
        around = spectrum[max(j - 4 * AROUND, 0) : j + 4 * AROUND + 1]
        mean = float(np.median(around[around > 0.0])) / log(2.0)  # of an exponential variable
        p_value = min(1.0, count * exp(-min(power[j] / max(mean, 1e-300), 700.0)))
        peaks.append((float(power[j]), p_value, j))
        power[max(j - 2, 0) : j + 3] = 0.0
    return peaks


def _score_spectral_lines(residual: Residual) -> CoordinateScore | None:
    """Score the strongest lines of all recordings, in seconds and in samples.

    A line that repeats with the sample index has another frequency at another sampling rate. Lines
    of the motion of the stage are left out: they are unmodelled hysteresis.
    """
    view = residual.view
    seconds = tuple(track.time_s for track in view.tracks)
    samples = tuple(np.arange(len(track.drive), dtype=np.float64) for track in view.tracks)
    candidates, driven_Hz = [], []
    for k, track in enumerate(view.tracks):
        step_Hz = track.rate_Hz / len(track.drive)
        values = residual.values[view.track_rows(k)]
        spread = np.zeros(len(track.drive))
        spread[track.rows] = values - values.mean()
        spectrum = np.abs(np.fft.rfft(spread)) ** 2 / len(values)
        driven = _driven_lines(view.static[k], view.noise)
        for line in driven:
            spectrum[ceil(line - RESOLVED) : floor(line + RESOLVED) + 1] = 0.0
        spectrum[: int(MIN_PERIODS)] = 0.0
        candidates += [(power, p, j * step_Hz, k) for power, p, j in strongest_peaks(spectrum)]
        driven_Hz.append(driven * step_Hz)
    best: CoordinateScore | None = None
    for _, p_value, line_Hz, k in sorted(candidates, reverse=True)[: 2 * LINES]:
        p_value = min(1.0, p_value * len(view.tracks))
        score = _score_wave(residual, "frequency", seconds, "s", line_Hz, k, p_value)
        offset_Hz = np.abs(driven_Hz[k] - score.basis.per_unit)
        if offset_Hz.min(initial=np.inf) * float(seconds[k][-1]) < RESOLVED:
            continue
        per_sample = line_Hz / view.tracks[k].rate_Hz
        in_samples = _score_wave(
            residual, "sample_index", samples, "samples", per_sample, k, p_value
        )
        if in_samples.gain > MIN_GAIN_RATIO * score.gain:
            score = in_samples
        if best is None or score.gain > best.gain:
            best = score
    return None if best is None else _with_harmonics(residual, best)


def _driven_lines(static: Array, noise: float) -> Array:
    """Return the spectral lines of the motion of the stage, in periods of the recording.

    Each is the vertex of the parabola through the three highest values of its lobe.
    """
    from scipy.ndimage import median_filter

    count = len(static)
    spectrum = 4.0 * np.abs(np.fft.rfft((static - static.mean()) * np.hanning(count))) / count
    floor_level = 2.0 * noise / sqrt(count)
    around = np.maximum(median_filter(spectrum, 2 * AROUND + 1, mode="nearest"), floor_level)
    top = np.flatnonzero(spectrum[1:-1] >= np.maximum(spectrum[:-2], spectrum[2:])) + 1
    top = top[spectrum[top] > MIN_LINE_RATIO * around[top]]
    below, centre, above = (np.log(np.maximum(spectrum[top + j], 1e-300)) for j in (-1, 0, 1))
    curvature = np.minimum(below - 2.0 * centre + above, -1e-9)
    return np.asarray(top + 0.5 * (below - above) / curvature)


def _score_wave(
    residual: Residual,
    coordinate: str,
    position: Signals,
    unit: str,
    per_unit: float,
    k: int,
    p_value: float,
) -> CoordinateScore:
    """Score a wave of all tracks near the frequency of a line in track k.

    Its frequency is the one at which the waves of all tracks together explain most.
    """
    width = 1.0 / float(position[k][-1])
    longest = max(float(signal[-1]) for signal in position)
    count = int(np.clip(8.0 * longest * width, 9, 161)) | 1
    frequencies = per_unit + width * np.linspace(-1.0, 1.0, count)
    power = np.zeros(count)
    for i, track in enumerate(residual.view.tracks):
        if float(position[i][-1]) * per_unit < MIN_PERIODS:
            continue
        values, x = residual.values[residual.view.track_rows(i)], position[i][track.rows]
        wave = values * np.exp(2j * np.pi * frequencies[0] * x)
        step = np.exp(2j * np.pi * (frequencies[1] - frequencies[0]) * x)
        for j in range(count):
            power[j] += abs(wave.sum()) ** 2 / len(values)
            wave = wave * step
    best = float(frequencies[int(np.argmax(power))])
    return residual.score(wave_basis(residual.view, coordinate, position, best, unit), p_value)


def _with_harmonics(residual: Residual, line: CoordinateScore) -> CoordinateScore:
    """Return a line with its harmonics or those of the mains, if they explain more than it."""
    best, basis = line, line.basis
    trials = [(basis.coordinate, basis.per_unit, HARMONICS)]
    mains_Hz = mains_frequency_Hz(basis.per_unit) if basis.coordinate == "frequency" else 0.0
    if mains_Hz:
        trials.append(("line_phase", mains_Hz, MAINS_HARMONICS))
    for coordinate, per_unit, count in trials:
        waves = wave_basis(residual.view, coordinate, basis.position, per_unit, basis.unit, count)
        score = residual.score(waves, line.p_value)
        if score.gain > MIN_GAIN_RATIO * best.gain:
            best = score
    return best


def _score_sample_index(residual: Residual) -> CoordinateScore | None:
    """Score the period in samples with the largest chi-squared of the means over its samples."""
    view = residual.view
    excess = np.zeros(MAX_PERIOD + 1)  # of chi-squared, in standard deviations
    for period in range(2, MAX_PERIOD + 1):
        for k, track in enumerate(view.tracks):
            values = residual.values[view.track_rows(k)]
            if len(values) < ROWS_PER_CELL * period:
                continue
            cell = track.rows % period
            count = np.bincount(cell, minlength=period)
            total = np.bincount(cell, values, minlength=period)
            power = float(np.sum(total**2 / np.maximum(count, 1)))
            excess[period] += power / max(float(np.mean(values**2)), 1e-300) - period
        excess[period] /= sqrt(2.0 * period)
    period = int(np.argmax(excess))
    if excess[period] <= 0.0:
        return None
    freedom = period * len(view.tracks)
    chi_squared = excess[period] * sqrt(2.0 * period) + freedom
    p_value = min(1.0, MAX_PERIOD * float(chdtrc(freedom, chi_squared)))
    return residual.score(sample_index_basis(view, period), p_value)


def _score_wave_along(
    residual: Residual, coordinate: str, signals: Signals
) -> CoordinateScore | None:
    """Score the strongest wave along a signal, in half strokes."""
    view = residual.view
    distances = [signal - float(signal.min()) for signal in signals]
    longest = max(float(distance.max()) for distance in distances)
    frequencies = np.arange(4, CELLS // 8) / (2.0 * longest)
    power = np.zeros(len(frequencies))
    for k, distance in enumerate(distances):
        values = residual.values[view.track_rows(k)]
        position = distance[view.tracks[k].rows]
        cell = np.minimum((position / longest * CELLS).astype(int), CELLS - 1)
        wave = np.fft.rfft(np.bincount(cell, values - values.mean(), CELLS), 2 * CELLS)
        is_resolved = float(distance.max()) * frequencies > MIN_PERIODS
        spectrum = np.abs(wave[4 : 4 + len(frequencies)]) ** 2 / len(values)
        power += np.where(is_resolved, spectrum, 0.0)
    peaks = strongest_peaks(power)
    if not peaks:
        return None
    _, p_value, index = peaks[0]
    per_unit = float(frequencies[index])
    basis = wave_basis(view, coordinate, signals, per_unit, "half strokes")
    return _with_harmonics(residual, residual.score(basis, p_value))
