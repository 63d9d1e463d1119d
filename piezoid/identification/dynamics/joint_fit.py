"""Joint fit of hysteresis and dynamics of an axis, starting from separate fits.

    minimise over all segments   1/samples sum_lines |E(f)|^2 / sigma^2(f)
    y = y_off + G[Psi(sum_i w_i P_i[u])],    G of modes, lags and a delay with unit gain at rest

E is the spectrum of measured minus modelled displacement, without the straight line of each
segment. sigma^2 is the smoothed power of the residual, so that correlated noise and errors of the
operator have small weights [Whittle 1953]. Hysteresis and lag imitate each other, so intervals of
dynamics behind a fixed hysteresis are too narrow: on 14 fresh stages of
``benchmarks/dynamics_coverage.py`` they contain the true delay of no stage and the true damping of
4 stages; the intervals of the joint fit those of 12 and 13.

A segment is uninterrupted, and the static fit has determined its initial memory. The drive of the
operator is that behind the hold of the controller and the declared pole of the amplifier.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

from piezoid.identification.dynamics.fit_dynamics import ModalBasis, sorted_terms
from piezoid.identification.dynamics.modal import (
    Declaration,
    JointFit,
    LinearDynamics,
    Structure,
    filters_of,
)
from piezoid.identification.hysteresis.pieces import behind_pole
from piezoid.identification.model import AxisModel
from piezoid.identification.simulation import fitted_pieces
from piezoid.numerics.arrays import Array, ComplexArray
from piezoid.numerics.levenberg_marquardt import NormalEquations, Rule, minimise
from piezoid.numerics.robust import NORMAL_95, sandwich_covariance
from piezoid.operators.dead_zone import DeadZones
from piezoid.operators.play import play_columns
from piezoid.operators.prandtl_ishlinskii import ModifiedPrandtlIshlinskii
from piezoid.records.recording import Recording

SMALL_PLAYS = (0.05, 0.1, 0.2, 0.35)  # of the reach of the exciting drive
MIN_DISTANCE = 0.02  # of that reach, between thresholds
MAX_SAMPLES = 60_000  # of a segment: one second of a fast recording is as informative as ten
RINGING = 10.0  # time constants after which a ring has decayed
MAX_FREQUENCY = 0.4  # of the sampling rate: above is only noise
BANDS_PER_DECADE, BAND_LINES = 10, 12  # over which the residual's power is averaged
WEIGHT_ROUNDS = 3
# Few steps between updates of the weights; half of ``enough`` is the gain in log likelihood.
RULE = Rule(tolerance=0.0, enough=0.1, iterations=4, tries=6)
MAX_LOG_STEP = 0.3
NEIGHBOURS = 30  # samples over which whitened noise may still be correlated
PARTS = 12  # of a segment, each an independent sample of the operator error
PARTS_QUANTILE = 2.2010  # Student's of eleven degrees of freedom, 95 %
TINY = 1e-300


@dataclass(frozen=True, kw_only=True, eq=False)
class Segment:
    """One uninterrupted segment of one recording.

    recording     name
    states_V      (plays, samples)  of the plays
    measured_m    (samples,)  rising with the drive
    basis         modes and lags of unit gain, behind the declared sensor, at the lines of the
                  padded spectrum
    padded        number of samples of the padded signal
    """

    recording: str
    states_V: Array
    measured_m: Array
    basis: ModalBasis
    padded: int

    def spectrum(self, signals: Array) -> ComplexArray:
        """Return the padded spectra of signals minus their first samples, (..., lines)."""
        return np.asarray(rfft(signals - signals[..., :1], self.padded))

    def signal(self, spectrum: ComplexArray) -> Array:
        """Return the signal of a padded spectrum, (samples,)."""
        return np.asarray(irfft(spectrum, self.padded))[: len(self.measured_m)]


def segments_of(
    axis: AxisModel,
    recording: Recording,
    threshold_V: Array,
    dynamics: LinearDynamics,
    structure: Structure,
) -> list[Segment]:
    """Return the segments of a recording whose initial memory the static fit determined.

    axis         operator and declared poles, which determine the drive of the plays
    threshold_V  (plays,)  of the plays of the segments
    dynamics     duration of the ringing, and sampling rate of the controller
    structure    modes and lags of the basis
    """
    rate_Hz, operator = recording.sampling_rate_Hz, axis.hysteresis
    sensor = filters_of(sensor=axis.rig.sensor_bandwidth_Hz)
    # The longest time constant; an overdamped mode has its slow pole at w / (2 zeta).
    w, zeta = 2.0 * np.pi * dynamics.mode_frequency_Hz, dynamics.mode_damping
    modes_s = np.maximum(1.0 / (zeta * w), np.where(zeta > 1.0, 2.0 * zeta / w, 0.0))
    lags_s = 1.0 / (2.0 * np.pi * dynamics.lag_frequency_Hz)
    longest_s = float(max([*modes_s, *lags_s], default=0.0))
    ring = int(np.ceil((RINGING * longest_s + dynamics.delay_s) * rate_Hz)) + 1
    segments = []
    for piece in fitted_pieces(axis, recording):
        measured_m = recording.displacement_m(axis.axis)[piece.samples]
        drive_V = _drive_at_operator(
            piece.voltage_V[:MAX_SAMPLES],
            axis.rig.amplifier_bandwidth_Hz,
            rate_Hz,
            dynamics.sampling_rate_Hz,
        )
        inside_V = operator.envelope.run(drive_V - operator.voltage_offset_V)
        # The memory is a curve of slope at most one over the threshold: interpolation is
        # admissible.
        memory_V = np.interp(threshold_V, operator.plays.threshold, piece.start.memory_V)
        states_V, _ = play_columns(inside_V, threshold_V, memory_V)
        padded = next_fast_len(len(drive_V) + min(len(drive_V), ring), real=True)
        segments.append(
            Segment(
                recording=recording.name,
                states_V=np.ascontiguousarray(states_V.T),
                measured_m=axis.polarity * measured_m[:MAX_SAMPLES],
                basis=ModalBasis(
                    structure=structure,
                    frequency_Hz=np.asarray(rfftfreq(padded, 1.0 / rate_Hz)),
                    sampling_rate_Hz=rate_Hz,
                    declaration=Declaration(hold="band_limited", filters=sensor),
                ),
                padded=padded,
            )
        )
    return segments


def _drive_at_operator(
    voltage_V: Array, amplifier_Hz: float | None, rate_Hz: float, controller_Hz: float
) -> Array:
    """Return the drive behind hold and declared amplifier, (samples,), without its images.

    At the rate of the controller, each value is held for one sample. The hold delays the drive by
    half a sample; images of the staircase, which the stage does not follow, are omitted. Slower
    recordings contain samples of a drive that is nearly linear between them.
    """
    if rate_Hz < 0.99 * controller_Hz:
        return behind_pole(voltage_V, amplifier_Hz, rate_Hz)
    count = len(voltage_V)
    padded = next_fast_len(2 * count, real=True)
    fade = 0.5 + 0.5 * np.cos(np.pi * np.arange(1, padded - count + 1) / (padded - count))
    level = voltage_V - voltage_V[0]
    chain = Declaration(filters=filters_of(amplifier=amplifier_Hz))
    response = chain.response(np.asarray(rfftfreq(padded, 1.0 / rate_Hz)), rate_Hz)
    spectrum = response * rfft(np.concatenate([level, level[-1] * fade]))
    return np.asarray(voltage_V[0] + irfft(spectrum, padded)[:count])


def fit_jointly(
    axis: AxisModel,
    dynamics: LinearDynamics,
    exciting: Recording,
    recordings: Sequence[Recording],
) -> tuple[LinearDynamics, JointFit] | None:
    """Fit operator and dynamics together to all recordings with a fitted initial memory.

    Returns the dynamics, whose intervals include the uncertainty of the hysteresis, and the record
    of the fit; None if the initial memory of ``exciting`` was not fitted.

    axis        its operator is the start; thresholds do not change
    dynamics    start
    exciting    recording that excites the modes; among ``recordings``

    Plays smaller than the exciting drive are added to the operator, because a loss angle that does
    not depend on frequency would be fitted as a delay. Half of the change without these plays
    counts as uncertainty of the structure.
    """
    if not fitted_pieces(axis, exciting):
        return None
    structure = replace(dynamics.structure, direct=False)
    coarse_V = axis.hysteresis.plays.threshold
    exciting_V = exciting.voltage_V(axis.axis)
    reach_V = 2.0 * float(np.median(np.abs(exciting_V - np.median(exciting_V))))
    small_V = reach_V * np.array(SMALL_PLAYS)
    small_V = small_V[np.abs(small_V[:, None] - coarse_V).min(axis=1) > MIN_DISTANCE * reach_V]
    threshold_V = np.unique(np.concatenate([coarse_V, small_V]))
    segments = [
        segment
        for recording in recordings
        for segment in segments_of(axis, recording, threshold_V, dynamics, structure)
    ]
    layout = Layout(
        plays=len(threshold_V),
        threshold_m=axis.hysteresis.dead_zones.threshold,
        structure=structure,
    )
    is_coarse = np.isin(threshold_V, coarse_V)
    start = layout.start(axis.hysteresis, dynamics, is_coarse)
    coarse, _ = _fit(segments, layout, start, is_coarse)
    theta, line_weights = _fit(segments, layout, coarse, np.ones_like(is_coarse))
    change = 0.5 * (theta - coarse)[layout.shape]
    covariance = _covariance(segments, layout, theta, line_weights)[layout.shape, layout.shape]
    weights, zones, shape, shares = layout.split(theta)
    terms = sorted_terms(
        layout.structure,
        shape,
        shares * dynamics.static_gain_m_per_V,
        covariance + np.outer(change, change),
    )
    record = JointFit(
        recordings=tuple(segment.recording for segment in segments),
        play_threshold_V=tuple(threshold_V.tolist()),
        play_weight_m_per_V=tuple(weights.tolist()),
        dead_zone_weight=tuple(zones.weight.tolist()),
        separate_rms_m=_residual_rms(segments, layout, start),
        joint_rms_m=_residual_rms(segments, layout, theta),
    )
    return replace(dynamics, **terms), record


@dataclass(frozen=True, kw_only=True)
class Layout:
    """Order of the parameters: play weights, dead zones, linear shape, all shares but the last.

    plays        number of plays
    threshold_m  (zones,)  of the dead zones; the weight of the one at 0 is 1
    structure    modes and lags
    """

    plays: int
    threshold_m: Array
    structure: Structure

    @property
    def shape(self) -> slice:
        """Indices of ln f, ln zeta, ln f of lags and the delay, in the order of LinearDynamics."""
        first = self.plays + len(self.threshold_m) - 1
        return slice(first, first + self.structure.shapes)

    @property
    def size(self) -> int:
        """Number of parameters."""
        return int(self.shape.stop) + self.structure.columns - 1

    def start(
        self,
        operator: ModifiedPrandtlIshlinskii,
        dynamics: LinearDynamics,
        is_coarse: NDArray[np.bool_],
    ) -> Array:
        """Return the parameters of separate fits; additional plays have weight 0.

        is_coarse  (plays,)  whether a play is one of the operator
        """
        weight = np.zeros(self.plays)
        weight[is_coarse] = operator.plays.weight
        zones = operator.dead_zones
        gains = np.concatenate([dynamics.mode_gain_m_per_V, dynamics.lag_gain_m_per_V])
        parts = [
            weight,
            np.delete(zones.weight, zones.zero),
            dynamics.shape,
            (gains / gains.sum())[:-1],
        ]
        return np.concatenate(parts)

    def split(self, theta: Array) -> tuple[Array, DeadZones, Array, Array]:
        """Return play weights, dead zones, linear shape and the shares of the gain."""
        zero = int(np.flatnonzero(self.threshold_m == 0.0)[0])
        weight = np.insert(theta[self.plays : self.shape.start], zero, 1.0)
        shares = theta[self.shape.stop :]
        return (
            theta[: self.plays],
            DeadZones(threshold=self.threshold_m, weight=weight),
            theta[self.shape],
            np.append(shares, 1.0 - shares.sum()),
        )

    def residual(self, theta: Array, segment: Segment) -> Array:
        """Return the measured minus the modelled displacement without its line, (samples,)."""
        weight, zones, shape, shares = self.split(theta)
        static_m = zones.run(weight @ segment.states_V)
        response = segment.basis.columns(shape) @ shares
        modelled_m = segment.signal(response * segment.spectrum(static_m))
        return _without_line(segment.measured_m - modelled_m)

    def tangents(self, theta: Array, segment: Segment) -> Array:
        """Return the derivatives of the model without their lines, (parameters, samples)."""
        weight, zones, shape, shares = self.split(theta)
        inner = weight @ segment.states_V
        static_m, slope = zones.run_with_slope(inner)
        fractions = segment.basis.columns(shape)
        response = fractions @ shares
        outer = np.delete(zones.columns(inner).T, zones.zero, axis=0)
        static = [*(slope * states for states in segment.states_V), *outer]
        by_shape = segment.basis.derivatives(shape) @ shares
        changes = [*by_shape, *(fractions[:, :-1] - fractions[:, -1:]).T]
        spectrum = segment.spectrum(static_m)
        signals = [segment.signal(response * segment.spectrum(signal)) for signal in static]
        signals += [segment.signal(change * spectrum) for change in changes]
        return _without_line(np.array(signals))


def _fit(
    segments: Sequence[Segment], layout: Layout, start: Array, is_free: NDArray[np.bool_]
) -> tuple[Array, list[Array]]:
    """Fit all parameters to all segments; return them and the weights of the lines.

    is_free  (plays,)  whether the weight of a play is fitted; otherwise it stays 0
    """
    logs = slice(layout.shape.start, layout.shape.stop - 1)
    lower, longest = np.full(layout.size, -np.inf), np.full(layout.size, np.inf)
    upper = np.full(layout.size, np.inf)
    upper[: layout.plays][~is_free] = 0.0
    lower[: layout.plays] = lower[logs.stop] = 0.0  # play weights and delay
    longest[logs] = MAX_LOG_STEP
    theta, weights = start, _line_weights([np.zeros(1) for _ in segments], segments, layout, start)
    for _ in range(WEIGHT_ROUNDS):
        theta = minimise(
            partial(_Point, segments, layout, weights),
            theta,
            (lower, upper),
            rule=RULE,
            longest=longest,
        ).x
        weights = _line_weights(weights, segments, layout, theta)
    return theta, weights


def _residual_rms(segments: Sequence[Segment], layout: Layout, theta: Array) -> tuple[float, ...]:
    return tuple(float(np.std(layout.residual(theta, segment))) for segment in segments)


def _without_line(signals: Array) -> Array:
    """Return signals, (..., samples), minus their fitted straight lines."""
    time = np.linspace(-1.0, 1.0, signals.shape[-1])
    level = signals - signals.mean(axis=-1, keepdims=True)
    return np.asarray(level - np.multiply.outer(level @ time / (time @ time), time))


def _line_weights(
    weights: list[Array], segments: Sequence[Segment], layout: Layout, theta: Array
) -> list[Array]:
    """Return one over the standard deviation of each line, at least the previous weight.

    The few lowest lines contain almost all of a slow sweep. If their weight could decrease, a
    small gain at other lines would spoil the operator. For the same reason every segment counts as
    if it had as many lines as the longest: its residual is an error of the operator rather than
    noise, and not independent in every line.
    """
    longest = max(len(segment.measured_m) for segment in segments)
    updated = []
    for segment, previous in zip(segments, weights, strict=True):
        power = np.abs(rfft(layout.residual(theta, segment))) ** 2
        samples = len(segment.measured_m)
        lines = np.arange(len(power))
        band = np.floor(BANDS_PER_DECADE * np.log10(np.maximum(lines / BAND_LINES, 1.0)))
        band = band.astype(np.int64)
        count = np.bincount(band)
        mean, middle = np.bincount(band, power) / count, np.bincount(band, lines) / count
        weight = 1.0 / np.sqrt(np.maximum(np.interp(lines, middle, mean), TINY))
        weight[0] = weight[lines > MAX_FREQUENCY * samples] = 0.0
        updated.append(np.maximum(np.sqrt(longest / samples) * weight, previous))
    return updated


class _Point:
    """Parameters and the weighted residual spectra of all segments."""

    def __init__(
        self, segments: Sequence[Segment], layout: Layout, weights: Sequence[Array], theta: Array
    ) -> None:
        self.segments, self.layout, self.weights, self.theta = segments, layout, weights, theta
        self.errors = [
            _weighted_lines(layout.residual(theta, segment), weight)
            for segment, weight in zip(segments, weights, strict=True)
        ]
        self.cost = sum(float(error @ error) for error in self.errors)

    def linearised(self) -> NormalEquations:
        size = self.layout.size
        gram, slope = np.zeros((size, size)), np.zeros(size)
        for segment, weight, error in zip(self.segments, self.weights, self.errors, strict=True):
            J = _weighted_lines(self.layout.tangents(self.theta, segment), weight)
            gram += J @ J.T
            slope -= J @ error
        return NormalEquations(gram=gram, slope=slope, cost=self.cost)


def _weighted_lines(signals: Array, weight: Array) -> Array:
    """Return real and imaginary parts of the weighted lines of signals, (..., 2 lines).

    The factor sqrt 2 accounts for the negative frequencies of a real signal.
    """
    spectrum: ComplexArray = rfft(signals) * (np.sqrt(2.0) * weight)
    return np.asarray(spectrum.view(np.float64))


def _covariance(
    segments: Sequence[Segment], layout: Layout, theta: Array, weights: list[Array]
) -> Array:
    """Return the largest, for each parameter, of inverse curvature and two sandwiches.

    Scores are whitened derivatives times the whitened residual. Sums over neighbouring samples
    allow for noise that changes in time [Newey & West 1987]; sums over parts of a segment allow
    for the error of the operator, which repeats from cycle to cycle and changes during a sweep.
    """
    curvature = np.zeros((layout.size, layout.size))
    by_sample, by_part = curvature.copy(), curvature.copy()
    for segment, weight in zip(segments, weights, strict=True):
        signals = np.vstack(
            [
                layout.tangents(theta, segment),
                layout.residual(theta, segment),
            ]
        )
        samples = signals.shape[1]
        whitened = irfft(rfft(signals) * weight, samples) * np.sqrt(samples)
        tangents, scores = whitened[:-1], whitened[:-1] * whitened[-1]
        curvature += tangents @ tangents.T
        edges = np.zeros((len(scores), NEIGHBOURS))
        running = np.cumsum(np.concatenate([edges, scores, edges], axis=1), axis=1)
        sums = running[:, NEIGHBOURS:] - running[:, :-NEIGHBOURS]
        by_sample += sums @ sums.T / NEIGHBOURS
        starts = np.linspace(0, scores.shape[1], PARTS + 1).astype(np.int64)[:-1]
        sums = np.add.reduceat(scores, starts, axis=1)
        by_part += sums @ sums.T * PARTS / (PARTS - 1) * (PARTS_QUANTILE / NORMAL_95) ** 2
    return sandwich_covariance(curvature, (by_sample, by_part))
