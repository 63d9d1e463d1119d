"""TunnellingModel: the junction from sweeps, from closed loops, and from both together.

Sweeps measure k over the height they were given, the loop over the extension per volt it was
given. Their ratio is free of the barrier:

    k_loop / k_sweep = (true extension per volt) / (declared one)    if the sweep's height is true

so that a disagreement says that one of the two calibrations, or the spot, is another.
"""

import math
from dataclasses import dataclass

from piezoid.identification.tunnelling.barrier_fit import GapLaw
from piezoid.identification.tunnelling.loop_model import LoopPlant
from piezoid.identification.tunnelling.sweep_pairs import DirectionShift
from piezoid.numerics.robust import NORMAL_95
from piezoid.operators.tunnelling import barrier_of_decay
from piezoid.record_json import Interval


@dataclass(frozen=True, kw_only=True)
class JointBarrier:
    """Decay and barrier of sweeps and loop together.

    ratio           k of the loop over k of the sweeps, and its 95 % interval
    agree           whether that interval holds 1
    decay_per_m     weighted mean of both; None where they disagree
    decay_interval_per_m  95 % of it; where they disagree, from the lower end of the lower to the
                    upper end of the higher
    barrier_eV, barrier_interval_eV  of the decay
    """

    ratio: float
    ratio_interval: Interval
    agree: bool
    decay_per_m: float | None
    decay_interval_per_m: Interval
    barrier_eV: float | None
    barrier_interval_eV: Interval


def join_barriers(sweeps: tuple[float, Interval], loop: tuple[float, Interval]) -> JointBarrier:
    """Combine two decays with their 95 % intervals, in the logarithm, by inverse variance.

    sweeps, loop  decay and interval, 1/m; an interval without an end counts as no information

    Decays that differ by more than their standard deviations widen the mean by that much
    (Birge's ratio).
    """
    variances = [
        (math.log(high / low) / (2.0 * NORMAL_95)) ** 2
        if low > 0.0 and math.isfinite(high)
        else math.inf
        for _, (low, high) in (sweeps, loop)
    ]
    log_ratio = math.log(loop[0]) - math.log(sweeps[0])
    half = NORMAL_95 * math.sqrt(sum(variances))
    agree = abs(log_ratio) <= half
    decay = None
    interval = min(sweeps[1][0], loop[1][0]), max(sweeps[1][1], loop[1][1])
    if agree:
        weights = [1.0 / max(variance, 1e-30) for variance in variances]
        total = sum(weights)
        share = weights[1] / total if total > 0.0 else 0.5
        mean = math.log(sweeps[0]) + share * log_ratio
        excess = weights[0] * share * log_ratio**2 if total > 0.0 else 0.0
        spread = math.sqrt(max(excess, 1.0) / total) if total > 0.0 else math.inf
        decay, interval = math.exp(mean), _around(mean, NORMAL_95 * spread)
    return JointBarrier(
        ratio=math.exp(log_ratio),
        ratio_interval=_around(log_ratio, half),
        agree=agree,
        decay_per_m=decay,
        decay_interval_per_m=interval,
        barrier_eV=None if decay is None else barrier_of_decay(decay),
        barrier_interval_eV=(barrier_of_decay(interval[0]), barrier_of_decay(interval[1])),
    )


def _around(center: float, half: float) -> Interval:
    """Return exp(center -+ half); everything positive where half is infinite."""
    if not math.isfinite(half):
        return 0.0, math.inf
    return math.exp(center - half), math.exp(center + half)


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
