"""fit_response: a measured frequency response -> modes, delay, creep slope, with intervals.

    G(f) = G_slow(f) G_modes(f) F(f)

F are the declared poles the response was measured through; G_modes the modal form of
``fit_dynamics``; G_slow falls as creep does, (j f)^(-alpha), which no few poles make.

How surely each line of a measured response is known, where its file tells little of that.

    var G = a^2 + b^2 |G|^2                                    without coherence
    var G = c |G|^2 (1 - coherence) / coherence                with it        [Bendat & Piersol]

a, b or c come from how the residual of neighbouring lines differs [von Neumann 1941]: what a model
leaves that is smooth, because a mode is missing, does not count as noise.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezoid.errors import ExcitationError, IdentificationError
from piezoid.identification.dynamics.fit_dynamics import Declaration, fit_dynamics
from piezoid.identification.dynamics.frequency_response import FrequencyResponse
from piezoid.identification.dynamics.maximum_likelihood import resolved_modes
from piezoid.identification.dynamics.modal import LinearDynamics
from piezoid.identification.dynamics.modal_basis import Filter, Structure
from piezoid.identification.dynamics.periodic_estimate import smoothed
from piezoid.identification.dynamics.records import (
    FURTHEST_deg,
    SlowPart,
    STEEPEST_dB,
)
from piezoid.identification.dynamics.response_refinement import refined
from piezoid.numerics.arrays import Array, ComplexArray
from piezoid.numerics.robust import NORMAL_95
from piezoid.records.frequency_response import (
    LEAST_COHERENCE,
    FrequencyResponseRecord,
    ResponsePath,
)
from piezoid.records.response_summary import apparent_modes

RATIOS = np.concatenate([[0.0], np.geomspace(1e-8, 1e4, 61)])  # of a^2 to b^2 |G|^2 at its median
NEIGHBOURS = 5  # lines over which a measured coherence is smoothed: each scatters by itself
LEAST_SHARE = 0.1  # of the median of (1 - coherence) / coherence: printed 1.000 is no certainty
ROUGH_LINES = 21
ROUGH_FLOOR = 1e-3  # of the gain
ALONE = 6.0  # standard deviations: one line of 10^8 by chance
BESIDE = 3.0

FEWEST_LINES = 20
LONGEST_PERIODS = 10.0  # a delay, in periods of the highest line
FAR_BELOW = 0.2  # of the first mode: what it adds there, 4 %, is fitted beside the slope
SLOW_DECADES = 0.5
SLOW_LINES = 8
AS_GOOD = 1.25  # a cost within this of the least, or of that of noise, counts as equal
ROUNDS = 2  # of noise from residual, residual from fit
# A modulus margin of 0.5 bears half the gain at any frequency; the fit may take half of that.
MOST_LEFT = 0.25
MEDIAN_OF = 3  # lines: a single one is noise
STRUCTURES = (
    Structure(modes=0, lags=1),
    Structure(modes=1),
    Structure(modes=1, direct=True),
    Structure(modes=1, lags=1),
    Structure(modes=2),
    Structure(modes=2, direct=True),
    Structure(modes=2, lags=1),
    Structure(modes=3),
    Structure(modes=3, direct=True),
    Structure(modes=4, direct=True),
)


@dataclass(frozen=True, kw_only=True, eq=False)
class ResponseFound:
    """The dynamics in a measured response, and what they were read from.

    dynamics   of one path
    measured   the lines, slow part taken out, with variances and what was rejected
    slow       None where too few lines lie far below the first mode
    left, left_Hz  the largest part of the response that the model leaves, and where
    noise      of one line far below the first mode, relative
    """

    dynamics: LinearDynamics
    measured: FrequencyResponse
    slow: SlowPart | None
    left: float
    left_Hz: float
    noise: float

    @property
    def is_determined(self) -> bool:
        """Whether the numbers may be read: all known, and little of the response left."""
        lags_Hz = self.dynamics.lag_frequency_Hz
        poles_known = bool((lags_Hz < 2.0 * self.dynamics.band_Hz[1]).all())
        return self.left <= MOST_LEFT and poles_known and bool(resolved_modes(self.dynamics).all())


def measured_response(
    record: FrequencyResponseRecord, axis: str, declared: tuple[Filter, ...]
) -> ComplexArray:
    """Return an axis' own response with all declared poles in it, (lines,) m/V.

    declared  those of the rig; what the measurement did not go through is put into it
    """
    response = np.array(_own(record, axis).response_m_per_V)
    for pole in declared:
        if pole.name not in record.includes:
            response *= pole.system().response(record.frequency_Hz)[:, 0, 0]
    return response


def fit_response(
    record: FrequencyResponseRecord, axis: str, declared: tuple[Filter, ...]
) -> ResponseFound:
    """Fit modes, delay and creep slope to the response of an axis to its own drive.

    record    of one file
    declared  poles of the rig: known, and not fitted again

    Raises ``ExcitationError`` for too few coherent lines, ``IdentificationError`` where no
    structure can be fitted.
    """
    path, f = _own(record, axis), record.frequency_Hz
    response = measured_response(record, axis, declared)
    kept = path.is_coherent
    if kept.sum() < FEWEST_LINES:
        raise ExcitationError(
            f"{record.name}: {int(kept.sum())} of {len(kept)} lines of axis {axis} are coherent "
            f"({LEAST_COHERENCE:g} or more)",
            needed=f"at least {FEWEST_LINES}",
            remedy="Measure with a larger drive, longer, or at more frequencies.",
        )
    slow = slow_part(f, response, path)
    quick = response if slow is None else response / slow.response(f)
    alone = np.zeros(len(kept), dtype=np.bool_)
    variance = np.ones(len(kept))
    variance[kept] = rough_variance(quick[kept])
    for _ in range(ROUNDS):
        used = kept & ~alone
        lines = _lines(record, axis, quick, variance, alone)
        model = _best(lines, declared).response(f)[:, 0, 0]
        coherence = None if path.coherence is None else path.coherence[used]
        variance[used] = variance_of(quick[used], (quick - model)[used], coherence)
        if not alone.any():
            alone[kept] = standing_alone((quick - model)[kept], variance[kept])
    lines = _lines(record, axis, quick, variance, alone)
    dynamics = _best(lines, declared)
    if slow is not None and slow.is_taken:
        used = kept & ~alone
        dynamics, slow = refined(_used(lines), response[used], dynamics, slow)
        lines = _lines(record, axis, response / slow.response(f), variance, alone)
    return _found(lines, dynamics, slow)


def _own(record: FrequencyResponseRecord, axis: str) -> ResponsePath:
    path = record.path(axis, axis)
    if path is None:
        raise ExcitationError(
            f"{record.name} holds the responses of {', '.join(record.axes) or 'no axis'}",
            needed=f"that of {axis} to its own drive",
            remedy="Name its columns in lab.toml.",
        )
    return path


def _lines(
    record: FrequencyResponseRecord,
    axis: str,
    quick: ComplexArray,
    variance: Array,
    alone: NDArray[np.bool_],
) -> FrequencyResponse:
    """Return the response as the modal fit takes it; the drive's level is not in such files."""
    path = _own(record, axis)
    shape = (len(quick), 1, 1)
    coherence = np.ones(len(quick)) if path.coherence is None else path.coherence
    return FrequencyResponse(
        inputs=(axis,),
        outputs=(axis,),
        sampling_rate_Hz=2.0 * float(record.frequency_Hz[-1]),
        frequency_Hz=record.frequency_Hz,
        response=quick.reshape(shape),
        noise_variance=variance.reshape(shape),
        distortion_variance=np.zeros(shape),
        coherence=coherence[:, None],
        is_interference=alone[:, None],
        is_rejected=(~path.is_coherent | alone)[:, None],
        least_coherence=LEAST_COHERENCE,
        variance_freedom=float(len(quick)),
        drive_rms_V=np.zeros(1),
        realisations=1,
        periods=1,
    )


def _used(lines: FrequencyResponse) -> FrequencyResponse:
    return lines.at_lines(np.flatnonzero(~lines.is_rejected[:, 0]))


def _best(lines: FrequencyResponse, declared: tuple[Filter, ...]) -> LinearDynamics:
    """Fit structures to the lines in use, and keep the smallest that leaves nothing smooth.

    Where all leave something, the smallest that is as good as the best; one with a term that
    means nothing fits a little better, and does not count where there are others.
    """
    used = _used(lines)
    declaration = Declaration(
        hold="band_limited",
        filters=declared,
        longest_delay_s=LONGEST_PERIODS / float(used.frequency_Hz[-1]),
    )
    fits, refusal = [], None
    for structure in STRUCTURES:
        if 4 * (structure.columns + structure.shapes) > 2 * len(used.frequency_Hz):
            continue
        try:
            fit = fit_dynamics(used, structure, declaration)
        except IdentificationError as error:
            refusal = error
            continue
        if _leaves_noise(used, fit) and resolved_modes(fit).all():
            return fit
        fits.append(fit)
    if not fits:
        raise refusal or IdentificationError(
            f"{len(used.frequency_Hz)} lines",
            needed="enough for one mode",
            remedy="Measure at more frequencies.",
        )
    fits = [fit for fit in fits if resolved_modes(fit).all()] or fits
    least = min(fit.cost for fit in fits)
    return next(fit for fit in fits if fit.cost <= AS_GOOD * least)


def _leaves_noise(lines: FrequencyResponse, fit: LinearDynamics) -> bool:
    """Whether what is left differs from line to line as much as it is large [von Neumann 1941]."""
    left = (lines.response - fit.response(lines.frequency_Hz))[:, 0, 0]
    left = left / np.sqrt(lines.variance[:, 0, 0])
    differs = 0.5 * float(np.mean(np.abs(np.diff(left)) ** 2))
    return float(np.mean(np.abs(left) ** 2)) <= AS_GOOD * differs


def _found(
    lines: FrequencyResponse, dynamics: LinearDynamics, slow: SlowPart | None
) -> ResponseFound:
    used = _used(lines)
    f, response = used.frequency_Hz, used.response[:, 0, 0]
    at_rest = abs(float(dynamics.static_gain_m_per_V[0, 0]))
    left = np.abs(response - dynamics.response(f)[:, 0, 0])
    left /= np.maximum(np.abs(response), at_rest)
    half = MEDIAN_OF // 2
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(left, half, mode="edge"), MEDIAN_OF)
    typical = np.median(windows, axis=1)
    place = int(np.argmax(typical))
    spread = np.sqrt(used.variance[:, 0, 0]) / np.abs(response)
    return ResponseFound(
        dynamics=dynamics,
        measured=lines,
        slow=slow,
        left=float(typical[place]),
        left_Hz=float(f[place]),
        noise=float(np.median(spread[: max(len(spread) // 4, 1)])),
    )


def slow_part(frequency_Hz: Array, response: ComplexArray, path: ResponsePath) -> SlowPart | None:
    """Return slope and phase far below the first mode, None where too few lines are there.

        ln |G| = g + (slope / 20 dB) ln f + c f^2,   arg G = phase + d f

    c stands for what modes and poles add, d for their lag and the delay.
    """
    first_Hz = first_limit_Hz(frequency_Hz, response, path)
    low = path.is_coherent & (frequency_Hz < FAR_BELOW * first_Hz)
    f = frequency_Hz[low]
    if len(f) < SLOW_LINES or f[-1] < 10.0**SLOW_DECADES * f[0]:
        return None
    x, turned = f / f[-1], response[low] / response[low][0]
    log, one = np.log(x), np.ones(len(x))
    slope, slope_std = _regressed(np.stack([log, one, x**2], axis=1), np.log(np.abs(turned)))
    angle = np.unwrap(np.angle(response[low]))
    phase, phase_std = _regressed(np.stack([one, x], axis=1), angle)
    phase -= np.pi * round(phase / np.pi)  # the sign of the response is the polarity's
    slope_dB, half_dB = 20.0 * slope, 20.0 * NORMAL_95 * slope_std  # a power of one: 20 dB
    phase_deg, half_deg = float(np.degrees(phase)), NORMAL_95 * float(np.degrees(phase_std))
    is_creep = slope_dB - half_dB <= 0.0 and slope_dB > -STEEPEST_dB
    is_lag = phase_deg - half_deg <= 0.0 and phase_deg > -FURTHEST_deg
    return SlowPart(
        slope_dB=slope_dB,
        slope_ci95=(slope_dB - half_dB, slope_dB + half_dB),
        phase_deg=phase_deg,
        phase_ci95=(phase_deg - half_deg, phase_deg + half_deg),
        low_Hz=float(f[0]),
        high_Hz=float(f[-1]),
        from_Hz=first_Hz,
        is_taken=is_creep and is_lag,
    )


def first_limit_Hz(frequency_Hz: Array, response: ComplexArray, path: ResponsePath) -> float:
    """Return the first peak; without one where the gain has fallen by 3 dB, or the last line."""
    peaks = apparent_modes(frequency_Hz, replace(path, response_m_per_V=response))
    if peaks:
        return peaks[0].frequency_Hz
    gain = np.abs(response)
    fallen = np.flatnonzero((gain < np.median(gain[:3]) / np.sqrt(2.0)) & path.is_coherent)
    return float(frequency_Hz[fallen[0] if len(fallen) else -1])


def _regressed(columns: Array, values: Array) -> tuple[float, float]:
    """Return the first coefficient of least squares, and its standard deviation."""
    found = np.linalg.lstsq(columns, values, rcond=None)[0]
    left = values - columns @ found
    spare = max(len(values) - columns.shape[1], 1)
    inverse = np.linalg.inv(columns.T @ columns)
    return float(found[0]), float(np.sqrt(inverse[0, 0] * (left @ left) / spare))


def rough_variance(response: ComplexArray) -> Array:
    """Return a first guess from how the logarithm of the response bends from line to line."""
    log = np.log(np.abs(response)) + 1j * np.unwrap(np.angle(response))
    bend = np.abs(np.diff(log, 2)) ** 2 / 6.0 * 2.0
    bend = np.concatenate([bend[:1], bend, bend[-1:]])
    half = min(ROUGH_LINES, len(bend)) // 2
    padded = np.pad(bend, half, mode="reflect" if len(bend) > half else "edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1)
    return np.asarray(np.abs(response) ** 2 * (np.median(windows, axis=1) + ROUGH_FLOOR**2))


def variance_of(response: ComplexArray, residual: ComplexArray, coherence: Array | None) -> Array:
    """Return the variance of each line, (lines,) m2/V2.

    residual   what a model leaves of the response
    coherence  where it was measured
    """
    shown = 0.5 * np.abs(np.diff(residual)) ** 2
    if coherence is not None:
        share = (1.0 - coherence) / coherence
        width = min(NEIGHBOURS, (len(share) - 1) // 2 * 2 + 1)
        smooth = smoothed(share[:, None], width)[:, 0]
        floor = LEAST_SHARE * float(np.median(smooth))
        shape = np.abs(response) ** 2 * np.maximum(smooth, floor if floor > 0.0 else 1.0)
        return np.asarray(shape * _scale(shown, shape))
    power = np.abs(response) ** 2
    shapes = [ratio * float(np.median(power)) + power for ratio in RATIOS]
    shapes.append(np.full(len(power), float(np.median(power))))
    found = [(_surprise(shown, shape), k) for k, shape in enumerate(shapes)]
    best = shapes[min(found)[1]]
    return np.asarray(best * _scale(shown, best))


def _pairs(shape: Array) -> Array:
    return np.asarray(0.5 * (shape[1:] + shape[:-1]))


def _scale(shown: Array, shape: Array) -> float:
    return max(float(np.mean(shown / _pairs(shape))), float(np.finfo(np.float64).tiny))


def _surprise(shown: Array, shape: Array) -> float:
    """Minus twice the mean log likelihood of squared complex differences, the scale eliminated."""
    return float(np.mean(np.log(_pairs(shape)))) + float(np.log(_scale(shown, shape)))


def standing_alone(residual: ComplexArray, variance: Array) -> NDArray[np.bool_]:
    """Tell the single lines that stand out from a model and from both of their neighbours."""
    size = np.abs(residual) / np.sqrt(variance)
    size = size / max(float(np.median(size)) / np.sqrt(np.log(2.0)), 1e-300)
    beside = np.pad(size, 1, mode="reflect")
    calm = (beside[:-2] < BESIDE) & (beside[2:] < BESIDE)
    return np.asarray((size > ALONE) & calm)
