"""Findings of modes that the fit of dynamics has identified, excluded from the search for effects.

Recordings that a mode shapes determine its frequency and damping far better than a search for
effects, and hide all other effects. Hysteresis and slow effects are searched in the recordings
that the mode does not shape.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from math import sqrt

import numpy as np

from piezoid.diagnosis.diagnosis import (
    NO_RECORDING,
    Diagnosis,
    Finding,
    Size,
    held_out_gain,
    with_finding,
)
from piezoid.diagnosis.effects import delay, effect_named, every_effect, lag
from piezoid.diagnosis.residual_view import View
from piezoid.formatting import with_unit
from piezoid.identification.dynamics.axis_dynamics import quasi_static
from piezoid.identification.dynamics.bandwidth import BandwidthVerdict
from piezoid.identification.dynamics.behind_hysteresis import voltage_behind_hysteresis
from piezoid.identification.dynamics.fit_dynamics import resolved_modes
from piezoid.identification.dynamics.modal import LinearDynamics
from piezoid.identification.fit import rig_of
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.records.lab import Lab
from piezoid.records.recording import Recording

NAME = "resonance"
LAGS = (delay.EFFECT.name, lag.EFFECT.name)
TREND = 3  # degree of the slow motion that no dynamics explain
MIN_P_VALUE = 1e-12
MIN_RATIO = 0.8  # of the gain ratio: its uncertainty by damping and static gain
MIN_RISE = 1.5  # noise and distortion raise a gain by up to 1.2
# With a larger rise the mode would be within 10 % of the band and resolved; noise that grows with
# speed raised a single line by 24.
MAX_RISE = 6.0
# Of the part of the motion that a mode would add: for tones to 120 Hz and a mode of 160 Hz the
# residual contains 0.76 of it on a Dahl stage, 0.79 on plays, and at most 0.01 without the mode.
MIN_SHARE = 0.4
NOISE_LINES = 3.0  # times the rms of a line of white noise, which a motion must exceed
RISING_P = 1e-3  # the largest of some hundred lines lies four standard deviations out


def split_by_mode(
    recordings: Sequence[Recording], model: AxisModel, lab: Lab
) -> tuple[tuple[Recording, ...], tuple[Recording, ...]]:
    """Split recordings into quasi-static ones to be searched, and those shaped by a mode.

    The second part is empty if the model has no mode, or if no recording would remain.
    """
    dynamics = model.dynamics
    if dynamics is None or not resolved_modes(dynamics).any():
        return tuple(recordings), ()
    return quasi_static(recordings, model.axis, rig_of(lab, model.axis))


def with_modes(
    diagnosis: Diagnosis, model: AxisModel, shaped: Sequence[Recording], final: View
) -> Diagnosis:
    """Return a diagnosis with a finding of the largest mode of the dynamics of the model.

    shaped   recordings that the mode shapes, whose errors the finding states
    final    view of the searched recordings with every effect in the model
    """
    dynamics = model.dynamics
    if dynamics is None:
        return _with_rising_gain(diagnosis, model.bandwidth, final)
    if not shaped:
        return diagnosis if model.response is None else _with_response(diagnosis, model, dynamics)
    largest = int(np.argmax(np.abs(dynamics.mode_gain_m_per_V)))
    frequency_Hz = float(dynamics.mode_frequency_Hz[largest])
    low_Hz, high_Hz = dynamics.mode_frequency_interval_Hz()[largest].tolist()
    # residuals behind the hysteresis, without their slow trend
    residuals_m: tuple[list[Array], list[Array]] = ([], [])  # without and with the modes
    for recording in shaped:
        drive_V = voltage_behind_hysteresis(model, recording)
        relative_V = drive_V - drive_V[0]
        moved_m, _ = dynamics.sampled(recording.sampling_rate_Hz).run(relative_V)
        motions_m = (dynamics.static_gain_m_per_V * relative_V, moved_m)
        for residuals, motion_m in zip(residuals_m, motions_m, strict=True):
            residual_m = recording.displacement_m(model.axis) - motion_m
            time = np.linspace(-1.0, 1.0, len(residual_m))
            trend_m = np.polyval(np.polyfit(time, residual_m, TREND), time)
            residuals.append(residual_m - trend_m)
    before_m, after_m = (float(np.sqrt(np.mean(np.concatenate(r) ** 2))) for r in residuals_m)
    effect = effect_named(NAME)
    gain = held_out_gain(before_m, after_m)
    names = ", ".join(recording.name for recording in shaped)
    finding = Finding(
        effect=NAME,
        held_out_gain=gain,
        held_out_rms_before_m=before_m,
        held_out_rms_after_m=after_m,
        p_value=min(1.0, MIN_P_VALUE * len(every_effect())),
        rms_percent=100.0 * (before_m * gain / diagnosis.stroke_m),
        size=Size(value=frequency_Hz, unit=effect.unit, ci95=(low_Hz, high_Hz)),
        not_separable_from=(),
        explanation=f"{effect.summary} It is identified from {names}; the errors in the table are "
        "those on this data alone, without and with the mode. The hysteresis is that of the other "
        "recordings.",
        next_experiment=effect.experiment,
        parameters={
            "frequency_Hz": frequency_Hz,
            "quality": float(0.5 / dynamics.mode_damping[largest]),
        },
    )
    return with_finding(_with_known_delay(diagnosis, dynamics, names), finding)


def _with_known_delay(diagnosis: Diagnosis, dynamics: LinearDynamics, names: str) -> Diagnosis:
    """State that the recordings of the modes determine the delay which the others do not.

    names  of the recordings that the mode shapes
    """
    low, high = (with_unit(end_s, "s") for end_s in dynamics.delay_interval_s())
    if not dynamics.delay_s > 0.0:
        return diagnosis
    answer = (
        f"{NO_RECORDING}: {names}, which this finding leaves out, determines a delay of "
        f"{with_unit(dynamics.delay_s, 's')} ({low} to {high}) beside the mode. The controllers "
        "use that delay."
    )
    return replace(
        diagnosis,
        findings=tuple(
            replace(finding, next_experiment=answer)
            if finding.effect in LAGS and NAME in finding.not_separable_from
            else finding
            for finding in diagnosis.findings
        ),
    )


def _with_rising_gain(
    diagnosis: Diagnosis, bandwidth: BandwidthVerdict | None, final: View
) -> Diagnosis:
    """Add a finding of an unresolved mode beyond the band, by a gain that rises towards its end.

    Below its frequency f_0 a lightly damped mode multiplies the static gain by

        r = 1 / (1 - (f / f_0)^2),   f_0 = f / sqrt(1 - 1 / r)

    The gain is that behind the hysteresis of the model, and also rises if that hysteresis is
    wrong: small fast tones on large slow motion have another gain on a Dahl stage than on plays.
    The part 1 - 1 / r of the motion at f must therefore be missing from the widest class of
    hysteresis.
    """
    if bandwidth is None or bandwidth.kind == "first_order" or NAME in diagnosis.names:
        return diagnosis
    ratio, peak_Hz = bandwidth.peak_ratio or 0.0, bandwidth.peak_Hz or 0.0
    if not MIN_RISE <= ratio <= MAX_RISE:
        return diagnosis
    if unexplained_share(final, peak_Hz) < MIN_SHARE * (1.0 - 1.0 / ratio):
        return diagnosis
    frequency_Hz, high_Hz = (peak_Hz / sqrt(1.0 - 1.0 / r) for r in (ratio, MIN_RATIO * ratio))
    effect, error = effect_named(NAME), diagnosis.final
    finding = Finding(
        effect=NAME,
        held_out_gain=0.0,
        held_out_rms_before_m=error.rms_m,
        held_out_rms_after_m=error.rms_m,
        p_value=RISING_P,
        rms_percent=0.0,
        size=Size(value=frequency_Hz, unit=effect.unit, ci95=(peak_Hz, high_Hz)),
        not_separable_from=(),
        explanation=f"{effect.summary} The gain at {with_unit(peak_Hz, 'Hz')} is {ratio:.2g} "
        "times the static gain, and the recordings end at "
        f"{with_unit(bandwidth.highest_Hz, 'Hz')}: a mode lies near or beyond that and is not "
        "resolved.",
        next_experiment="Record a small chirp to at least "
        f"{with_unit(2.0 * frequency_Hz, 'Hz', 2)}, at the rate of the controller or faster.",
        parameters={"frequency_Hz": frequency_Hz},
    )
    return with_finding(diagnosis, finding)


def unexplained_share(view: View, frequency_Hz: float) -> float:
    """Return the share of the motion at a frequency that the widest hysteresis class misses.

        |sum_k e_k exp(-i w t_k)| / rows - 3 s / sqrt(rows)

    over |sum_n y_n exp(-i w t_n)| / samples

    for the recording with the largest motion at that frequency; e residual of rms s,
    y displacement. White noise alone gives s / sqrt(rows).
    """
    shares = []
    edges = pairwise(view.nuisance.edges)
    for track, (first, stop) in zip(view.tracks, edges, strict=True):
        wave = np.exp(-2j * np.pi * frequency_Hz * track.time_s)
        motion = float(abs(np.mean((track.response - track.response.mean()) * wave)))
        residual = view.null.residual[first:stop]
        noise_line = NOISE_LINES * float(np.sqrt(np.mean(residual**2) / len(residual)))
        missing = max(float(abs(np.mean(residual * wave[track.rows]))) - noise_line, 0.0)
        if track.rate_Hz > 2.0 * frequency_Hz:
            shares.append((motion, missing / max(motion, 1e-300)))
    return max(shares, default=(0.0, 0.0))[1]


def _with_response(diagnosis: Diagnosis, model: AxisModel, dynamics: LinearDynamics) -> Diagnosis:
    """State that a measured frequency response shows modes that the recordings do not show."""
    assert model.response is not None
    modes = resolved_modes(dynamics)
    if not modes.any():
        return diagnosis
    modes_Hz = ", ".join(with_unit(float(f), "Hz", 4) for f in dynamics.mode_frequency_Hz[modes])
    note = (
        f"{model.response.name} shows it at {modes_Hz}, and the model has it; of the recordings: "
    )
    return replace(
        diagnosis,
        not_detected=tuple(
            replace(absence, reason=note + absence.reason) if absence.effect == NAME else absence
            for absence in diagnosis.not_detected
        ),
    )
