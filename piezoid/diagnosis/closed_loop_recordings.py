"""Creep under feedback that holds the sensor: the drive that compensates it shows it directly.

    y = const  =>  -g (u(t) - u(0)) = a ln(1 + t / s) + noise,      g the stage's mean gain

The logarithm, with two parameters, is compared with a cubic of time, with three, on left-out
blocks, in units of the drive. It is creep if it continues the move before and its error is not
larger than that of the cubic; if it is hardly smaller, creep cannot be separated from drift. The
interval of the size contains the error of the mean gain: the slope of a small loop after a
reversal is smaller.

Source: Jung & Gweon (2000) on the logarithm; Fleming & Leang (2014) on holding a position.
"""

from collections.abc import Sequence
from dataclasses import replace
from math import erfc, log, sqrt

import numpy as np

from piezoid.diagnosis.blocked_regression import SAME_ERROR, gain_on_blocks, held_out_residual
from piezoid.diagnosis.candidate import MINIMUM_Z
from piezoid.diagnosis.diagnosis import Diagnosis, Finding, Size, with_finding
from piezoid.diagnosis.effects import effect_named, every_effect
from piezoid.diagnosis.residual_coordinates import coordinate_profile
from piezoid.diagnosis.signals import cubic
from piezoid.formatting import significant, with_unit
from piezoid.numerics.arrays import Array
from piezoid.records.checks.plausibility import held_span, is_held_throughout
from piezoid.records.recording import Recording

NAME = "creep"
MIN_GAIN = 0.1  # relative reduction of the rms of the drive, which also wanders without creep
SCALES = 12  # of the logarithm, from one sample to a third of the hold
# The slope of a small loop is below the mean gain: on six laws sizes were 1.00 to 1.42 times the
# truth. The lower limit of the interval is therefore smaller by this share of the size.
SLOPE = 0.35


def with_creep_of_holds(
    diagnosis: Diagnosis, recordings: Sequence[Recording], gain_m_per_V: float
) -> Diagnosis:
    """Add creep measured in closed-loop holds, if no other recording showed creep.

    recordings    all recordings of the axis, in the order in which they were made
    gain_m_per_V  mean gain, with its sign, of the recordings in which the sensor moves
    """
    if NAME in diagnosis.names:
        return diagnosis
    axis, findings = diagnosis.axis, []
    for number, recording in enumerate(recordings):
        span = held_span(recording, axis)
        if span is None:
            continue
        drive_V, first, step_V = recording.voltage_V(axis), 0, 0.0
        if not is_held_throughout(recording, axis):
            first, step_V = span.start, _span_V(drive_V[: span.start])
        elif number:
            # the step is in the previous recording, if that ended where the hold starts
            earlier_V = recordings[number - 1].voltage_V(axis)
            move_V = _span_V(earlier_V)
            distance_V = abs(float(earlier_V[-1]) - float(drive_V[0]))
            step_V = move_V if distance_V < 0.1 * abs(move_V) else 0.0
        rows = np.arange(span.start, span.stop)
        time_s = (rows - first) / recording.sampling_rate_Hz
        findings.append(
            _finding(recording.name, time_s, drive_V[rows], step_V, diagnosis, gain_m_per_V)
        )
    largest = max(filter(None, findings), key=lambda finding: finding.share, default=None)
    return diagnosis if largest is None else with_finding(diagnosis, largest)


def _span_V(drive_V: Array) -> float:
    """Return the range of a drive; negative if its minimum comes after its maximum."""
    if len(drive_V) < 2:
        return 0.0
    low, high = int(np.argmin(drive_V)), int(np.argmax(drive_V))
    return float(np.ptp(drive_V)) * (1.0 if high > low else -1.0)


def _finding(
    recording: str,
    time_s: Array,
    held_V: Array,
    step_V: float,
    diagnosis: Diagnosis,
    gain_m_per_V: float,
) -> Finding | None:
    """Fit logarithmic creep to a hold, and return its finding; None if it is not significant.

    time_s  (rows,)  from the start of the hold
    held_V  (rows,)  drive during the hold
    step_V  step of the drive before the hold, with its sign; 0 if it is unknown
    """
    drive_V = held_V - held_V.mean()
    sample_s = float(np.median(np.diff(time_s)))
    fits = []
    for scale_s in np.geomspace(sample_s, time_s[-1] / 3.0, SCALES).tolist():
        residual_V = held_out_residual(drive_V, [np.log1p(time_s / scale_s)[:, None]])
        fits.append((float(np.sqrt(np.mean(residual_V**2))), scale_s, residual_V))
    after_V, scale_s, residual_V = min(fits, key=lambda fit: fit[0])
    constant_V = held_out_residual(drive_V, [])
    before_V = float(np.sqrt(np.mean(constant_V**2)))
    cubic_V = float(np.sqrt(np.mean(held_out_residual(drive_V, [cubic(time_s)]) ** 2)))
    column = np.log1p(time_s / scale_s)
    column -= column.mean()
    slope_V = float(column @ drive_V) / float(column @ column)
    gain, z = gain_on_blocks(constant_V, residual_V)
    # the drive compensates creep, so it moves against the step before
    continues = step_V * slope_V < 0.0
    if gain < MIN_GAIN or z < MINIMUM_Z or not continues or after_V > SAME_ERROR * cubic_V:
        return None
    effect = effect_named(NAME)
    percent = 100.0 * abs(slope_V * log(10.0) / step_V)
    profile = coordinate_profile(
        np.log10(np.maximum(time_s, scale_s)),
        -gain_m_per_V * drive_V,
        -gain_m_per_V * slope_V * column,
        unit="s",
        recording=recording,
    )
    return Finding(
        effect=NAME,
        held_out_gain=float(np.clip(gain, 0.0, 1.0)),
        held_out_rms_before_m=before_V * abs(gain_m_per_V),
        held_out_rms_after_m=after_V * abs(gain_m_per_V),
        p_value=min(1.0, max(0.5 * erfc(z / sqrt(2.0)), 1e-12) * len(every_effect())),
        rms_percent=100.0
        * abs(gain_m_per_V * slope_V)
        * float(np.std(column))
        / diagnosis.stroke_m,
        size=Size(value=percent, unit=effect.unit, ci95=((1.0 - SLOPE) * percent, 1.05 * percent)),
        not_separable_from=effect.confounded if after_V > cubic_V / SAME_ERROR else (),
        explanation=f"{effect.summary} In "
        f"{recording} a feedback holds the sensor, and the drive gives way by "
        f"{with_unit(float(np.ptp(drive_V)), 'V')} as ln(1 + t / "
        f"{with_unit(scale_s, 's', 2)}): {significant(percent, 2)} % of the "
        f"{with_unit(abs(step_V), 'V')} before it in every decade of time. "
        f"{with_unit(after_V, 'V')} rms of the drive are left, by a cubic of time "
        f"{with_unit(cubic_V, 'V')}.",
        next_experiment=effect.experiment,
        parameters={"scale_s": scale_s},
        coordinate="time_since_turn",
        seen=replace(profile, place=tuple(10.0**decade for decade in profile.place)),
    )
