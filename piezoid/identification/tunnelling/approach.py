"""ApproachCurve: one sweep of the tunnelling current over the tip's height."""

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piezoid.errors import ExcitationError, RecordingError
from piezoid.numerics.arrays import Array, frozen, same_length

_SATURATED_RUN = 3  # neighbours in height with exactly the largest current: noise never does that
FEWEST_POINTS = 8  # three parameters, two of noise, and something left over to judge them by


class Direction(Enum):
    """Which way the tip moved while the sweep was taken."""

    FORWARD = "forward"
    BACKWARD = "backward"


@dataclass(frozen=True, kw_only=True, eq=False)
class ApproachCurve:
    """One sweep of the current over the height, rows that say nothing already left out.

    label          for messages: the column or file it came from
    direction      of the tip's travel
    bias_V         non-zero; its sign is the polarity of the current
    height_m       (points,)  grows when the tip retracts; neither start nor order matters
    current_A      (points,)  as measured, offset included
    rows           rows of the recording, with and without numbers
    saturated      rows left out because the amplifier stood at its limit
    """

    label: str
    direction: Direction
    bias_V: float
    height_m: Array
    current_A: Array
    rows: int
    saturated: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "height_m", frozen(self.height_m, "height_m"))
        object.__setattr__(self, "current_A", frozen(self.current_A, "current_A"))
        same_length([("height_m", self.height_m), ("current_A", self.current_A)])
        if not (math.isfinite(self.bias_V) and abs(self.bias_V) > 0.0):
            raise ValueError(f"{self.label}: bias_V is {self.bias_V}, expected a voltage")
        if self.rows < self.points + self.saturated:
            raise ValueError(f"{self.label}: {self.rows} rows hold {self.points} points")

    @property
    def points(self) -> int:
        """Number of rows that hold both a height and a current."""
        return len(self.height_m)

    @property
    def polarity(self) -> float:
        """The sign of the tunnelling current at this bias."""
        return math.copysign(1.0, self.bias_V)


def read_approach(
    height_m: ArrayLike,
    current_A: ArrayLike,
    *,
    bias_V: float,
    direction: Direction,
    label: str,
) -> ApproachCurve:
    """Take a sweep from two columns, leaving out rows without a number and saturated ones.

    height_m   (rows,)  m, grows when the tip retracts; NaN where a row is missing
    current_A  (rows,)  A, of either polarity; NaN where a row is missing
    bias_V     V, at the sample or the tip: only its sign relative to the current matters

    Refused: columns of unequal length, too few rows with numbers, a height that does not move.
    """
    height = np.asarray(height_m, dtype=np.float64)
    current = np.asarray(current_A, dtype=np.float64)
    if height.shape != current.shape or height.ndim != 1:
        raise RecordingError(
            f"{label}: heights of shape {height.shape}, currents of shape {current.shape}",
            needed="two columns of one length",
            remedy="Pass the height and the current of the same sweep.",
        )
    present = np.isfinite(height) & np.isfinite(current)
    clipped = _saturated(height[present], current[present])
    used = np.flatnonzero(present)[~clipped]
    _refuse_too_little(height[used], label)
    return ApproachCurve(
        label=label,
        direction=direction,
        bias_V=bias_V,
        height_m=height[used],
        current_A=current[used],
        rows=len(height),
        saturated=int(np.count_nonzero(clipped)),
    )


def _saturated(height_m: Array, current_A: Array) -> NDArray[np.bool_]:
    """Which points repeat exactly the largest current while the height moves on."""
    at_limit = np.abs(current_A) >= np.max(np.abs(current_A), initial=0.0)
    if at_limit.all():
        return np.zeros_like(at_limit)
    in_order = at_limit[np.argsort(height_m, kind="stable")]
    runs = np.convolve(in_order, np.ones(_SATURATED_RUN), mode="valid")
    stands = bool(np.any(runs >= _SATURATED_RUN))
    return at_limit if stands else np.zeros_like(at_limit)


def _refuse_too_little(height_m: Array, label: str) -> None:
    if len(height_m) < FEWEST_POINTS:
        raise ExcitationError(
            f"{label}: {len(height_m)} rows hold both a height and a current",
            needed=f"at least {FEWEST_POINTS}",
            remedy="Record the sweep again with more points.",
            points=len(height_m),
        )
    if not np.ptp(height_m) > 0.0:
        raise ExcitationError(
            f"{label}: all heights are {height_m[0]:.6g} m",
            needed="a height that moves",
            remedy="Pass the relative height of the sweep, in metres.",
        )
