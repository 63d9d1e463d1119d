"""The Hammerstein model and its derivatives: memory before dynamics, one vector of parameters.

    y = G(s) Psi( sum_i w_i z_i[u] ),        G(0) = 1
    G(s) = e^(-s tau) [ sum_m g_m w_m^2/(s^2 + 2 zeta_m w_m s + w_m^2) + sum_l g_l w_l/(s + w_l) ]

parameters: w_i | weights of the dead zones but the central one | ln f_m | ln zeta_m | ln f_l | tau
            | g but the last, which makes the sum 1

Every derivative is a signal behind the same G, or the same signal behind a derivative of G.

Its rows: play states and displacement of every recording, with its spectrum.

    u -> declared amplifier -> envelope -> plays z_i -> Psi(sum w_i z_i) -> G -> y

The plays' states do not depend on what is fitted, so they are followed once. Everything behind
the operator is linear and is applied to spectra, each recording padded until its ring has died
away, so that none comes around. Signals are rows: their samples lie together in memory.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

from piezoid.identification.dynamics.frequency_response import ComplexArray
from piezoid.identification.dynamics.modal import LinearDynamics
from piezoid.identification.hysteresis.pieces import MINIMUM_SAMPLES, behind_pole
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import DeadZones
from piezoid.operators.modified_prandtl_ishlinskii import ModifiedPrandtlIshlinskii
from piezoid.operators.play import play_columns
from piezoid.records.recording import Recording

MOST_ROWS = 60_000  # of one piece: a second of a fast one says as much as ten
DIED = 10.0  # time constants after which a ring counts as gone


@dataclass(frozen=True, kw_only=True, eq=False)
class HammersteinRows:
    """One uninterrupted piece of one recording.

    recording      its name
    rate_Hz        > 0
    drive_V        (samples,)  behind hold and amplifier
    states_V       (plays, samples)  of the operator's plays
    measured_m     (samples,)  rising with the drive
    frequency_Hz   (lines,)  of the padded spectrum
    chain          (lines,)  the declared sensor
    padded         samples of the padded signal
    """

    recording: str
    rate_Hz: float
    drive_V: Array
    states_V: Array
    measured_m: Array
    frequency_Hz: Array
    chain: ComplexArray
    padded: int

    @property
    def samples(self) -> int:
        """Samples of the piece."""
        return len(self.measured_m)

    def of_plays(self, chosen: NDArray[np.bool_]) -> "HammersteinRows":
        """Return the same piece with some of the plays alone."""
        return replace(self, states_V=self.states_V[chosen])

    def spectrum(self, signals: Array) -> ComplexArray:
        """Return the padded spectra of signals about their first samples, (..., lines)."""
        return np.asarray(rfft(signals - signals[..., :1], self.padded))


def rows_of(
    axis: AxisModel,
    recordings: Sequence[Recording],
    *,
    threshold_V: Array,
    dynamics: LinearDynamics,
) -> tuple[HammersteinRows, ...]:
    """Return the rows of every piece whose memory the static fit found.

    axis         whose operator, memories and declared poles are taken
    threshold_V  (plays,)  of the plays to follow
    dynamics     how long a ring lasts, and the rate at which the drive's numbers were held; slower
                 recordings hold samples of a drive that is nearly straight between them
    """
    ring_s = DIED * _slowest_s(dynamics) + dynamics.delay_s
    controller_Hz = dynamics.sampling_rate_Hz
    found = []
    for recording in recordings:
        starts = [start for start in axis.starts if start.recording == recording.name]
        pieces = [p for p in recording.pieces if p.stop - p.start >= MINIMUM_SAMPLES]
        for part, start in zip(pieces, starts, strict=False):
            part = slice(part.start, min(part.stop, part.start + MOST_ROWS))
            drive_V = drive_at_operator(
                recording.voltage_V(axis.axis)[part],
                axis,
                recording.sampling_rate_Hz,
                controller_Hz,
            )
            found.append(
                _piece(axis, recording, part, drive_V, (start.memory_V, threshold_V), ring_s)
            )
    return tuple(found)


def _slowest_s(dynamics: LinearDynamics) -> float:
    """The longest time constant; the slow pole of an overdamped mode lies at w / (2 zeta)."""
    w, zeta = 2.0 * np.pi * dynamics.mode_frequency_Hz, dynamics.mode_damping
    modes = np.maximum(1.0 / (zeta * w), np.where(zeta > 1.0, 2.0 * zeta / w, 0.0))
    lags = 1.0 / (2.0 * np.pi * dynamics.lag_frequency_Hz)
    return float(max(*modes, *lags, 0.0, 0.0))


def drive_at_operator(
    voltage_V: Array, axis: AxisModel, rate_Hz: float, controller_Hz: float
) -> Array:
    """Return the drive behind hold and declared amplifier, (samples,), without its images.

    At the controller's rate the numbers are held for a tick: half a tick late, and the images of
    the staircase, which the stage does not follow, are left out. Slower recordings hold samples of
    a drive that is nearly straight between them.
    """
    pole_Hz = axis.rig.amplifier_bandwidth_Hz
    if rate_Hz < 0.99 * controller_Hz:
        return behind_pole(voltage_V, pole_Hz, rate_Hz)
    count = len(voltage_V)
    padded = next_fast_len(2 * count, real=True)
    back = 0.5 + 0.5 * np.cos(np.pi * np.arange(1, padded - count + 1) / (padded - count))
    level = voltage_V - voltage_V[0]
    frequency_Hz = np.asarray(rfftfreq(padded, 1.0 / rate_Hz))
    turn = frequency_Hz / rate_Hz
    chain = np.sinc(turn) * np.exp(-1j * np.pi * turn)
    if pole_Hz is not None:
        chain = chain / (1.0 + 1j * frequency_Hz / pole_Hz)
    spectrum = chain * rfft(np.concatenate([level, level[-1] * back]))
    return np.asarray(voltage_V[0] + irfft(spectrum, padded)[:count])


def sensor_chain(axis: AxisModel, frequency_Hz: Array) -> ComplexArray:
    """Return the declared sensor, (lines,)."""
    sensor_Hz = axis.rig.sensor_bandwidth_Hz
    chain = np.ones(len(frequency_Hz), dtype=np.complex128)
    return chain if sensor_Hz is None else chain / (1.0 + 1j * frequency_Hz / sensor_Hz)


def _piece(
    axis: AxisModel,
    recording: Recording,
    part: slice,
    drive_V: Array,
    plays: tuple[Array, Array],
    ring_s: float,
) -> HammersteinRows:
    rate_Hz, operator = recording.sampling_rate_Hz, axis.hysteresis
    memory_V, threshold_V = plays
    inside_V = operator.envelope.run(drive_V - operator.voltage_offset_V)
    # Between known plays a memory is a curve of slope at most one: its chords are admissible.
    memory_V = np.interp(threshold_V, operator.plays.threshold, memory_V)
    states_V, _ = play_columns(inside_V, threshold_V, memory_V)
    longer = min(len(drive_V), int(np.ceil(ring_s * rate_Hz)) + 1)
    padded = next_fast_len(len(drive_V) + longer, real=True)
    frequency_Hz = np.asarray(rfftfreq(padded, 1.0 / rate_Hz))
    return HammersteinRows(
        recording=recording.name,
        rate_Hz=rate_Hz,
        drive_V=drive_V,
        states_V=np.ascontiguousarray(states_V.T),
        measured_m=axis.polarity * recording.displacement_m(axis.axis)[part],
        frequency_Hz=frequency_Hz,
        chain=sensor_chain(axis, frequency_Hz),
        padded=padded,
    )


@dataclass(frozen=True, kw_only=True)
class HammersteinShape:
    """How the vector of parameters is laid out.

    plays, zones, modes, lags  how many of each
    threshold_m                of the dead zones
    """

    plays: int
    zones: int
    modes: int
    lags: int
    threshold_m: Array

    @property
    def linear(self) -> slice:
        """Where ln f, ln zeta, ln f of lags and the delay stand, as in LinearDynamics."""
        first = self.plays + self.zones - 1
        return slice(first, first + 2 * self.modes + self.lags + 1)

    @property
    def size(self) -> int:
        """Number of parameters."""
        linear = self.plays + self.zones + 2 * self.modes + self.lags
        return linear + self.modes + self.lags - 1

    def split(self, theta: Array) -> tuple[Array, DeadZones, Array, Array]:
        """Return play weights, dead zones, the linear shape, and all shares."""
        zero = int(np.flatnonzero(self.threshold_m == 0.0)[0])
        weight = np.insert(theta[self.plays : self.linear.start], zero, 1.0)
        shares = theta[self.linear.stop :]
        return (
            theta[: self.plays],
            DeadZones(threshold=self.threshold_m, weight=weight),
            theta[self.linear],
            np.append(shares, 1.0 - shares.sum()),
        )


def start_of(
    operator: ModifiedPrandtlIshlinskii, dynamics: LinearDynamics, threshold_V: Array
) -> tuple[HammersteinShape, Array]:
    """Return layout and parameters of an operator and dynamics that were found apart.

    threshold_V  (plays,)  of the operator and others beside them, which begin without weight
    """
    place = np.searchsorted(threshold_V, operator.plays.threshold)
    weight = np.zeros(len(threshold_V))
    weight[place] = operator.plays.weight
    shape = HammersteinShape(
        plays=len(threshold_V),
        zones=len(operator.dead_zones.weight),
        modes=len(dynamics.mode_frequency_Hz),
        lags=len(dynamics.lag_frequency_Hz),
        threshold_m=operator.dead_zones.threshold,
    )
    gains = np.concatenate(
        [dynamics.mode_gain_m_per_V[:, 0, 0], dynamics.lag_gain_m_per_V[:, 0, 0]]
    )
    theta = np.concatenate(
        [
            weight,
            np.delete(operator.dead_zones.weight, operator.dead_zones.zero),
            np.log(dynamics.mode_frequency_Hz),
            np.log(dynamics.mode_damping),
            np.log(dynamics.lag_frequency_Hz),
            [dynamics.delay_s],
            (gains / gains.sum())[:-1],
        ]
    )
    return shape, theta


def terms_at(shape: HammersteinShape, linear: Array, frequency_Hz: Array) -> ComplexArray:
    """Return the modes and lags without their shares, the delay with them, (lines, terms)."""
    n, lags = shape.modes, shape.lags
    s = 2j * np.pi * frequency_Hz[:, None]
    w = 2.0 * np.pi * np.exp(linear[:n])
    zeta = np.exp(linear[n : 2 * n])
    low = 2.0 * np.pi * np.exp(linear[2 * n : 2 * n + lags])
    modes = w**2 / (s**2 + 2.0 * zeta * w * s + w**2)
    return np.asarray(np.concatenate([modes, low / (s + low)], axis=1) * np.exp(-s * linear[-1]))


def simulate_rows(shape: HammersteinShape, theta: Array, rows: HammersteinRows) -> Array:
    """Return the model's displacement, (samples,), about its first value."""
    weight, zones, linear, shares = shape.split(theta)
    moved = zones.run(weight @ rows.states_V)
    response = rows.chain * (terms_at(shape, linear, rows.frequency_Hz) @ shares)
    return _back(rows, response * rows.spectrum(moved))


def tangents(shape: HammersteinShape, theta: Array, rows: HammersteinRows) -> Array:
    """Return the derivatives of ``simulate_rows``, (parameters, samples)."""
    weight, zones, linear, shares = shape.split(theta)
    inner = weight @ rows.states_V
    moved, slope = zones.run_with_slope(inner)
    terms = terms_at(shape, linear, rows.frequency_Hz)
    response = rows.chain * (terms @ shares)
    spectrum = rows.chain * rows.spectrum(moved)
    outer = np.delete(zones.columns(inner).T, zones.zero, axis=0)
    inside = (*(slope * states for states in rows.states_V), *outer)
    changes = _changes(shape, linear, shares, terms, rows.frequency_Hz)
    changes += [terms[:, place] - terms[:, -1] for place in range(len(shares) - 1)]
    found = np.empty((shape.size, rows.samples))
    for place, signal in enumerate(inside):
        found[place] = _back(rows, response * rows.spectrum(signal))
    for place, change in enumerate(changes, start=len(inside)):
        found[place] = _back(rows, change * spectrum)
    return found


def _changes(
    shape: HammersteinShape,
    linear: Array,
    shares: Array,
    terms: ComplexArray,
    frequency_Hz: Array,
) -> list[ComplexArray]:
    """Derivatives of G by each entry of the linear shape: T = w^2/D, L = p/(s + p)."""
    n, lags = shape.modes, shape.lags
    s = 2j * np.pi * frequency_Hz
    late = np.exp(-s * linear[-1])
    found: list[ComplexArray] = []
    damped: list[ComplexArray] = []
    for m in range(n):
        w, zeta = 2.0 * np.pi * np.exp(linear[m]), np.exp(linear[n + m])
        below = s**2 + 2.0 * zeta * w * s + w**2
        along = shares[m] * terms[:, m]
        found.append(along * (2.0 - (2.0 * zeta * w * s + 2.0 * w**2) / below))
        damped.append(along * (-2.0 * zeta * w * s / below))
    found += damped
    for k in range(lags):
        low = 2.0 * np.pi * np.exp(linear[2 * n + k])
        found.append(shares[n + k] * late * low * s / (s + low) ** 2)
    found.append(-s * (terms @ shares))
    return found


def _back(rows: HammersteinRows, spectrum: ComplexArray) -> Array:
    return np.asarray(irfft(spectrum, rows.padded))[: rows.samples]


def straightened(signals: Array) -> Array:
    """Return signals, (..., samples), without their straight lines."""
    place = np.linspace(-1.0, 1.0, signals.shape[-1])
    level = signals - signals.mean(axis=-1, keepdims=True)
    return np.asarray(level - np.multiply.outer(level @ place / (place @ place), place))
