"""TunnellingModel: what leaves this folder, in plain numbers that come back exactly."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from piezoid.identification.tunnelling.barrier_fit import BarrierFit
from piezoid.identification.tunnelling.closed_loop import ClosedLoopFit
from piezoid.identification.tunnelling.confidence import Confidence
from piezoid.identification.tunnelling.directions import DirectionShift
from piezoid.identification.tunnelling.family import PlantFamily
from piezoid.identification.tunnelling.junction_plant import JunctionPlant

Interval = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class GapLaw:
    """From sweeps: i = polarity I_0 exp(-k z) + offset, z growing when the tip retracts.

    decay_per_m               k, and its 95 % interval; an upper end may be infinite
    barrier_eV                apparent, and its 95 % interval
    current_at_zero_height_A  I_0 > 0
    offset_A                  of the amplifier, with its sign
    floor_A                   rms noise without current
    gap_jitter_m              what the noise in proportion to the current amounts to
    sweep_decay_per_m         k of each sweep alone
    confidence, reasons       how far to trust it
    """

    polarity: float
    decay_per_m: float
    decay_interval_per_m: Interval
    barrier_eV: float
    barrier_interval_eV: Interval
    current_at_zero_height_A: float
    offset_A: float
    floor_A: float
    gap_jitter_m: float
    sweep_decay_per_m: tuple[float, ...]
    confidence: Confidence
    reasons: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class LoopPlant:
    """From a closed loop: the plant, its intervals, the naive gain, and the family.

    plant                    nominal
    gain_interval            95 %, nepers per volt
    sensor_pole_interval_Hz  95 %; an upper end may be infinite
    delay_interval_s         95 %
    barrier_eV               apparent, and its 95 % interval
    naive_gain               nepers per volt, for comparison only
    naive_reason             why it differs
    family                   the plants a controller has to hold, nominal first
    family_records           how many records the family rests on
    confidence, reasons      how far to trust it
    """

    plant: JunctionPlant
    gain_interval: Interval
    sensor_pole_interval_Hz: Interval
    delay_interval_s: Interval
    barrier_eV: float
    barrier_interval_eV: Interval
    naive_gain: float
    naive_reason: str
    family: tuple[JunctionPlant, ...]
    family_records: int
    confidence: Confidence
    reasons: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class TunnellingModel:
    """The tunnelling junction: from sweeps, from the closed loop, or from both.

    gap_law     None where no sweep was recorded; of the forward sweeps where there are both
    loop_plant  None where no loop was recorded
    backward    of the backward sweeps; None unless there are both
    shift       between both; None too where no current stands clear of the noise in both
    """

    gap_law: GapLaw | None
    loop_plant: LoopPlant | None
    backward: GapLaw | None = None
    shift: DirectionShift | None = None

    def __post_init__(self) -> None:
        if self.gap_law is None and self.loop_plant is None:
            raise ValueError("a TunnellingModel needs a gap law or a loop plant")

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values; an infinite end of an interval becomes null."""
        plain: dict[str, Any] = _plain(asdict(self))
        return plain

    @staticmethod
    def from_json(content: Mapping[str, Any]) -> "TunnellingModel":
        """Return the record that ``to_json`` wrote, number for number."""
        law, loop = content["gap_law"], content["loop_plant"]
        backward, shift = content["backward"], content["shift"]
        return TunnellingModel(
            gap_law=None if law is None else _law_from_json(law),
            loop_plant=None if loop is None else _loop_from_json(loop),
            backward=None if backward is None else _law_from_json(backward),
            shift=None if shift is None else _shift_from_json(shift),
        )


def describe_gap_law(fit: BarrierFit) -> GapLaw:
    """Take from a fit of sweeps what a model carries on."""
    return GapLaw(
        polarity=fit.polarity,
        decay_per_m=fit.decay_per_m,
        decay_interval_per_m=fit.decay_interval_per_m,
        barrier_eV=fit.barrier_eV,
        barrier_interval_eV=fit.barrier_interval_eV,
        current_at_zero_height_A=fit.current_at_zero_height_A,
        offset_A=fit.offset_A,
        floor_A=fit.noise.floor_A,
        gap_jitter_m=fit.gap_jitter_m,
        sweep_decay_per_m=fit.sweep_decay_per_m,
        confidence=fit.confidence,
        reasons=tuple(reason.text for reason in fit.reasons),
    )


def describe_loop_plant(fit: ClosedLoopFit, family: PlantFamily) -> LoopPlant:
    """Take from a closed-loop fit and the family around it what a model carries on."""
    return LoopPlant(
        plant=fit.plant,
        gain_interval=fit.gain_interval,
        sensor_pole_interval_Hz=fit.sensor_pole_interval_Hz,
        delay_interval_s=fit.delay_interval_s,
        barrier_eV=fit.barrier_eV,
        barrier_interval_eV=fit.barrier_interval_eV,
        naive_gain=fit.naive_gain,
        naive_reason=fit.naive_reason,
        family=family.members,
        family_records=family.records,
        confidence=fit.confidence,
        reasons=tuple(reason.text for reason in fit.reasons),
    )


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _plain(inner) for name, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    if isinstance(value, Confidence):
        return value.value
    if isinstance(value, float) and math.isinf(value):
        return None
    return value


def _interval(content: list[Any]) -> Interval:
    low, high = content
    return float(low), math.inf if high is None else float(high)


def _law_from_json(content: Mapping[str, Any]) -> GapLaw:
    intervals = {n: _interval(content[n]) for n in ("decay_interval_per_m", "barrier_interval_eV")}
    alone = {"sweep_decay_per_m": tuple(content["sweep_decay_per_m"])}
    return GapLaw(**{**content, **intervals, **alone, **_judgement(content)})


def _shift_from_json(content: Mapping[str, Any]) -> DirectionShift:
    names = ("shift_interval_m", "decay_change_interval")
    return DirectionShift(**{**content, **{name: _interval(content[name]) for name in names}})


def _loop_from_json(content: Mapping[str, Any]) -> LoopPlant:
    names = ("gain_interval", "sensor_pole_interval_Hz", "delay_interval_s", "barrier_interval_eV")
    intervals = {name: _interval(content[name]) for name in names}
    plants = {
        "plant": JunctionPlant(**content["plant"]),
        "family": tuple(JunctionPlant(**member) for member in content["family"]),
    }
    return LoopPlant(**{**content, **intervals, **plants, **_judgement(content)})


def _judgement(content: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "confidence": Confidence(content["confidence"]),
        "reasons": tuple(content["reasons"]),
    }
