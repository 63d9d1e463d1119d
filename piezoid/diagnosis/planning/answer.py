"""How much of an open question a drive would answer, before it is played.

What is left of a question is 1 where nothing is gained and 0 where all is answered: of a size,
half its expected interval over half the present one; of an effect not seen, the rms from which it
would show over that from which it shows now; of two that look alike, the error of the less known
size, with the other free beside it, over what it is now.

The errors of separation.py are rather too small, so that their ratios are trusted: where the
recordings are at hand, what a diagnosis says now is taken to shrink as its standard error does.
"""

from math import isfinite, sqrt

from piezoid.diagnosis.diagnosis import Size
from piezoid.diagnosis.planning.question import Question
from piezoid.diagnosis.planning.separation import Told

HALF_95 = 1.96  # standard errors
POWER = 2.8  # standard errors of the smallest size that is found in four of five cases
WORTHWHILE = 0.8  # of what is open: a recording that leaves more is not worth its time


def answers(question: Question, before: Told | None, after: Told) -> bool:
    """Tell whether a drive answers enough of a question to be worth playing."""
    told = question.kind != "separate" or POWER * after.worst <= 1.0
    return told and left_open(question, before, after) <= WORTHWHILE


def left_open(question: Question, before: Told | None, after: Told) -> float:
    """Return how much of a question a drive leaves, 0 to 1."""
    if question.kind == "separate":
        now = 1.0 / POWER if before is None else before.worst
        return _ratio(after.worst, now)
    if question.finding is not None:
        return _ratio(expected_half(question, before, after), _half(question.finding.size))
    held_m = None if question.absent is None else question.absent.detection_limit_m
    now_m = question.suspects[0].rms_m if held_m is None else held_m
    return _ratio(expected_limit_m(question, before, after), now_m)


def _ratio(after: float, now: float) -> float:
    if not isfinite(after):
        return 1.0
    return min(after / now, 1.0) if now > 0.0 else 1.0


def _half(size: Size) -> float:
    low, high = size.ci95
    return 0.5 * (high - low)


def expected_half(question: Question, before: Told | None, after: Told) -> float:
    """Return half the interval to expect of the size that was diagnosed, in its own unit.

    Without the recordings, what the planned drive alone would say is added to what was known.
    """
    finding = question.finding
    if finding is None:
        raise TypeError("no size was diagnosed")
    half, error = _half(finding.size), after.errors[0]
    if before is not None and isfinite(before.errors[0]):
        return half * min(error / before.errors[0], 1.0)
    if not isfinite(error):
        return half
    alone = HALF_95 * error * abs(finding.size.value)
    return half * alone / sqrt(half**2 + alone**2) if half > 0.0 else 0.0


def expected_limit_m(question: Question, before: Told | None, after: Told) -> float:
    """Return the rms from which an effect would show, m.

    Never less than what the diagnosis asks of an effect before it names it, however often a drive
    repeats it: below that, shapes of the model's own error pass for causes.
    """
    held_m = None if question.absent is None else question.absent.detection_limit_m
    alone_m = POWER * after.errors[0] * question.suspects[0].rms_m
    if held_m is None:
        return max(alone_m, question.floor_m)
    if before is not None and isfinite(before.errors[0]):
        alone_m = held_m * after.errors[0] / before.errors[0]
    return min(max(alone_m, question.floor_m), held_m)
