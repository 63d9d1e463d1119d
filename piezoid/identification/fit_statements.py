"""Statements about a fit: whether the model applies, what limits its accuracy, what to record.

Report and terminal select and print these statements; they evaluate nothing themselves.
"""

from dataclasses import replace
from enum import StrEnum

from piezoid.formatting import significant, with_unit
from piezoid.identification.hysteresis.pieces import drifting_zeros
from piezoid.identification.model import AxisModel
from piezoid.records import drive_scope
from piezoid.statement import Level, Statement, limit

# Uncompensated hysteresis of 10 to 15 % of the range is an error of about 3 % rms.
GOOD_PERCENT = 0.5  # of the range, rms: a sixth of uncompensated hysteresis or less
POOR_PERCENT = 2.0  # of the range, rms: two thirds of uncompensated hysteresis
NEAR_NOISE = 1.5  # held-out error over sensor noise: the sensor limits the error
LOOSE_WIDTH = 0.2  # half interval of the loop width over the width
MAX_WIDTH_ERRORS = 10.0  # half interval over the held-out error, which contains both branches
MIN_BLOCKS = 10  # of cycles, from which intervals are computed
POOR_SCORE, ACTION_SCORE, GOOD_SCORE = 50, 70, 90  # of `Limit.most`

MAX_EXCLUDED = 0.1  # of a piece of a recording: a larger part that was excluded is a warning

ZERO_DRIFT = "baseline_drift"  # quantity of the notes on fitted drift of the zero
DYNAMICS = "dynamics"  # quantity of the notes on poles, resonances and delay
REMEDIES = {
    **drive_scope.REMEDIES,
    "speed": "Repeat the same drive ten times slower: hysteresis keeps its width, a lag does not.",
    "amplitude": "Record reversals of decreasing size over the whole range.",
    "recording": "Record a second, different drive over this range: reversals of many sizes at "
    "another speed.",
    "closed_loop": "Open the loop and record again with the drive free.",
    "leads": "Check the assignment of the columns, and that one clock stamps both channels.",
    "smoothed": "Use the file as it was recorded, without smoothing.",
    "implausible_gain": "Check both units, and whether the drive is an amplifier's monitor. "
    "At a sharp resonance such a gain is right.",
    "stands": "Record with the drive inside that range, or exclude those cycles.",
    "slides": "Stamp both channels by one clock, and record again.",
    "zero_jump": "Tighten the mount, check the sensor's zero and its counter, and record again.",
}


class Grade(StrEnum):
    """Reliability of a fitted axis."""

    GOOD = "good"
    LIMITED = "usable with care"
    POOR = "poor"
    REJECTED = "model does not apply"


def grade_of(axis: AxisModel) -> Grade:
    """Grade an axis by its held-out error and by the gaps of its recordings.

    A good axis has an error below ``GOOD_PERCENT`` of its range or at the sensor noise, and its
    recordings determine the loop and its cause.
    """
    quality = axis.quality
    if not axis.verdict.applies:
        return Grade.REJECTED
    cap = min((limit.most for limit in quality.limits), default=100)
    is_noise_limited = quality.held_out_rms_m <= NEAR_NOISE * quality.noise_rms_m
    error_percent = 0.0 if is_noise_limited else quality.held_out_rms_percent
    if cap < POOR_SCORE or error_percent > POOR_PERCENT:
        return Grade.POOR
    if cap < GOOD_SCORE or error_percent > GOOD_PERCENT:
        return Grade.LIMITED
    return Grade.GOOD


def fit_statements(axis: AxisModel) -> tuple[Statement, ...]:
    """Return the statements about one fitted axis, most important first."""
    statements, name = [], axis.axis
    if not axis.verdict.applies:
        text = (
            f"The hysteresis model does not apply: {axis.verdict.reason}. Check the columns, "
            "the unit of the time, and that both channels are sampled at the same instant; then "
            "sweep ten times slower."
        )
        statements.append(limit(Level.ACTION, "model_class", text, axis=name))
    if not axis.quality.converged:
        text = (
            "The search stopped at its limit of iterations; a better fit may exist. Record "
            "reversals of decreasing size over the whole range and fit again."
        )
        statements.append(limit(Level.WARNING, "convergence", text, axis=name))
    for gap in axis.quality.limits:
        level = Level.ACTION if gap.most <= ACTION_SCORE else Level.WARNING
        text = f"{sentence(gap.reason)} {REMEDIES.get(gap.lack, '')}".strip()
        statements.append(limit(level, gap.lack, text, axis=name))
    quality = axis.quality
    if quality.noise_is_most:
        text = (
            f"The sensor noise is at most {with_unit(quality.noise_rms_m, 'm')}: it cannot be "
            "separated from the residual. Repeat the drive: equal periods differ by the noise."
        )
        noise_m = quality.noise_rms_m
        statements.append(limit(Level.WARNING, "noise", text, axis=name, value=noise_m, unit="m"))
    statements += _intervals(axis)
    for start, drift_m in drifting_zeros(axis.starts, quality.rms_m, quality.range_m):
        text = (
            f"The zero drifts by {with_unit(drift_m, 'm')} "
            f"({significant(100.0 * drift_m / quality.range_m, 2)} % of the range) during "
            f"{start.recording}; the fit follows the drift."
        )
        note = limit(Level.NOTE, ZERO_DRIFT, text, axis=name, value=drift_m, unit="m")
        statements.append(replace(note, recording=start.recording))
    for start in axis.starts:
        if start.first > 0:
            level = Level.WARNING if start.first > MAX_EXCLUDED * start.last else Level.NOTE
            text = (
                f"The first {start.first} of {start.last} samples of {start.recording}, or of a "
                "piece of it behind a gap, were excluded: no initial state of the hysteresis "
                "explains them. Record again after several full cycles of the drive."
            )
            count, recording = float(start.first), start.recording
            statements.append(
                limit(level, "excluded", text, axis=name, recording=recording, value=count)
            )
    for remark in axis.verdict.remarks:
        quantity = DYNAMICS if remark in axis.dynamics_remarks else "fit"
        is_verdict = axis.bandwidth is not None and remark == axis.bandwidth.text
        level = Level.ACTION if is_verdict and axis.unfitted_resonance_Hz else Level.NOTE
        statements.append(limit(level, quantity, remark, axis=name))
    return tuple(statements)


def sentence(clause: str) -> str:
    """Return a clause as a sentence with capital and full stop; a file name keeps its case."""
    first_word, _, _ = clause.partition(" ")
    first_letter = clause[:1].upper() if first_word.rstrip(",:").isalpha() else clause[:1]
    return f"{first_letter}{clause[1:].rstrip('.')}."


def _intervals(axis: AxisModel) -> list[Statement]:
    statements = []
    blocks = axis.uncertainty.blocks
    if blocks < MIN_BLOCKS:
        text = (
            f"The intervals rest on only {blocks} blocks of cycles. Record at least twelve cycles "
            "of different sizes."
        )
        statements.append(
            limit(Level.WARNING, "blocks", text, axis=axis.axis, value=float(blocks))
        )
    width_m, half_m = axis.uncertainty.loop_width_m
    if half_m > LOOSE_WIDTH * abs(width_m):
        text = (
            f"The width of the loop, {with_unit(width_m, 'm')}, is known to "
            f"±{with_unit(half_m, 'm')} only."
            if has_usable_intervals(axis)
            else "These recordings do not determine single parameters, so no interval of a "
            "parameter is usable. The held-out error, "
            f"{with_unit(axis.quality.held_out_rms_m, 'm')} rms, still holds for similar drives."
        )
        text += " For narrower intervals, record full-range cycles several times at one speed."
        statements.append(
            limit(Level.WARNING, "loop_width", text, axis=axis.axis, value=half_m, unit="m")
        )
    return statements


def has_usable_intervals(axis: AxisModel) -> bool:
    """Return whether the intervals of the parameters agree with the held-out error.

    Intervals and held-out predictions are computed from the same refits without a block. Accurate
    predictions with wide intervals show that the intervals extrapolate linearly along a poorly
    determined direction.
    """
    width_m, half_m = axis.uncertainty.loop_width_m
    limit_m = max(LOOSE_WIDTH * abs(width_m), MAX_WIDTH_ERRORS * axis.quality.held_out_rms_m)
    return not axis.quality.is_tested or half_m <= limit_m
