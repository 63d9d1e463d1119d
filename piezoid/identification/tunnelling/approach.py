"""ApproachCurve: one sweep of the tunnelling current over the tip's height.

Rows at the preamplifier's limit are left out. They are recognised by their shape: next to the
surface an exponential falls from its largest value P to 0.9 P within a fixed share of the height
it needs from 0.9 P to 0.45 P,

    h(P to 0.9 P) / h(0.9 P to 0.45 P) = ln(1 / 0.9) / ln 2 = 0.152        whatever its decay,

and a clipped one within a far larger share, whether its readings repeat exactly or carry noise
from behind the clipping stage. Rows are counted instead of heights: noise of the current cannot
move them in height.
"""

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike

from piezoid.errors import ExcitationError, RecordingError
from piezoid.numerics.arrays import Array, freeze, same_length

_SHOULDER = 0.9
_HALF = 0.5 * _SHOULDER
_EXPONENTIAL = math.log(1.0 / _SHOULDER) / math.log(1.0 / 0.5)
# 400 unclipped sweeps with 5 % noise and 3 % hysteresis: largest 2.4; clipped at half: 7.6.
_TOO_LONG = 3.0
_FEWEST = 5  # rows on a plateau of readings that differ
_REPEATED = 3  # neighbours in height with exactly the largest current: noise never does that
# Averaged over a row, a current with hum or noise touches the limit before its mean gets there.
_CLEAR = 0.8
_SMOOTHED = 5  # rows of the running median

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
    bias_V         its sign is the polarity expected of the current; None or 0 where the file does
                   not know it
    height_m       (points,)  grows when the tip retracts; neither start nor order matters
    current_A      (points,)  as measured, offset included
    rows           rows of the recording, with and without numbers
    saturated      rows left out because the amplifier stood at its limit
    pair           sweeps of one name went to and fro one after the other; empty: alone
    duration_s     of the one way; None where the file does not say
    """

    label: str
    direction: Direction
    bias_V: float | None
    height_m: Array
    current_A: Array
    rows: int
    saturated: int = 0
    pair: str = ""
    duration_s: float | None = None

    def __post_init__(self) -> None:
        freeze(self, "height_m", "current_A")
        same_length([("height_m", self.height_m), ("current_A", self.current_A)])
        if self.bias_V is not None and not math.isfinite(self.bias_V):
            raise ValueError(f"{self.label}: bias_V is {self.bias_V}, expected a voltage")
        if self.rows < self.points + self.saturated:
            raise ValueError(f"{self.label}: {self.rows} rows hold {self.points} points")

    @property
    def points(self) -> int:
        """Number of rows that hold both a height and a current."""
        return len(self.height_m)

    @property
    def polarity(self) -> float:
        """The sign of the current: that of the bias or, where it is not known, of the largest."""
        if self.bias_V:
            return math.copysign(1.0, self.bias_V)
        middle_A = float(np.median(self.current_A))
        farthest = int(np.argmax(np.abs(self.current_A - middle_A)))
        return math.copysign(1.0, float(self.current_A[farthest]) - middle_A)


def read_approach(
    height_m: ArrayLike,
    current_A: ArrayLike,
    *,
    bias_V: float | None,
    direction: Direction,
    label: str,
    pair: str = "",
    duration_s: float | None = None,
) -> ApproachCurve:
    """Take a sweep from two columns, leaving out rows without a number and saturated ones.

    height_m   (rows,)  m, grows when the tip retracts; NaN where a row is missing
    current_A  (rows,)  A, of either polarity; NaN where a row is missing
    bias_V     V, at the sample or the tip: only its sign relative to the current matters; None
               or 0: the sign is taken from the current
    pair, duration_s  as in ``ApproachCurve``

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
    order = np.argsort(height[present], kind="stable")
    clipped = np.zeros(len(order), dtype=bool)
    lowest = rows_at_limit(current[present][order])
    clipped[order[:lowest]] = True
    used = np.flatnonzero(present)[~clipped]
    _refuse_too_little(height[used], lowest, label)
    return ApproachCurve(
        label=label,
        direction=direction,
        bias_V=bias_V,
        height_m=height[used],
        current_A=current[used],
        rows=len(height),
        saturated=lowest,
        pair=pair,
        duration_s=duration_s,
    )


def _refuse_too_little(height_m: Array, saturated: int, label: str) -> None:
    if len(height_m) < FEWEST_POINTS:
        beside = f", {saturated} more lie at the amplifier's limit" if saturated else ""
        raise ExcitationError(
            f"{label}: {len(height_m)} rows hold both a height and a current{beside}",
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


def rows_at_limit(current_A: Array) -> int:
    """Return how many rows, counted from the lowest height, lie at the amplifier's limit.

    current_A  (rows,)  in order of the height, lowest first; of either polarity

    Zero where no plateau is seen, or no fall behind it to compare it with. Rows up to where the
    current falls to 0.8 of the limit count: part of their readings may have been cut.
    """
    if len(current_A) < 2 * _FEWEST:
        return 0
    nearest = current_A[: max(len(current_A) // 20, _FEWEST)]
    upright_A = math.copysign(1.0, float(np.median(nearest))) * current_A
    smooth_A = _running_median(upright_A)
    limit_A = float(np.median(upright_A[:_FEWEST]))
    if not limit_A > 0.0:
        return 0
    shoulder = _first_below(smooth_A, _SHOULDER * limit_A)
    half = _first_below(smooth_A, _HALF * limit_A)
    flat = shoulder > _TOO_LONG * _EXPONENTIAL * max(half - shoulder, 1)
    falls = half < len(current_A)
    if not (falls and (_repeats(upright_A) or (flat and shoulder >= _FEWEST))):
        return 0
    return _first_below(smooth_A, _CLEAR * limit_A)


def _first_below(current_A: Array, level_A: float) -> int:
    """The first row below a level; all rows where none is."""
    below = np.flatnonzero(current_A < level_A)
    return int(below[0]) if len(below) else len(current_A)


def _repeats(upright_A: Array) -> bool:
    at_limit = (upright_A >= upright_A.max()).astype(np.float64)
    runs = np.convolve(at_limit, np.ones(_REPEATED), mode="valid")
    return bool(np.any(runs >= _REPEATED)) and not bool(at_limit.all())


def _running_median(values: Array) -> Array:
    side = _SMOOTHED // 2
    padded = np.concatenate([np.full(side, values[0]), values, np.full(side, values[-1])])
    windows = np.lib.stride_tricks.sliding_window_view(padded, _SMOOTHED)
    return np.asarray(np.median(windows, axis=1))
