"""ActuatorModel to model.json and back, exactly: every number returns with its last bit."""

import dataclasses
from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from msgspec import ValidationError, convert

from piezoid.errors import ParameterFileError
from piezoid.identification.dynamics.bandwidth import BandwidthVerdict
from piezoid.identification.dynamics.hammerstein_record import JointFit
from piezoid.identification.dynamics.modal import LinearDynamics
from piezoid.identification.dynamics.response_record import ResponseFit
from piezoid.identification.extensions import extension_from_json
from piezoid.identification.hysteresis.pieces import Rig
from piezoid.identification.model import (
    SCHEMA,
    ActuatorModel,
    AxisModel,
    Discrepancy,
    Lag,
    PieceStart,
)
from piezoid.identification.quality import Certificate, FitQuality, Uncertainty, Verdict
from piezoid.identification.tunnelling.model import TunnellingModel
from piezoid.operators.dead_zone import DeadZones
from piezoid.operators.modified_prandtl_ishlinskii import ModifiedPrandtlIshlinskii
from piezoid.operators.prandtl_ishlinskii import PrandtlIshlinskii
from piezoid.provenance import seal, unseal

_WRONG = (
    ValidationError, LookupError, ArithmeticError, TypeError, ValueError, AttributeError,
)  # fmt: skip
GAUGE = "dead_zone_weight at threshold 0 is 1; the envelope keeps the range of the drive"


def write_model(model: ActuatorModel) -> bytes:
    """Return the bytes of model.json."""
    return seal(
        SCHEMA,
        {
            "stage": model.stage,
            "gauge": GAUGE,
            "sources": dict(model.sources),
            "lab": model.lab,
            "axes": {name: _axis_to_json(axis) for name, axis in model.axes.items()},
            "tunnelling": None if model.tunnelling is None else model.tunnelling.to_json(),
            "remarks": list(model.remarks),
            "controller_rate_Hz": model.controller_rate_Hz,
        },
    )


def read_model(content: bytes, place: str = "model.json") -> ActuatorModel:
    """Read model.json back.

    Raises ``ParameterFileError`` where a bit was changed, the schema is another, or an entry that
    this version needs is missing.
    """
    record = unseal(content, SCHEMA, place)
    try:
        return ActuatorModel(
            stage=convert(record["stage"], str),
            axes={name: _axis_from_json(axis) for name, axis in record["axes"].items()},
            sources=convert(record["sources"], dict[str, str]),
            lab=convert(record["lab"], str | None),
            tunnelling=_tunnelling_from_json(record["tunnelling"]),
            remarks=convert(record["remarks"], tuple[str, ...]),
            controller_rate_Hz=convert(record["controller_rate_Hz"], float | None),
        )
    except _WRONG as error:
        raise ParameterFileError(
            f"{place}: {type(error).__name__} at {error}",
            needed=f"every entry of schema {SCHEMA}, of its own kind",
            remedy="Fit the recordings again with this version.",
        ) from error


def _tunnelling_from_json(content: Mapping[str, Any] | None) -> TunnellingModel | None:
    return None if content is None else TunnellingModel.from_json(content)


def _dynamics_from_json(content: dict[str, Any] | None) -> LinearDynamics | None:
    return None if content is None else LinearDynamics.from_json(content)


def _bandwidth_from_json(content: Mapping[str, Any] | None) -> BandwidthVerdict | None:
    return None if content is None else BandwidthVerdict.from_json(content)


def _response_from_json(content: Mapping[str, Any] | None) -> ResponseFit | None:
    return None if content is None else ResponseFit.from_json(content)


def _axis_to_json(axis: AxisModel) -> dict[str, Any]:
    return {
        "axis": axis.axis,
        "polarity": axis.polarity,
        "hysteresis": _hysteresis_to_json(axis.hysteresis),
        "lag": dataclasses.asdict(axis.lag),
        "rig": dataclasses.asdict(axis.rig),
        "dynamics": None if axis.dynamics is None else axis.dynamics.to_json(),
        "joint": None if axis.joint is None else axis.joint.to_json(),
        "bandwidth": None if axis.bandwidth is None else axis.bandwidth.to_json(),
        "response": None if axis.response is None else axis.response.to_json(),
        "valid_range": {"voltage_V": list(axis.voltage_V)},
        "verdict": {
            "applies": axis.verdict.applies,
            "reason": axis.verdict.reason,
            "remarks": list(axis.verdict.remarks),
        },
        "quality": _quality_to_json(axis.quality),
        "uncertainty": _uncertainty_to_json(axis.uncertainty),
        "certificate": dataclasses.asdict(axis.certificate),
        "extensions": [extension.to_json() for extension in axis.extensions],
        "starts": [_start_to_json(start) for start in axis.starts],
        "dynamics_remarks": list(axis.dynamics_remarks),
        "discrepancy": _discrepancy_to_json(axis.discrepancy),
    }


def _discrepancy_to_json(found: Discrepancy | None) -> dict[str, Any] | None:
    if found is None:
        return None
    return {
        "centre_V": found.centre_V,
        "reach_V": found.reach_V,
        "threshold_V": found.threshold_V.tolist(),
        "weight_m": found.weight_m.tolist(),
        "steepest_m_per_V": found.steepest_m_per_V,
    }


def _discrepancy_from_json(record: Mapping[str, Any] | None) -> Discrepancy | None:
    if record is None:
        return None
    return Discrepancy(
        centre_V=convert(record["centre_V"], float),
        reach_V=convert(record["reach_V"], float),
        threshold_V=np.array(record["threshold_V"]),
        weight_m=np.array(record["weight_m"]),
        steepest_m_per_V=convert(record["steepest_m_per_V"], float),
    )


def _hysteresis_to_json(hysteresis: ModifiedPrandtlIshlinskii) -> dict[str, Any]:
    return {
        "play_threshold_V": hysteresis.plays.threshold.tolist(),
        "play_weight_m_per_V": hysteresis.plays.weight.tolist(),
        "dead_zone_threshold_m": hysteresis.dead_zones.threshold.tolist(),
        "dead_zone_weight": hysteresis.dead_zones.weight.tolist(),
        "envelope_threshold_V": hysteresis.envelope.threshold.tolist(),
        "envelope_weight": hysteresis.envelope.weight.tolist(),
        "voltage_offset_V": hysteresis.voltage_offset_V,
        "displacement_offset_m": hysteresis.displacement_offset_m,
    }


def _start_to_json(start: PieceStart) -> dict[str, Any]:
    return {
        "recording": start.recording,
        "memory_V": start.memory_V.tolist(),
        "zero_m": start.zero_m.tolist(),
        "first": start.first,
        "last": start.last,
    }


def _quality_to_json(quality: FitQuality) -> dict[str, Any]:
    return {
        "rms_m": quality.rms_m,
        "held_out_rms_m": quality.held_out_rms_m,
        "held_out_rms_percent": quality.held_out_rms_percent,
        "held_out_kind": quality.held_out_kind,
        "range_m": quality.range_m,
        "noise_rms_m": quality.noise_rms_m,
        "rows": quality.rows,
        "kkt_gap": quality.kkt_gap,
        "gradient": quality.gradient,
        "converged": quality.converged,
        "orders": [dataclasses.asdict(order) for order in quality.orders],
        "limits": [dataclasses.asdict(limit) for limit in quality.limits],
    }


def _uncertainty_to_json(found: Uncertainty) -> dict[str, Any]:
    return {
        "blocks": found.blocks,
        "names": list(found.names),
        "values": found.values.tolist(),
        "covariance": found.covariance.tolist(),
        "upper_limit": dict(found.upper_limit),
        "reach_V": found.reach_V.tolist(),
        "loading_m": found.loading_m.tolist(),
        "loading_half_m": found.loading_half_m.tolist(),
        "loop_width_m": list(found.loop_width_m),
    }


def _axis_from_json(record: Mapping[str, Any]) -> AxisModel:
    hysteresis = record["hysteresis"]
    return AxisModel(
        axis=convert(record["axis"], str),
        polarity=convert(record["polarity"], Literal[-1, 1]),
        hysteresis=ModifiedPrandtlIshlinskii(
            plays=PrandtlIshlinskii(
                threshold=np.array(hysteresis["play_threshold_V"]),
                weight=np.array(hysteresis["play_weight_m_per_V"]),
            ),
            dead_zones=DeadZones(
                threshold=np.array(hysteresis["dead_zone_threshold_m"]),
                weight=np.array(hysteresis["dead_zone_weight"]),
            ),
            envelope=DeadZones(
                threshold=np.array(hysteresis["envelope_threshold_V"]),
                weight=np.array(hysteresis["envelope_weight"]),
            ),
            voltage_offset_V=convert(hysteresis["voltage_offset_V"], float),
            displacement_offset_m=convert(hysteresis["displacement_offset_m"], float),
        ),
        lag=convert(record["lag"], Lag),
        rig=convert(record["rig"], Rig),
        starts=tuple(_start_from_json(start) for start in record["starts"]),
        voltage_V=convert(record["valid_range"]["voltage_V"], tuple[float, float]),
        verdict=convert(record["verdict"], Verdict),
        quality=convert(record["quality"], FitQuality),
        uncertainty=_uncertainty_from_json(record["uncertainty"]),
        certificate=convert(record["certificate"], Certificate),
        dynamics=_dynamics_from_json(record["dynamics"]),
        joint=None if record["joint"] is None else JointFit.from_json(record["joint"]),
        # Files of before there were any have no such entries.
        bandwidth=_bandwidth_from_json(record.get("bandwidth")),
        response=_response_from_json(record.get("response")),
        extensions=tuple(extension_from_json(e) for e in record.get("extensions", ())),
        discrepancy=_discrepancy_from_json(record.get("discrepancy")),
        dynamics_remarks=convert(record.get("dynamics_remarks", ()), tuple[str, ...]),
    )


def _start_from_json(record: Mapping[str, Any]) -> PieceStart:
    return PieceStart(
        recording=convert(record["recording"], str),
        memory_V=record["memory_V"],
        zero_m=record["zero_m"],
        first=convert(record["first"], int),
        last=convert(record["last"], int),
    )


def _uncertainty_from_json(record: Mapping[str, Any]) -> Uncertainty:
    told = {
        "blocks": convert(record["blocks"], int),
        "names": convert(record["names"], tuple[str, ...]),
        "upper_limit": convert(record["upper_limit"], dict[str, float]),
        "loop_width_m": convert(record["loop_width_m"], tuple[float, float]),
    }
    return Uncertainty(**{**record, **told})
