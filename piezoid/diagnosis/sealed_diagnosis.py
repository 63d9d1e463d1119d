"""Write and read diagnosis.json."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

from piezoid.diagnosis.diagnosis import (
    SOMETHING_ELSE,
    Diagnosis,
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
    optional = ("unexplained", "budget", "counted")
    entries = {
        name: entry
        for name, entry in fields_of(diagnosis).items()
        if name not in NOT_WRITTEN and (entry or name not in optional)
    }
    rows = [
        [(NOT_DETECTED.get(name, name), entry) for name, entry in fields_of(absent).items()]
        for absent in diagnosis.not_detected
    ]
    return {**entries, "not_detected": [dict([*r[:2], ("unit", unit), *r[2:]]) for r in rows]}


def _layout(
    kind: type, names: Mapping[str, str] = MappingProxyType({}), optional: Sequence[str] = ()
) -> RecordLayout:
    """Return the layout of a record with fields of other names, and without empty optional ones.

    Raises ``ValueError`` at reading an effect that this version does not know.
    """
    fields = {entry: field for field, entry in names.items()}

    def read(table: Mapping[str, Any]) -> Any:
        known = {SOMETHING_ELSE, *(effect.name for effect in every_effect())}
        if table.get("effect", SOMETHING_ELSE) not in known:
            raise ValueError(f"effect {table['effect']!r}, which this version does not know")
        return from_fields(kind, {fields.get(n, n): v for n, v in table.items() if n != "unit"})

    def write(record: Any) -> dict[str, Any]:
        entries = fields_of(record).items()
        return {names.get(n, n): v for n, v in entries if n not in optional or v not in (None, "")}

    return RecordLayout(kind=kind, write=write, read=read)


LAYOUTS = (
    RecordLayout(kind=Diagnosis, write=_diagnosis_entries),
    _layout(Finding, optional=("coordinate", "law", "seen")),
    _layout(NotDetected, NOT_DETECTED),
    _layout(HeldOut, HELD_OUT, ("explained_rms_m",)),
    _layout(Unexplained, UNEXPLAINED),
)
