"""Statements about data, model or controller.

Checks, fits, diagnosis, design and verification return statements. The terminal, the report and
the JSON files select and print statements without evaluating results again.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum, StrEnum


class Kind(StrEnum):
    """Subject of a statement."""

    FINDING = "finding"  # a property of the data, the stage or the model that was detected
    LIMIT = "limit"  # a property that these data do not show, or a limit of a result


class Level(IntEnum):
    """How much a statement matters to the reader."""

    NOTE = 0  # report only
    WARNING = 1  # affects how far a result can be trusted
    ACTION = 2  # the reader should do something; printed on the terminal


@dataclass(frozen=True, kw_only=True)
class Statement:
    """One fact in one to three sentences.

    Args:
        kind: finding or limit.
        level: note, warning or action.
        quantity: identifier of the quantity (``"baseline_step"``).
        text: the sentence for the reader; complete without the other fields.
        axis: name of the axis; empty if the statement concerns the stage.
        place: location in a file (column, line or row); empty if it concerns no single location.
        recording: name of the recording; empty if it concerns all recordings of the axis.
        value: the measured number in SI units; None if the statement has no number.
        unit: SI unit of ``value``.

    >>> Statement(
    ...     kind=Kind.FINDING,
    ...     level=Level.WARNING,
    ...     quantity="baseline_step",
    ...     text="The zero of sweep.csv jumps by 128 nm at 3.2 s.",
    ...     axis="x",
    ...     recording="sweep.csv",
    ...     value=128e-9,
    ...     unit="m",
    ... ).level.name
    'WARNING'
    """

    kind: Kind
    level: Level
    quantity: str
    text: str
    axis: str = ""
    place: str = ""
    recording: str = ""
    value: float | None = None
    unit: str = ""


def finding(
    quantity: str,
    text: str,
    *,
    level: Level = Level.NOTE,
    axis: str = "",
    place: str = "",
    recording: str = "",
    value: float | None = None,
    unit: str = "",
) -> Statement:
    """Return a finding, by default one that only the report and ``piezoid inspect`` show."""
    return Statement(
        kind=Kind.FINDING,
        level=level,
        quantity=quantity,
        text=text,
        axis=axis,
        place=place,
        recording=recording,
        value=value,
        unit=unit,
    )


def limit(
    level: Level,
    quantity: str,
    text: str,
    *,
    axis: str = "",
    recording: str = "",
    value: float | None = None,
    unit: str = "",
) -> Statement:
    """Return a statement about a property that the data do not show, or a limit of a result."""
    return Statement(
        kind=Kind.LIMIT,
        level=level,
        quantity=quantity,
        text=text,
        axis=axis,
        recording=recording,
        value=value,
        unit=unit,
    )


def select(
    statements: Iterable[Statement], *, minimum: Level = Level.NOTE
) -> tuple[Statement, ...]:
    """Return the statements at or above a level, most important first, without repeats.

    Args:
        statements: statements in the order in which they were made.
        minimum: lowest level that is kept.
    """
    selected = dict.fromkeys(s for s in statements if s.level >= minimum)
    return tuple(sorted(selected, key=lambda statement: -statement.level))
