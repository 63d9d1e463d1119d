"""What the joint fit is given: play states and displacement of every recording, with its spectrum.

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
