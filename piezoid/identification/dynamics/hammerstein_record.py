"""What a model carries on of a joint fit of hysteresis and dynamics."""

from dataclasses import dataclass
from typing import Literal

Order = Literal["before", "behind", "undecided"]


@dataclass(frozen=True, kw_only=True)
class StructureVerdict:
    """Where the nonlinearity stands, and why.

    order                  of the nonlinearity: before or behind the dynamics, or undecided
    agreement_before       correlation of the measured harmonics with those of G[H[u]], -1 to 1
    agreement_behind       with those of H[G[u]]
    phase_before_deg       by which the measured ones lead those of G[H[u]]
    phase_behind_deg       by which they lead those of H[G[u]]
    difference_half        half the 95 % interval of the difference of the agreements
    lowest_Hz              from where harmonics counted
    """

    order: Order
    agreement_before: float
    agreement_behind: float
    phase_before_deg: float
    phase_behind_deg: float
    difference_half: float
    lowest_Hz: float

    @property
    def text(self) -> str:
        """One sentence."""
        said = {
            "before": "the hysteresis stands before the dynamics",
            "behind": "the hysteresis stands behind the dynamics: this model has the wrong order",
            "undecided": "the recording does not tell where the hysteresis stands",
        }[self.order]
        return (
            f"Harmonics above {self.lowest_Hz:.0f} Hz agree to {self.agreement_before:.2f} with "
            f"hysteresis before the dynamics (phase off by {self.phase_before_deg:.0f} degrees), "
            f"to {self.agreement_behind:.2f} with hysteresis behind them "
            f"({self.phase_behind_deg:.0f} degrees), difference known to "
            f"{self.difference_half:.2f}: {said}."
        )


@dataclass(frozen=True, kw_only=True)
class JointFit:
    """Operator and dynamics fitted together; the dynamics themselves stand in the axis.

    recordings            of the fit, one for every piece
    play_threshold_V      (plays,)  those of the operator, and small ones of the exciting drive
    play_weight_m_per_V   (plays,)
    dead_zone_weight      (zones,)  at the operator's thresholds
    apart_rms_m           of what operator and dynamics found apart leave, each piece
    joint_rms_m           of what the joint fit leaves, each piece
    structure             where the nonlinearity stands
    """

    recordings: tuple[str, ...]
    play_threshold_V: tuple[float, ...]
    play_weight_m_per_V: tuple[float, ...]
    dead_zone_weight: tuple[float, ...]
    apart_rms_m: tuple[float, ...]
    joint_rms_m: tuple[float, ...]
    structure: StructureVerdict
