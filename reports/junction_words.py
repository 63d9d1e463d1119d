"""What is said of a junction, in the verdict and in its chapter."""

import math

from piezoid.identification.tunnelling.barrier_fit import JointBarrier
from piezoid.identification.tunnelling.confidence import Confidence
from piezoid.identification.tunnelling.loop_model import LoopPlant
from piezoid.identification.tunnelling.model import GapLaw
from piezoid_reports.page import Prose
from piezoid_reports.quantities import NARROW, significant, told

TONES = {Confidence.HIGH: "good", Confidence.MEDIUM: "middling", Confidence.LOW: "bad"}


def judged(law: GapLaw) -> Prose:
    """Return barrier, interval and confidence as one paragraph."""
    return Prose(text=barrier_sentence(law), tone=TONES[law.confidence])


def barrier_sentence(law: GapLaw) -> str:
    """Return barrier, interval and confidence as a sentence."""
    barrier = told_interval(law.barrier_eV, law.barrier_interval_eV, "eV")
    broken = len(law.reasons)
    why = (
        f"{broken} of the rules it is judged by are not met"
        if broken
        else "every rule it is judged by is met"
    )
    return f"Apparent barrier {barrier}, {confidence_of(law)} confidence: {why}."


SOURCES = {
    "shot": "shot noise",
    "johnson": "Johnson noise of the resistor",
    "adc_step": "step of the current's converter",
    "drive_step": "step of the drive's converter",
    "gap": "unrest of the gap itself",
}


def loop_judged(loop: LoopPlant) -> Prose:
    """Return barrier, interval and confidence of the closed loop as one paragraph."""
    return Prose(text=loop_sentence(loop), tone=TONES[loop.confidence])


def loop_sentence(loop: LoopPlant) -> str:
    """Return what the closed loop says of barrier and gain as a sentence."""
    barrier = told_interval(loop.barrier_eV, loop.barrier_interval_eV, "eV")
    gain = told_interval(loop.plant.gain_nepers_per_V, loop.gain_interval, "")
    count = max(len(loop.records), 1)
    records = "one closed loop" if count == 1 else f"{count} closed loops"
    return (
        f"From {records}: apparent barrier {barrier}, gain of the height loop {gain} nepers per "
        f"volt, {loop.confidence.value} confidence."
    )


def joint_sentence(law: GapLaw, loop: LoopPlant, joint: JointBarrier) -> str:
    """Return whether sweeps and closed loop agree, with both barriers, as a sentence."""
    if joint.barrier_eV is not None:
        common = told_interval(joint.barrier_eV, joint.barrier_interval_eV, "eV")
        return f"Sweeps and loop agree. Both together, weighted: {common}."
    low, high = (significant(end, 4) for end in joint.barrier_interval_eV)
    sweeps = told_interval(law.barrier_eV, law.barrier_interval_eV, "eV")
    looped = told_interval(loop.barrier_eV, loop.barrier_interval_eV, "eV")
    return (
        f"Sweeps and loop disagree: {sweeps} from the sweeps, {looped} from the loop. The "
        "extension per volt or the calibration of the height is off, or the tip or the spot was "
        f"another; what is known of the barrier is {low} to {high} eV."
    )


def confidence_of(law: GapLaw) -> str:
    """Return the confidence as a word."""
    return law.confidence.value


def told_interval(value: float, interval: tuple[float, float], unit: str) -> str:
    """Return a value and its 95 % interval, which need not be symmetric or bounded.

    Where any value is inside the interval, none is told.
    """
    low, high = interval
    if low <= 0.0 and not math.isfinite(high):
        return "unknown (any value fits these recordings)"
    if unit in ("", "eV"):
        ends = [significant(end, 4) if math.isfinite(end) else "any" for end in (low, high)]
        shown = f"{significant(value, 4)}{NARROW}{unit}" if unit else significant(value, 4)
        return f"{shown} ({ends[0]} to {ends[1]})"
    if not math.isfinite(high):
        return f"{told(value, unit)} ({told(low, unit)} or more)"
    return f"{told(value, unit)} ({told(low, unit)} to {told(high, unit)})"
