"""Fitted plays behind functions: operator, uncertainty and the shapes that were tried."""

from dataclasses import dataclass

import numpy as np

from piezoid.identification.hysteresis.pieces import PieceStart
from piezoid.identification.quality import Certificate
from piezoid.numerics.arrays import Array, freeze
from piezoid.operators.preisach_plays import PreisachPlays


@dataclass(frozen=True, kw_only=True)
class FunctionOrder:
    """One shape of plays behind functions that was tried, with its errors.

    plays           number of plays
    pieces          number of straight pieces of each function
    held_out_rms_m  error on held-out rows that do not depend on the initial state
    plain_rms_m     residual of plays with dead zones on these rows, to which they were fitted
    """

    plays: int
    pieces: int
    held_out_rms_m: float
    plain_rms_m: float


@dataclass(frozen=True, kw_only=True, eq=False)
class PlaysFit:
    """Errors, bound and starts of the fit of plays with dead zones, which functions replaced."""

    rms_m: float
    held_out_rms_m: float
    held_out_kind: str
    certificate: Certificate
    starts: tuple[PieceStart, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class MinorLoops:
    """Plays behind functions, which replace plays with dead zones in simulation and export.

    operator      its displacement is measured from the zero of ``AxisModel.hysteresis``
    without_m     (blocks, plays, edges - 1)  rises of the functions between edges, refitted
                  without each block of time
    least_rise_m  lower bound of the rises of the play of zero width, in all of these fits
    plain         the fit of plays with dead zones, from which a diagnosis starts
    """

    operator: PreisachPlays
    without_m: Array
    least_rise_m: float
    plain: PlaysFit

    def __post_init__(self) -> None:
        freeze(self, "without_m", ndim=3)
        if self.without_m.shape[1:] != self.operator.rise_m.shape:
            raise ValueError(
                f"fits without blocks of shape {self.without_m.shape}, expected "
                f"{self.operator.rise_m.shape} each"
            )

    def draw(self, rng: np.random.Generator, draws: int) -> tuple[PreisachPlays, ...]:
        """Draw operators from the jackknife distribution of the fit.

            rise + sum_c xi_c sqrt((G - 1)/G) (rise_(c) - mean),   xi standard normal, G blocks

        As in the fit, no function falls and the first rises by ``least_rise_m`` at least.
        """
        blocks = len(self.without_m)
        deviates = rng.standard_normal((draws, blocks)) * np.sqrt((blocks - 1) / blocks)
        centred_m = self.without_m - self.without_m.mean(axis=0)
        rises_m = self.operator.rise_m + np.tensordot(deviates, centred_m, axes=1)
        rises_m[:, 0] = np.maximum(rises_m[:, 0], self.least_rise_m)
        return tuple(self.operator.with_rises(rise_m) for rise_m in np.maximum(rises_m, 0.0))
