"""Quantisation: the steps of a converter are coarse.

What you see
    The reading takes few values, all multiples of one step, and rests on them; or it climbs in
    equal stairs while the drive in the file is smooth.
Why it happens
    A converter has too few bits, or its range is far wider than the signal.
How it is detected
    All readings are multiples of one step that is visible beside stroke and noise. For a drive,
    the residual is a sawtooth of the drive,

        e = -D w,   w = (u - v) / D - round((u - v) / D),

    whose fundamental has the height D / pi of its period and is in phase with its harmonics.
What the extension adds
    The quantised drive. Nothing for a reading: the remedy is a finer converter or a narrower
    range.
Source
    Widrow & Kollar (2008); Rayleigh (1880) on phases that point together
"""

import numpy as np

from piezoid.diagnosis.converter_steps import (
    MIN_POWER,
    MIN_STEP,
    drive_spectrum,
    lattice_step,
    steps_of_drive,
)
from piezoid.diagnosis.effect import OVER_TIME, Effect, Fault, FaultTest
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.signals import stroke_of, with_displacement
from piezoid.numerics.robust import white_noise_rms
from piezoid.records.recording import Recording

MIN_NOISE_RATIO = 1.5  # step over noise
MIN_SAMPLES = 0.7  # share of the samples whose reading has steps
EQUAL_STEPS = 0.02  # relative difference of the steps of two recordings


def _steps_of_reading(view: View) -> Fault | None:
    """Find steps of the reading; each recording may have its own range of the converter.

    The p-value is exp(-n R^2), that of n random phases with the same mean resultant

        R = |mean exp(2 pi i y / step)|, over the rows at which the reading changed  [Rayleigh]
    """
    # motion smaller than half a step leaves the reading constant, which shows no step
    readings = [track.measured for track in view.tracks if np.ptp(track.measured)]
    visible, evidence = [], 0.0
    for reading in readings:
        step = lattice_step(reading)
        if step <= max(MIN_STEP, MIN_NOISE_RATIO * white_noise_rms(reading)):
            visible.append(0.0)  # small compared with stroke or noise
            continue
        visible.append(step)
        changed = reading[1:][np.diff(reading) != 0]
        resultant = abs(np.mean(np.exp(2j * np.pi * changed / step))) if len(changed) else 0.0
        evidence += float(len(changed) * resultant**2)
    steps, samples = np.array(visible), np.array([len(reading) for reading in readings])
    is_coarse = steps > 0.0
    if not is_coarse.any() or samples[is_coarse].sum() < MIN_SAMPLES * samples.sum():
        return None
    step = float(steps[int(np.argmax(np.where(is_coarse, samples, 0)))])
    is_equal = np.abs(steps - step) < EQUAL_STEPS * step
    difference = np.abs(steps[is_coarse & ~is_equal] - step)
    return Fault(
        tracks=view.tracks,
        value=1e9 * view.half_stroke_m * step,
        spread=1e9 * view.half_stroke_m * float(np.max(difference, initial=0.01 * step)),
        p_value=float(np.exp(-min(evidence, 700.0))),
    )


def largest_undetected(view: View) -> float:
    """Return the rms error of the coarsest converter that agrees with the data, of the stroke.

    A reading that never repeats a value may have steps of up to twice the mean gap of its values;
    a sawtooth of the drive below the limit of its spectrum may be present.
    """
    readings = [track.measured for track in view.tracks]
    steps = [lattice_step(y) or 2.0 * float(np.ptp(y)) / len(y) for y in readings]
    residual = view.null.residual
    _, spectrum = drive_spectrum(view.column(lambda _, track: track.drive), residual)
    median = float(np.median(np.abs(spectrum) ** 2))
    sawtooth = np.pi * 2.0 * np.sqrt(MIN_POWER * median) / len(residual)
    return float(max(*steps, sawtooth, MIN_STEP) / np.sqrt(12.0) / 2.0)


def inject(recording: Recording, share: float) -> Recording:
    """Round the reading to steps whose error has this rms."""
    step_m = np.sqrt(12.0) * share * stroke_of(recording)
    return with_displacement(recording, step_m * np.round(recording.displacement_m() / step_m))


EFFECT = Effect(
    name="quantisation",
    explanation=__doc__ or "",
    unit="nm, one step",
    experiment="Record the same sweep with the converter's range reduced to the signal, or with "
    "more bits; a step that shrinks with the range is the converter's.",
    control="The loop hunts between steps; a narrower converter range helps, filters do not.",
    shows=OVER_TIME,
    tangent="its remedy is a finer converter range, not another drive",
    fault=FaultTest(
        find=lambda view: _steps_of_reading(view) or steps_of_drive(view),
        bound=largest_undetected,
    ),
    inject=inject,
)
