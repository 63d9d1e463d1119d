"""Write ActuatorModel to model.json and read it back exactly."""

from collections.abc import Mapping
from typing import Any, Literal

from msgspec import convert

from piezoid.digests import seal
from piezoid.errors import ParameterFileError
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.dynamics.modal import LinearDynamics
from piezoid.identification.extensions import LAYOUT_OF_EXTENSIONS
from piezoid.identification.model import SCHEMA, AxisModel
from piezoid.identification.quality import FitQuality
from piezoid.operators.dead_zone import DeadZones
from piezoid.operators.prandtl_ishlinskii import ModifiedPrandtlIshlinskii, PrandtlIshlinskii
from piezoid.record_json import RecordLayout, fields_of, from_fields, read_sealed, to_json

MAX_OPERATORS = 256  # plays, or dead zones; the controller has at most 32, the fit at most 16
MAX_MAGNITUDE = 1e12  # volts, metres, metres a volt, or counts of a converter
GAUGE = "dead_zone_weight at threshold 0 is 1; the envelope keeps the range of the drive"


def write_model(model: ActuatorModel) -> bytes:
    """Return the bytes of model.json."""
    return seal(SCHEMA, to_json(model, LAYOUTS))


def read_model(content: bytes, location: str = "model.json") -> ActuatorModel:
    """Read model.json back.

    Raises ``ParameterFileError`` if the content was changed, the schema differs, or a required
    entry is missing.
    """
    remedy = "Fit the recordings again with this version."
    return read_sealed(ActuatorModel, content, SCHEMA, location, remedy=remedy, layouts=LAYOUTS)


def _stage_entry(model: ActuatorModel) -> dict[str, Any]:
    entries = fields_of(model)
    first = {"stage": entries.pop("stage"), "gauge": GAUGE, "sources": entries.pop("sources")}
    ordered = {**first, "lab": entries.pop("lab"), **entries}
    return {
        name: value for name, value in ordered.items() if name != "coupled" or value is not None
    }


def _axis_entry(axis: AxisModel) -> dict[str, Any]:
    names = (
        "axis", "polarity", "hysteresis", "lag", "rig", "dynamics", "joint", "bandwidth",
        "response", "valid_range", "verdict", "quality", "uncertainty", "certificate",
        "extensions", "starts", "dynamics_remarks", "discrepancy",
    )  # fmt: skip
    entries = fields_of(axis)
    entries["valid_range"] = {"voltage_V": entries.pop("voltage_V")}
    # These entries are written only if they are set.
    optional = ("counted", "loop_shape", "minor_loops", "function_orders")
    present = {name: entries[name] for name in optional if entries[name]}
    return {name: entries[name] for name in names} | present


def _axis(entry: Mapping[str, Any]) -> AxisModel:
    entries = {**entry, "voltage_V": entry["valid_range"]["voltage_V"]}
    del entries["valid_range"]
    convert(entry["polarity"], Literal[-1, 1])
    return from_fields(AxisModel, entries, LAYOUTS)


def _hysteresis_entry(operator: ModifiedPrandtlIshlinskii) -> dict[str, Any]:
    return {
        "play_threshold_V": operator.plays.threshold,
        "play_weight_m_per_V": operator.plays.weight,
        "dead_zone_threshold_m": operator.dead_zones.threshold,
        "dead_zone_weight": operator.dead_zones.weight,
        "envelope_threshold_V": operator.envelope.threshold,
        "envelope_weight": operator.envelope.weight,
        "voltage_offset_V": operator.voltage_offset_V,
        "displacement_offset_m": operator.displacement_offset_m,
    }


def _hysteresis(entry: Mapping[str, Any]) -> ModifiedPrandtlIshlinskii:
    """Read a hysteresis; ``ParameterFileError`` for too many operators or too large numbers."""
    for name, value in entry.items():
        numbers = value if isinstance(value, list) else [value]
        if len(numbers) > MAX_OPERATORS:
            raise _out_of_bounds(f"{name} has {len(numbers)} entries", f"at most {MAX_OPERATORS}")
        sizes = [abs(x) for x in numbers if isinstance(x, int | float)]
        if max(sizes, default=0.0) > MAX_MAGNITUDE:
            raise _out_of_bounds(f"{name} holds {max(sizes):.3g}", f"at most {MAX_MAGNITUDE:.0g}")
    weights = entry["play_weight_m_per_V"]
    if isinstance(weights, list) and weights and not any(weights):
        raise _out_of_bounds("all play_weight_m_per_V are 0", "a weight above 0: the stage moves")

    def read(kind: type[Any], threshold: str, weight: str) -> Any:
        return from_fields(kind, {"threshold": entry[threshold], "weight": entry[weight]})

    return ModifiedPrandtlIshlinskii(
        plays=read(PrandtlIshlinskii, "play_threshold_V", "play_weight_m_per_V"),
        dead_zones=read(DeadZones, "dead_zone_threshold_m", "dead_zone_weight"),
        envelope=read(DeadZones, "envelope_threshold_V", "envelope_weight"),
        voltage_offset_V=convert(entry["voltage_offset_V"], float),
        displacement_offset_m=convert(entry["displacement_offset_m"], float),
    )


def _out_of_bounds(fault: str, needed: str) -> ParameterFileError:
    return ParameterFileError(
        f"the hysteresis of a model: {fault}",
        needed=needed,
        remedy="Fit the recordings again with this version.",
    )


def _quality_entry(quality: FitQuality) -> dict[str, Any]:
    entries = fields_of(quality)
    first = {name: entries.pop(name) for name in ("rms_m", "held_out_rms_m")}
    derived = ("held_out_rms_percent", "explained_rms_m")
    return {**first, **{name: getattr(quality, name) for name in derived}, **entries}


LAYOUTS: tuple[RecordLayout, ...] = (
    RecordLayout(
        kind=ActuatorModel,
        write=_stage_entry,
        read=lambda entry: from_fields(
            ActuatorModel, {k: v for k, v in entry.items() if k != "gauge"}, LAYOUTS
        ),
    ),
    RecordLayout(kind=AxisModel, write=_axis_entry, read=_axis),
    RecordLayout(kind=ModifiedPrandtlIshlinskii, write=_hysteresis_entry, read=_hysteresis),
    RecordLayout(kind=FitQuality, write=_quality_entry),
    RecordLayout(kind=LinearDynamics, write=LinearDynamics.to_json, read=LinearDynamics.from_json),
    LAYOUT_OF_EXTENSIONS,
)
