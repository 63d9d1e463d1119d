"""Certify a loop around hysteresis: stability by small gain, and a bound of the error."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np
from numpy.typing import ArrayLike

from piezoid.design.feedforward import ReferencePath
from piezoid.design.hysteresis_bounds import HysteresisBounds
from piezoid.design.plant import Fraction
from piezoid.design.sensitivity import closed_loop_polynomial, sensitivities
from piezoid.errors import UnstableLoopError
from piezoid.formatting import with_unit
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.numerics.polynomial import delayed, grid_Hz, product, response, spectral_radius, total
from piezoid.operators.linear import recursive_filter
from piezoid.record_json import Unbounded

_TAIL = 1e-12  # relative to the first sample, where an impulse response is truncated
_MIN_SAMPLES, _MAX_SAMPLES = 500.0, 400_000
_SIGMAS = 3.0
_MAX_USEFUL_SHARE = 0.1  # of the displacement range: a larger bound excludes nothing in practice


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


def certify(
    members: Sequence[Fraction],
    R: ArrayLike,
    S: ArrayLike,
    T: ArrayLike,
    *,
    path: ReferencePath,
    bounds: HysteresisBounds,
    reference_slew_m_per_s: float,
    voltage_step_V: float,
    sensor_noise_rms_m: float,
    disturbances: Disturbances | None = None,
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
    reference_slew_m_per_s  of the fastest reference
    voltage_step_V          of the converter
    sensor_noise_rms_m      of one sample, white
    disturbances            from the recordings; by default none
    """
    eps = bounds.increment_gain
    grid = grid_Hz(members[0].sampling_rate_Hz, lowest_Hz=1e-2, count=4000)
    peak = max(float(np.abs(sensitivities(m, R, S, grid).Syb).max()) for m in members)
    for member in members:
        radius = spectral_radius(closed_loop_polynomial(member, R, S))
        if not radius < 1.0:
            raise UnstableLoopError(
                f"the loop of the member '{member.label}' has a pole of magnitude {radius:.6g}",
                needed="every member stable: an unstable loop has no bounded error",
                remedy="Lower the bandwidth, or describe the family more narrowly.",
                member=member.label,
            )
    controller, slew_m_per_s = (R, S, product(T, path.filter)), reference_slew_m_per_s
    disturbances = disturbances or Disturbances()
    by_member = [
        _member_bounds(
            member, controller, path.preview_samples, bounds, voltage_step_V, disturbances
        )
        for member in members
    ]
    worst, converter_m, _ = max(by_member, key=lambda row: row[0].at(slew_m_per_s))
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
        noise_error_m=max(_SIGMAS * gain * sensor_noise_rms_m for *_, gain in by_member),
        disturbance_error_m=worst.steady_m - converter_m,
        reference_slew_m_per_s=slew_m_per_s,
        worst_member=worst.label,
        conditions=(
            *bounds.conditions,
            *(as_recorded if disturbances != Disturbances() else ()),
            f"the linear plant is one of the {len(members)} members",
            f"the reference moves at most {with_unit(slew_m_per_s, 'm/s')}",
            "the command stays inside the converter's limits",
            "sensor noise comes on top and is stated separately",
        ),
        speed_bounds=tuple(bound for bound, *_ in by_member),
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


def _member_bounds(
    member: Fraction,
    controller: tuple[ArrayLike, ArrayLike, ArrayLike],
    preview: int,
    bounds: HysteresisBounds,
    voltage_step_V: float,
    disturbances: Disturbances,
) -> tuple[SpeedBound, float, float]:
    """Bound the errors of one member, and return its converter error and noise gain as well.

        motion m   min(||A S / P||_1 sup|m|, ||A S / (P (1 - q^-1))||_1 sup|D m|)
        reading n  ||B R / P||_1 sup|n|, or |B R / P| sup|n| at a single frequency

    controller  R, S, and T times the reference filter
    returned    bounds; largest error due to half a step of the converter, m; and the standard
                deviation due to white sensor noise of 1 m
    """
    R, S, filtered_t = controller
    P = closed_loop_polynomial(member, R, S)
    A, B, rate_Hz = member.A, member.B_position, member.sampling_rate_Hz

    def gain(*factors: ArrayLike) -> float:
        return peak_gain(product(*factors), P)

    command_gain = gain(B, S)
    converter_m = command_gain * (0.5 * voltage_step_V)
    # The bound by increments for 1 m/s is infinite if the loop may amplify them.
    eps, increments_s = bounds.increment_gain, float(np.inf)
    feedback_gain = eps * gain(member.B, R)
    if feedback_gain < 1.0:
        command_step_V = gain(filtered_t, A) * (1.0 / rate_Hz) / (1.0 - feedback_gain)
        increments_s = gain(B, divide_by_difference(S)) * eps * command_step_V
    disturbance_m = 0.0
    for half_range_m, fastest_m_per_s in disturbances.motions:
        bound_m = gain(A, S) * half_range_m
        if fastest_m_per_s > 0.0:
            step_m = fastest_m_per_s / rate_Hz
            bound_m = min(bound_m, gain(A, divide_by_difference(S)) * step_m)
        disturbance_m += bound_m
    numerator = product(B, R)
    for frequency_Hz, error_m in disturbances.readings:
        if frequency_Hz > 0.0:
            line = response(numerator, P, [frequency_Hz], rate_Hz)
            disturbance_m += float(np.abs(line[0])) * error_m
        else:
            disturbance_m += gain(numerator) * error_m
    mismatch = total(delayed(P, preview), -product(filtered_t, B))
    speed_bound = SpeedBound(
        label=member.label,
        steady_m=converter_m + disturbance_m,
        hysteresis_m=command_gain * bounds.error_m / bounds.gain_m_per_V,
        hysteresis_s=increments_s,
        reference_s=gain(divide_by_difference(mismatch)) / rate_Hz,
    )
    noise_gain = float(np.sqrt((impulse_response(numerator, P) ** 2).sum()))
    return speed_bound, converter_m, noise_gain


def useful_bound_m(certificate: Certificate | None, axis: AxisModel) -> float | None:
    """Return the guaranteed error of a loop, or None without a useful bound.

    A bound above a tenth of the displacement range is of no use.
    """
    if certificate is None or not certificate.is_guaranteed:
        return None
    error_m = certificate.guaranteed_error_m
    limit_m = _MAX_USEFUL_SHARE * axis.quality.range_m
    return error_m if isfinite(error_m) and error_m <= limit_m else None


def guaranteed_error_m(
    certificate: Certificate | None, axis: AxisModel, *, is_verified: bool = True
) -> float | str:
    """Return the guaranteed error of a loop, or state why there is no useful one.

    is_verified  whether the controller passed its verification
    """
    if certificate is None or not certificate.is_guaranteed:
        return "none"
    if not is_verified:
        return "not verified"
    bound_m = useful_bound_m(certificate, axis)
    return "no useful bound" if bound_m is None else bound_m


def error_parts_m(certificate: Certificate) -> dict[str, float]:
    """Return the contributions to a guaranteed error by name, m; their sum is that error.

    In the inverse form, the error of the hysteresis model takes the place of the hysteresis.
    """
    is_inverted = certificate.form == "inverse"
    return {
        "the uncertainty of the hysteresis model" if is_inverted else "the hysteresis": (
            certificate.hysteresis_error_m
        ),
        "the delay of the reference": certificate.reference_error_m,
        "the converter": certificate.converter_error_m,
        "drift, coupling and hum": certificate.disturbance_error_m,
    }
