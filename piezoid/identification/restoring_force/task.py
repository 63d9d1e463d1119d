"""One recording as a task of simulation, and the blocks of it that are left out."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezoid.errors import ExcitationError, RecordingError
from piezoid.identification.dynamics.repetition import find_repetition
from piezoid.identification.restoring_force.equation_error import Start, starts
from piezoid.numerics.arrays import Array
from piezoid.operators.hysteretic_mode import Hold
from piezoid.records.recording import Recording

BLOCKS = 16  # of a record, or of a period of the drive
FEWEST = 2000  # samples: some 20 numbers are fitted to half of them


@dataclass(frozen=True, kw_only=True, eq=False)
class Task:
    """What is to be simulated, and which samples are left out when laws are compared.

    drive, displacement_m  (samples,)
    is_left_out            (samples,)  bool
    """

    drive: Array
    displacement_m: Array
    sampling_rate_Hz: float
    hold: Hold
    is_left_out: NDArray[np.bool_]

    def starts(self, chosen: NDArray[np.bool_]) -> dict[str, Start]:
        """Return the starts that the equation error finds on the chosen samples."""
        return starts(self.drive, self.displacement_m, self.sampling_rate_Hz, self.hold, chosen)


def task_of(drive: Array, displacement_m: Array, sampling_rate_Hz: float, hold: Hold) -> Task:
    """Return the task of two signals, or refuse what cannot be fitted."""
    if len(drive) < FEWEST:
        raise ExcitationError(
            f"{len(drive)} samples",
            needed=f"at least {FEWEST}: half of the blocks are left out",
            remedy="Record longer, or at a higher rate.",
        )
    if not (np.ptp(drive) > 0.0 and np.ptp(displacement_m) > 0.0):
        raise ExcitationError(
            f"a drive that spans {np.ptp(drive):.3g} and a displacement that spans "
            f"{np.ptp(displacement_m):.3g} m",
            needed="both to move",
            remedy="Drive the stage through its resonance.",
        )
    return Task(
        drive=drive,
        displacement_m=displacement_m,
        sampling_rate_Hz=sampling_rate_Hz,
        hold=hold,
        is_left_out=left_out_samples(drive),
    )


def left_out_samples(drive: Array) -> NDArray[np.bool_]:
    """Return every second block of the record, or of every period alike, (samples,)."""
    found = find_repetition(drive)
    period = found.period_samples if found is not None else len(drive)
    phase = (np.arange(len(drive)) - (found.first if found is not None else 0)) % period
    return np.asarray((phase * BLOCKS // period) % 2 == 1)


def drive_and_motion(recording: Recording, axis: str | None) -> tuple[Array, Array]:
    """Return drive and displacement of a recording that one simulation can follow, or refuse."""
    drive, motion_m = recording.voltage_V(axis), recording.displacement_m(axis)
    if recording.breaks:
        raise RecordingError(
            f"{recording.name}: {len(recording.breaks)} breaks, the first after "
            f"{recording.breaks[0] / recording.sampling_rate_Hz:.6g} s",
            needed="one uninterrupted motion",
            remedy="Cut one part out with recording.seconds(start_s, stop_s).",
        )
    return drive, motion_m
