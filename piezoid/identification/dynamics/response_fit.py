"""Fit modes, delay and creep slope, with intervals, to a measured frequency response.

    G(f) = F(f) G_slow(f) G_modes(f),    G_slow = (f / f1)^(slope / 20 dB) e^(j phase)

F is the response of the declared poles in the measurement; G_modes the modal form of
``fit_dynamics``; G_slow falls like creep, which a few poles cannot represent. A slow part that is
removed first would transfer its error to the delay (a thousandth of a radian is 0.16 us at 1 kHz),
so all parts are fitted together at the end. The variance of each line is

    var G = a^2 + b^2 |G|^2                                    without coherence
    var G = c |G|^2 (1 - coherence) / coherence                with coherence [Bendat & Piersol]

a, b or c follow from differences of the residual between neighbouring lines [von Neumann 1941], so
that a smooth residual, because a mode is missing, does not count as noise.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from piezoid.errors import ExcitationError, IdentificationError
from piezoid.identification.dynamics.fit_dynamics import (
    fit_dynamics,
    fit_with_slow_part,
    is_identifiable,
    resolved_modes,
)
from piezoid.identification.dynamics.frequency_response import FrequencyResponse, smooth_lines
from piezoid.identification.dynamics.modal import (
    Declaration,
    Filter,
    LinearDynamics,
    MAX_LAG_deg,
    MAX_SLOPE_dB,
    SlowPart,
    Structure,
)
from piezoid.numerics.arrays import Array, ComplexArray
from piezoid.records.frequency_response import (
    MIN_COHERENCE,
    FrequencyResponseRecord,
    ResponsePath,
    apparent_modes,
)

NOISE_RATIOS = np.concatenate([[0.0], np.geomspace(1e-8, 1e4, 61)])  # a^2 over median b^2 |G|^2
COHERENCE_LINES = 5  # over which a measured coherence is smoothed
MIN_SHARE = 0.1  # of the median of (1 - coherence) / coherence: a coherence of 1.000 is rounded
FIRST_NOISE = 0.01  # of the response: decides only the weights of the first round
# Standard deviations of an outlying line (10^-8 by chance) and at most of its neighbours.
OUTLIER, NEIGHBOUR = 6.0, 3.0
MIN_LINES = 20
MAX_DELAY_PERIODS = 10.0  # of the highest line
FAR_BELOW = 0.2  # of the first mode, which adds 4 % there and is fitted with the slope
SLOW_DECADES, SLOW_LINES = 0.5, 8
EQUAL_COST = 1.25  # times the lowest cost, or that of noise: costs below count as equal
NOISE_ROUNDS = 2  # of residual and variance in turn
# A modulus margin of 0.5 tolerates errors of half the gain; the fit may use half of that.
MAX_RESIDUAL = 0.25
RESIDUAL_LINES = 3  # of the running median: a single line is noise
TINY = float(np.finfo(np.float64).tiny)
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
class FittedResponse:
    """Dynamics fitted to a measured response, and its lines.

    dynamics   of one path
    measured   response without the slow part, with variances and rejected lines
    slow       None: too few lines far below the first mode
    residual, residual_Hz  largest relative residual and its frequency
    noise      relative, of one line far below the first mode
    """

    dynamics: LinearDynamics
    measured: FrequencyResponse
    slow: SlowPart | None
    residual: float
    residual_Hz: float
    noise: float

    @property
    def is_determined(self) -> bool:
        """Whether all parameters are identifiable and the residual is small."""
        return self.residual <= MAX_RESIDUAL and is_identifiable(self.dynamics)


def measured_response(
    record: FrequencyResponseRecord, axis: str, declared: tuple[Filter, ...]
) -> ComplexArray:
    """Return the response of an axis to its own drive behind all declared poles, (lines,) m/V.

    declared  poles of the rig; poles that the measurement did not include are added
    """
    missing = tuple(pole for pole in declared if pole.name not in record.includes)
    chain = Declaration(hold="band_limited", filters=missing)
    f = record.frequency_Hz
    return np.asarray(_path(record, axis).response_m_per_V * chain.response(f, 2.0 * float(f[-1])))


def fit_response(
    record: FrequencyResponseRecord, axis: str, declared: tuple[Filter, ...]
) -> FittedResponse:
    """Fit modes, delay and creep slope to the response of an axis to its own drive.

    record    of one file
    declared  poles of the rig, which are not fitted

    Raises ``ExcitationError`` for too few coherent lines, ``IdentificationError`` if no structure
    can be fitted.
    """
    path, f = _path(record, axis), record.frequency_Hz
    response = measured_response(record, axis, declared)
    is_coherent = path.is_coherent
    if is_coherent.sum() < MIN_LINES:
        raise ExcitationError(
            f"{record.name}: {int(is_coherent.sum())} of {len(f)} lines of axis {axis} are "
            f"coherent ({MIN_COHERENCE:g} or more)",
            needed=f"at least {MIN_LINES}",
            remedy="Measure with a larger drive, longer, or at more frequencies.",
        )
    slow = slow_part(f, response, path)
    fast = response if slow is None else response / slow.response(f)
    is_outlier = np.zeros(len(f), dtype=np.bool_)
    variance = (FIRST_NOISE * np.abs(fast)) ** 2
    lines = FrequencyResponse(
        axis=axis,
        sampling_rate_Hz=2.0 * float(f[-1]),
        frequency_Hz=f,
        response=fast,
        variance=variance,
        coherence=np.ones(len(f)) if path.coherence is None else path.coherence,
        is_interference=is_outlier,
        is_rejected=~is_coherent,
        least_coherence=MIN_COHERENCE,
        variance_freedom=float(len(f)),
        drive_rms_V=0.0,  # files do not state the level of the drive
    )
    for _ in range(NOISE_ROUNDS):
        is_used = is_coherent & ~is_outlier
        residual = fast - _best_fit(lines, declared).response(f)
        coherence = None if path.coherence is None else path.coherence[is_used]
        variance[is_used] = _variance(fast[is_used], residual[is_used], coherence)
        if not is_outlier.any():
            size = np.abs(residual[is_coherent]) / np.sqrt(variance[is_coherent])
            is_outlier[is_coherent] = _single_outliers(size)
        is_rejected = ~is_coherent | is_outlier
        lines = replace(
            lines, variance=variance, is_interference=is_outlier, is_rejected=is_rejected
        )
    dynamics = _best_fit(lines, declared)
    if slow is not None and slow.is_taken:
        measured = replace(lines, response=response).without_rejected()
        dynamics, slow = fit_with_slow_part(measured, dynamics, slow)
        lines = replace(lines, response=response / slow.response(f))
    used_lines = lines.without_rejected()
    f, values = used_lines.frequency_Hz, used_lines.response
    static_gain = abs(dynamics.static_gain_m_per_V)
    relative = np.abs(values - dynamics.response(f))
    relative /= np.maximum(np.abs(values), static_gain)
    smooth = median_filter(relative, RESIDUAL_LINES, mode="nearest")
    worst = int(np.argmax(smooth))
    spread = np.sqrt(used_lines.variance) / np.abs(values)
    return FittedResponse(
        dynamics=dynamics,
        measured=lines,
        slow=slow,
        residual=float(smooth[worst]),
        residual_Hz=float(f[worst]),
        noise=float(np.median(spread[: max(len(spread) // 4, 1)])),
    )


def _path(record: FrequencyResponseRecord, axis: str) -> ResponsePath:
    path = record.path(axis, axis)
    if path is None:
        raise ExcitationError(
            f"{record.name} holds the responses of {', '.join(record.axes) or 'no axis'}",
            needed=f"that of {axis} to its own drive",
            remedy="Name its columns in lab.toml.",
        )
    return path


def _single_outliers(size: Array) -> NDArray[np.bool_]:
    """Return the lines that deviate from the model while both neighbours do not.

    size  (lines,)  magnitude of the residual over its standard deviation
    """
    size = size / max(float(np.median(size)) / np.sqrt(np.log(2.0)), TINY)
    padded = np.pad(size, 1, mode="reflect")
    is_alone = (padded[:-2] < NEIGHBOUR) & (padded[2:] < NEIGHBOUR)
    return np.asarray((size > OUTLIER) & is_alone)


def _best_fit(lines: FrequencyResponse, declared: tuple[Filter, ...]) -> LinearDynamics:
    """Return the smallest structure whose residual is noise, or whose cost is near the lowest.

    Structures with unresolved modes are used only if there are no others.
    """
    usable = lines.without_rejected()
    declaration = Declaration(
        hold="band_limited",
        filters=declared,
        longest_delay_s=MAX_DELAY_PERIODS / float(usable.frequency_Hz[-1]),
    )
    fits, refusal = [], None
    for structure in STRUCTURES:
        if 4 * (structure.columns + structure.shapes) > 2 * len(usable.frequency_Hz):
            continue
        try:
            fit = fit_dynamics(usable, structure, declaration)
        except IdentificationError as error:
            refusal = error
            continue
        # Differences between neighbouring lines are as large as the residual itself if it is noise
        # [von Neumann 1941].
        residual = usable.response - fit.response(usable.frequency_Hz)
        residual = residual / np.sqrt(usable.variance)
        difference = 0.5 * float(np.mean(np.abs(np.diff(residual)) ** 2))
        is_noise = float(np.mean(np.abs(residual) ** 2)) <= EQUAL_COST * difference
        if is_noise and resolved_modes(fit).all():
            return fit
        fits.append(fit)
    if refusal is not None and not fits:
        raise refusal
    fits = [fit for fit in fits if resolved_modes(fit).all()] or fits
    lowest_cost = min(fit.cost for fit in fits)
    return next(fit for fit in fits if fit.cost <= EQUAL_COST * lowest_cost)


def slow_part(frequency_Hz: Array, response: ComplexArray, path: ResponsePath) -> SlowPart | None:
    """Return slope and phase far below the first mode; None if there are too few lines.

        ln |G| = g + (slope / 20 dB) ln f + c f^2,   arg G = phase + d f

    c is the gain due to modes and poles, d their lag and the delay. The first mode is the first
    peak, or without a peak the frequency at which the gain has fallen by 3 dB.
    """
    peaks = apparent_modes(frequency_Hz, replace(path, response_m_per_V=response))
    gain = np.abs(response)
    fallen = np.flatnonzero((gain < np.median(gain[:3]) / np.sqrt(2.0)) & path.is_coherent)
    first_Hz = float(frequency_Hz[fallen[0] if len(fallen) else -1])
    first_Hz = peaks[0].frequency_Hz if peaks else first_Hz
    low = path.is_coherent & (frequency_Hz < FAR_BELOW * first_Hz)
    f = frequency_Hz[low]
    if len(f) < SLOW_LINES or f[-1] < 10.0**SLOW_DECADES * f[0]:
        return None
    x, relative, constant = f / f[-1], response[low] / response[low][0], np.ones(len(f))
    by_log = np.stack([np.log(x), constant, x**2], axis=1)
    slope = _regression(by_log, np.log(np.abs(relative)))
    angle = np.unwrap(np.angle(response[low]))
    phase = _regression(np.stack([constant, x], axis=1), angle)
    phase[0] -= np.pi * np.round(phase[0] / np.pi)  # the polarity determines the sign
    band_Hz = (float(f[0]), float(f[-1]))
    part = SlowPart.of(20.0 * slope, np.degrees(phase), band_Hz, first_Hz)
    is_creep = part.slope_ci95[0] <= 0.0 and part.slope_dB > -MAX_SLOPE_dB
    is_lag = part.phase_ci95[0] <= 0.0 and part.phase_deg > -MAX_LAG_deg
    return replace(part, is_taken=is_creep and is_lag)


def _regression(columns: Array, values: Array) -> Array:
    """Return the first coefficient of a least-squares fit and its standard deviation, (2,)."""
    coefficients = np.linalg.lstsq(columns, values, rcond=None)[0]
    residual = values - columns @ coefficients
    spare = max(len(values) - columns.shape[1], 1)
    inverse = np.linalg.inv(columns.T @ columns)
    return np.array([coefficients[0], np.sqrt(inverse[0, 0] * (residual @ residual) / spare)])


def _variance(response: ComplexArray, residual: ComplexArray, coherence: Array | None) -> Array:
    """Return the variance of each line, (lines,) m2/V2, from differences of the residual.

    coherence  (lines,)  None: not measured
    """
    difference = 0.5 * np.abs(np.diff(residual)) ** 2
    power = np.abs(response) ** 2

    if coherence is not None:
        share = (1.0 - coherence) / coherence
        smooth = smooth_lines(share, COHERENCE_LINES)
        floor = MIN_SHARE * float(np.median(smooth))
        shapes = [power * np.maximum(smooth, floor if floor > 0.0 else 1.0)]
    else:
        level = float(np.median(power))
        shapes = [*(ratio * level + power for ratio in NOISE_RATIOS), np.full(len(power), level)]
    candidates = []
    for shape in shapes:
        between = 0.5 * (shape[1:] + shape[:-1])
        scale = max(float(np.mean(difference / between)), TINY)
        # Minus the mean log likelihood of the squared differences, with the scale eliminated.
        cost = float(np.mean(np.log(between))) + float(np.log(scale))
        candidates.append((cost, shape * scale))
    return np.asarray(min(candidates, key=lambda candidate: candidate[0])[1])
