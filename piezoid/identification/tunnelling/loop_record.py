"""LoopRecord: what a controller of the tunnelling current wrote down while the loop was closed."""

import math
from dataclasses import dataclass

import numpy as np

from piezoid.errors import ExcitationError
from piezoid.numerics.arrays import Array, freeze, same_length
from piezoid.operators.tunnelling import log_current

_LOST_FRACTION = 0.01  # of the samples below the floor: then the tip was not tunnelling


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopRecord:
    """Reference, drive and current of a closed loop on the log current, tick by tick.

    label              for messages
    sampling_rate_Hz   > 0
    set_point_A        carries the current's sign
    floor_A            > 0: currents below it count as a lost tip
    reference          (samples,)  the external dither, in any unit: added to the set point or to
                       the drive; it must not depend on the current
    drive_V            (samples,)  at the converter, dither included; written after the current of
                       the same row was read
    current_A          (samples,)
    period_samples     of a periodic dither; None where it is not periodic

    Refused: a current below the floor in more than a hundredth of the samples.
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
        if not (math.isfinite(self.sampling_rate_Hz) and self.sampling_rate_Hz > 0.0):
            raise ValueError(f"{self.label}: sampling_rate_Hz is {self.sampling_rate_Hz}")
        if not self.floor_A > 0.0:
            raise ValueError(f"{self.label}: floor_A is {self.floor_A}, expected more than 0")
        self._refuse_lost()

    def _refuse_lost(self) -> None:
        upright_A = math.copysign(1.0, self.set_point_A) * self.current_A
        lost = int(np.count_nonzero(upright_A < self.floor_A))
        if lost > _LOST_FRACTION * self.samples:
            raise ExcitationError(
                f"{self.label}: {lost} of {self.samples} currents lie below {self.floor_A:.3g} A "
                "of the set point's sign",
                needed="a tip that tunnels throughout",
                remedy="Check the set point's sign, or cut the record where the tip was lost.",
                lost=lost,
            )

    @property
    def samples(self) -> int:
        """Number of ticks."""
        return len(self.drive_V)

    @property
    def log_current(self) -> Array:
        """The log current relative to the set point, (samples,) nepers."""
        return log_current(self.current_A, set_point_A=self.set_point_A, floor_A=self.floor_A)
