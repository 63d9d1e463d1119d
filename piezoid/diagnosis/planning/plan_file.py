"""A plan as files, drive.csv and plan.json."""

from collections.abc import Mapping
from math import isfinite
from typing import Any

from piezoid.diagnosis.experiment import Plan
from piezoid.diagnosis.planning.answer import HALF_95, expected_half, expected_limit_m
from piezoid.diagnosis.planning.plan_words import sentences
from piezoid.diagnosis.planning.separation import Told
from piezoid.diagnosis.planning.table import Alternative
from piezoid.provenance import digest_of_bytes, seal

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
        "before": _told(found, found.before),
        "after": _told(found, found.after),
        "size": _size(found),
        "alternatives": [_alternative(found, one) for one in found.alternatives],
    }


def _told(found: Plan, told: Told | None) -> dict[str, Any] | None:
    """Return separability, and of each effect half its expected interval over its size."""
    if told is None:
        return None
    halves = zip(found.question.effects, told.errors, strict=True)
    return {
        "separability": told.separability if len(told.errors) > 1 else None,
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
        "expected": _told(found, one.told),
        "refusal": one.refusal,
    }
