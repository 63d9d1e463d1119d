"""Fitted starts of the pieces of recordings: memory and zero."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from piezoid.numerics.arrays import Array, freeze

SEEN = 5e-4  # of the range: smaller movements of the zero do not matter to a controller
# Times what the fit leaves: the zero takes up what a class leaves of a strange law, too. On
# healthy recordings of seven laws it moved by 0.01 to 3.1 times that, with a drift of 1 % by 16.
BEYOND_THE_FIT = 4.0


@dataclass(frozen=True, kw_only=True, eq=False)
class PieceStart:
    """Where one uninterrupted piece of a recording began.

    recording    its name
    memory_V     (plays,)  admissible states of u - u_off before the first sample
    zero_m       (knots,)  displacement at which the operator's output is 0, spread over the rows
    first, last  rows of the piece that counted
    history_weight  (histories,)  weights of ``AxisModel.history_changes_m``; empty: none
    """

    recording: str
    memory_V: Array
    zero_m: Array
    first: int
    last: int
    history_weight: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        freeze(self, "memory_V", "zero_m", "history_weight")


def wandering_zeros(
    starts: Sequence[PieceStart], rms_m: float, range_m: float
) -> tuple[tuple[PieceStart, float], ...]:
    """Return the pieces whose zero moves by more than a good fit allows, and the movement.

    rms_m    residual of the fit
    range_m  of the displacement
    """
    least_m = max(SEEN * range_m, BEYOND_THE_FIT * rms_m)
    wandering = [(start, float(np.ptp(start.zero_m))) for start in starts]
    return tuple((start, by_m) for start, by_m in wandering if by_m > least_m)
