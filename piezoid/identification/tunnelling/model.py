"""Model of the junction from sweeps, from closed loops, and from both together.

Sweeps measure k relative to the recorded height, the loop relative to the declared extension per
volt. Their ratio does not depend on the barrier:

    k_loop / k_sweep = (true extension per volt) / (declared)    if the height of the sweep is true

so that a disagreement shows that one of the two calibrations is wrong, or that the spots differ.
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
    agree           whether that interval contains 1
    decay_per_m     weighted mean of both; None if they disagree
    decay_interval_per_m  95 % interval of the mean; if they disagree, the range of both intervals
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

    sweeps, loop  decay and interval, 1/m; an unbounded interval carries no information

    If the decays differ by more than their standard deviations, the interval of the mean is
    widened by that ratio (Birge).
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
        decay, interval = math.exp(mean), _exp_interval(mean, NORMAL_95 * spread)
    return JointBarrier(
        ratio=math.exp(log_ratio),
        ratio_interval=_exp_interval(log_ratio, half),
        agree=agree,
        decay_per_m=decay,
        decay_interval_per_m=interval,
        barrier_eV=None if decay is None else barrier_of_decay(decay),
        barrier_interval_eV=(barrier_of_decay(interval[0]), barrier_of_decay(interval[1])),
    )


def _exp_interval(center: float, half: float) -> Interval:
    """Return exp(center -+ half); (0, inf) if half is infinite."""
    if not math.isfinite(half):
        return 0.0, math.inf
    return math.exp(center - half), math.exp(center + half)


@dataclass(frozen=True, kw_only=True)
class TunnellingModel:
    """Model of the tunnelling junction, from sweeps, closed loops, or both.

    gap_law     of all sweeps together, corrected for drift; None: no sweeps loop_plant  None: no
    closed loops forward     of the forward sweeps, not corrected for drift; None unless there are
    both directions backward    of the backward sweeps likewise shift       between both
    directions; None also if no current is above the noise in both joint       of sweeps and loops
    together; None unless there are both
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
