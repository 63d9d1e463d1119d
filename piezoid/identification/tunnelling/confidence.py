"""How far a result of the tunnelling junction may be trusted, and what speaks against it."""

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum


class Confidence(Enum):
    """How far a result may be trusted."""

    HIGH = "high"
    MEDIUM = "medium"
    LOW = "low"


@dataclass(frozen=True, kw_only=True)
class Reason:
    """Why a result deserves less than full confidence.

    grade  highest confidence that the result can have despite it
    text   one sentence with the number and the limit it exceeds
    """

    grade: Confidence
    text: str


def lowest_grade(reasons: Iterable[Reason]) -> tuple[Confidence, tuple[Reason, ...]]:
    """Return the lowest grade of the reasons, high without any, and the reasons, worst first."""
    worst_first = sorted(reasons, key=lambda reason: reason.grade is not Confidence.LOW)
    grade = worst_first[0].grade if worst_first else Confidence.HIGH
    return grade, tuple(worst_first)
