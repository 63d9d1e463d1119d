"""Segments of recordings for the joint fit: play states, and spectra padded for decay.

A segment is uninterrupted, and the static fit determined its initial memory. The drive is that at
the hysteresis: behind the hold of the controller and the declared pole of the amplifier.
"""

from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

from piezoid.identification.dynamics.modal import LinearDynamics
from piezoid.identification.dynamics.modal_basis import Declaration, ModalBasis, Structure
from piezoid.identification.hysteresis.pieces import MINIMUM_SAMPLES, behind_pole
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array, ComplexArray
from piezoid.operators.play import play_columns
from piezoid.records.recording import Recording

SMALL_PLAYS = (0.05, 0.1, 0.2, 0.35)  # of the exciting drive's reach
DISTINCT = 0.02  # of that reach: plays nearer to each other are one
MAX_SAMPLES = 60_000  # of one segment: one second of a fast recording is as informative as ten
RINGING = 10.0  # time constants after which a ring has decayed


def with_small_plays(threshold_V: Array, voltage_V: Array) -> Array:
    """Return the operator's thresholds and those of plays as small as a drive, ascending.

    threshold_V  (plays,)    of the operator
    voltage_V    (samples,)  of the recording that excites the modes
    """
    reach_V = 2.0 * float(np.median(np.abs(voltage_V - np.median(voltage_V))))
    small_V = reach_V * np.array(SMALL_PLAYS)
    distance_V = np.abs(small_V[:, None] - threshold_V).min(axis=1)
    return np.unique(np.concatenate([threshold_V, small_V[distance_V > DISTINCT * reach_V]]))


@dataclass(frozen=True, kw_only=True, eq=False)
class Segment:
    """One uninterrupted segment of one recording.

    recording     its name
    states_V      (plays, samples)  of the operator's plays
    measured_m    (samples,)  rising with the drive
    basis         modes and lags of unit gain at the lines of the padded spectrum
    sensor        (lines,)  response of the declared sensor
    padded        samples of the padded signal
    """

    recording: str
    states_V: Array
    measured_m: Array
    basis: ModalBasis
    sensor: ComplexArray
    padded: int

    @property
    def samples(self) -> int:
        """Samples of the segment."""
        return len(self.measured_m)

    def spectrum(self, signals: Array) -> ComplexArray:
        """Return the padded spectra of signals about their first samples, (..., lines)."""
        return np.asarray(rfft(signals - signals[..., :1], self.padded))

    def signal(self, spectrum: ComplexArray) -> Array:
        """Return the signal of a padded spectrum, (samples,)."""
        return np.asarray(irfft(spectrum, self.padded))[: self.samples]


def segments_of(
    axis: AxisModel,
    recording: Recording,
    threshold_V: Array,
    dynamics: LinearDynamics,
    structure: Structure,
) -> list[Segment]:
    """Return the segments of a recording whose initial memory the static fit determined.

    axis         whose operator and declared poles make the drive of the plays
    threshold_V  (plays,)  of the plays whose states are returned
    dynamics     how long motion decays, and the rate of the controller
    structure    modes and lags of the basis
    """
    rate_Hz, operator = recording.sampling_rate_Hz, axis.hysteresis
    # The longest time constant; an overdamped mode has its slow pole at w / (2 zeta).
    w, zeta = 2.0 * np.pi * dynamics.mode_frequency_Hz, dynamics.mode_damping
    modes_s = np.maximum(1.0 / (zeta * w), np.where(zeta > 1.0, 2.0 * zeta / w, 0.0))
    lags_s = 1.0 / (2.0 * np.pi * dynamics.lag_frequency_Hz)
    longest_s = float(max([*modes_s, *lags_s], default=0.0))
    ring = int(np.ceil((RINGING * longest_s + dynamics.delay_s) * rate_Hz)) + 1
    starts = [start for start in axis.starts if start.recording == recording.name]
    pieces = [p for p in recording.pieces if p.stop - p.start >= MINIMUM_SAMPLES]
    segments = []
    for piece, start in zip(pieces, starts, strict=False):
        rows = slice(piece.start, min(piece.stop, piece.start + MAX_SAMPLES))
        drive_V = _drive_at_operator(
            recording.voltage_V(axis.axis)[rows],
            axis.rig.amplifier_bandwidth_Hz,
            rate_Hz,
            dynamics.sampling_rate_Hz,
        )
        inside_V = operator.envelope.run(drive_V - operator.voltage_offset_V)
        # Between known plays a memory is a curve of slope at most one: its chords are admissible.
        memory_V = np.interp(threshold_V, operator.plays.threshold, start.memory_V)
        states_V, _ = play_columns(inside_V, threshold_V, memory_V)
        padded = next_fast_len(len(drive_V) + min(len(drive_V), ring), real=True)
        frequency_Hz = np.asarray(rfftfreq(padded, 1.0 / rate_Hz))
        sensor_Hz = axis.rig.sensor_bandwidth_Hz
        lag = 0.0 if sensor_Hz is None else frequency_Hz / sensor_Hz
        segments.append(
            Segment(
                recording=recording.name,
                states_V=np.ascontiguousarray(states_V.T),
                measured_m=axis.polarity * recording.displacement_m(axis.axis)[rows],
                basis=ModalBasis(
                    structure=structure,
                    frequency_Hz=frequency_Hz,
                    sampling_rate_Hz=rate_Hz,
                    declaration=Declaration(hold="band_limited"),
                ),
                sensor=np.asarray(np.ones(len(frequency_Hz)) / (1.0 + 1j * lag)),
                padded=padded,
            )
        )
    return segments


def _drive_at_operator(
    voltage_V: Array, amplifier_Hz: float | None, rate_Hz: float, controller_Hz: float
) -> Array:
    """Return the drive behind hold and declared amplifier, (samples,), without its images.

    At the controller's rate the numbers are held for a tick: half a tick late, and the images of
    the staircase, which the stage does not follow, are left out. Slower recordings hold samples of
    a drive that is nearly straight between them.
    """
    if rate_Hz < 0.99 * controller_Hz:
        return behind_pole(voltage_V, amplifier_Hz, rate_Hz)
    count = len(voltage_V)
    padded = next_fast_len(2 * count, real=True)
    fade = 0.5 + 0.5 * np.cos(np.pi * np.arange(1, padded - count + 1) / (padded - count))
    level = voltage_V - voltage_V[0]
    frequency_Hz = np.asarray(rfftfreq(padded, 1.0 / rate_Hz))
    turn = frequency_Hz / rate_Hz
    response: ComplexArray = np.sinc(turn) * np.exp(-1j * np.pi * turn)
    if amplifier_Hz is not None:
        response = response / (1.0 + 1j * frequency_Hz / amplifier_Hz)
    spectrum = response * rfft(np.concatenate([level, level[-1] * fade]))
    return np.asarray(voltage_V[0] + irfft(spectrum, padded)[:count])
