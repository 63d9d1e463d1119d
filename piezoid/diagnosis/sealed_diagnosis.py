"""diagnosis.json: the shape of its entries, written and read back kind by kind."""

from collections.abc import Mapping, Sequence
from typing import Any

from msgspec import UNSET, Struct, UnsetType, ValidationError, convert, to_builtins

from piezoid.counts import in_counts
from piezoid.diagnosis.diagnosis import (
    Diagnosis,
    Finding,
    HeldOut,
    NotDetected,
    Seen,
    Size,
    Unexplained,
)
from piezoid.diagnosis.effects import EFFECTS
from piezoid.diagnosis.something_else import NAME
from piezoid.errors import ParameterFileError
from piezoid.provenance import seal, unseal

SCHEMA = "piezoid.diagnosis/1"


class _HeldOut(Struct, frozen=True, kw_only=True):
    held_out_rms_m: float
    held_out_rms_percent: float


class _Size(Struct, frozen=True, kw_only=True):
    value: float
    unit: str
    ci95: tuple[float, float]


class _Seen(Struct, frozen=True, kw_only=True):
    unit: str
    place: tuple[float, ...]
    low_m: tuple[float, ...]
    median_m: tuple[float, ...]
    high_m: tuple[float, ...]
    fitted_m: tuple[float, ...]
    recording: str


class _Unexplained(Struct, frozen=True, kw_only=True):
    rms_m: float
    share: float
    p_value: float
    coordinate: str
    coordinate_gain: float


class _Finding(Struct, frozen=True, kw_only=True, omit_defaults=True):
    effect: str
    held_out_gain: float
    held_out_rms_before_m: float
    held_out_rms_after_m: float
    p_value: float
    size: _Size
    rms_percent: float
    parameters: dict[str, float]
    not_separable_from: tuple[str, ...]
    explanation: str
    next_experiment: str
    coordinate: str = ""
    law: str = ""
    seen: _Seen | UnsetType = UNSET


class _Absent(Struct, frozen=True, kw_only=True):
    effect: str
    upper_bound: float | None
    unit: str
    detection_limit: float | None
    reason: str
    next_experiment: str


class _Axis(Struct, frozen=True, kw_only=True):
    axis: str
    stroke_m: float
    baseline: _HeldOut
    noise_floor_rms_m: float
    envelope_rms_m: float
    findings: tuple[_Finding, ...]
    not_detected: tuple[_Absent, ...]
    final: _HeldOut
    explained_fraction: float
    unexplained: _Unexplained | UnsetType = UNSET
    counted: tuple[str, ...] | UnsetType = UNSET


def write_diagnosis(
    diagnosis: Diagnosis,
    *,
    others: Sequence[Diagnosis] = (),
    since: Mapping[str, Any] | None = None,
) -> bytes:
    """Return the sealed bytes of diagnosis.json.

    others  diagnoses of further axes, under ``axes``
    since   what changed since a model was fitted, under ``since_model``
    """
    content = _record_of(diagnosis)
    if others:
        content["axes"] = {other.axis: _record_of(other) for other in others}
    if since is not None:
        content["since_model"] = dict(since)
    return seal(SCHEMA, content)


def read_diagnosis(content: bytes, place: str = "diagnosis.json") -> Diagnosis:
    """Read diagnosis.json back: the axis at its top.

    Raises ``ParameterFileError`` where a bit was changed, the schema is another, or an entry is
    missing or of another kind.
    """
    return read_diagnoses(content, place)[0]


def read_diagnoses(content: bytes, place: str = "diagnosis.json") -> tuple[Diagnosis, ...]:
    """Read the diagnoses of all axes back, the one at the top first; raises the same."""
    record = unseal(content, SCHEMA, place)
    try:
        others = convert(record.get("axes", {}), dict[str, _Axis])
        return tuple(_diagnosis(axis) for axis in (convert(record, _Axis), *others.values()))
    except (ValidationError, ValueError) as error:
        raise ParameterFileError(
            f"{place}: {error}",
            needed=f"every entry of schema {SCHEMA}, of its own kind",
            remedy="Diagnose the recordings again with this version.",
        ) from error


def _record_of(diagnosis: Diagnosis) -> dict[str, Any]:
    axis = _Axis(
        axis=diagnosis.axis,
        stroke_m=diagnosis.stroke_m,
        baseline=_held_out_entry(diagnosis.baseline),
        noise_floor_rms_m=diagnosis.noise_floor_rms_m,
        envelope_rms_m=diagnosis.envelope_rms_m,
        findings=tuple(_finding_entry(finding) for finding in diagnosis.findings),
        not_detected=tuple(
            _absent_entry(absent, in_counts("m, rms", diagnosis.counted))
            for absent in diagnosis.not_detected
        ),
        final=_held_out_entry(diagnosis.final),
        explained_fraction=diagnosis.explained_fraction,
        unexplained=_unexplained_entry(diagnosis.unexplained),
        counted=diagnosis.counted or UNSET,
    )
    record: dict[str, Any] = to_builtins(axis)
    return record


def _held_out_entry(held: HeldOut) -> _HeldOut:
    return _HeldOut(held_out_rms_m=held.rms_m, held_out_rms_percent=held.rms_percent)


def _finding_entry(finding: Finding) -> _Finding:
    size = finding.size
    return _Finding(
        effect=finding.effect,
        held_out_gain=finding.held_out_gain,
        held_out_rms_before_m=finding.held_out_rms_before_m,
        held_out_rms_after_m=finding.held_out_rms_after_m,
        p_value=finding.p_value,
        size=_Size(value=size.value, unit=size.unit, ci95=size.ci95),
        rms_percent=finding.rms_percent,
        parameters=dict(finding.parameters),
        not_separable_from=finding.not_separable_from,
        explanation=finding.explanation,
        next_experiment=finding.next_experiment,
        coordinate=finding.coordinate,
        law=finding.law,
        seen=_seen_entry(finding.seen),
    )


def _seen_entry(seen: Seen | None) -> _Seen | UnsetType:
    if seen is None:
        return UNSET
    return _Seen(
        unit=seen.unit,
        place=seen.place,
        low_m=seen.low_m,
        median_m=seen.median_m,
        high_m=seen.high_m,
        fitted_m=seen.fitted_m,
        recording=seen.recording,
    )


def _unexplained_entry(unexplained: Unexplained | None) -> _Unexplained | UnsetType:
    if unexplained is None:
        return UNSET
    return _Unexplained(
        rms_m=unexplained.rms_m,
        share=unexplained.share,
        p_value=unexplained.p_value,
        coordinate=unexplained.coordinate,
        coordinate_gain=unexplained.gain,
    )


def _absent_entry(absent: NotDetected, unit: str) -> _Absent:
    return _Absent(
        effect=absent.effect,
        upper_bound=absent.upper_bound_m,
        unit=unit,
        detection_limit=absent.detection_limit_m,
        reason=absent.reason,
        next_experiment=absent.next_experiment,
    )


def _diagnosis(axis: _Axis) -> Diagnosis:
    return Diagnosis(
        axis=axis.axis,
        stroke_m=axis.stroke_m,
        baseline=_held_out(axis.baseline),
        final=_held_out(axis.final),
        envelope_rms_m=axis.envelope_rms_m,
        noise_floor_rms_m=axis.noise_floor_rms_m,
        explained_fraction=axis.explained_fraction,
        unexplained=_unexplained(axis.unexplained),
        findings=tuple(_finding(entry) for entry in axis.findings),
        not_detected=tuple(_absent(entry) for entry in axis.not_detected),
        counted=() if isinstance(axis.counted, UnsetType) else axis.counted,
    )


def _unexplained(entry: _Unexplained | UnsetType) -> Unexplained | None:
    if isinstance(entry, UnsetType):
        return None
    return Unexplained(
        rms_m=entry.rms_m,
        share=entry.share,
        p_value=entry.p_value,
        coordinate=entry.coordinate,
        gain=entry.coordinate_gain,
    )


def _seen(entry: _Seen | UnsetType) -> Seen | None:
    if isinstance(entry, UnsetType):
        return None
    return Seen(
        unit=entry.unit,
        place=entry.place,
        low_m=entry.low_m,
        median_m=entry.median_m,
        high_m=entry.high_m,
        fitted_m=entry.fitted_m,
        recording=entry.recording,
    )


def _held_out(entry: _HeldOut) -> HeldOut:
    return HeldOut(rms_m=entry.held_out_rms_m, rms_percent=entry.held_out_rms_percent)


def _known(effect: str) -> str:
    if effect not in {known.name for known in EFFECTS}:
        raise ValueError(f"effect {effect!r}, which this version does not know")
    return effect


def _finding(entry: _Finding) -> Finding:
    return Finding(
        effect=entry.effect if entry.effect == NAME else _known(entry.effect),
        held_out_gain=entry.held_out_gain,
        held_out_rms_before_m=entry.held_out_rms_before_m,
        held_out_rms_after_m=entry.held_out_rms_after_m,
        p_value=entry.p_value,
        rms_percent=entry.rms_percent,
        size=Size(value=entry.size.value, unit=entry.size.unit, ci95=entry.size.ci95),
        not_separable_from=entry.not_separable_from,
        explanation=entry.explanation,
        next_experiment=entry.next_experiment,
        parameters=entry.parameters,
        coordinate=entry.coordinate,
        law=entry.law,
        seen=_seen(entry.seen),
    )


def _absent(entry: _Absent) -> NotDetected:
    return NotDetected(
        effect=_known(entry.effect),
        upper_bound_m=entry.upper_bound,
        detection_limit_m=entry.detection_limit,
        reason=entry.reason,
        next_experiment=entry.next_experiment,
    )
