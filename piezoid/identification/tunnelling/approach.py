"""Sweeps of the tunnelling current over the tip's height, from columns or a Z spectroscopy file.

Rows at the preamplifier's limit are excluded. They are recognised by their shape: next to the
surface an exponential falls from its largest value P to 0.9 P within a fixed share of the height
it needs from 0.9 P to 0.45 P,

    h(P to 0.9 P) / h(0.9 P to 0.45 P) = ln(1 / 0.9) / ln 2 = 0.152        whatever its decay,

and a clipped one within a far larger share, whether its readings repeat exactly or carry noise
from behind the clipping stage. Rows are counted instead of heights: noise of the current cannot
move them in height.
"""

import math
import re
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import median_filter

from piezoid.errors import ExcitationError, RecordingError, UnitError
from piezoid.numerics.arrays import Array, freeze, same_length
from piezoid.records.column_roles import meaning_of
from piezoid.records.recording import Quantity
from piezoid.records.table import RawTable
from piezoid.records.units import Dimension

_SWEEP = re.compile(r"Current(?: \[(?!bwd)(?P<number>[^\]]+)\])?(?P<backward> \[bwd\])?")
_AVERAGE = "AVG"
_BIAS_KEY = "Bias>Bias (V)"
_TIMES_OF_A_ROW = ("Settling time (s)", "Integration time (s)")
_MODULES = ("", "Z Spectroscopy>")  # what Nanonis writes in front of its own settings

_SHOULDER = 0.9
_HALF = 0.5 * _SHOULDER
_EXPONENTIAL = math.log(1.0 / _SHOULDER) / math.log(1.0 / 0.5)
# 400 unclipped sweeps with 5 % noise and 3 % hysteresis: largest 2.4; clipped at half: 7.6.
_TOO_LONG = 3.0
_MIN_PLATEAU = 5  # rows on a plateau of readings that differ
_REPEATED = 3  # neighbours in height with exactly the largest current: noise never does that
# Averaged over a row, a current with hum or noise touches the limit before its mean gets there.
_CLEAR = 0.8
_SMOOTHED = 5  # rows of the running median

MIN_POINTS = 8  # three parameters, two of noise, and some degrees of freedom


class Direction(Enum):
    """Direction of the tip during a sweep."""

    FORWARD = "forward"
    BACKWARD = "backward"


@dataclass(frozen=True, kw_only=True, eq=False)
class ApproachCurve:
    """One sweep of the current over the height, without missing and saturated rows.

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


def read_z_spectroscopy(table: RawTable) -> tuple[ApproachCurve, ...]:
    """Return every sweep of a Z spectroscopy file, in the order of its columns.

    The height is the swept column, which must be a displacement that grows when the tip retracts,
    as ``Z rel (m)`` of Nanonis does. Single sweeps are used; the average only where the file
    holds nothing else, since it would count the same noise twice. The bias is that of the sweep's
    own column or, without one, of the file's head. Where neither states a bias, or it is 0 V and
    was applied elsewhere, the sign of the current stands in. In a table without a column of that
    name, every column that means a current is one, as ``I (pA)``. A head that states settling and
    integration time of a row tells how long a sweep took.
    """
    height = table.find(table.independent) if table.independent else None
    unit = None if height is None else height.heading.unit
    if height is None or unit is None or unit.dimension is not Dimension.LENGTH:
        raise UnitError(
            f"{table.name}: the swept column is {table.independent!r}",
            needed="a height with a unit of length, as 'Z rel (m)'",
            remedy="Take a Z spectroscopy; or build the sweep from two arrays.",
        )
    height_m = table.si(height.number)
    sweeps = [  # column, number of the sweep, ' [bwd]' or nothing
        (column, match["number"] or "", match["backward"] or "")
        for column in table.columns
        if (match := _SWEEP.fullmatch(column.heading.stem))
    ] or [
        (column, "", "")
        for column in table.columns
        if (role := meaning_of(column.heading)).quantity is Quantity.CURRENT and role.by_name
    ]
    if not sweeps:
        labels = ", ".join(repr(column.label) for column in table.columns[:8])
        raise RecordingError(
            f"{table.name}: no current among {labels}",
            needed="columns named 'Current (A)' or 'Current [00001] (A)', '[bwd]' for backward",
            remedy="Save the sweep with its current, or build the sweep from two arrays.",
        )
    duration_s = None  # of one direction, where the head states the times of a row
    for module in _MODULES:
        times = [table.metadata.get(module + key, "nan") for key in _TIMES_OF_A_ROW]
        try:
            row_s = sum(map(float, times))
        except ValueError:
            continue
        if duration_s is None and math.isfinite(row_s) and row_s > 0.0:
            duration_s = len(height_m) * row_s
    stated_V = table.metadata.get(_BIAS_KEY)
    curves = []
    for column, number, backward in [s for s in sweeps if s[1] != _AVERAGE] or sweeps:
        bias = table.find(f"Bias{f' [{number}]' if number else ''}{backward}")
        bias_V = stated_V if bias is None else np.nanmedian(bias.si_values)
        curve = read_approach(
            height_m,
            column.si_values,
            bias_V=None if bias_V is None else float(bias_V),
            direction=Direction.BACKWARD if backward else Direction.FORWARD,
            label=f"{table.name}: {column.label}",
            pair=f"{table.name}: {number}",
            duration_s=duration_s,
        )
        curves.append(curve)
    return tuple(curves)


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
    saturated = rows_at_limit(current[present][order])
    rows = np.flatnonzero(present)[np.sort(order[saturated:])]
    if len(rows) < MIN_POINTS:
        clipped = f", {saturated} more lie at the amplifier's limit" if saturated else ""
        raise ExcitationError(
            f"{label}: {len(rows)} rows hold both a height and a current{clipped}",
            needed=f"at least {MIN_POINTS}",
            remedy="Record the sweep again with more points.",
            points=len(rows),
        )
    if not np.ptp(height[rows]) > 0.0:
        raise ExcitationError(
            f"{label}: all heights are {height[rows][0]:.6g} m",
            needed="a height that moves",
            remedy="Pass the relative height of the sweep, in metres.",
        )
    return ApproachCurve(
        label=label,
        direction=direction,
        bias_V=bias_V,
        height_m=height[rows],
        current_A=current[rows],
        rows=len(height),
        saturated=saturated,
        pair=pair,
        duration_s=duration_s,
    )


def rows_at_limit(current_A: Array) -> int:
    """Return how many rows, counted from the lowest height, lie at the amplifier's limit.

    current_A  (rows,)  in order of the height, lowest first; of either polarity

    Zero where no plateau is seen, or no fall behind it to compare it with. Rows up to where the
    current falls to 0.8 of the limit count: part of their readings may have been cut.
    """
    rows = len(current_A)
    if rows < 2 * _MIN_PLATEAU:
        return 0
    nearest = current_A[: max(rows // 20, _MIN_PLATEAU)]
    upright_A = math.copysign(1.0, float(np.median(nearest))) * current_A
    limit_A = float(np.median(upright_A[:_MIN_PLATEAU]))
    if not limit_A > 0.0:
        return 0
    smooth_A = median_filter(upright_A, _SMOOTHED, mode="nearest")

    def first_below(share: float) -> int:
        below = np.flatnonzero(smooth_A < share * limit_A)
        return int(below[0]) if len(below) else rows

    shoulder, half = first_below(_SHOULDER), first_below(_HALF)
    is_flat = shoulder > _TOO_LONG * _EXPONENTIAL * max(half - shoulder, 1)
    is_largest = upright_A >= upright_A.max()
    neighbours = np.convolve(is_largest.astype(np.float64), np.ones(_REPEATED), mode="valid")
    repeats = bool(np.any(neighbours >= _REPEATED)) and not bool(is_largest.all())
    if half < rows and (repeats or (is_flat and shoulder >= _MIN_PLATEAU)):
        return first_below(_CLEAR)
    return 0
