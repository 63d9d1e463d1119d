"""A plan in sentences, and as files: drive.csv and plan.json."""

from collections.abc import Mapping
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
from piezoid.diagnosis.planning.plan_ranking import Alternative
from piezoid.diagnosis.planning.separation import SeparationEstimate
from piezoid.digests import digest_of_bytes, seal
from piezoid.formatting import significant, with_unit, words

SCHEMA = "piezoid.plan/1"


def plan_files(found: Plan, *, model_digest: str, diagnosis_digest: str) -> dict[str, bytes]:
    """Return drive.csv and plan.json by name."""
    drive = found.drive.to_csv().encode()
    content = {
        "model": model_digest,
        "diagnosis": diagnosis_digest,
        "drive_csv": digest_of_bytes(drive),
        **plan_json(found),
    }
    return {"drive.csv": drive, "plan.json": seal(SCHEMA, content)}


def plan_json(found: Plan) -> dict[str, Any]:
    """Return the content of plan.json without digests."""
    question, drive = found.question, found.drive
    return {
        "axis": found.axis,
        "question": {"kind": question.kind, "effects": list(question.effects)},
        "why": " ".join(sentences(found)),
        "drive": {
            "name": drive.name,
            "why": drive.why,
            "axes": list(drive.axes),
            "sampling_rate_Hz": drive.sampling_rate_Hz,
            "samples": len(drive.voltage_V),
            "duration_s": found.duration_s,
        },
        "limits": {
            "voltage_min_V": found.limits.voltage_min_V,
            "voltage_max_V": found.limits.voltage_max_V,
            "slew_V_per_s": found.limits.slew_V_per_s,
            "from": found.limits_from,
        },
        "answers": found.answers,
        "forbids": found.forbids,
        "set_aside": [{"kind": one.kind, "effects": list(one.effects)} for one in found.set_aside],
        "before": _estimate_json(found, found.before),
        "after": _estimate_json(found, found.after),
        "size": _size(found),
        "alternatives": [_alternative(found, one) for one in found.alternatives],
    }


def _estimate_json(found: Plan, estimate: SeparationEstimate | None) -> dict[str, Any] | None:
    """Return separability, and of each effect half its expected interval over its size."""
    if estimate is None:
        return None
    halves = zip(found.question.effects, estimate.errors, strict=True)
    return {
        "separability": estimate.separability if len(estimate.errors) > 1 else None,
        "half_interval_over_size": {
            name: HALF_95 * error if isfinite(error) else None for name, error in halves
        },
    }


def _size(found: Plan) -> Mapping[str, Any]:
    """Return the size that was diagnosed, and the interval expected of it or of its limit."""
    finding = found.question.finding
    if finding is None:
        absent = found.question.absent
        expected_m = expected_limit_m(found.question, found.before, found.after)
        return {
            "unit": "m, rms",
            "detection_limit": None if absent is None else absent.detection_limit_m,
            "expected_detection_limit": expected_m,
        }
    low, high = finding.size.ci95
    return {
        "unit": finding.size.unit,
        "value": finding.size.value,
        "half": 0.5 * (high - low),
        "expected_half": expected_half(found.question, found.before, found.after),
    }


def _alternative(found: Plan, one: Alternative) -> dict[str, Any]:
    return {
        "name": one.name,
        "why": one.why,
        "duration_s": one.duration_s,
        "score": one.score,
        "expected": _estimate_json(found, one.estimate),
        "refusal": one.refusal,
    }


def sentences(found: Plan) -> tuple[str, ...]:
    """Return why, what, what to expect of it, and what was asked before it in vain."""
    if found.question.kind == "detect" and not is_open(found.question):
        return _settled(found)
    said = (_why(found.question), _what(found), _expected(found), found.forbids, _aside(found))
    return tuple(filter(None, said))


def _settled(found: Plan) -> tuple[str, ...]:
    absent = found.question.absent
    limit_m = 0.0 if absent is None else absent.detection_limit_m or 0.0
    return (
        f"These recordings show {words(found.question.effects[0])} from "
        f"{with_unit(limit_m, 'm')} rms, the smallest size that a diagnosis reports: no recording "
        "is needed.",
        f"The best drive for a check is {_played(found)}.",
    )


def _why(question: Question) -> str:
    first, *others = map(words, question.effects)
    if question.kind == "separate":
        return f"These recordings cannot separate {first} from {others[0]}."
    if question.finding is not None:
        size = question.finding.size
        low, high = map(significant, size.ci95)
        return (
            f"Size of {first} so far: {significant(size.value)} {size.unit}, 95 % interval {low} "
            f"to {high}."
        )
    limit_m = question.absent.detection_limit_m if question.absent else None
    if limit_m is None:
        return f"These recordings cannot show {first} at all."
    return f"These recordings show {first} only from {with_unit(limit_m, 'm')} rms."


def _what(found: Plan) -> str:
    played = f"{_played(found)}. {found.drive.why}"
    if found.answers:
        return f"Play {played}"
    return f"No drive answers this within these limits; the best is {played}"


def _played(found: Plan) -> str:
    drive, limits = found.drive, found.limits
    return (
        f"{drive.name}, {found.duration_s:.0f} s at {drive.sampling_rate_Hz:g} Hz between "
        f"{limits.voltage_min_V:.4g} and {limits.voltage_max_V:.4g} V"
    )


def _expected(found: Plan) -> str:
    question, before, after = found.question, found.before, found.after
    if question.kind == "separate":
        return f"{_separable(before, after)}{_lost(found)}"
    if question.finding is not None:
        size = question.finding.size
        half = 0.5 * (size.ci95[1] - size.ci95[0])
        return (
            f"Expected half width of the 95 % interval: "
            f"{significant(expected_half(question, before, after), 2)} {size.unit} (now "
            f"{significant(half, 2)})."
        )
    return _shows_from(found)


def _shows_from(found: Plan) -> str:
    question = found.question
    expected_m = expected_limit_m(question, found.before, found.after)
    is_least = expected_m <= question.floor_m
    least = ", the smallest size that a diagnosis reports" if is_least else ""
    held_m = None if question.absent is None else question.absent.detection_limit_m
    now = ", as now" if held_m is not None and expected_m >= held_m else ""
    return f"Expected detection limit: {with_unit(expected_m, 'm', 2)} rms{now}{least}."


def _separable(before: SeparationEstimate | None, after: SeparationEstimate) -> str:
    reached = f"Expected separability of the two: {after.separability:.2g} of 1"
    if before is None:
        return f"{reached}."
    shrinks = after.worst / before.worst if isfinite(before.worst) else 1.0
    narrower = (
        f"; the wider interval shrinks to {100 * shrinks:.0f} % of its width"
        if shrinks < 1.0
        else ""
    )
    return f"{reached} (now {before.separability:.2g}){narrower}."


def _lost(found: Plan) -> str:
    """Say where a size stays lost in its error, however well the two differ."""
    lost = [
        words(name)
        for name, error in zip(found.question.effects, found.after.errors, strict=True)
        if POWER * error > 1.0
    ]
    return f" The size of {' and of '.join(lost)} remains smaller than its error." if lost else ""


def _aside(found: Plan) -> str:
    if not found.set_aside:
        return ""
    asked = "; ".join(map(_asked, found.set_aside))
    return f"More important, but answered by no drive within these limits: {asked}."


def _asked(question: Question) -> str:
    first, *others = map(words, question.effects)
    if question.kind == "separate":
        return f"{first} or {others[0]}"
    return f"the size of {first}" if question.kind == "tighten" else f"whether there is {first}"
