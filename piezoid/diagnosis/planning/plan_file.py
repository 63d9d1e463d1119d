"""A plan as files, drive.csv and plan.json, and as three sentences."""

from collections.abc import Mapping
from math import isfinite, sqrt
from typing import Any

from piezoid.diagnosis.experiment import Alternative, Plan
from piezoid.diagnosis.planning.separation import Told
from piezoid.provenance import digest_of_bytes, seal

SCHEMA = "piezoid.plan/1"
HALF_95 = 1.96  # standard errors
POWER = 2.8  # standard errors of the smallest size that is found in four of five cases


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
        "before": _told(found, found.before),
        "after": _told(found, found.after),
        "size": _size(found),
        "alternatives": [_alternative(found, one) for one in found.alternatives],
    }


def sentences(found: Plan) -> tuple[str, str, str]:
    """Return why, what, and what to expect of it."""
    return _why(found), _what(found), _expected(found)


def _why(found: Plan) -> str:
    first, *others = found.question.effects
    if found.question.kind == "separate":
        return f"These recordings show {first} or {others[0]} and cannot tell which."
    if found.question.finding is not None:
        size = found.question.finding.size
        low, high = size.ci95
        return (
            f"These recordings give {first} as {size.value:.3g} {size.unit}, anywhere from "
            f"{low:.3g} to {high:.3g}."
        )
    limit_m = found.question.absent.detection_limit_m if found.question.absent else None
    if limit_m is None:
        return f"These recordings cannot show {first} at all."
    return f"These recordings would show {first} only from {1e9 * limit_m:.3g} nm rms."


def _what(found: Plan) -> str:
    drive, limits = found.drive, found.limits
    return (
        f"Play {drive.name}, {found.duration_s:.0f} s at {drive.sampling_rate_Hz:g} Hz between "
        f"{limits.voltage_min_V:g} and {limits.voltage_max_V:g} V. {drive.why}"
    )


def _expected(found: Plan) -> str:
    before, after = found.before, found.after
    if found.question.kind == "separate":
        if before is None:
            return f"Expect the separability of the two to be {after.separability:.2g} of 1."
        return (
            f"Expect the separability of the two to be {after.separability:.2g} of 1 where it is "
            f"{before.separability:.2g} now, and the wider of their intervals to shrink to "
            f"{100 * min(after.worst / before.worst, 1.0):.0f} % of what it is."
        )
    size = _size(found)
    if "expected_half" in size and size["half"] is not None:
        return (
            f"Expect half the 95 % interval to be {size['expected_half']:.2g} {size['unit']} "
            f"where it is {size['half']:.2g} now."
        )
    limit_m = POWER * after.errors[0] * found.question.suspects[0].rms_m
    return f"Expect it to show from {1e9 * limit_m:.2g} nm rms."


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
    finding, error = found.question.finding, found.after.errors[0]
    if finding is None:
        suspect = found.question.suspects[0]
        absent = found.question.absent
        return {
            "unit": "m, rms",
            "detection_limit": None if absent is None else absent.detection_limit_m,
            "expected_detection_limit": POWER * error * suspect.rms_m,
        }
    low, high = finding.size.ci95
    return {
        "unit": finding.size.unit,
        "value": finding.size.value,
        "half": 0.5 * (high - low),
        "expected_half": expected_half(found),
    }


def expected_half(found: Plan) -> float:
    """Return half the interval to expect of the size that was diagnosed, in its own unit.

    With the recordings at hand the interval is taken to shrink as its standard error does; without
    them what the planned drive alone would say is added to what was known.
    """
    finding = found.question.finding
    if finding is None:
        raise TypeError("no size was diagnosed")
    low, high = finding.size.ci95
    half, error = 0.5 * (high - low), found.after.errors[0]
    if found.before is not None and isfinite(found.before.errors[0]):
        return half * min(error / found.before.errors[0], 1.0)
    alone = HALF_95 * error * abs(finding.size.value)
    return half * alone / sqrt(half**2 + alone**2) if half > 0.0 else 0.0


def _alternative(found: Plan, one: Alternative) -> dict[str, Any]:
    return {
        "name": one.name,
        "why": one.why,
        "duration_s": one.duration_s,
        "score": one.score,
        "expected": _told(found, one.told),
        "refusal": one.refusal,
    }
