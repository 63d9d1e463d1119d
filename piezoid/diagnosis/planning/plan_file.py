"""Write a plan as sentences and as files: drive.csv and plan.json."""

from math import isfinite
from typing import Any

from piezoid.diagnosis.experiment import Plan
from piezoid.diagnosis.planning.open_questions import (
    HALF_95,
    POWER,
    Question,
    expected_half,
    expected_limit_m,
    is_open,
)
from piezoid.diagnosis.planning.separation import SeparationEstimate
from piezoid.digests import digest_of_bytes, seal
from piezoid.formatting import resolved_percent, significant, with_unit, words

SCHEMA = "piezoid.plan/1"
MAX_ERROR = 10.0  # relative: a larger error is no size
ALONE = (
    "The recordings of the diagnosis were not given: the estimate is for the new drive alone, and "
    "too optimistic."
)


def plan_files(plan: Plan, *, model_digest: str, diagnosis_digest: str) -> dict[str, bytes]:
    """Return drive.csv and plan.json by name."""
    question, drive, limits = plan.question, plan.drive, plan.limits
    drive_csv = drive.to_csv().encode()
    size: dict[str, Any]
    if question.finding is None:
        size = {
            "unit": "m, rms",
            "detection_limit": question.limit_m,
            "expected_detection_limit": expected_limit_m(question, plan.recorded, plan.planned),
        }
    else:
        size = {
            "unit": question.finding.size.unit,
            "value": question.finding.size.value,
            "half": question.finding.size.half_width,
            "expected_half": expected_half(question, plan.recorded, plan.planned),
        }
    content = {
        "model": model_digest,
        "diagnosis": diagnosis_digest,
        "drive_csv": digest_of_bytes(drive_csv),
        "axis": plan.axis,
        "question": _question_json(question),
        "why": " ".join(sentences(plan)),
        "drive": {
            "name": drive.name,
            "why": drive.why,
            "axes": list(drive.axes),
            "sampling_rate_Hz": drive.sampling_rate_Hz,
            "samples": len(drive.voltage_V),
            "duration_s": drive.duration_s,
        },
        "limits": {
            "voltage_min_V": limits.voltage_min_V,
            "voltage_max_V": limits.voltage_max_V,
            "slew_V_per_s": limits.slew_V_per_s,
            "from": f"{plan.bench.range_from}; {plan.bench.speed_from}",
        },
        "answers": plan.answers,
        "forbids": plan.forbids,
        "set_aside": [_question_json(question) for question in plan.set_aside],
        "before": _estimate_json(question, plan.recorded),
        "after": _estimate_json(question, plan.planned),
        "size": size,
        "alternatives": [
            {
                "name": alternative.name,
                "why": alternative.why,
                "duration_s": alternative.duration_s,
                "score": alternative.score,
                "expected": _estimate_json(question, alternative.estimate),
                "refusal": alternative.refusal,
            }
            for alternative in plan.alternatives
        ],
    }
    return {"drive.csv": drive_csv, "plan.json": seal(SCHEMA, content)}


def _question_json(question: Question) -> dict[str, Any]:
    return {"kind": question.kind, "effects": list(question.effects)}


def _estimate_json(
    question: Question, estimate: SeparationEstimate | None
) -> dict[str, Any] | None:
    """Return the separability, and the relative half width of the interval of each effect."""
    if estimate is None:
        return None
    return {
        "separability": estimate.separability if len(estimate.errors) > 1 else None,
        "half_interval_over_size": {
            name: HALF_95 * error if isfinite(error) else None
            for name, error in zip(question.effects, estimate.errors, strict=True)
        },
    }


def sentences(plan: Plan) -> tuple[str, ...]:
    """Return reason, drive, expectation and remaining questions of a plan."""
    question, drive, limits = plan.question, plan.drive, plan.limits
    drive_text = (
        f"{drive.name}, {drive.duration_s:.0f} s, {drive.sampling_rate_Hz:g} samples/s "
        f"between {limits.voltage_min_V:.4g} and {limits.voltage_max_V:.4g} V, at most "
        f"{with_unit(limits.slew_V_per_s, 'V/s')}"
    )
    if plan.bench.speed_from not in plan.forbids:
        drive_text += f" ({plan.bench.speed_from})"
    if question.kind == "detect" and not is_open(question):
        return (
            f"These recordings show {words(question.effects[0])} from "
            f"{with_unit(question.limit_m or 0.0, 'm')} rms, the smallest size that a diagnosis "
            "reports: no recording is needed.",
            f"The best drive for a check is {drive_text}.",
        )
    verdict = "No drive answers this question within these limits; the best is"
    unanswered = "; ".join(map(_topic, plan.set_aside))
    texts = (
        _reason(question),
        f"{'Play' if plan.answers else verdict} {drive_text}. {drive.why}",
        _expectation(plan),
        _advice(plan),
        ALONE if plan.recorded is None else "",
        plan.forbids,
        f"More important, but answered by no drive within these limits: {unanswered}."
        if unanswered
        else "",
    )
    return tuple(text for text in texts if text)


def _topic(question: Question) -> str:
    first, *further = map(words, question.effects)
    return {
        "separate": f"{first} or {' or '.join(further)}",
        "tighten": f"the size of {first}",
        "detect": f"whether there is {first}",
    }[question.kind]


def _reason(question: Question) -> str:
    first, *further = map(words, question.effects)
    if question.kind == "separate":
        return f"These recordings cannot separate {first} from {further[0]}."
    if question.finding is not None:
        size = question.finding.size
        low, high = map(significant, size.ci95)
        return (
            f"Size of {first} so far: {significant(size.value)} {size.unit}, 95 % interval {low} "
            f"to {high}."
        )
    if question.limit_m is None:
        reason = f": {question.absent.reason}" if question.absent is not None else ""
        return f"These recordings cannot show {first}{reason}."
    return f"These recordings show {first} only from {with_unit(question.limit_m, 'm')} rms."


def _advice(plan: Plan) -> str:
    """Compare the drive with the experiment that the diagnosis recommends, if it is another."""
    suspect, drive = plan.question.suspects[0], plan.drive
    names = () if plan.question.kind == "detect" else suspect.tangent.advised
    advised = next((a for a in plan.alternatives if a.name in names), None)
    if advised is None or advised.estimate is None or drive.name in names:
        return ""
    return (
        f"The report recommends {advised.name} for {words(suspect.name)}, "
        f"{advised.duration_s:.0f} s with an expected standard error of "
        f"{standard_error(plan.question, advised.estimate)}; {drive.name} takes "
        f"{drive.duration_s:.0f} s for {standard_error(plan.question, plan.planned)}."
    )


def standard_error(question: Question, estimate: SeparationEstimate) -> str:
    """Return the expected relative standard error of the size in question, as text."""
    error = estimate.worst if question.kind == "separate" else estimate.errors[0]
    return f"{significant(100 * error, 2)} %" if error < MAX_ERROR else "not shown"


def _expectation(plan: Plan) -> str:
    question, recorded, planned = plan.question, plan.recorded, plan.planned
    if question.kind == "separate":
        text = f"Expected separability of the two: {resolved_percent(planned.separability)}"
        if recorded is not None:
            text += f" (now {resolved_percent(recorded.separability)})"
            shrinks = planned.worst / recorded.worst if isfinite(recorded.worst) else 1.0
            if shrinks < 1.0:
                text += f"; the wider interval shrinks to {100 * shrinks:.0f} % of its width"
        uncertain = [
            words(name)
            for name, error in zip(question.effects, planned.errors, strict=True)
            if POWER * error > 1.0
        ]
        if uncertain:
            text += f". The size of {' and of '.join(uncertain)} remains smaller than its error"
        return f"{text}."
    if question.finding is not None:
        size = question.finding.size
        expected = significant(expected_half(question, recorded, planned), 2)
        return (
            f"Expected half width of the 95 % interval: {expected} {size.unit} (now "
            f"{significant(size.half_width, 2)})."
        )
    expected_m = expected_limit_m(question, recorded, planned)
    now = ", as now" if question.limit_m is not None and expected_m >= question.limit_m else ""
    is_smallest = expected_m <= question.floor_m
    smallest = ", the smallest size that a diagnosis reports" if is_smallest else ""
    return f"Expected detection limit: {with_unit(expected_m, 'm', 2)} rms{now}{smallest}."
