"""Confidence rating of a result of the tunnelling junction, with its reasons."""

from collections.abc import Iterable
from enum import Enum


class Confidence(Enum):
    """Rating of a result, from best to worst."""

    HIGH = "high"
    MEDIUM = "medium"
    LOW = "low"


Reason = tuple[Confidence, str]  # highest possible rating, and a sentence with numbers


def lowest_grade(reasons: Iterable[Reason]) -> tuple[Confidence, tuple[str, ...]]:
    """Return the lowest rating of the reasons (high without any), and their texts, worst first."""
    by_grade = sorted(reasons, key=lambda reason: reason[0] is not Confidence.LOW)
    grade = by_grade[0][0] if by_grade else Confidence.HIGH
    return grade, tuple(text for _, text in by_grade)
