"""Free decay after a step: frequency and damping of each ring, with intervals."""

from dataclasses import dataclass

import numpy as np

from piezoid.errors import ExcitationError, IdentificationError
from piezoid.numerics.arrays import Array, frozen
from piezoid.numerics.quantiles import NORMAL_95

ROUNDS = 50
SETTLED = 1e-9  # relative gain in the sum of squares at which the fit stops
UNKNOWN_FACTOR = 3.0  # a wider interval says that the mode is not in the record
STEP = 1e-6  # of the central differences in log frequency and log damping


@dataclass(frozen=True, kw_only=True, eq=False)
class Ring:
    """Decaying oscillations after an event, the largest first.

        y(t) = trend(t) + sum_m a_m e^(-zeta_m w_m t) cos(w_m sqrt(1 - zeta_m^2) t + phi_m)

    frequency_Hz           (modes,)     undamped, w / 2 pi
    frequency_interval_Hz  (modes, 2)   95 %
    damping                (modes,)     zeta
    damping_interval       (modes, 2)   95 %
    amplitude_m            (modes,)     a, at the first sample
    residual_rms_m         scalar       what the modes and the trend leave
    residual_correlation   scalar       of neighbouring residuals; near zero if nothing is left
    samples                how many were used
    """

    frequency_Hz: Array
    frequency_interval_Hz: Array
    damping: Array
    damping_interval: Array
    amplitude_m: Array
    residual_rms_m: float
    residual_correlation: float
    samples: int

    def __post_init__(self) -> None:
        for name in ("frequency_Hz", "damping", "amplitude_m"):
            object.__setattr__(self, name, frozen(getattr(self, name), name))
        for name in ("frequency_interval_Hz", "damping_interval"):
            object.__setattr__(self, name, frozen(getattr(self, name), name, ndim=2))


def find_step(voltage_V: Array) -> int:
    """Return the first sample after the largest jump of the drive.

    Raises ``ExcitationError`` unless that jump is ten times any step elsewhere.
    """
    steps = np.abs(np.diff(voltage_V))
    place = int(np.argmax(steps))
    others = np.delete(steps, place)
    if len(others) and not steps[place] > 10 * others.max():
        raise ExcitationError(
            f"the largest change of the drive between two samples is {steps[place]:.3g} V, "
            f"the next {others.max():.3g} V",
            needed="one step ten times larger than any other change",
            remedy="Record a step, or name the sample where the ring starts.",
        )
    return place + 1


def identify_ring(
    displacement_m: Array,
    sampling_rate_Hz: float,
    *,
    start: int,
    samples: int,
    modes: int,
    trend_degree: int = 2,
) -> Ring:
    """Fit decaying oscillations and a smooth trend to what follows a step.

    displacement_m    (samples,)  the whole record
    start             first sample of the free decay: after the drive and its lags have settled
    samples           how many to use; some time constants of the slowest ring
    modes             how many oscillations
    trend_degree      of the polynomial that follows creep and a slowly moving drive

    Starts from the signal subspace of the record's Hankel matrix [Kung, Arun & Rao 1983], ends
    with nonlinear least squares. Intervals allow for correlated residuals (Newey & West 1987).
    """
    y = np.asarray(displacement_m[start : start + samples], dtype=np.float64)
    if len(y) < 8 * modes + 4 * (trend_degree + 1):
        raise ExcitationError(
            f"{len(y)} samples after the step",
            needed=f"at least {8 * modes + 4 * (trend_degree + 1)} for {modes} modes",
            remedy="Record longer after the step, or ask for fewer modes.",
        )
    time_s = np.arange(len(y)) / sampling_rate_Hz
    across = np.linspace(-1, 1, len(y))
    trend = np.polynomial.legendre.legvander(across, trend_degree).astype(np.float64)
    shape = _subspace_start(y, trend, sampling_rate_Hz, modes)
    shape = _least_squares(y, time_s, trend, shape)
    return _ring(y, time_s, trend, shape)


def choose_ring(
    displacement_m: Array,
    sampling_rate_Hz: float,
    *,
    start: int,
    samples: int,
    most_modes: int = 4,
) -> Ring:
    """Return the ring with as many modes as the record bears.

    The Bayesian criterion N ln(residual variance) + 5 modes ln N, each mode having a frequency, a
    damping, two amplitudes and its own choice; numbers of modes the record cannot determine do
    not take part. Raises the refusal for one mode if there is none.
    """
    found: list[tuple[float, Ring]] = []
    for modes in range(1, most_modes + 1):
        try:
            ring = identify_ring(
                displacement_m, sampling_rate_Hz, start=start, samples=samples, modes=modes
            )
        except (IdentificationError, ExcitationError):
            if modes == 1:
                raise
            break
        fitted = ring.samples * 2 * np.log(ring.residual_rms_m)
        found.append((float(fitted + 5 * modes * np.log(ring.samples)), ring))
    return min(found, key=lambda pair: pair[0])[1]


def _subspace_start(y: Array, trend: Array, rate_Hz: float, modes: int) -> Array:
    """Poles from the shift invariance of the Hankel matrix's leading singular vectors."""
    flat = y - trend @ np.linalg.lstsq(trend, y, rcond=None)[0]
    rows = len(y) // 2
    hankel = np.lib.stride_tricks.sliding_window_view(flat, rows).T
    left = np.linalg.svd(hankel, full_matrices=False)[0][:, : 2 * modes + 2]
    poles = np.linalg.eigvals(np.linalg.lstsq(left[:-1], left[1:], rcond=None)[0])
    upper = np.log(poles[poles.imag > 1e-6]) * rate_Hz
    if len(upper) < modes:
        raise IdentificationError(
            f"the record shows {len(upper)} oscillations, {modes} were asked for",
            needed="as many rings as modes",
            remedy="Ask for fewer modes, or start closer to the step.",
        )
    w = np.abs(upper)
    damping = np.clip(-upper.real / w, 1e-4, 0.9)
    strength = _amplitudes(flat, np.arange(len(y)) / rate_Hz, trend, np.log([w, damping]))
    kept = np.argsort(-strength)[:modes]
    return np.asarray(np.log(np.concatenate([w[kept], damping[kept]])), dtype=np.float64)


def _columns(time_s: Array, trend: Array, shape: Array) -> Array:
    """Trend, then sine and cosine of each ring."""
    w, damping = np.exp(np.reshape(shape, (2, -1)))
    decay = np.exp(-np.outer(time_s, damping * w))
    turn = np.outer(time_s, w * np.sqrt(np.maximum(1 - damping**2, 1e-12)))
    return np.concatenate([trend, decay * np.cos(turn), decay * np.sin(turn)], axis=1)


def _amplitudes(y: Array, time_s: Array, trend: Array, shape: Array) -> Array:
    gains = np.linalg.lstsq(_columns(time_s, trend, shape), y, rcond=None)[0]
    cosine, sine = gains[trend.shape[1] :].reshape(2, -1)
    return np.asarray(np.hypot(cosine, sine), dtype=np.float64)


def _projected(y: Array, time_s: Array, trend: Array, shape: Array) -> tuple[Array, Array]:
    """Residual and its tangents after the best trend and amplitudes (variable projection)."""
    columns = _columns(time_s, trend, shape)
    Q, R = np.linalg.qr(columns)
    gains = np.linalg.solve(R, Q.T @ y)
    tangent = np.empty((len(y), len(shape)))
    for p in range(len(shape)):
        step = np.zeros(len(shape))
        step[p] = STEP
        change = _columns(time_s, trend, shape + step) - _columns(time_s, trend, shape - step)
        tangent[:, p] = change @ gains / (2 * STEP)
    return y - Q @ (Q.T @ y), tangent - Q @ (Q.T @ tangent)


def _least_squares(y: Array, time_s: Array, trend: Array, shape: Array) -> Array:
    shape = np.asarray(shape, dtype=np.float64)
    residual, tangent = _projected(y, time_s, trend, shape)
    damping = 1e-3
    for _ in range(ROUNDS):
        curvature = tangent.T @ tangent
        damped = curvature + damping * np.diag(np.diag(curvature))
        moved = shape + np.clip(np.linalg.solve(damped, tangent.T @ residual), -0.3, 0.3)
        new_residual, new_tangent = _projected(y, time_s, trend, moved)
        gained = residual @ residual - new_residual @ new_residual
        if gained > 0:
            shape, residual, tangent = moved, new_residual, new_tangent
            damping = max(damping / 10, 1e-12)
        else:
            damping *= 10
        if 0 <= gained <= SETTLED * float(residual @ residual) or damping > 1e8:
            break
    return shape


def _ring(y: Array, time_s: Array, trend: Array, shape: Array) -> Ring:
    residual, tangent = _projected(y, time_s, trend, shape)
    spread = NORMAL_95 * np.sqrt(np.diag(_covariance(residual, tangent, trend.shape[1])))
    _check_known(spread, modes=len(shape) // 2)
    amplitude_m = _amplitudes(y, time_s, trend, shape)
    order = np.argsort(-amplitude_m)
    w, zeta = np.exp(shape.reshape(2, -1))[:, order]
    factor_w, factor_zeta = np.exp(spread.reshape(2, -1))[:, order]
    frequency_Hz = w / (2 * np.pi)
    return Ring(
        frequency_Hz=frequency_Hz,
        frequency_interval_Hz=np.stack([frequency_Hz / factor_w, frequency_Hz * factor_w], 1),
        damping=zeta,
        damping_interval=np.stack([zeta / factor_zeta, zeta * factor_zeta], 1),
        amplitude_m=amplitude_m[order],
        residual_rms_m=float(np.sqrt(np.mean(residual**2))),
        residual_correlation=float(residual[1:] @ residual[:-1] / (residual @ residual)),
        samples=len(y),
    )


def _check_known(spread: Array, modes: int) -> None:
    worst = float(np.exp(min(float(spread.max()), 99.0)))
    if not worst < UNKNOWN_FACTOR:
        raise IdentificationError(
            f"with {modes} modes, one of them is known to a factor {worst:.2g} only",
            needed=f"each frequency and damping known to a factor of {UNKNOWN_FACTOR:g}",
            remedy="Ask for fewer modes, or start closer to the step.",
        )


def _covariance(residual: Array, tangent: Array, trend_columns: int) -> Array:
    """The wider of the plain covariance and the one for correlated residuals."""
    unknowns = trend_columns + 2 * tangent.shape[1]
    freedom = max(len(residual) - unknowns, 1)
    inverse = np.linalg.inv(tangent.T @ tangent)
    plain = inverse * float(residual @ residual) / freedom
    scores = tangent * residual[:, None]
    meat = scores.T @ scores
    reach = round(4 * (len(residual) / 100) ** (2 / 9)) + 2
    for lag in range(1, reach + 1):
        moved = scores[lag:].T @ scores[:-lag]
        meat += (1 - lag / (reach + 1)) * (moved + moved.T)
    robust = inverse @ meat @ inverse * len(residual) / freedom
    wider = np.sqrt(np.maximum(np.diag(robust) / np.diag(plain), 1.0))
    return np.asarray(plain * np.outer(wider, wider))
