"""Hysteresis and dynamics of an axis in one fit, started from both found apart.

    minimise over all recordings   1/samples sum_lines |E(f)|^2 / sigma^2(f)

E is the spectrum of measured minus modelled displacement, each recording about its own straight
line, and sigma^2 the smoothed power of what is left: correlated noise, and what the operator does
not follow, weigh as little as they deserve [Whittle 1953]. Hysteresis and lag imitate each other;
here neither is fixed before the other is known. Scores, whitened derivatives times the whitened
residual at one sample, are not independent: the covariance is C^-1 M C^-1, M the sum of products
of what counts as one draw [White 1982].

Whether the hysteresis comes before the dynamics or behind them, told by its harmonics' phase.

    before:  y = G[H[u]]     a harmonic made at f arrives through G(n f)
    behind:  y = H[G[u]]     a harmonic is made of what came through G(f): n times its phase

Above a third of the resonance the two part. What is linear is taken out of the measurement and of
both simulations, and only such frequencies and times count at which the drive itself is silent.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.fft import irfft, rfft

from piezoid.identification.dynamics.frequency_response import ComplexArray
from piezoid.identification.dynamics.hammerstein_model import (
    HammersteinRows,
    HammersteinShape,
    rows_of,
    simulate_rows,
    start_of,
    straightened,
    tangents,
    terms_at,
)
from piezoid.identification.dynamics.hammerstein_record import JointFit, Order, StructureVerdict
from piezoid.identification.dynamics.modal import LinearDynamics
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.numerics.executor import Once
from piezoid.numerics.levenberg_marquardt import NormalEquations, Rule, minimise
from piezoid.numerics.robust import NORMAL_95
from piezoid.operators.play import play_columns
from piezoid.records.recording import Recording

SILENT = 1e-4  # of the window's strongest line: there the drive does not count as driving
WINDOWS = 32
BLOCKS = 8
SIGNIFICANT = 2.4  # Student's quantile of seven degrees of freedom, 95 %

SMALL_PLAYS = (0.05, 0.1, 0.2, 0.35)  # of the exciting drive's reach
WITHIN = 0.02  # of that reach: plays nearer to each other are one
ROUNDS = 3  # of new weights
# Between them a few steps; half of what is enough is the gain in log likelihood.
STEPS = Rule(tolerance=0.0, enough=0.1, iterations=4, tries=6)
SMOOTH_PER_DECADE = 10
FEWEST_LINES = 12  # in one band of the noise's power
LONGEST_MOVE = 0.3  # of a logarithm in one step
NEIGHBOURS = 30  # samples over which whitened noise may still be correlated
PARTS = 12  # of a recording
STUDENT = 2.2010  # quantile of eleven degrees of freedom, 95 %, where a normal one is taken
HIGHEST = 0.4  # of a recording's rate: above, noise alone


@dataclass(frozen=True, kw_only=True, eq=False)
class Joint:
    """Dynamics whose intervals know of the hysteresis, and what the joint fit says besides."""

    dynamics: LinearDynamics
    record: JointFit


def fit_jointly(
    axis: AxisModel,
    dynamics: LinearDynamics,
    exciting: Recording,
    recordings: Sequence[Recording],
) -> Joint | None:
    """Fit operator and dynamics together to all recordings whose memory is known.

    axis        whose operator is the start; its thresholds are kept
    dynamics    the start, of one path without rate gains
    exciting    the recording that drives the modes; among ``recordings``

    Plays as small as the exciting drive are put beside those of the operator: a loss angle that
    does not depend on frequency must not pass for delay. What changes when they are left out, half
    of it, counts as uncertainty of the structure. None where the recording's memory is not known.
    """
    known = {start.recording for start in axis.starts}
    held = [recording for recording in recordings if recording.name in known]
    if exciting.name not in known:
        return None
    coarse_V = axis.hysteresis.plays.threshold
    fine_V = _with_small(coarse_V, exciting.voltage_V(axis.axis))
    rows = rows_of(axis, held, threshold_V=fine_V, dynamics=dynamics)
    shape, start = start_of(axis.hysteresis, dynamics, fine_V)
    is_coarse = np.isin(fine_V, coarse_V)
    kept = np.concatenate([is_coarse, np.ones(shape.size - shape.plays, dtype=np.bool_)])
    fewer = replace(shape, plays=len(coarse_V))
    coarse = fit_hammerstein([row.of_plays(is_coarse) for row in rows], fewer, start[kept])
    start[kept] = coarse.theta
    fine = fit_hammerstein(rows, shape, start)
    place = fine.shape.linear
    change = 0.5 * (fine.theta[place] - coarse.theta[coarse.shape.linear])
    weight, zones, linear, shares = fine.shape.split(fine.theta)
    driven = next(held_rows for held_rows in rows if held_rows.recording == exciting.name)
    return Joint(
        dynamics=_moved(
            dynamics, linear, shares, fine.covariance[place, place] + np.outer(change, change)
        ),
        record=JointFit(
            recordings=tuple(held_rows.recording for held_rows in rows),
            play_threshold_V=tuple(fine_V.tolist()),
            play_weight_m_per_V=tuple(weight.tolist()),
            dead_zone_weight=tuple(zones.weight.tolist()),
            apart_rms_m=coarse.start_rms_m,
            joint_rms_m=fine.rms_m,
            structure=judge_structure(axis, fine.shape, fine.theta, fine_V, driven),
        ),
    )


def _with_small(threshold_V: Array, voltage_V: Array) -> Array:
    """Return thresholds with those of small drives among them, ascending."""
    reach_V = 2.0 * float(np.median(np.abs(voltage_V - np.median(voltage_V))))
    small_V = reach_V * np.array(SMALL_PLAYS)
    apart = np.abs(small_V[:, None] - threshold_V).min(axis=1) > WITHIN * reach_V
    return np.unique(np.concatenate([threshold_V, small_V[apart]]))


def _moved(
    dynamics: LinearDynamics, linear: Array, shares: Array, covariance: Array
) -> LinearDynamics:
    """Return the dynamics at the joint fit's shape, the gain at rest as it was."""
    n, lags = len(dynamics.mode_frequency_Hz), len(dynamics.lag_frequency_Hz)
    gains = (shares * dynamics.static_gain_m_per_V[0, 0])[:, None, None]
    order = np.argsort(linear[:n])
    lag_order = np.argsort(linear[2 * n : 2 * n + lags])
    by = np.concatenate([order, n + order, 2 * n + lag_order, [2 * n + lags]])
    return replace(
        dynamics,
        mode_frequency_Hz=np.exp(linear[:n][order]),
        mode_damping=np.exp(linear[n : 2 * n][order]),
        mode_gain_m_per_V=gains[:n][order],
        lag_frequency_Hz=np.exp(linear[2 * n : 2 * n + lags][lag_order]),
        lag_gain_m_per_V=gains[n:][lag_order],
        delay_s=float(linear[-1]),
        shape_covariance=covariance[np.ix_(by, by)],
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class HammersteinFit:
    """The parameters and how well they are known.

    theta       (parameters,)  laid out by the shape
    covariance  (parameters, parameters)
    start_rms_m  of what is left at the start, operator and dynamics found apart; each recording
    rms_m       of what is left at the end, each recording
    """

    shape: HammersteinShape
    theta: Array
    covariance: Array
    start_rms_m: tuple[float, ...]
    rms_m: tuple[float, ...]


def fit_hammerstein(
    rows: Sequence[HammersteinRows], shape: HammersteinShape, start: Array
) -> HammersteinFit:
    """Fit all parameters to all rows from a start, and state their covariance.

    The covariance is the largest, parameter by parameter, of the inverse curvature and of two
    sandwiches over the whitened scores: with their neighbours, which sees noise that changes in
    time, and part by part, which sees what the operator does not follow.
    """
    theta, logs = start, slice(shape.linear.start, shape.linear.stop - 1)
    lower, longest = np.full(shape.size, -np.inf), np.full(shape.size, np.inf)
    lower[: shape.plays] = lower[logs.stop] = 0.0  # weights of plays, and the delay
    longest[logs] = LONGEST_MOVE
    weights = [np.zeros(1) for _ in rows]
    for _ in range(ROUNDS):
        weights = _heavier(weights, rows, shape, theta)
        theta = minimise(
            partial(_Point, rows, shape, weights),
            theta,
            (lower, np.full(shape.size, np.inf)),
            rule=STEPS,
            longest=longest,
        ).x
    weights = _heavier(weights, rows, shape, theta)
    return HammersteinFit(
        shape=shape,
        theta=theta,
        covariance=_covariance(rows, shape, theta, weights),
        start_rms_m=tuple(float(np.std(_left(shape, start, r))) for r in rows),
        rms_m=tuple(float(np.std(_left(shape, theta, r))) for r in rows),
    )


def _left(shape: HammersteinShape, theta: Array, rows: HammersteinRows) -> Array:
    return straightened(rows.measured_m - simulate_rows(shape, theta, rows))


def _heavier(
    weights: list[Array], rows: Sequence[HammersteinRows], shape: HammersteinShape, theta: Array
) -> list[Array]:
    """New weights, nowhere less than those before.

    A few low lines hold the whole of a slow sweep: free to lose their weight, they would give the
    operator away for what little a better one gains elsewhere. For the same reason every
    recording counts as if it had as many lines as the longest: what a recording leaves is the
    operator's error rather than noise, and does not come again in every line.
    """
    longest = max(held.samples for held in rows)
    return [
        np.maximum(np.sqrt(longest / held.samples) * _weights(_left(shape, theta, held), held), w)
        for held, w in zip(rows, weights, strict=True)
    ]


def _weights(left_m: Array, rows: HammersteinRows) -> Array:
    """One over the standard deviation of each line; zero where nothing is to be fitted."""
    power = np.abs(rfft(left_m)) ** 2
    lines = np.arange(len(power))
    band = np.floor(SMOOTH_PER_DECADE * np.log10(np.maximum(lines / FEWEST_LINES, 1.0)))
    band = band.astype(np.int64)
    mean = np.bincount(band, power) / np.bincount(band)
    smooth = np.interp(lines, np.bincount(band, lines) / np.bincount(band), mean)
    weight = 1.0 / np.sqrt(np.maximum(smooth, 1e-300))
    weight[0] = 0.0
    weight[lines > HIGHEST * rows.samples] = 0.0
    return np.asarray(weight)


@dataclass(frozen=True, eq=False)
class _Point:
    """Parameters, and what they leave of every recording's weighted lines."""

    rows: Sequence[HammersteinRows]
    shape: HammersteinShape
    weights: Sequence[Array]
    theta: Array

    @Once
    def errors(self) -> list[Array]:
        pairs = zip(self.rows, self.weights, strict=True)
        return [_weighted(_left(self.shape, self.theta, held), weight) for held, weight in pairs]

    @property
    def cost(self) -> float:
        return sum(float(error @ error) for error in self.errors)

    def linearised(self) -> NormalEquations:
        size = self.shape.size
        gram, slope = np.zeros((size, size)), np.zeros(size)
        for held, weight, error in zip(self.rows, self.weights, self.errors, strict=True):
            J = _weighted(straightened(tangents(self.shape, self.theta, held)), weight)
            gram += J @ J.T
            slope -= J @ error
        return NormalEquations(gram=gram, slope=slope, cost=self.cost)


def _weighted(signals: Array, weight: Array) -> Array:
    """Real and imaginary parts of the weighted lines of signals, (..., 2 lines).

    Half the spectrum of a real signal holds all of it: twice its squares are the whole sum.
    """
    spectrum: ComplexArray = rfft(signals) * (np.sqrt(2.0) * weight)
    return np.asarray(spectrum.view(np.float64))


def _covariance(
    rows: Sequence[HammersteinRows], shape: HammersteinShape, theta: Array, weights: list[Array]
) -> Array:
    curvature = np.zeros((shape.size, shape.size))
    near, far = curvature.copy(), curvature.copy()
    for held, weight in zip(rows, weights, strict=True):
        J = straightened(tangents(shape, theta, held))
        white, left = _whitened(J, weight), _whitened(_left(shape, theta, held), weight)
        curvature += white @ white.T
        near += over_neighbours(white * left)
        far += over_parts(white * left)
    scale = np.sqrt(np.maximum(np.diag(curvature), 1e-300))
    inverse = np.linalg.pinv(curvature / np.outer(scale, scale), rcond=1e-12, hermitian=True)
    inverse = inverse / np.outer(scale, scale)
    spread = np.maximum(*(np.diag(inverse @ meat @ inverse) for meat in (near, far)))
    stretch = np.sqrt(np.maximum(spread / np.maximum(np.diag(inverse), 1e-300), 1.0))
    return np.asarray(inverse * np.outer(stretch, stretch))


def _whitened(signals: Array, weight: Array) -> Array:
    """Signals in time, each line over its standard deviation: unit variance and white."""
    samples = signals.shape[-1]
    return np.asarray(irfft(rfft(signals) * weight, samples) * np.sqrt(samples))


def over_neighbours(scores: Array) -> Array:
    """Return the sum of products with neighbours, falling with distance [Newey & West 1987].

    It sees noise that changes in time. Weights 1 - lag / n are those of sums over n neighbours:
    sum_t S_t S_t^T / n.
    """
    edges = np.zeros((len(scores), NEIGHBOURS))
    running = np.cumsum(np.concatenate([edges, scores, edges], axis=1), axis=1)
    sums = running[:, NEIGHBOURS:] - running[:, :-NEIGHBOURS]
    return np.asarray(sums @ sums.T / NEIGHBOURS)


def over_parts(scores: Array) -> Array:
    """Return the sum of products of whole parts of the recording, each of them one draw.

    What an operator does not follow repeats from cycle to cycle and only changes as the drive
    sweeps on, so that cycles are no draws; parts are. So few know their own spread poorly, hence
    Student's quantile.
    """
    edges = np.linspace(0, scores.shape[1], PARTS + 1).astype(np.int64)[:-1]
    sums = np.add.reduceat(scores, edges, axis=1)
    return np.asarray(sums @ sums.T * PARTS / (PARTS - 1) * (STUDENT / NORMAL_95) ** 2)


def judge_structure(
    axis: AxisModel,
    shape: HammersteinShape,
    theta: Array,
    threshold_V: Array,
    rows: HammersteinRows,
) -> StructureVerdict:
    """Compare the harmonics of a recording with both orders of the same two parts.

    rows  of a recording whose drive is silent somewhere, as a chirp's or a sparse multisine's is
    """
    linear = _through(shape, theta, rows, rows.drive_V)
    before = simulate_rows(shape, theta, rows)
    behind = _hysteresis(axis, shape, theta, threshold_V, linear)
    lowest_Hz = float(np.exp(shape.split(theta)[2][0])) / 3.0
    parts = [_nonlinear(signal, linear) for signal in (rows.measured_m, before, behind)]
    blocks = _blocks(rows, parts, lowest_Hz)
    whole = blocks.sum(axis=0)
    left_out = np.array([_agreement(whole - block) for block in blocks])
    a, b = _agreement(whole)
    gap = (left_out[:, 0] - left_out[:, 1]).real
    half = SIGNIFICANT * float(np.sqrt((BLOCKS - 1) * np.var(gap)))
    difference = float((a - b).real)
    order: Order = "undecided"
    if abs(difference) > half and max(a.real, b.real) > 0.0:
        order = "before" if difference > 0.0 else "behind"
    return StructureVerdict(
        order=order,
        agreement_before=float(a.real),
        agreement_behind=float(b.real),
        phase_before_deg=float(np.degrees(np.angle(a))),
        phase_behind_deg=float(np.degrees(np.angle(b))),
        difference_half=half,
        lowest_Hz=lowest_Hz,
    )


def _through(shape: HammersteinShape, theta: Array, rows: HammersteinRows, signal: Array) -> Array:
    _, _, linear, shares = shape.split(theta)
    response = rows.chain * (terms_at(shape, linear, rows.frequency_Hz) @ shares)
    moved = irfft(response * rows.spectrum(signal), rows.padded)[: rows.samples]
    return np.asarray(signal[0] + moved)


def _hysteresis(
    axis: AxisModel, shape: HammersteinShape, theta: Array, threshold_V: Array, drive_V: Array
) -> Array:
    operator = axis.hysteresis
    weight, zones, _, _ = shape.split(theta)
    inside_V = operator.envelope.run(drive_V - operator.voltage_offset_V)
    states_V, _ = play_columns(inside_V, threshold_V, np.zeros(len(threshold_V)))
    return zones.run(states_V @ weight)


def _nonlinear(signal: Array, linear: Array) -> Array:
    level, line = straightened(signal), straightened(linear)
    return np.asarray(level - line * float(level @ line / (line @ line)))


def _blocks(rows: HammersteinRows, parts: list[Array], lowest_Hz: float) -> Array:
    """Cross and own powers of measured and both simulated harmonics, (blocks, 5)."""
    length = 2 ** int(np.log2(rows.samples / WINDOWS))
    signals = np.stack([straightened(rows.drive_V), *parts])
    frequency_Hz, found = _short_time(signals, rows.rate_Hz, length)
    drive, measured, before, behind = found
    power = np.abs(drive) ** 2
    counts = power < SILENT * power.max(axis=0)
    counts &= ((frequency_Hz >= lowest_Hz) & (frequency_Hz <= 0.4 * rows.rate_Hz))[:, None]
    products = [
        np.where(counts, value, 0.0).sum(axis=0)
        for value in (
            measured * before.conj(),
            measured * behind.conj(),
            np.abs(measured) ** 2,
            np.abs(before) ** 2,
            np.abs(behind) ** 2,
        )
    ]
    each = np.array_split(np.array(products), BLOCKS, axis=1)
    return np.array([block.sum(axis=1) for block in each])


def _short_time(signals: Array, rate_Hz: float, length: int) -> tuple[Array, Array]:
    """Return the lines of Hann windows that overlap by half, (signals, lines, windows)."""
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(length) / length)
    parts = sliding_window_view(signals, length, axis=1)[:, :: length // 2] * window
    return np.arange(length // 2 + 1) * rate_Hz / length, np.moveaxis(rfft(parts), 1, 2)


def _agreement(sums: Array) -> Array:
    own = np.sqrt(np.maximum(sums[2].real * sums[3:5].real, 1e-300))
    return np.asarray(sums[:2] / own)
