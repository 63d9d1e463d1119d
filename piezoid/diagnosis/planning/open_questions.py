"""What a diagnosis left open, most pressing first: what the next experiment is to answer.

What a drive leaves of a question is 1 where nothing is gained and 0 where all is answered: of a
size, half its expected interval over half the present one; of an effect not seen, the rms from
which it would show over that from which it shows now; of two that look alike, the error of the
less known size, with the other free beside it, over what it is now.

The errors of separation.py are rather too small, so that their ratios are trusted: where the
recordings are at hand, what a diagnosis says now is taken to shrink as its standard error does.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import isfinite, sqrt

from piezoid.diagnosis.candidate import MINIMUM_SHARE
from piezoid.diagnosis.diagnosis import Diagnosis, Finding, NotDetected, Size
from piezoid.diagnosis.effect import Tangent
from piezoid.diagnosis.effects import effect_named, every_effect
from piezoid.diagnosis.planning.separation import SeparationEstimate, Suspect
from piezoid.errors import ExcitationError

HALF_95 = 1.96  # standard errors
POWER = 2.8  # standard errors of the smallest size that is found in four of five cases
WORTHWHILE = 0.8  # of what is open: a recording that leaves more is not worth its time
WIDE = 0.25  # half an interval over the size: from here on it is worth a recording
VISIBLE = 2e-3  # of the stroke, of an effect these recordings could not have shown
ABOVE = 1.25  # times the least that is ever named: from here on a limit can be lowered


@dataclass(frozen=True, kw_only=True)
class Question:
    """What the experiment is to answer.

    kind      ``separate``, ``tighten`` or ``detect``
    suspects  the effect asked about first, then those it is mistaken for
    finding   where it was found
    absent    where it was not
    floor_m   rms below which the diagnosis names no such effect, however well it shows
    """

    kind: str
    suspects: tuple[Suspect, ...]
    finding: Finding | None = None
    absent: NotDetected | None = None
    floor_m: float = 0.0

    @property
    def effects(self) -> tuple[str, ...]:
        """Return the names."""
        return tuple(suspect.name for suspect in self.suspects)


def questions_of(diagnosis: Diagnosis, effect: str | None) -> tuple[Question, ...]:
    """Return what was left open, most pressing first, or what can be asked about one effect.

    Raises ``ExcitationError`` where nothing is left to ask, and for a name that is no question.
    """
    questions = [
        *_to_separate(diagnosis),
        *_to_tighten(diagnosis),
        *_to_detect(diagnosis),
    ]
    if effect is None:
        return _pressing(questions)
    tangent = _tangent_of(effect)
    if isinstance(tangent, str):
        raise ExcitationError(
            f"a plan for {effect} was asked for",
            needed="an effect that a drive can expose",
            remedy=f"No drive helps: {tangent}.",
        )
    asked = tuple(q for q in questions if q.effects[0] == effect)
    if not asked:
        raise ExcitationError(
            f"the diagnosis says nothing of {effect!r}",
            needed="one of " + ", ".join(sorted({q.effects[0] for q in questions})),
            remedy="Name one of these.",
        )
    return asked


def _pressing(questions: Sequence[Question]) -> tuple[Question, ...]:
    found = tuple(one for one in questions if is_open(one))
    if not found:
        raise ExcitationError(
            "the diagnosis leaves nothing open that a drive could show better",
            needed="effects not told apart, wide intervals, or effects that could hide",
            remedy="No recording is needed; name one with --effect to ask all the same.",
        )
    return found


def is_open(question: Question) -> bool:
    """Tell whether a question is worth asking unasked."""
    if question.kind == "tighten":
        return _width(question.finding) > WIDE
    limit_m = None if question.absent is None else question.absent.detection_limit_m
    return limit_m is None or limit_m > ABOVE * question.floor_m


def suspect_of(finding: Finding, stroke_m: float) -> Suspect | None:
    """Return what was found as a plan and a picture take it, or None for a fault of the data."""
    own = _suspect(finding.effect, finding.share, stroke_m)
    return own and replace(own, scale=finding.parameters.get(own.tangent.found))


def _to_separate(diagnosis: Diagnosis) -> list[Question]:
    found = {finding.effect: finding for finding in diagnosis.findings}
    questions = []
    for finding in diagnosis.findings:
        own = suspect_of(finding, diagnosis.stroke_m)
        for alternative in finding.not_separable_from:
            share = found[alternative].share if alternative in found else finding.share
            other = _suspect(alternative, share, diagnosis.stroke_m)
            if own and other:
                questions.append(Question(kind="separate", suspects=(own, other), finding=finding))
    return questions


def _to_tighten(diagnosis: Diagnosis) -> list[Question]:
    questions = []
    for finding in sorted(diagnosis.findings, key=_width, reverse=True):
        own = suspect_of(finding, diagnosis.stroke_m)
        beside = [suspect_of(f, diagnosis.stroke_m) for f in diagnosis.findings]
        others = tuple(s for s in beside if s and s.name != finding.effect)
        if own:
            questions.append(Question(kind="tighten", suspects=(own, *others), finding=finding))
    return questions


def _to_detect(diagnosis: Diagnosis) -> list[Question]:
    def openness(absent: NotDetected) -> float:
        limit_m = absent.detection_limit_m
        return float("inf") if limit_m is None else limit_m

    questions = []
    for absent in sorted(diagnosis.not_detected, key=openness, reverse=True):
        limit_m = absent.detection_limit_m
        share = VISIBLE if limit_m is None else limit_m / diagnosis.stroke_m
        own = _suspect(absent.effect, share, diagnosis.stroke_m)
        # below which the diagnosis itself names no such effect
        effect = effect_named(absent.effect)
        worth_m = diagnosis.envelope_rms_m * sqrt(2.0 * effect.minimum_gain)
        floor_m = max(MINIMUM_SHARE * diagnosis.stroke_m, worth_m)
        if own:
            questions.append(
                Question(kind="detect", suspects=(own,), absent=absent, floor_m=floor_m)
            )
    return questions


def _suspect(name: str, share: float, stroke_m: float) -> Suspect | None:
    tangent = _tangent_of(name)
    if not isinstance(tangent, Tangent):
        return None
    return Suspect(name=name, tangent=tangent, rms_m=max(share, 1e-6) * stroke_m)


def _tangent_of(name: str) -> Tangent | str | None:
    """Return the tangent of a name, or why it has none; None for a name that is no effect."""
    return next((effect.tangent for effect in every_effect() if effect.name == name), None)


def _width(finding: Finding | None) -> float:
    """Return half an interval over its size."""
    if finding is None:
        return 0.0
    low, high = finding.size.ci95
    return 0.5 * (high - low) / max(abs(finding.size.value), 1e-30)


def answers(
    question: Question, before: SeparationEstimate | None, after: SeparationEstimate
) -> bool:
    """Tell whether a drive answers enough of a question to be worth playing."""
    stand_out = question.kind != "separate" or POWER * after.worst <= 1.0
    return stand_out and left_open(question, before, after) <= WORTHWHILE


def left_open(
    question: Question, before: SeparationEstimate | None, after: SeparationEstimate
) -> float:
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


def expected_half(
    question: Question, before: SeparationEstimate | None, after: SeparationEstimate
) -> float:
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


def expected_limit_m(
    question: Question, before: SeparationEstimate | None, after: SeparationEstimate
) -> float:
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
