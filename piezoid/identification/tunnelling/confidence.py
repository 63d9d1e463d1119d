"""How far a fitted barrier may be trusted, and why: rules with their limits, in plain sight."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np


class Confidence(Enum):
    """How far a result may be trusted."""

    HIGH = "high"
    MEDIUM = "medium"
    LOW = "low"


@dataclass(frozen=True, kw_only=True)
class Reason:
    """Why a result deserves less than full confidence.

    grade  the confidence it leaves at most
    text   one sentence with the number and the limit it breaks
    """

    grade: Confidence
    text: str


@dataclass(frozen=True, kw_only=True)
class SweepEvidence:
    """What the rules look at.

    points             used in the fit
    rows               of the recording
    saturated          rows left out because the amplifier stood at its limit
    peak_A             largest modelled current
    floor_A            rms noise without current
    decades            of current above three times that noise, within the heights swept
    relative_noise     noise proportional to the current
    jumps              tip jumps found
    largest_jump       nepers
    barrier_eV         fitted
    barrier_low_eV     ends of its 95 % interval
    barrier_high_eV    infinite where nothing bounds it
    reaches_floor      the sweep ends where the current is below the noise
    slope_change       decay of the weak half over that of the strong half, minus one
    outliers           fraction of the points pulled in as outliers
    """

    points: int
    rows: int
    saturated: int
    peak_A: float
    floor_A: float
    decades: float
    relative_noise: float
    jumps: int
    largest_jump: float
    barrier_eV: float
    barrier_low_eV: float
    barrier_high_eV: float
    reaches_floor: bool
    slope_change: float
    outliers: float

    @property
    def relative_width(self) -> float:
        """Width of the 95 % interval over the value."""
        return (self.barrier_high_eV - self.barrier_low_eV) / self.barrier_eV


@dataclass(frozen=True, kw_only=True)
class Rule:
    """One quantity with the two limits it may not exceed.

    quantity  what is compared
    medium    beyond it, at most medium confidence
    low       beyond it, low confidence
    sentence  what to say, given the evidence
    """

    quantity: Callable[[SweepEvidence], float]
    medium: float
    low: float
    sentence: Callable[[SweepEvidence], str]


RULES: tuple[Rule, ...] = (
    Rule(
        quantity=lambda e: e.saturated / e.rows,
        medium=0.0,
        low=0.5,
        sentence=lambda e: f"{e.saturated} of {e.rows} rows lie at the amplifier's limit",
    ),
    Rule(
        quantity=lambda e: 1.0 - (e.points + e.saturated) / e.rows,
        medium=0.1,
        low=0.5,
        sentence=lambda e: f"{e.rows - e.points - e.saturated} of {e.rows} rows hold no number",
    ),
    Rule(
        quantity=lambda e: -e.points,
        medium=-40,
        low=-20,
        sentence=lambda e: f"only {e.points} points",
    ),
    Rule(
        quantity=lambda e: -e.decades,
        medium=-2.5,
        low=-1.5,
        sentence=lambda e: (
            f"the current spans {e.decades:.2g} decades above three times its noise: "
            f"{e.peak_A:.3g} A at most, noise {e.floor_A:.3g} A"
        ),
    ),
    Rule(
        quantity=lambda e: e.relative_width,
        medium=0.2,
        low=0.5,
        sentence=lambda e: (
            f"the 95 % interval runs from {e.barrier_low_eV:.3g} to {e.barrier_high_eV:.3g} eV"
        ),
    ),
    Rule(
        quantity=lambda e: e.relative_noise,
        medium=0.1,
        low=0.3,
        sentence=lambda e: (
            f"the current fluctuates by {100 * e.relative_noise:.2g} % of itself: unstable tip"
        ),
    ),
    Rule(
        quantity=lambda e: e.jumps,
        medium=0,
        low=1,
        sentence=lambda e: f"{e.jumps} tip jump(s), the largest of {e.largest_jump:.2g} nepers",
    ),
    Rule(
        quantity=lambda e: abs(e.largest_jump),
        medium=0.3,
        low=1.0,
        sentence=lambda e: f"a tip jump of {e.largest_jump:.2g} nepers",
    ),
    Rule(
        quantity=lambda e: float(not e.reaches_floor),
        medium=0.5,
        low=np.inf,
        sentence=lambda e: (
            f"the sweep ends above the noise of {e.floor_A:.3g} A: the offset rests on the "
            "fitted law"
        ),
    ),
    Rule(
        quantity=lambda e: abs(e.slope_change),
        medium=0.1,
        low=0.3,
        sentence=lambda e: (
            f"the decay of the weaker half differs by {100 * e.slope_change:.2g} % from that of "
            "the stronger: creep of the height, or not one exponential"
        ),
    ),
    Rule(
        quantity=lambda e: e.outliers,
        medium=0.05,
        low=0.2,
        sentence=lambda e: f"{100 * e.outliers:.2g} % of the points are outliers",
    ),
    Rule(
        quantity=lambda e: max(e.barrier_eV / 7.0, 0.05 / e.barrier_eV),
        medium=1.0,
        low=2.0,
        sentence=lambda e: (
            f"a barrier of {e.barrier_eV:.3g} eV lies outside 0.05 to 7 eV: is the height in "
            "metres, and is its calibration right?"
        ),
    ),
)


def judge(evidence: SweepEvidence) -> tuple[Confidence, tuple[Reason, ...]]:
    """Return the confidence a fit deserves and every rule it breaks, worst first."""
    reasons = []
    for rule in RULES:
        value = rule.quantity(evidence)
        if not value <= rule.medium:
            grade = Confidence.MEDIUM if value <= rule.low else Confidence.LOW
            reasons.append(Reason(grade=grade, text=rule.sentence(evidence)))
    reasons.sort(key=lambda reason: reason.grade is not Confidence.LOW)
    if not reasons:
        return Confidence.HIGH, ()
    return reasons[0].grade, tuple(reasons)
