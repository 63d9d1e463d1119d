"""Forward against backward: the shift between both ways, and whether one decay fits both."""

import math
from dataclasses import dataclass

import numpy as np

from piezoid.errors import ExcitationError
from piezoid.identification.tunnelling.barrier_fit import NORMAL_95, BarrierFit
from piezoid.record_json import Interval


@dataclass(frozen=True, kw_only=True)
class DirectionShift:
    """How the backward sweeps differ from the forward ones.

    reference_current_A  magnitude at which the heights are compared
    shift_m              height of that current backward minus forward; hysteresis, creep, drift
    shift_interval_m     95 %
    decay_change         decay backward over forward, minus one
    decay_change_interval  95 %
    """

    reference_current_A: float
    shift_m: float
    shift_interval_m: Interval
    decay_change: float
    decay_change_interval: Interval

    @property
    def is_one_decay(self) -> bool:
        """Whether both directions are compatible with one decay."""
        low, high = self.decay_change_interval
        return low <= 0.0 <= high


def compare_directions(forward: BarrierFit, backward: BarrierFit) -> DirectionShift:
    """Compare the two directions at a current both saw well.

        z(i) = ( ln I_0 - ln i ) / k,    shift = z_backward(i) - z_forward(i)

    The reference is the geometric mean of the smaller peak and three times the larger floor; there
    decay and height are nearly uncorrelated. Intervals by the delta method from the block
    covariances, the directions taken as independent.
    """
    reference_A = _reference(forward, backward)
    heights = [_height_of(fit, reference_A) for fit in (forward, backward)]
    spread_m = NORMAL_95 * math.hypot(heights[0][1], heights[1][1])
    shift_m = heights[1][0] - heights[0][0]
    change = backward.decay_per_m / forward.decay_per_m - 1.0
    relative = [math.sqrt(f.covariance[0, 0]) / f.decay_per_m for f in (forward, backward)]
    spread = NORMAL_95 * math.hypot(*relative) * (1.0 + change)
    return DirectionShift(
        reference_current_A=reference_A,
        shift_m=shift_m,
        shift_interval_m=(shift_m - spread_m, shift_m + spread_m),
        decay_change=change,
        decay_change_interval=(change - spread, change + spread),
    )


def _reference(forward: BarrierFit, backward: BarrierFit) -> float:
    peak_A = min(forward.evidence.peak_A, backward.evidence.peak_A)
    floor_A = 3.0 * max(forward.noise.floor_A, backward.noise.floor_A)
    if peak_A <= floor_A:
        raise ExcitationError(
            f"{forward.labels[0]}, {backward.labels[0]}: at most {peak_A:.3g} A over a noise of "
            f"{floor_A / 3.0:.3g} A",
            needed="in both directions a current above three times the noise",
            remedy="Approach closer, or average longer.",
        )
    return math.sqrt(peak_A * floor_A)


def _height_of(fit: BarrierFit, current_A: float) -> tuple[float, float]:
    """Height of a current and its standard deviation, m."""
    height_m = math.log(fit.current_at_zero_height_A / current_A) / fit.decay_per_m
    gradient = np.array([-height_m, 1.0]) / fit.decay_per_m
    return height_m, math.sqrt(float(gradient @ fit.covariance @ gradient))
