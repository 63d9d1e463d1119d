"""Write and read diagnosis.json."""

from collections.abc import Mapping, Sequence
from typing import Any

from piezoid.diagnosis.diagnosis import (
    SOMETHING_ELSE,
    Diagnosis,
    FinalError,
    Finding,
    HeldOut,
    NotDetected,
    Unexplained,
)
from piezoid.diagnosis.effects import every_effect
from piezoid.digests import seal, unseal
from piezoid.record_json import RecordLayout, fields_of, from_fields, from_json, refusing, to_json

SCHEMA = "piezoid.diagnosis/1"
REMEDY = "Diagnose the recordings again with this version."
OTHER_ENTRIES = ("schema", "digest", "axes", "since_model")  # beside the first diagnosis
NOT_WRITTEN = ("strengths", "model")
# field -> entry of the file with another name
HELD_OUT = {"rms_m": "held_out_rms_m", "rms_percent": "held_out_rms_percent"}
UNEXPLAINED = {"gain": "coordinate_gain"}
NOT_DETECTED = {"upper_bound_m": "upper_bound", "detection_limit_m": "detection_limit"}


def write_diagnosis(
    diagnosis: Diagnosis,
    *,
    further_axes: Sequence[Diagnosis] = (),
    changes: Mapping[str, Any] | None = None,
) -> bytes:
    """Return the sealed bytes of diagnosis.json.

    further_axes  diagnoses of further axes, under ``axes``
    changes       changes since a model was fitted, under ``since_model``
    """
    content = to_json(diagnosis, LAYOUTS)
    if further_axes:
        content["axes"] = {further.axis: to_json(further, LAYOUTS) for further in further_axes}
    if changes is not None:
        content["since_model"] = dict(changes)
    return seal(SCHEMA, content)


def read_diagnoses(content: bytes, location: str = "diagnosis.json") -> tuple[Diagnosis, ...]:
    """Read the diagnoses of all axes from diagnosis.json.

    Raises ``ParameterFileError`` if the digest does not match, the schema is different, or an
    entry is missing or of another type.
    """
    record = unseal(content, SCHEMA, location)
    with refusing(SCHEMA, location, remedy=REMEDY):
        first = {name: entry for name, entry in record.items() if name not in OTHER_ENTRIES}
        axes = (first, *record.get("axes", {}).values())
        return tuple(from_json(Diagnosis, axis, LAYOUTS) for axis in axes)


def _diagnosis_entries(diagnosis: Diagnosis) -> dict[str, Any]:
    unit = "counts, rms" if "displacement" in diagnosis.counted else "m, rms"
    entries = {n: v for n, v in fields_of(diagnosis).items() if n not in NOT_WRITTEN}
    not_detected = [[*_rename(fields_of(n), NOT_DETECTED).items()] for n in diagnosis.not_detected]
    entries["not_detected"] = [dict([*e[:2], ("unit", unit), *e[2:]]) for e in not_detected]
    return _without_empty(entries, "unexplained", "budget", "counted")


def _check_effect(table: Mapping[str, Any]) -> Mapping[str, Any]:
    if table["effect"] not in {SOMETHING_ELSE, *(effect.name for effect in every_effect())}:
        raise ValueError(f"effect {table['effect']!r}, which this version does not know")
    return table


def _without_empty(entries: dict[str, Any], *optional: str) -> dict[str, Any]:
    """Omit optional entries that are empty."""
    return {name: entry for name, entry in entries.items() if name not in optional or entry}


def _rename(entries: Mapping[str, Any], names: Mapping[str, str]) -> dict[str, Any]:
    return {names.get(name, name): entry for name, entry in entries.items()}


def _invert(names: Mapping[str, str]) -> dict[str, str]:
    return {entry: field for field, entry in names.items()}


def _layout(kind: type, names: Mapping[str, str]) -> RecordLayout:
    return RecordLayout(
        kind=kind,
        write=lambda record: _rename(fields_of(record), names),
        read=lambda table: from_fields(kind, _rename(table, _invert(names))),
    )


LAYOUTS = (
    RecordLayout(kind=Diagnosis, write=_diagnosis_entries),
    RecordLayout(
        kind=Finding,
        write=lambda finding: _without_empty(fields_of(finding), "coordinate", "law", "seen"),
        read=lambda table: from_fields(Finding, _check_effect(table)),
    ),
    RecordLayout(
        kind=NotDetected,
        write=fields_of,
        read=lambda table: from_fields(
            NotDetected,
            {
                name: entry
                for name, entry in _rename(_check_effect(table), _invert(NOT_DETECTED)).items()
                if name != "unit"
            },
        ),
    ),
    _layout(FinalError, HELD_OUT),
    _layout(HeldOut, HELD_OUT),
    _layout(Unexplained, UNEXPLAINED),
)
