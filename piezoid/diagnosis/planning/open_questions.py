"""Open questions of a diagnosis, and the uncertainty that remains after a drive.

The remaining uncertainty is 1 if nothing is gained and 0 if the question is answered. For a size
it is the expected interval over the present interval; for an effect that was not detected, the
expected detection limit over the present limit; for two confounded effects, the error of the less
certain size, with the other free, over its present value.

The errors of ``separation`` are too small, but their ratios are reliable: if the recordings are
given, the interval of the diagnosis is expected to shrink in proportion to the standard error.
"""

from dataclasses import dataclass, replace
from math import inf, isfinite, sqrt

from piezoid.diagnosis.candidate import MINIMUM_SHARE
from piezoid.diagnosis.diagnosis import Diagnosis, Finding, NotDetected
from piezoid.diagnosis.effect import Tangent
from piezoid.diagnosis.effects import effect_named, every_effect
from piezoid.diagnosis.planning.separation import SeparationEstimate, Suspect
from piezoid.errors import ExcitationError

HALF_95 = 1.96  # standard errors
POWER = 2.8  # standard errors of the smallest size that is detected in four cases of five
WIDE = 0.25  # half the interval over the size from which a size is worth a recording
UNTESTED_SHARE = 2e-3  # of the stroke: assumed size of an effect that was not tested
LOWERABLE = 1.25  # detection limit over the smallest size that is named


@dataclass(frozen=True, kw_only=True)
class Question:
    """A question that an experiment may answer.

    kind      ``separate``, ``tighten`` or ``detect``
    suspects  the effect in question, then the effects with which it may be confounded
    finding   finding of the effect, if it was detected
    absent    record of the effect, if it was not detected
    floor_m   rms below which the diagnosis does not name the effect
    """

    kind: str
    suspects: tuple[Suspect, ...]
    finding: Finding | None = None
    absent: NotDetected | None = None
    floor_m: float = 0.0

    @property
    def effects(self) -> tuple[str, ...]:
        """Return the names of the effects."""
        return tuple(suspect.name for suspect in self.suspects)

    @property
    def limit_m(self) -> float | None:
        """Return the present detection limit; None if the effect was detected or not tested."""
        return None if self.absent is None else self.absent.detection_limit_m


def questions_of(diagnosis: Diagnosis, effect: str | None) -> tuple[Question, ...]:
    """Return the open questions of a diagnosis, or all about one effect, most pressing first.

    Raises ``ExcitationError`` if no question is open, or none is about the effect.
    """
    questions = _every_question(diagnosis)
    if effect is None:
        pressing = tuple(question for question in questions if is_open(question))
        if not pressing:
            raise ExcitationError(
                "the diagnosis has no open question that a drive could answer",
                needed="confounded effects, wide intervals, or effects with a high detection "
                "limit",
                remedy="No recording is needed. To plan one for an effect, name it with --effect.",
            )
        return pressing
    tangent = _tangent_of(effect)
    if isinstance(tangent, str):
        raise ExcitationError(
            f"no drive can be planned for {effect}: {tangent}",
            needed="an effect whose size one drive determines",
            remedy="Follow its next_experiment in diagnosis.json.",
        )
    about = tuple(question for question in questions if question.effects[0] == effect)
    if not about:
        raise ExcitationError(
            f"the diagnosis has no effect {effect!r}",
            needed="one of " + ", ".join(sorted({q.effects[0] for q in questions})),
            remedy="Name one of these.",
        )
    return about


def _every_question(diagnosis: Diagnosis) -> list[Question]:
    """Return the effects to separate, the sizes to tighten, and the effects to detect."""
    questions, detections = [], []
    stroke_m, findings = diagnosis.stroke_m, diagnosis.findings
    shares = {finding.effect: finding.share for finding in findings}
    suspects = {finding.effect: suspect_of(finding, stroke_m) for finding in findings}
    for finding in findings:
        suspect = suspects[finding.effect]
        for name in finding.not_separable_from if finding.needs_recording else ():
            alternative = _suspect(name, shares.get(name, finding.share), stroke_m)
            if suspect and alternative:
                pair = (suspect, alternative)
                questions.append(Question(kind="separate", suspects=pair, finding=finding))
    for finding in sorted(findings, key=lambda f: f.size.relative_width, reverse=True):
        suspect = suspects[finding.effect]
        if suspect:
            further = tuple(s for s in suspects.values() if s and s.name != finding.effect)
            questions.append(
                Question(kind="tighten", suspects=(suspect, *further), finding=finding)
            )
    for absent in diagnosis.not_detected:
        limit_m = absent.detection_limit_m
        share = UNTESTED_SHARE if limit_m is None else limit_m / stroke_m
        suspect = _suspect(absent.effect, share, stroke_m)
        if suspect is None:
            continue
        min_gain = effect_named(absent.effect).minimum_gain
        floor_m = max(MINIMUM_SHARE * stroke_m, diagnosis.envelope_rms_m * sqrt(2.0 * min_gain))
        detections.append(
            Question(kind="detect", suspects=(suspect,), absent=absent, floor_m=floor_m)
        )

    def limit(question: Question) -> float:
        return inf if question.limit_m is None else question.limit_m

    return [*questions, *sorted(detections, key=limit, reverse=True)]


def is_open(question: Question) -> bool:
    """Tell whether a question is worth a recording."""
    if question.kind == "tighten":
        return question.finding is not None and question.finding.size.relative_width > WIDE
    return question.limit_m is None or question.limit_m > LOWERABLE * question.floor_m


def suspect_of(finding: Finding, stroke_m: float) -> Suspect | None:
    """Return the suspect of a finding, or None for a fault of the data."""
    suspect = _suspect(finding.effect, finding.share, stroke_m)
    return suspect and replace(
        suspect, scale=finding.parameters.get(suspect.tangent.scale_parameter)
    )


def _suspect(name: str, share: float, stroke_m: float) -> Suspect | None:
    tangent = _tangent_of(name)
    if not isinstance(tangent, Tangent):
        return None
    return Suspect(name=name, tangent=tangent, rms_m=max(share, 1e-6) * stroke_m)


def _tangent_of(name: str) -> Tangent | str | None:
    """Return the tangent of an effect, or the reason for having none; None if it is unknown."""
    return next((effect.tangent for effect in every_effect() if effect.name == name), None)


def remaining_uncertainty(
    question: Question, recorded: SeparationEstimate | None, planned: SeparationEstimate
) -> float:
    """Return the share of the uncertainty that remains after a drive, 0 to 1."""
    if question.kind == "separate":
        expected, present = planned.worst, 1.0 / POWER if recorded is None else recorded.worst
    elif question.finding is not None:
        expected = expected_half(question, recorded, planned)
        present = question.finding.size.half_width
    else:
        expected = expected_limit_m(question, recorded, planned)
        present = question.suspects[0].rms_m if question.limit_m is None else question.limit_m
    if not isfinite(expected) or present <= 0.0:
        return 1.0
    return min(expected / present, 1.0)


def expected_half(
    question: Question, recorded: SeparationEstimate | None, planned: SeparationEstimate
) -> float:
    """Return the expected half width of the interval of a diagnosed size, in its unit.

    Without the recordings, the information of the planned drive is added to that of the diagnosis.
    """
    assert question.finding is not None
    size, error = question.finding.size, planned.errors[0]
    half = size.half_width
    if recorded is not None and isfinite(recorded.errors[0]):
        return half * min(error / recorded.errors[0], 1.0)
    if not isfinite(error):
        return half
    planned_half = HALF_95 * error * abs(size.value)
    return half * planned_half / sqrt(half**2 + planned_half**2) if half > 0.0 else 0.0


def expected_limit_m(
    question: Question, recorded: SeparationEstimate | None, planned: SeparationEstimate
) -> float:
    """Return the expected detection limit of an effect, rms in m.

    It is never below the minimum size that the diagnosis reports, however often a drive is
    repeated: smaller shapes may be model error.
    """
    present_m = question.limit_m
    expected_m = POWER * planned.errors[0] * question.suspects[0].rms_m
    if present_m is None:
        return max(expected_m, question.floor_m)
    if recorded is not None and isfinite(recorded.errors[0]):
        expected_m = present_m * planned.errors[0] / recorded.errors[0]
    return min(max(expected_m, question.floor_m), present_m)
