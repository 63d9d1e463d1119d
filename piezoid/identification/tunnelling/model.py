"""TunnellingModel: what leaves this folder, in plain numbers that come back exactly."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from piezoid.identification.tunnelling.approach import Direction
from piezoid.identification.tunnelling.barrier_fit import BarrierFit
from piezoid.identification.tunnelling.confidence import Confidence
from piezoid.identification.tunnelling.joint_barrier import JointBarrier
from piezoid.identification.tunnelling.loop_model import LoopPlant
from piezoid.identification.tunnelling.sweep_pairs import (
    DirectionShift,
    DriftFreeDecay,
    judge_together,
)
from piezoid.operators.tunnelling import barrier_of_decay
from piezoid.record_json import Interval

__all__ = ["GapLaw", "LoopPlant", "TunnellingModel", "common_law", "describe_gap_law"]


@dataclass(frozen=True, kw_only=True)
class GapLaw:
    """From sweeps: i = polarity I_0 exp(-k z) + offset, z growing when the tip retracts.

    decay_per_m               k, and its 95 % interval; an upper end may be infinite
    barrier_eV                apparent, and its 95 % interval
    current_at_zero_height_A  I_0 > 0
    offset_A                  of the amplifier, with its sign, and its standard deviation
    floor_A                   rms noise without current
    gap_jitter_m              what the noise in proportion to the current amounts to
    sweep_decay_per_m         k of each sweep alone; in a common law of each to and fro
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
    offset_standard_A: float = 0.0


@dataclass(frozen=True, kw_only=True)
class TunnellingModel:
    """The tunnelling junction: from sweeps, from the closed loop, or from both.

    gap_law     None where no sweep was recorded; of both directions together, drift allowed for
    loop_plant  None where no loop was recorded
    forward     of the forward sweeps as recorded, drift in its decay; None unless there are both
    backward    of the backward sweeps likewise
    shift       between both; None too where no current stands clear of the noise in both
    joint       of sweeps and loop together; None unless there are both
    """

    gap_law: GapLaw | None
    loop_plant: LoopPlant | None
    forward: GapLaw | None = None
    backward: GapLaw | None = None
    shift: DirectionShift | None = None
    joint: JointBarrier | None = None

    def __post_init__(self) -> None:
        if self.gap_law is None and self.loop_plant is None:
            raise ValueError("a TunnellingModel needs a gap law or a loop plant")


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
        offset_standard_A=fit.offset_standard_A,
        floor_A=fit.noise.floor_A,
        gap_jitter_m=fit.gap_jitter_m,
        sweep_decay_per_m=fit.sweep_decay_per_m,
        confidence=fit.confidence,
        reasons=tuple(reason.text for reason in fit.reasons),
    )


def common_law(fits: Mapping[Direction, BarrierFit], common: DriftFreeDecay) -> GapLaw:
    """Return the law of all sweeps together: their common decay, the mean of the rest.

    fits  of the directions there are, at least one, as ``fit_barrier`` gives them
    """
    laws = [describe_gap_law(fit) for fit in fits.values()]
    peak_A = min(fit.evidence.peak_A for fit in fits.values())
    # Where that current flows is seen by every direction; its mean height is what drift leaves.
    height_m = np.mean(
        [math.log(law.current_at_zero_height_A / peak_A) / law.decay_per_m for law in laws]
    )
    log_current = math.log(peak_A) + common.decay_per_m * float(height_m)
    shares = [1.0 / max(law.offset_standard_A, 1e-30) ** 2 for law in laws]
    confidence, reasons = judge_together(fits, common)
    low, high = common.interval_per_m
    return GapLaw(
        polarity=laws[0].polarity,
        decay_per_m=common.decay_per_m,
        decay_interval_per_m=common.interval_per_m,
        barrier_eV=barrier_of_decay(common.decay_per_m),
        barrier_interval_eV=(barrier_of_decay(low), barrier_of_decay(high)),
        current_at_zero_height_A=math.exp(min(log_current, 700.0)),
        offset_A=float(np.average([law.offset_A for law in laws], weights=shares)),
        offset_standard_A=float(1.0 / np.sqrt(np.sum(shares))),
        floor_A=float(np.mean([law.floor_A for law in laws])),
        gap_jitter_m=float(np.mean([law.gap_jitter_m for law in laws])),
        sweep_decay_per_m=tuple(estimate.decay_per_m for estimate in common.estimates),
        confidence=confidence,
        reasons=tuple(reason.text for reason in reasons),
    )
