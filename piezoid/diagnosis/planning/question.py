"""What a diagnosis left open, most pressing first: what the next experiment is to answer."""

from dataclasses import dataclass

from piezoid.diagnosis.diagnosis import Diagnosis, Finding, NotDetected
from piezoid.diagnosis.planning.separation import Suspect
from piezoid.diagnosis.planning.tangents import WITHOUT, tangent_of
from piezoid.errors import ExcitationError

WIDE = 0.25  # half an interval over the size: from here on it is worth a recording
VISIBLE = 2e-3  # of the stroke, of an effect these recordings could not have shown


@dataclass(frozen=True, kw_only=True)
class Question:
    """What the experiment is to answer.

    kind      ``separate``, ``tighten`` or ``detect``
    suspects  the effect asked about first, then those it is mistaken for
    finding   where it was found
    absent    where it was not
    """

    kind: str
    suspects: tuple[Suspect, ...]
    finding: Finding | None = None
    absent: NotDetected | None = None

    @property
    def effects(self) -> tuple[str, ...]:
        """Return the names."""
        return tuple(suspect.name for suspect in self.suspects)


def question_of(diagnosis: Diagnosis, effect: str | None) -> Question:
    """Return what was left open, most pressing first, or what is asked about one effect."""
    questions = [
        *_to_separate(diagnosis),
        *_to_tighten(diagnosis),
        *_to_detect(diagnosis),
    ]
    if effect is None:
        pressing = [q for q in questions if q.kind != "tighten" or _width(q.finding) > WIDE]
        return pressing[0]
    if effect in WITHOUT:
        raise ExcitationError(
            f"a plan for {effect} was asked for",
            needed="only what a drive can expose is planned for",
            remedy=f"No drive helps: {WITHOUT[effect]}.",
        )
    asked = [q for q in questions if q.effects[0] == effect]
    if not asked:
        raise ExcitationError(
            f"the diagnosis says nothing of {effect!r}",
            needed="one of " + ", ".join(sorted({q.effects[0] for q in questions})),
            remedy="Name one of these.",
        )
    return asked[0]


def suspect_of(finding: Finding, stroke_m: float) -> Suspect | None:
    """Return what was found as a plan and a picture take it, or None for a fault of the data."""
    tangent = tangent_of(finding.effect)
    if tangent is None:
        return None
    return Suspect(
        tangent=tangent,
        rms_m=max(finding.share, 1e-6) * stroke_m,
        scale=finding.parameters.get(tangent.found),
    )


def _to_separate(diagnosis: Diagnosis) -> list[Question]:
    found = {finding.effect: finding for finding in diagnosis.findings}
    questions = []
    for finding in diagnosis.findings:
        own = suspect_of(finding, diagnosis.stroke_m)
        for rival in finding.not_separable_from:
            share = found[rival].share if rival in found else finding.share
            other = _suspect(rival, share, diagnosis)
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
        own = _suspect(absent.effect, share, diagnosis)
        if own:
            questions.append(Question(kind="detect", suspects=(own,), absent=absent))
    return questions


def _suspect(name: str, share: float, diagnosis: Diagnosis) -> Suspect | None:
    tangent = tangent_of(name)
    if tangent is None:
        return None
    return Suspect(tangent=tangent, rms_m=max(share, 1e-6) * diagnosis.stroke_m)


def _width(finding: Finding | None) -> float:
    """Return half an interval over its size."""
    if finding is None:
        return 0.0
    low, high = finding.size.ci95
    return 0.5 * (high - low) / max(abs(finding.size.value), 1e-30)
