"""Fitted plays behind functions: operator, uncertainty and trials."""

from dataclasses import dataclass

import numpy as np

from piezoid.identification.piece_start import PieceStart
from piezoid.identification.quality import Certificate
from piezoid.numerics.arrays import Array, freeze
from piezoid.numerics.robust import student_quantile
from piezoid.operators.preisach_plays import PreisachPlays


@dataclass(frozen=True, kw_only=True)
class FunctionOrder:
    """Number of plays and pieces of one trial, with its errors.

    plays, pieces   how many, and of how many straight pieces every function is
    held_out_rms_m  what they leave of rows they were not fitted to, once pasts are forgotten
    plain_rms_m     what plays with dead zones leave of these, though they were fitted to them
    """

    plays: int
    pieces: int
    held_out_rms_m: float
    plain_rms_m: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Believed:
    """What an axis had before another class took the place of its plays with dead zones."""

    rms_m: float
    held_out_rms_m: float
    held_out_kind: str
    certificate: Certificate
    starts: tuple[PieceStart, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class MinorLoops:
    """Plays behind functions, which replace plays with dead zones in simulation and export.

    operator      0 where ``AxisModel.hysteresis`` is
    without_m     (blocks, plays, edges - 1)  what the functions rise between edges in fits without
                  one block of time each
    least_rise_m  that of the play of no width between edges, in all of these
    plain         what plays with dead zones leave, how far they may be wrong and where they begin,
                  by which a diagnosis goes
    """

    operator: PreisachPlays
    without_m: Array
    least_rise_m: float
    plain: Believed

    def __post_init__(self) -> None:
        freeze(self, "without_m", ndim=3)
        if self.without_m.shape[1:] != self.operator.rise_m.shape:
            raise ValueError(
                f"fits without blocks of shape {self.without_m.shape}, expected "
                f"{self.operator.rise_m.shape} each"
            )

    @property
    def half_m(self) -> Array:
        """Half the 95 % interval of the rises of all functions, (plays, edges - 1)."""
        blocks = len(self.without_m)
        spread = self.without_m.std(axis=0) * np.sqrt(blocks - 1.0)
        return np.asarray(student_quantile(0.975, blocks - 1) * spread)

    def draw(self, rng: np.random.Generator, draws: int) -> tuple[PreisachPlays, ...]:
        """Draw operators from the jackknife distribution of the fit.

            rise + sum_c xi_c sqrt((G - 1)/G) (rise_(c) - mean),   xi standard normal

        All their functions are non-decreasing, as in the fit.
        """
        blocks = len(self.without_m)
        kicks = rng.standard_normal((draws, blocks)) * np.sqrt((blocks - 1) / blocks)
        centred_m = self.without_m - self.without_m.mean(axis=0)
        rises_m = self.operator.rise_m + np.tensordot(kicks, centred_m, axes=1)
        rises_m[:, 0] = np.maximum(rises_m[:, 0], self.least_rise_m)
        return tuple(self.operator.with_rises(rise_m) for rise_m in np.maximum(rises_m, 0.0))
