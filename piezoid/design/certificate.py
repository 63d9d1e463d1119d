"""Certify a loop around hysteresis: small gain, and a bound of the error."""

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
from piezoid.numerics.frequency import grid_Hz, response
from piezoid.numerics.polynomial import delayed, product, spectral_radius, total
from piezoid.operators.linear import recursive_filter
from piezoid.record_json import Unbounded

_TAIL = 1e-12
_LONGEST = 400_000
_SIGMAS = 3.0


@dataclass(frozen=True, kw_only=True)
class SpeedBound:
    """Error bound of one member at any speed V of the reference.

        |e| <= steady + min(hysteresis, tau_h V) + tau_r V

    steady_m        what converter and disturbances do to a reference at rest
    hysteresis_m    ||g||_1 sup|delta|, however fast
    hysteresis_s    tau_h; infinite where the loop may amplify increments
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
        """Return the bound, m."""
        following_m = self.reference_s * slew_m_per_s
        return self.steady_m + self.hysteresis_at(slew_m_per_s) + following_m


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """A guarantee about one loop, over its whole plant family.

    form                        ``affine`` or ``inverse``
    increment_gain              eps: |D delta| <= eps |D v|
    loop_peak                   max over members and w of |T_v|, from delta to the command
    small_gain                  eps times that; below 1 hysteresis cannot destabilise the loop:
                                increments of all signals are l2-stable
    is_guaranteed               small_gain < 1 (every member is stable, or there is no certificate)
    hysteresis_error_m          min(||g||_1 sup|delta|, ||g/(1 - q^-1)||_1 eps sup|D v|)
    reference_error_m           ||(q^-p - H)/(1 - q^-1)||_1 sup|D r|
    converter_error_m           ||g||_1 half a converter step
    disturbance_error_m         what drift, coupling, hum and a sensor's cyclic error add: each
                                its largest value through the loop, in the l1 norm
    guaranteed_error_m          the sum of the four: |r[k-p] - y[k]| never exceeds it, y the
                                position in front of the sensor
    reference_slew_m_per_s      the fastest reference for which that holds
    noise_error_m               three standard deviations due to sensor noise; not in the sum
    worst_member                the member that decides the sum
    conditions                  what must be true, whole sentences
    speed_bounds                of every member, for slower references; empty in files of versions
                                that did not keep them
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

        It is no more than ``guaranteed_error_m``, and infinite beyond ``reference_slew_m_per_s``:
        nothing is guaranteed of what is faster.
        """
        if slew_m_per_s > self.reference_slew_m_per_s:
            return float(np.inf)
        bound_m = max((bound.at(slew_m_per_s) for bound in self.speed_bounds), default=np.inf)
        return min(bound_m, self.guaranteed_error_m)


@dataclass(frozen=True, kw_only=True)
class Disturbances:
    """Recorded disturbances other than drive and noise; by default none.

    motions   (half range in m, fastest change in m/s) of what moves the stage beside its drive;
              0 m/s: as fast as anything
    readings  (frequency in Hz, largest error in m) of what the sensor shows beside the position;
              0 Hz: at any frequency
    """

    motions: tuple[tuple[float, float], ...] = ()
    readings: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, kw_only=True)
class Operation:
    """How the loop will be used.

    reference_slew_m_per_s  the fastest reference
    voltage_step_V          of the converter
    sensor_noise_rms_m      of one sample, white
    disturbances            what acts beside drive and reference
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
    T        without the reference filter, which stands in ``path``
    """
    eps = bounds.increment_gain
    grid = grid_Hz(members[0].sampling_rate_Hz, lowest_Hz=1e-2, count=4000)
    peak = max(float(np.abs(sensitivities(m, R, S, grid).Syb).max()) for m in members)
    for member in members:
        reached = margins(member, R, S)
        if not reached.is_stable:
            raise UnstableLoopError(
                f"the loop of the member '{reached.label}' has a pole of magnitude "
                f"{reached.spectral_radius:.6g}",
                needed="every member stable: an unstable loop has no bounded error",
                remedy="Lower the bandwidth, or describe the family more narrowly.",
                member=reached.label,
            )
    filtered, slew_m_per_s = product(T, path.filter), operation.reference_slew_m_per_s
    loops = [_ClosedLoop(member, R, S) for member in members]
    speeds = [
        loop.speed_bound(filtered, path.preview_samples, bounds, operation) for loop in loops
    ]
    worst, loop = max(zip(speeds, loops, strict=True), key=lambda pair: pair[0].at(slew_m_per_s))
    converter_m = loop.converter_m(operation)
    disturbed = operation.disturbances.motions or operation.disturbances.readings
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
            *(as_recorded if disturbed else ()),
            f"the linear plant is one of the {len(members)} members",
            f"the reference moves at most {with_unit(slew_m_per_s, 'm/s')}",
            "the command stays inside the converter's limits",
            "sensor noise comes on top, as its own line",
        ),
        speed_bounds=tuple(speeds),
    )


def impulse_response(numerator: ArrayLike, denominator: ArrayLike) -> Array:
    """Return the impulse response of a stable fraction until it has died out.

    returned  (samples,); the length follows from the largest root, 1e-12 of it remains
    """
    radius = spectral_radius(np.asarray(denominator))
    samples = np.log(_TAIL) / np.log(radius) if 0.0 < radius < 1.0 else 0.0
    count = int(min(max(2.0 * samples, 500.0), _LONGEST))
    impulse = np.zeros(count)
    impulse[0] = 1.0
    return recursive_filter(numerator, denominator, impulse)


def peak_gain(numerator: ArrayLike, denominator: ArrayLike) -> float:
    """Return the l1 norm of the impulse response: the largest output for inputs within +-1."""
    return float(np.abs(impulse_response(numerator, denominator)).sum())


def without_difference(polynomial: ArrayLike) -> Array:
    """Return the polynomial divided by 1 - q^-1; its sum must be zero up to rounding."""
    coefficients = np.asarray(polynomial, dtype=np.float64)
    return np.cumsum(coefficients)[:-1]


class _ClosedLoop:
    """The loop of one member: what its impulse responses make of everything that acts on it."""

    def __init__(self, member: Fraction, R: ArrayLike, S: ArrayLike) -> None:
        self.member, self.R, self.S = member, R, S
        self.P = closed_loop_polynomial(member, R, S)
        self.step_s = 1.0 / member.sampling_rate_Hz

    def gain(self, *factors: ArrayLike) -> float:
        """Return the l1 norm of the response with this numerator over P."""
        return peak_gain(product(*factors), self.P)

    def speed_bound(
        self, filtered: Array, preview: int, bounds: HysteresisBounds, operation: Operation
    ) -> SpeedBound:
        """Return the error bound; ``filtered`` is T with its reference filter."""
        member = self.member
        mismatch = total(delayed(self.P, preview), -product(filtered, member.B_position))
        by_size = self.gain(member.B_position, self.S)
        return SpeedBound(
            label=member.label,
            steady_m=self.converter_m(operation) + self.disturbed_m(operation.disturbances),
            hysteresis_m=by_size * bounds.error_m / bounds.gain_m_per_V,
            hysteresis_s=self.by_increments_s(filtered, bounds.increment_gain),
            reference_s=self.gain(without_difference(mismatch)) / member.sampling_rate_Hz,
        )

    def by_increments_s(self, filtered: Array, eps: float) -> float:
        """Return the bound by increments for 1 m/s; infinite where the loop may amplify them."""
        member = self.member
        amplified = eps * self.gain(member.B, self.R)
        if amplified >= 1.0:
            return float(np.inf)
        command_step_V = self.gain(filtered, member.A) * self.step_s / (1.0 - amplified)
        return self.gain(member.B_position, without_difference(self.S)) * eps * command_step_V

    def converter_m(self, operation: Operation) -> float:
        """Return the largest error by half a step of the converter."""
        return self.gain(self.member.B_position, self.S) * (0.5 * operation.voltage_step_V)

    def noise_m(self, operation: Operation) -> float:
        """Return three standard deviations due to white sensor noise."""
        passed = impulse_response(product(self.member.B_position, self.R), self.P)
        return _SIGMAS * float(np.sqrt((passed**2).sum())) * operation.sensor_noise_rms_m

    def disturbed_m(self, disturbances: Disturbances) -> float:
        """Return the largest error by recorded disturbances.

        ||A S / P||_1 m, or ||A S / (P (1 - q^-1))||_1 times its change in a sample where that is
        less; ||B R / P||_1 n of the reading, or |B R / P| n at a frequency of its own.
        """
        member, total_m = self.member, 0.0
        for half_range_m, fastest_m_per_s in disturbances.motions:
            bound_m = self.gain(member.A, self.S) * half_range_m
            if fastest_m_per_s > 0.0:
                step_m = fastest_m_per_s / member.sampling_rate_Hz
                bound_m = min(bound_m, self.gain(member.A, without_difference(self.S)) * step_m)
            total_m += bound_m
        followed = product(member.B_position, self.R)
        for frequency_Hz, error_m in disturbances.readings:
            if frequency_Hz > 0.0:
                at_line = response(followed, self.P, [frequency_Hz], member.sampling_rate_Hz)
                total_m += float(np.abs(at_line[0])) * error_m
            else:
                total_m += self.gain(followed) * error_m
        return total_m
