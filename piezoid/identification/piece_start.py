"""Fitted starts of the pieces of recordings: initial state and zero."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from piezoid.numerics.arrays import Array, freeze

MIN_DRIFT = 5e-4  # of the range: a smaller drift of the zero does not matter to a controller
# Drift over the residual: the zero also follows unmodelled hysteresis. On healthy recordings of
# seven laws it drifted by 0.01 to 3.1 times the residual, with a drift of 1 % by 16 times.
MIN_RATIO = 4.0


@dataclass(frozen=True, kw_only=True, eq=False)
class PieceStart:
    """Initial state and zero of one uninterrupted piece of a recording.

    recording       name of the recording
    memory_V        (plays,)  admissible states of u - u_off before the first sample
    zero_m          (knots,)  displacement at output 0 of the operator, equidistant over the rows
    first, last     first fitted sample of the piece, and the sample after the last
    history_weight  (histories,)  weights of ``AxisModel.history_changes_m``; empty: 0
    """

    recording: str
    memory_V: Array
    zero_m: Array
    first: int
    last: int
    history_weight: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        freeze(self, "memory_V", "zero_m", "history_weight")


def drifting_zeros(
    starts: Sequence[PieceStart], rms_m: float, range_m: float
) -> tuple[tuple[PieceStart, float], ...]:
    """Return the pieces whose zero drifts significantly, each with its drift in m.

    rms_m    residual of the fit
    range_m  of the displacement
    """
    min_drift_m = max(MIN_DRIFT * range_m, MIN_RATIO * rms_m)
    drifts = [(start, float(np.ptp(start.zero_m))) for start in starts]
    return tuple((start, drift_m) for start, drift_m in drifts if drift_m > min_drift_m)
