"""One barrier from sweeps and closed loop, where the two agree; where they do not, their ratio.

Both measure k, a sweep over the height it was given, the loop over the extension per volt it was
given. Their ratio is free of the barrier:

    k_loop / k_sweep = (true extension per volt) / (declared one)    if the sweep's height is true

so that a disagreement says that one of the two calibrations, or the spot, is another.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

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


def join_barriers(
    sweeps: Sequence[tuple[float, Interval]], loop: tuple[float, Interval]
) -> JointBarrier:
    """Combine decays with their 95 % intervals, in the logarithm, by inverse variance.

    sweeps  (decay, interval), 1/m, of all sweeps together or of parts that tell nothing of drift
    loop    (decay, interval), 1/m

    Parts that differ by more than their intervals allow widen the mean by that much
    (Birge's ratio). An interval without an end counts as no information.
    """
    sweep, sweep_variance = _mean([_log(*pair) for pair in sweeps])
    loop_log, loop_variance = _log(*loop)
    half = NORMAL_95 * math.sqrt(sweep_variance + loop_variance)
    log_ratio = loop_log - sweep
    agree = abs(log_ratio) <= half
    joint = _mean([(sweep, sweep_variance), (loop_log, loop_variance)]) if agree else None
    decay = None if joint is None else math.exp(joint[0])
    ends = [*(interval for _, interval in sweeps), loop[1]]
    interval = min(low for low, _ in ends), max(high for _, high in ends)
    if joint is not None:
        interval = _ends(joint[0], NORMAL_95 * math.sqrt(joint[1]))
    return JointBarrier(
        ratio=math.exp(log_ratio),
        ratio_interval=_ends(log_ratio, half),
        agree=agree,
        decay_per_m=decay,
        decay_interval_per_m=interval,
        barrier_eV=None if decay is None else barrier_of_decay(decay),
        barrier_interval_eV=(barrier_of_decay(interval[0]), barrier_of_decay(interval[1])),
    )


def _log(decay: float, interval: Interval) -> tuple[float, float]:
    low, high = interval
    if not (low > 0.0 and math.isfinite(high)):
        return math.log(decay), math.inf
    return math.log(decay), (math.log(high / low) / (2.0 * NORMAL_95)) ** 2


def _mean(parts: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Mean and variance, widened where the parts scatter more than their variances say."""
    weights = [1.0 / max(variance, 1e-30) for _, variance in parts]
    total = sum(weights)
    if not total > 0.0:
        return sum(value for value, _ in parts) / len(parts), math.inf
    mean = sum(w * value for w, (value, _) in zip(weights, parts, strict=True)) / total
    known = [(w, value) for w, (value, _) in zip(weights, parts, strict=True) if w > 0.0]
    excess = sum(w * (value - mean) ** 2 for w, value in known) / max(len(known) - 1, 1)
    return mean, max(excess, 1.0) / total


def _ends(center: float, half: float) -> Interval:
    if not math.isfinite(half):
        return 0.0, math.inf
    return math.exp(center - half), math.exp(center + half)
