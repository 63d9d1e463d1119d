"""One number for an axis: how much of what a straight line leaves the model takes away."""

from math import log2

from piezoid.identification.model import AxisModel
from piezoid_reports.traces import Trace, rms

GOOD, MIDDLING = 90, 50
DOUBLED = 5  # points, where the error is twice the noise and where it is four times
CONTRADICTION = 0.9  # times the noise: what no model can leave, but for chance
WORDS = {"good": "good", "middling": "usable with care", "bad": "poor"}
UNSCORED = ("middling", "no score")
REFUSED = ("bad", "does not apply")


def score_of(axis: AxisModel, traces: tuple[Trace, ...]) -> int | None:
    """Return the score, 0 to 100; None where the class does not apply or nothing can be scored.

        100 (line - held out) / (line - noise),   all rms

    100: only the sensor's noise is left; 0: no better than a straight line. Three things cap it.
    An error of twice the noise is 95 at most, of four times or more 90: beside a wide loop it may
    be 1 % of the line and yet all that readings show. What was never measured has its own limit.
    And no error below what is called noise is perfect, for one of the two is wrong. Where the
    noise is not known but only no more than what the model leaves, none is taken off.
    """
    if not axis.verdict.applies or not traces:
        return None
    line_m = line_rms_m(traces)
    noise_m = 0.0 if axis.quality.noise_is_most else axis.quality.noise_rms_m
    if line_m <= noise_m:
        return None
    held_m = axis.quality.held_out_rms_m
    share = (line_m - held_m) / (line_m - noise_m)
    most = min((limit.most for limit in axis.quality.limits), default=100)
    if held_m < CONTRADICTION * noise_m:
        most = min(most, GOOD - 1)
    elif held_m > noise_m > 0.0:
        most = min(most, max(round(100 - DOUBLED * log2(held_m / noise_m)), GOOD))
    return min(round(100 * min(max(share, 0.0), 1.0)), most)


def line_rms_m(traces: tuple[Trace, ...]) -> float:
    """Return what the best straight line leaves on the samples the fit used, m rms."""
    squares = sum(rms(t.line_residual_m) ** 2 * t.counted for t in traces)
    return float((squares / sum(t.counted for t in traces)) ** 0.5)


def judgement_of(axis: AxisModel, score: int | None) -> tuple[str, str]:
    """Return ``good``, ``middling`` or ``bad``, and the word a reader sees."""
    if not axis.verdict.applies:
        return REFUSED
    if score is None:
        return UNSCORED
    tone = "bad" if score < MIDDLING else "middling" if score < GOOD else "good"
    return tone, WORDS[tone]
