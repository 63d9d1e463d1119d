"""Sweeps of the tunnelling current over height, from columns or Z spectroscopy files.

Rows at the limit of the preamplifier are excluded. They are recognised by the shape of the
current: next to the surface an exponential falls from its largest value P to 0.9 P within a fixed
share of the height from 0.9 P to 0.45 P,

    h(P to 0.9 P) / h(0.9 P to 0.45 P) = ln(1 / 0.9) / ln 2 = 0.152        for any decay,

and a clipped current within a far larger share, whether its readings repeat exactly or contain
noise from behind the clipping stage. Rows are counted instead of heights: rows are sorted by
height, which noise of the current does not affect.
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
_MODULES = ("", "Z Spectroscopy>")  # prefixes of the settings in Nanonis files

_SHOULDER = 0.9
_HALF = 0.5 * _SHOULDER
_EXPONENTIAL = math.log(1.0 / _SHOULDER) / math.log(1.0 / 0.5)
# 400 unclipped sweeps with 5 % noise and 3 % hysteresis: largest 2.4; clipped at half: 7.6.
_TOO_LONG = 3.0
_MIN_PLATEAU = 5  # rows on a plateau of readings that differ
_REPEATED = 3  # neighbours in height with exactly the largest current, which noise never causes
# Averaged over a row, a current with hum or noise is clipped before its mean reaches the limit.
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

    label          name of the column or file, for messages
    direction      of the motion of the tip
    bias_V         its sign is the expected polarity of the current; None or 0: not stated
    height_m       (points,)  increases when the tip retracts; neither origin nor order matters
    current_A      (points,)  as measured, offset included
    rows           number of rows of the recording, including missing ones
    saturated      number of rows excluded because the amplifier was at its limit
    pair           common name of a forward and a backward sweep in succession; '': single sweep
    duration_s     of the sweep; None: not stated
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

    @property
    def points(self) -> int:
        """Number of rows with both a height and a current."""
        return len(self.height_m)

    @property
    def polarity(self) -> float:
        """Sign of the current: that of the bias, or if unknown that of the largest current."""
        if self.bias_V:
            return math.copysign(1.0, self.bias_V)
        middle_A = float(np.median(self.current_A))
        farthest = int(np.argmax(np.abs(self.current_A - middle_A)))
        return math.copysign(1.0, float(self.current_A[farthest]) - middle_A)


def read_z_spectroscopy(table: RawTable) -> tuple[ApproachCurve, ...]:
    """Return every sweep of a Z spectroscopy file, in the order of its columns.

    The height is the swept column, which must be a displacement that increases when the tip
    retracts, like ``Z rel (m)`` of Nanonis. The average of sweeps is used only if the file
    contains no single sweeps, because it would count the same noise twice. The bias is that of the
    column of the sweep, else of the header; without a bias, or with 0 V, the polarity is that of
    the current. In a table without columns named like those of Nanonis, every column of a current
    is a sweep, such as ``I (pA)``. The duration of a sweep follows from settling and integration
    time of a row in the header.
    """
    height = table.find(table.independent) if table.independent else None
    unit = None if height is None else height.heading.unit
    if height is None or unit is None or unit.dimension is not Dimension.LENGTH:
        raise UnitError(
            f"{table.name}: the swept column is {table.independent!r}",
            needed="a height with a unit of length, such as 'Z rel (m)'",
            remedy="Take a Z spectroscopy; or build the sweep from two arrays.",
        )
    height_m = table.si(height.number)
    sweeps = [  # column, number of the sweep, ' [bwd]' or ''
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
    duration_s = None  # of one direction, if the header states the times of a row
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
    """Return the sweep of two columns, without missing and saturated rows.

    height_m   (rows,)  increases when the tip retracts; NaN in missing rows
    current_A  (rows,)  of either polarity; NaN in missing rows
    bias_V     at the sample or the tip, of which only the sign matters; None or 0: the sign is
               that of the current
    pair, duration_s  as in ``ApproachCurve``

    Raises ``RecordingError`` for columns of unequal length, ``ExcitationError`` for too few rows
    with numbers or a constant height.
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
            f"{label}: {len(rows)} rows contain both a height and a current{clipped}",
            needed=f"at least {MIN_POINTS}",
            remedy="Record the sweep again with more points.",
            points=len(rows),
        )
    if not np.ptp(height[rows]) > 0.0:
        raise ExcitationError(
            f"{label}: all heights are {height[rows][0]:.6g} m",
            needed="a height that changes",
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

    Zero without a plateau, or if the current does not fall behind it. Rows count up to the fall of
    the current to 0.8 of the limit, because parts of their readings may have been clipped.
    """
    rows = len(current_A)
    if rows < 2 * _MIN_PLATEAU:
        return 0
    lowest_rows = current_A[: max(rows // 20, _MIN_PLATEAU)]
    positive_A = math.copysign(1.0, float(np.median(lowest_rows))) * current_A
    limit_A = float(np.median(positive_A[:_MIN_PLATEAU]))
    if not limit_A > 0.0:
        return 0
    smooth_A = median_filter(positive_A, _SMOOTHED, mode="nearest")

    # The first rows at which the current has fallen to these shares of the limit.
    shoulder, half, clear = (
        int(np.argmax(is_below)) if (is_below := smooth_A < share * limit_A).any() else rows
        for share in (_SHOULDER, _HALF, _CLEAR)
    )
    is_flat = shoulder > _TOO_LONG * _EXPONENTIAL * max(half - shoulder, 1)
    is_largest = positive_A >= positive_A.max()
    neighbours = np.convolve(is_largest.astype(np.float64), np.ones(_REPEATED), mode="valid")
    repeats = bool(np.any(neighbours >= _REPEATED)) and not bool(is_largest.all())
    if half < rows and (repeats or (is_flat and shoulder >= _MIN_PLATEAU)):
        return clear
    return 0
