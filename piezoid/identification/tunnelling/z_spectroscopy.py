"""Sweeps out of a Z spectroscopy table: one height, a current for each sweep and direction."""

import math
import re
from typing import NamedTuple

import numpy as np

from piezoid.errors import RecordingError, UnitError
from piezoid.identification.tunnelling.approach import ApproachCurve, Direction, read_approach
from piezoid.records.table import Column, RawTable
from piezoid.records.units import Dimension

_SWEEP = re.compile(r"Current(?: \[(?!bwd)(?P<number>[^\]]+)\])?(?P<way> \[bwd\])?")
_AVERAGE = "AVG"
_BIAS_KEY = "Bias>Bias (V)"
_TIMES_OF_A_ROW = ("Settling time (s)", "Integration time (s)")
_MODULES = ("", "Z Spectroscopy>")  # what Nanonis writes in front of its own settings


class _Name(NamedTuple):
    number: str
    way: str


def read_z_spectroscopy(table: RawTable) -> tuple[ApproachCurve, ...]:
    """Return every sweep of a Z spectroscopy file, in the order of its columns.

    The height is the swept column, which must be a displacement that grows when the tip retracts,
    as ``Z rel (m)`` of Nanonis does. Single sweeps are taken; the average only where the file
    holds nothing else, since it would count the same noise twice. The bias is that of the sweep's
    own column or, without one, of the file's head; one of 0 V was applied elsewhere, and the sign
    of the current stands in. A head that states settling and integration time of a row tells how
    long a sweep took.
    """
    height_m = table.si(_height(table).number)
    named = [(column, name) for column in table.columns if (name := _named(column)) is not None]
    single = [pair for pair in named if pair[1].number != _AVERAGE]
    if not named:
        labels = ", ".join(repr(column.label) for column in table.columns[:8])
        raise RecordingError(
            f"{table.name}: no current among {labels}",
            needed="columns named 'Current (A)' or 'Current [00001] (A)', '[bwd]' for backward",
            remedy="Save the sweep with its current, or build the sweep from two arrays.",
        )
    return tuple(
        read_approach(
            height_m,
            column.si_values,
            bias_V=_bias_V(table, name),
            direction=Direction.BACKWARD if name.way else Direction.FORWARD,
            label=f"{table.name}: {column.label}",
            pair=f"{table.name}: {name.number}",
            duration_s=_duration_s(table, len(height_m)),
        )
        for column, name in (single or named)
    )


def _height(table: RawTable) -> Column:
    swept = table.find(table.independent) if table.independent else None
    unit = swept.heading.unit if swept is not None else None
    if swept is None or unit is None or unit.dimension is not Dimension.LENGTH:
        raise UnitError(
            f"{table.name}: the swept column is {table.independent!r}",
            needed="a height with a unit of length, as 'Z rel (m)'",
            remedy="Take a Z spectroscopy; or build the sweep from two arrays.",
        )
    return swept


def _named(column: Column) -> _Name | None:
    match = _SWEEP.fullmatch(column.heading.stem)
    return None if match is None else _Name(match["number"] or "", match["way"] or "")


def _duration_s(table: RawTable, rows: int) -> float | None:
    """How long one way took; None where the head does not say, or says nothing readable."""
    for module in _MODULES:
        try:
            each_s = sum(float(table.metadata[module + key]) for key in _TIMES_OF_A_ROW)
        except (KeyError, ValueError):
            continue
        if math.isfinite(each_s) and each_s > 0.0:
            return rows * each_s
    return None


def _bias_V(table: RawTable, name: _Name) -> float:
    number = f" [{name.number}]" if name.number else ""
    column = table.find(f"Bias{number}{name.way}")
    if column is not None:
        return float(np.nanmedian(column.si_values))
    if _BIAS_KEY in table.metadata:
        return float(table.metadata[_BIAS_KEY])
    raise RecordingError(
        f"{table.name}: no bias for 'Current{number}{name.way}'",
        needed=f"a column 'Bias{number}{name.way} (V)' or {_BIAS_KEY!r} in the file's head",
        remedy="Save the bias with the sweep, or build the sweep from two arrays.",
    )
