"""Closed-loop records from recordings and the declarations of lab.toml.

    drive in volts at the converter -> amplifier -> Z piezo: g_z = its gain times the actuator's

A missing declaration raises an error with the line to write; nothing is assumed.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from piezoid.errors import ExcitationError, LabFileError, RecordingError
from piezoid.numerics.arrays import Array, freeze, same_length
from piezoid.operators.tunnelling import log_current
from piezoid.records.lab import Lab
from piezoid.records.recording import Quantity, Recording

_LOST_FRACTION = 0.01  # of the samples below the floor: with more, the tip was lost

_LOOP = (Quantity.VOLTAGE, Quantity.CURRENT, Quantity.REFERENCE)
_SET_POINT_FACTOR = 2.0  # factor between the declared set point and the median current
_RATE_TOLERANCE = 0.01
_REPEATS = 1e-6  # of the span: largest difference of the periods of a dither, as printed


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopRecord:
    """Reference, drive and current of a closed loop on the log current, sample by sample.

    label              for messages
    sampling_rate_Hz   > 0
    set_point_A        carries the current's sign
    floor_A            > 0: smaller currents count as a lost tip
    reference          (samples,)  external dither in any unit, added to the set point or to the
                       drive; it must not depend on the current
    drive_V            (samples,)  at the converter, dither included; written after the current of
                       the same row was read
    current_A          (samples,)
    period_samples     of the dither; None: not periodic

    Raises ``ExcitationError`` if the current is below the floor in more than 1 % of the samples.
    """

    label: str
    sampling_rate_Hz: float
    set_point_A: float
    floor_A: float
    reference: Array
    drive_V: Array
    current_A: Array
    period_samples: int | None

    def __post_init__(self) -> None:
        freeze(self, "reference", "drive_V", "current_A")
        same_length([(n, getattr(self, n)) for n in ("drive_V", "reference", "current_A")])
        positive_A = math.copysign(1.0, self.set_point_A) * self.current_A
        below = int(np.count_nonzero(positive_A < self.floor_A))
        if below > _LOST_FRACTION * self.samples:
            raise ExcitationError(
                f"{self.label}: {below} of {self.samples} currents lie below {self.floor_A:.3g} A "
                "of the set point's sign",
                needed="a tip that tunnels throughout",
                remedy="Check the set point's sign, or cut the record where the tip was lost.",
                lost=below,
            )

    @property
    def samples(self) -> int:
        """Number of samples."""
        return len(self.drive_V)

    @property
    def period_s(self) -> float | None:
        """Period of the dither; None if it is not periodic."""
        return None if self.period_samples is None else self.period_samples / self.sampling_rate_Hz

    @property
    def log_current(self) -> Array:
        """The log current relative to the set point, (samples,) nepers."""
        return log_current(self.current_A, set_point_A=self.set_point_A, floor_A=self.floor_A)


@dataclass(frozen=True, kw_only=True)
class LoopRig:
    """Declared properties of an axis that controls a current.

    axis                   its name
    set_point_A            with the current's sign
    floor_A                > 0
    amplifier_pole_Hz      of the amplifier in front of the Z piezo
    drive_gain_m_per_V     g_z > 0, extension of the tip per volt at the converter
    bandwidth_Hz           of the current sensor; None: not declared
    feedback_ohm           of the current sensor; None: not declared
    extension_uncertainty  relative standard uncertainty of g_z
    """

    axis: str
    set_point_A: float
    floor_A: float
    amplifier_pole_Hz: float
    drive_gain_m_per_V: float
    bandwidth_Hz: float | None
    feedback_ohm: float | None
    extension_uncertainty: float


def is_loop(recording: Recording) -> bool:
    """Return whether a recording contains drive, current and reference of its axis."""
    return all(recording.find(quantity, recording.axis) is not None for quantity in _LOOP)


def rig_of_loop(lab: Lab, axis: str) -> LoopRig:
    """Return the declarations of an axis in lab.toml, or raise an error with the missing lines."""
    amplifier, declared = lab.amplifier_of(axis), lab.tunnelling
    extension = lab.actuator_of(axis).gain_m_per_V
    needed = {
        "[tunnelling]\nset_point_A": declared.set_point_A,
        "[tunnelling]\nfloor_A": declared.floor_A,
        f"[axis.{axis}.amplifier]\nbandwidth_Hz": amplifier.bandwidth_Hz,
        f"[axis.{axis}.amplifier]\ngain_V_per_V": amplifier.gain_V_per_V,
        f"[axis.{axis}.actuator]\ngain_m_per_V": extension,
    }
    missing = [name for name, value in needed.items() if value is None]
    if missing:
        lines = "\n".join(f"{name} = ..." for name in missing)
        raise LabFileError(
            f"{lab.place}: the closed loop of axis {axis} lacks "
            f"{', '.join(name.replace(chr(10), ' ') for name in missing)}",
            needed="set point and floor of the loop, amplifier and actuator of the tip",
            remedy=f"Write into lab.toml, one table for each heading:\n\n{lines}\n",
        )
    gain = {name: float(value) for name, value in needed.items() if value is not None}
    set_point_A, floor_A, pole_Hz, volts, metres = gain.values()
    if not volts * metres > 0.0:
        raise LabFileError(
            f"{lab.place}: the extension of axis {axis} is {volts * metres:.3g} m per volt",
            needed="a drive counted positive where it extends the tip",
            remedy="Write the gains positive, and the drive's column with that sign.",
        )
    return LoopRig(
        axis=axis,
        set_point_A=set_point_A,
        floor_A=floor_A,
        amplifier_pole_Hz=pole_Hz,
        drive_gain_m_per_V=volts * metres,
        bandwidth_Hz=declared.bandwidth_Hz,
        feedback_ohm=declared.feedback_ohm,
        extension_uncertainty=declared.extension_uncertainty,
    )


def loops_of(recordings: Sequence[Recording], lab: Lab) -> tuple[LoopRig, tuple[LoopRecord, ...]]:
    """Return the closed loops among recordings and their rig.

    recordings  at least one ``is_loop``, all of one axis and one rate
    """
    loops = [recording for recording in recordings if is_loop(recording)]
    axes_and_rates = sorted({(r.axis, r.sampling_rate_Hz) for r in loops})
    if len(axes_and_rates) != 1:
        listed = ", ".join(f"{axis} at {rate_Hz:g} Hz" for axis, rate_Hz in axes_and_rates)
        raise RecordingError(
            f"the closed loops are of {listed}",
            needed="one tip, one axis and one rate of the controller",
            remedy="Fit the tips one by one.",
        )
    axis, rate_Hz = axes_and_rates[0]
    declared_Hz = lab.acquisition.sampling_rate_Hz
    if declared_Hz is not None and abs(rate_Hz / declared_Hz - 1.0) > _RATE_TOLERANCE:
        raise LabFileError(
            f"{lab.place}: the controller runs at {declared_Hz:g} Hz, {loops[0].name} is recorded "
            f"at {rate_Hz:g} Hz",
            needed="every tick of the loop: motion between rows aliases",
            remedy="Record each tick, or correct sampling_rate_Hz under [acquisition].",
        )
    rig = rig_of_loop(lab, axis)
    return rig, tuple(read_loop(recording, rig, lab_file=lab.place) for recording in loops)


def read_loop(recording: Recording, rig: LoopRig, *, lab_file: str = "lab.toml") -> LoopRecord:
    """Return the longest uninterrupted piece of a recording as a closed-loop record.

    A periodic reference is analysed period by period, any other in blocks.
    """
    longest = max(recording.pieces, key=lambda piece: piece.stop - piece.start)
    channels = [recording.find(quantity, rig.axis) for quantity in _LOOP]
    drive_V, current_A, reference = (c.values[longest] for c in channels if c is not None)
    median_A = float(np.median(current_A))
    if not 1.0 / _SET_POINT_FACTOR < abs(median_A / rig.set_point_A) < _SET_POINT_FACTOR:
        raise LabFileError(
            f"{lab_file}: [tunnelling] set_point_A is {rig.set_point_A:.3g} A, the median current "
            f"of {recording.name} is {median_A:.3g} A",
            needed=f"a set point within a factor of {_SET_POINT_FACTOR:g} of that current",
            remedy="Correct the set point, or the unit of the current's column.",
        )
    return LoopRecord(
        label=recording.name,
        sampling_rate_Hz=recording.sampling_rate_Hz,
        set_point_A=rig.set_point_A,
        floor_A=rig.floor_A,
        reference=reference,
        drive_V=drive_V,
        current_A=current_A,
        period_samples=period_of(reference),
    )


def period_of(reference: Array) -> int | None:
    """Return the period of a signal that contains at least two, in samples, or None."""
    level = reference - reference.mean()
    span = float(np.ptp(level))
    if not span > 0.0:
        return None
    length = len(level)
    spectrum = np.fft.rfft(level, 2 * length)
    correlation = np.fft.irfft(np.abs(spectrum) ** 2)[: length // 2 + 1]
    # The autocorrelation of a periodic signal at its period is its power.
    overlap = np.arange(length, length - len(correlation), -1)
    share = correlation / np.maximum(overlap, 1)
    for shift in np.flatnonzero(share > 0.5 * share[0]):
        if shift > 1 and np.abs(level[shift:] - level[:-shift]).max() <= _REPEATS * span:
            return int(shift)
    return None
