"""Certify a loop around hysteresis: stability by small gain, and a bound of the error."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from piezoid.design.feedforward import ReferencePath
from piezoid.design.hysteresis_bounds import HysteresisBounds
from piezoid.design.plant import Fraction
from piezoid.design.sensitivity import closed_loop_polynomial, margins, sensitivities
from piezoid.errors import UnstableLoopError
from piezoid.formatting import with_unit
from piezoid.numerics.arrays import Array
from piezoid.numerics.polynomial import delayed, grid_Hz, product, response, spectral_radius, total
from piezoid.operators.linear import recursive_filter
from piezoid.record_json import Unbounded

_TAIL = 1e-12  # relative to the first sample, where an impulse response is truncated
_MIN_SAMPLES, _MAX_SAMPLES = 500.0, 400_000
_SIGMAS = 3.0


@dataclass(frozen=True, kw_only=True)
class SpeedBound:
    """Error bound of one member as a function of the speed V of the reference.

        |e| <= steady + min(hysteresis, tau_h V) + tau_r V

    steady_m        bound of the errors by converter and disturbances, at any speed
    hysteresis_m    ||g||_1 sup|delta|, at any speed
    hysteresis_s    tau_h; infinite if the loop may amplify increments
    reference_s     tau_r
    """

    label: str
    steady_m: float
    hysteresis_m: float
    hysteresis_s: Unbounded
    reference_s: float

    def hysteresis_at(self, slew_m_per_s: float) -> float:
        """Return the bound of the hysteresis contribution, m."""
        return min(self.hysteresis_m, self.hysteresis_s * slew_m_per_s)

    def at(self, slew_m_per_s: float) -> float:
        """Return the bound of the error, m."""
        reference_m = self.reference_s * slew_m_per_s
        return self.steady_m + self.hysteresis_at(slew_m_per_s) + reference_m


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """Guaranteed stability and error of one loop, over its whole plant family.

    form                        ``affine`` or ``inverse``
    increment_gain              eps: |D delta| <= eps |D v|
    loop_peak                   max over members and w of |T_v|, from delta to the command
    small_gain                  eps loop_peak; below 1 hysteresis cannot destabilise the loop:
                                increments of all signals are l2-stable
    is_guaranteed               small_gain < 1 (every member is stable, or there is no certificate)
    hysteresis_error_m          min(||g||_1 sup|delta|, ||g/(1 - q^-1)||_1 eps sup|D v|)
    reference_error_m           ||(q^-p - H)/(1 - q^-1)||_1 sup|D r|
    converter_error_m           ||g||_1 half a converter step
    disturbance_error_m         errors by drift, coupling, hum and a sensor's cyclic error: each
                                its largest value through the loop, in the l1 norm
    guaranteed_error_m          the sum of the four: |r[k-p] - y[k]| never exceeds it, y the
                                position in front of the sensor
    reference_slew_m_per_s      the fastest reference for which the bound holds
    noise_error_m               three standard deviations due to sensor noise; not in the sum
    worst_member                the member with the largest sum
    conditions                  conditions of the guarantee, whole sentences
    speed_bounds                of every member, for slower references; empty in files of earlier
                                versions
    """

    form: str
    increment_gain: float
    loop_peak: float
    small_gain: float
    is_guaranteed: bool
    hysteresis_error_m: float
    reference_error_m: float
    converter_error_m: float
    guaranteed_error_m: float
    noise_error_m: float
    disturbance_error_m: float = 0.0
    reference_slew_m_per_s: float = 0.0
    worst_member: str
    conditions: tuple[str, ...]
    speed_bounds: tuple[SpeedBound, ...] = ()

    def guaranteed_at(self, slew_m_per_s: float) -> float:
        """Return the guaranteed error for references up to a speed, m.

        At most ``guaranteed_error_m``; infinite for references faster than
        ``reference_slew_m_per_s``, for which there is no guarantee.
        """
        if slew_m_per_s > self.reference_slew_m_per_s:
            return float(np.inf)
        bound_m = max((bound.at(slew_m_per_s) for bound in self.speed_bounds), default=np.inf)
        return min(bound_m, self.guaranteed_error_m)


@dataclass(frozen=True, kw_only=True)
class Disturbances:
    """Recorded disturbances other than sensor noise; by default none.

    motions   (half range in m, fastest change in m/s) of each motion that the drive does not
              cause; 0 m/s: of any speed
    readings  (frequency in Hz, largest error in m) of each error of the reading; 0 Hz: at any
              frequency
    """

    motions: tuple[tuple[float, float], ...] = ()
    readings: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, kw_only=True)
class Operation:
    """Signals that act on the loop in use.

    reference_slew_m_per_s  of the fastest reference
    voltage_step_V          of the converter
    sensor_noise_rms_m      of one sample, white
    disturbances            from the recordings
    """

    reference_slew_m_per_s: float
    voltage_step_V: float
    sensor_noise_rms_m: float
    disturbances: Disturbances = field(default_factory=lambda: Disturbances())


def certify(
    members: Sequence[Fraction],
    R: ArrayLike,
    S: ArrayLike,
    T: ArrayLike,
    *,
    path: ReferencePath,
    bounds: HysteresisBounds,
    operation: Operation,
) -> Certificate:
    """Prove error bounds of a loop around hysteresis.

        small gain   eps max|T_v| < 1,   T_v = -B R / P
        command      sup|D v| <= ||T F A / P||_1 sup|D r| / (1 - eps ||T_v||_1)
        error        |e| <= min(||g||_1 sup|delta|, ||g/(1 - q^-1)||_1 eps sup|D v|) + ...

    g is the impulse response from delta to the output, B S / P; the integrator in S gives it a
    zero at z = 1, so the second norm is finite. LTI operators commute with differencing, hence
    small gain in increments.                 [Desoer & Vidyasagar 1975, for small gain]

    members  each is the plant for a command in volts, gain a; their errors are bounded one by one
    T        without the reference filter of ``path``
    """
    eps = bounds.increment_gain
    grid = grid_Hz(members[0].sampling_rate_Hz, lowest_Hz=1e-2, count=4000)
    peak = max(float(np.abs(sensitivities(m, R, S, grid).Syb).max()) for m in members)
    for member in members:
        radius = margins(member, R, S).spectral_radius
        if not radius < 1.0:
            raise UnstableLoopError(
                f"the loop of the member '{member.label}' has a pole of magnitude {radius:.6g}",
                needed="every member stable: an unstable loop has no bounded error",
                remedy="Lower the bandwidth, or describe the family more narrowly.",
                member=member.label,
            )
    filtered_t, slew_m_per_s = product(T, path.filter), operation.reference_slew_m_per_s
    loops = [_ClosedLoop(member, R, S) for member in members]
    speed_bounds = [
        loop.speed_bound(filtered_t, path.preview_samples, bounds, operation) for loop in loops
    ]
    worst, loop = max(
        zip(speed_bounds, loops, strict=True), key=lambda pair: pair[0].at(slew_m_per_s)
    )
    converter_m = loop.converter_m(operation)
    has_disturbances = operation.disturbances.motions or operation.disturbances.readings
    as_recorded = ("drift, coupling and hum stay as large and as fast as in the recordings",)
    return Certificate(
        form=bounds.form,
        increment_gain=eps,
        loop_peak=peak,
        small_gain=eps * peak,
        is_guaranteed=eps * peak < 1.0,
        hysteresis_error_m=worst.hysteresis_at(slew_m_per_s),
        reference_error_m=worst.reference_s * slew_m_per_s,
        converter_error_m=converter_m,
        guaranteed_error_m=worst.at(slew_m_per_s),
        noise_error_m=max(loop.noise_m(operation) for loop in loops),
        disturbance_error_m=worst.steady_m - converter_m,
        reference_slew_m_per_s=slew_m_per_s,
        worst_member=worst.label,
        conditions=(
            *bounds.conditions,
            *(as_recorded if has_disturbances else ()),
            f"the linear plant is one of the {len(members)} members",
            f"the reference moves at most {with_unit(slew_m_per_s, 'm/s')}",
            "the command stays inside the converter's limits",
            "sensor noise comes on top, as its own line",
        ),
        speed_bounds=tuple(speed_bounds),
    )


def impulse_response(numerator: ArrayLike, denominator: ArrayLike) -> Array:
    """Return the impulse response of a stable fraction until it has decayed, (samples,).

    Its length is twice the time in which the slowest pole decays to 1e-12.
    """
    radius = spectral_radius(np.asarray(denominator))
    samples = np.log(_TAIL) / np.log(radius) if 0.0 < radius < 1.0 else 0.0
    count = int(min(max(2.0 * samples, _MIN_SAMPLES), _MAX_SAMPLES))
    impulse = np.zeros(count)
    impulse[0] = 1.0
    return recursive_filter(numerator, denominator, impulse)


def peak_gain(numerator: ArrayLike, denominator: ArrayLike) -> float:
    """Return the l1 norm of the impulse response: the largest output for inputs within +-1."""
    return float(np.abs(impulse_response(numerator, denominator)).sum())


def divide_by_difference(polynomial: ArrayLike) -> Array:
    """Return the polynomial divided by 1 - q^-1; its sum must be zero up to rounding."""
    coefficients = np.asarray(polynomial, dtype=np.float64)
    return np.cumsum(coefficients)[:-1]


class _ClosedLoop:
    """Error bounds of the loop of one member, from its impulse responses."""

    def __init__(self, member: Fraction, R: ArrayLike, S: ArrayLike) -> None:
        self.member, self.R, self.S = member, R, S
        self.P = closed_loop_polynomial(member, R, S)

    def gain(self, *factors: ArrayLike) -> float:
        """Return the l1 norm of the response with the product of the factors over P."""
        return peak_gain(product(*factors), self.P)

    def speed_bound(
        self, filtered_t: Array, preview: int, bounds: HysteresisBounds, operation: Operation
    ) -> SpeedBound:
        """Return the error bound; ``filtered_t`` is T times the reference filter."""
        member = self.member
        mismatch = total(delayed(self.P, preview), -product(filtered_t, member.B_position))
        disturbance_gain = self.gain(member.B_position, self.S)
        return SpeedBound(
            label=member.label,
            steady_m=self.converter_m(operation) + self.disturbance_m(operation.disturbances),
            hysteresis_m=disturbance_gain * bounds.error_m / bounds.gain_m_per_V,
            hysteresis_s=self.increment_bound_s(filtered_t, bounds.increment_gain),
            reference_s=self.gain(divide_by_difference(mismatch)) / member.sampling_rate_Hz,
        )

    def increment_bound_s(self, filtered_t: Array, eps: float) -> float:
        """Return the bound by increments for 1 m/s; infinite if the loop may amplify them."""
        member = self.member
        feedback_gain = eps * self.gain(member.B, self.R)
        if feedback_gain >= 1.0:
            return float(np.inf)
        step_s = 1.0 / member.sampling_rate_Hz
        command_step_V = self.gain(filtered_t, member.A) * step_s / (1.0 - feedback_gain)
        return self.gain(member.B_position, divide_by_difference(self.S)) * eps * command_step_V

    def converter_m(self, operation: Operation) -> float:
        """Return the largest error due to half a step of the converter."""
        return self.gain(self.member.B_position, self.S) * (0.5 * operation.voltage_step_V)

    def noise_m(self, operation: Operation) -> float:
        """Return three standard deviations due to white sensor noise."""
        noise_response = impulse_response(product(self.member.B_position, self.R), self.P)
        return _SIGMAS * float(np.sqrt((noise_response**2).sum())) * operation.sensor_noise_rms_m

    def disturbance_m(self, disturbances: Disturbances) -> float:
        """Return the largest error due to the recorded disturbances.

        motion m   min(||A S / P||_1 sup|m|, ||A S / (P (1 - q^-1))||_1 sup|D m|)
        reading n  ||B R / P||_1 sup|n|, or |B R / P| sup|n| at a single frequency
        """
        member, total_m = self.member, 0.0
        for half_range_m, fastest_m_per_s in disturbances.motions:
            bound_m = self.gain(member.A, self.S) * half_range_m
            if fastest_m_per_s > 0.0:
                step_m = fastest_m_per_s / member.sampling_rate_Hz
                bound_m = min(bound_m, self.gain(member.A, divide_by_difference(self.S)) * step_m)
            total_m += bound_m
        numerator = product(member.B_position, self.R)
        for frequency_Hz, error_m in disturbances.readings:
            if frequency_Hz > 0.0:
                line = response(numerator, self.P, [frequency_Hz], member.sampling_rate_Hz)
                total_m += float(np.abs(line[0])) * error_m
            else:
                total_m += self.gain(numerator) * error_m
        return total_m
