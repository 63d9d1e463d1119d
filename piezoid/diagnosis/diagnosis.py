"""Diagnosis: what was found, what was not, and how small a thing these recordings could show."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from piezoid.diagnosis.effects import EFFECTS
from piezoid.errors import ParameterFileError
from piezoid.identification.model import AxisModel
from piezoid.provenance import seal, unseal
from piezoid.showing import shown

SCHEMA = "piezoid.diagnosis/1"


@dataclass(frozen=True, kw_only=True)
class Size:
    """A number with its unit and 95 % interval."""

    value: float
    unit: str
    ci95: tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One cause that these recordings show.

    held_out_gain           1 - rms with it / rms without it, both refitted, on rows left out
    held_out_rms_before_m   without it
    held_out_rms_after_m    with it
    p_value                 times the number of effects tried [Bonferroni]
    share                   rms of what it adds, of the stroke
    not_separable_from      effects that would explain nearly as much
    parameters              nonlinear ones, by name with unit
    """

    effect: str
    held_out_gain: float
    held_out_rms_before_m: float
    held_out_rms_after_m: float
    p_value: float
    share: float
    size: Size
    not_separable_from: tuple[str, ...]
    explanation: str
    next_experiment: str
    parameters: Mapping[str, float]


@dataclass(frozen=True, kw_only=True)
class NotDetected:
    """One effect that these recordings do not show.

    upper_bound_m      rms of the most it could be, one-sided 95 %; None where it was not tested
    detection_limit_m  rms from which it would have been found in four of five cases
    reason             one sentence with numbers
    """

    effect: str
    upper_bound_m: float | None
    detection_limit_m: float | None
    reason: str
    next_experiment: str


@dataclass(frozen=True, kw_only=True)
class HeldOut:
    """An error on data that were not fitted, in metres and in percent of the stroke."""

    rms_m: float
    rms_percent: float


@dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """Everything that was found and not found about one axis.

    baseline            of the simulation before any effect
    final               with everything found
    envelope_rms_m      what the widest class of hysteresis leaves with everything found
    noise_floor_rms_m   of the sensor
    explained_fraction  of the variance above the noise floor
    findings            by falling gain
    model               the axis with everything found in it, as it ships; None where no model was
                        at hand. It stands in model.json, not here
    """

    axis: str
    stroke_m: float
    baseline: HeldOut
    final: HeldOut
    envelope_rms_m: float
    noise_floor_rms_m: float
    explained_fraction: float
    findings: tuple[Finding, ...]
    not_detected: tuple[NotDetected, ...]
    model: AxisModel | None = field(default=None, compare=False, repr=False)

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of what was found, largest gain first."""
        return tuple(finding.effect for finding in self.findings)

    def _repr_html_(self) -> str:
        found = [
            (finding.effect, f"gain {100 * finding.held_out_gain:.1f} %, p {finding.p_value:.2g}")
            for finding in self.findings
        ]
        return shown(
            f"Diagnosis of axis {self.axis}",
            (
                *(found or [("found", "nothing")]),
                ("error before, after", f"{self.baseline.rms_m:.3g} m, {self.final.rms_m:.3g} m"),
                ("explained", f"{100 * self.explained_fraction:.0f} %"),
            ),
        )

    def to_json(self) -> dict[str, Any]:
        """Return the content of diagnosis.json without schema and digest."""
        return {
            "axis": self.axis,
            "stroke_m": self.stroke_m,
            "baseline": _held_out(self.baseline),
            "noise_floor_rms_m": self.noise_floor_rms_m,
            "envelope_rms_m": self.envelope_rms_m,
            "findings": [_finding(finding) for finding in self.findings],
            "not_detected": [_absent(absent) for absent in self.not_detected],
            "final": _held_out(self.final),
            "explained_fraction": self.explained_fraction,
        }


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
    content = diagnosis.to_json()
    if others:
        content["axes"] = {other.axis: other.to_json() for other in others}
    if since is not None:
        content["since_model"] = dict(since)
    return seal(SCHEMA, content)


def read_diagnosis(content: bytes, place: str = "diagnosis.json") -> Diagnosis:
    """Read diagnosis.json back: the axis at its top.

    Raises ``ParameterFileError`` where a bit was changed, the schema is another, or an entry is
    missing.
    """
    return read_diagnoses(content, place)[0]


def read_diagnoses(content: bytes, place: str = "diagnosis.json") -> tuple[Diagnosis, ...]:
    """Read the diagnoses of all axes back, the one at the top first; raises the same."""
    record = unseal(content, SCHEMA, place)
    try:
        entries = [record, *record.get("axes", {}).values()]
        return tuple(_diagnosis_from(entry) for entry in entries)
    except (KeyError, TypeError, ValueError) as error:
        raise ParameterFileError(
            f"{place}: {type(error).__name__} at {error}",
            needed=f"every entry of schema {SCHEMA}, of its own kind",
            remedy="Diagnose the recordings again with this version.",
        ) from error


def _diagnosis_from(record: Mapping[str, Any]) -> Diagnosis:
    return Diagnosis(
        axis=record["axis"],
        stroke_m=record["stroke_m"],
        baseline=_held_out_from(record["baseline"]),
        final=_held_out_from(record["final"]),
        envelope_rms_m=record["envelope_rms_m"],
        noise_floor_rms_m=record["noise_floor_rms_m"],
        explained_fraction=record["explained_fraction"],
        findings=tuple(_finding_from(entry) for entry in record["findings"]),
        not_detected=tuple(_absent_from(entry) for entry in record["not_detected"]),
    )


def _held_out(held: HeldOut) -> dict[str, float]:
    return {"held_out_rms_m": held.rms_m, "held_out_rms_percent": held.rms_percent}


def _finding(finding: Finding) -> dict[str, Any]:
    size = finding.size
    return {
        "effect": finding.effect,
        "held_out_gain": finding.held_out_gain,
        "held_out_rms_before_m": finding.held_out_rms_before_m,
        "held_out_rms_after_m": finding.held_out_rms_after_m,
        "p_value": finding.p_value,
        "size": {"value": size.value, "unit": size.unit, "ci95": list(size.ci95)},
        "rms_percent": 100.0 * finding.share,
        "parameters": dict(finding.parameters),
        "not_separable_from": list(finding.not_separable_from),
        "explanation": finding.explanation,
        "next_experiment": finding.next_experiment,
    }


def _absent(absent: NotDetected) -> dict[str, Any]:
    return {
        "effect": absent.effect,
        "upper_bound": absent.upper_bound_m,
        "unit": "m, rms",
        "detection_limit": absent.detection_limit_m,
        "reason": absent.reason,
        "next_experiment": absent.next_experiment,
    }


def _held_out_from(record: Mapping[str, float]) -> HeldOut:
    return HeldOut(rms_m=record["held_out_rms_m"], rms_percent=record["held_out_rms_percent"])


def _known(effect: str) -> str:
    if effect not in {known.name for known in EFFECTS}:
        raise ValueError(f"effect {effect!r}, which this version does not know")
    return effect


def _finding_from(record: Mapping[str, Any]) -> Finding:
    low, high = record["size"]["ci95"]
    kept = ("held_out_gain", "held_out_rms_before_m", "held_out_rms_after_m", "p_value")
    return Finding(
        effect=_known(record["effect"]),
        **{name: record[name] for name in kept},
        share=record["rms_percent"] / 100.0,
        size=Size(value=record["size"]["value"], unit=record["size"]["unit"], ci95=(low, high)),
        not_separable_from=tuple(record["not_separable_from"]),
        explanation=record["explanation"],
        next_experiment=record["next_experiment"],
        parameters=record["parameters"],
    )


def _absent_from(record: Mapping[str, Any]) -> NotDetected:
    return NotDetected(
        effect=_known(record["effect"]),
        upper_bound_m=record["upper_bound"],
        detection_limit_m=record["detection_limit"],
        reason=record["reason"],
        next_experiment=record["next_experiment"],
    )
