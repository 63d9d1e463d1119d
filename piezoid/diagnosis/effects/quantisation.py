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

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from piezoid.diagnosis.effect import OVER_TIME, Effect, Fault, FaultTest
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.signals import stroke_of, with_displacement
from piezoid.numerics.arrays import Array
from piezoid.numerics.robust import white_noise_rms
from piezoid.records.recording import Recording
from piezoid.records.sample_statistics import step_size

MIN_STEP = 1.2e-3  # of half the stroke: an rms error of 0.02 % of the stroke

# a reading
MIN_NOISE_RATIO = 1.5  # step over noise
MIN_SAMPLES = 0.7  # share of all samples whose reading has steps
EQUAL_STEPS = 0.02  # relative difference of the steps of two recordings
DECIMALS = 9  # of half the stroke
MAX_LATTICE_STEPS = 2000  # in the range: finer steps do not matter
ON_LATTICE = 0.1  # of a step
STEP_ERROR = 0.02  # of a step: rounding of its last printed digit
TRIALS_PER_PERIOD = 20  # of a step, for each that the range resolves
MIN_ON_LATTICE = 0.99  # share of the samples; the remaining ones are spikes

# a drive
MIN_STEPS, MAX_STEPS = 20.0, 300.0  # in half its range
CELLS = 16_384  # of the range, for its spectrum
RANGE = 4.0  # half ranges of the drive: more than any track has
PADDING = 4  # frequencies for each that the range resolves
MIN_POWER = 30.0  # times the median of the spectrum
HEIGHT_ERROR = 0.4  # relative deviation of the sawtooth's height
HEIGHT_Z = 3.0  # standard errors of it
BLOCKS = 20  # of rows, for these
DRIVE_DECIMALS = 6  # of half the range
VALUES_PER_STEP = 4.0  # of a drive; with fewer the steps may be those of the drive
MIN_FINE_ROWS = 0.1  # of all rows


def lattice_step(response: Array) -> float:
    """Return the step of a reading that is a multiple of it, or 0 if no value repeats.

    Spikes, and values interpolated instead of them, are not multiples. A step of which nearly all
    samples are multiples is therefore searched first, near the median gap of the values. Values
    printed with few digits are uneven, and their mean gap is too inexact to count hundreds of
    steps: the step is the one at which the phases of the values agree best.
    """
    if not np.any(np.diff(response) == 0):
        return 0.0
    values, count = np.unique(np.round(response, DECIMALS), return_counts=True)
    gap = float(np.median(np.diff(values))) if len(values) > 1 else 0.0
    if MAX_LATTICE_STEPS * gap > values[-1] - values[0]:
        n_steps = float(np.ptp(values)) / gap
        trials = int(2.0 * STEP_ERROR * n_steps * TRIALS_PER_PERIOD) + 2
        ratios = np.linspace(1.0 - STEP_ERROR, 1.0 + STEP_ERROR, trials)
        phasors = np.exp(2j * np.pi * np.outer(ratios / gap, values))
        step = gap / float(ratios[int(np.argmax(np.abs(phasors.sum(axis=1))))])
        position = (values - values[np.argmax(count)]) / step
        is_on = np.abs(position - np.round(position)) < ON_LATTICE
        if count[is_on].sum() > MIN_ON_LATTICE * len(response):
            return step
    return step_size(np.round(response, DECIMALS))


def _steps_of_reading(view: View) -> Fault | None:
    """Find steps of the reading; each recording may have its own range of the converter.

    The p-value is exp(-n R^2), that of n random phases with the same mean resultant

        R = |mean exp(2 pi i y / step)|, over the rows at which the reading changed  [Rayleigh]
    """
    visible, evidence = [], 0.0
    for track in view.tracks:
        reading = track.measured
        step = lattice_step(reading)
        if step <= max(MIN_STEP, MIN_NOISE_RATIO * white_noise_rms(reading)):
            visible.append(0.0)  # small compared with stroke or noise
            continue
        visible.append(step)
        changed = reading[1:][np.diff(reading) != 0]
        resultant = abs(np.mean(np.exp(2j * np.pi * changed / step))) if len(changed) else 0.0
        evidence += float(len(changed) * resultant**2)
    steps = np.array(visible)
    samples = np.array([len(track.response) for track in view.tracks])
    is_coarse = steps > 0.0
    if samples[is_coarse].sum() < MIN_SAMPLES * samples.sum():
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


def drive_step(view: View) -> float:
    """Return the displacement of a step of a coarse drive, of half the stroke; 0 if it is fine."""
    fault = steps_of_drive(view)
    return 0.0 if fault is None else 1e-9 * fault.value / view.half_stroke_m


def steps_of_drive(view: View) -> Fault | None:
    """Find a residual that is a sawtooth of the drive.

    The residual of a recorded staircase is not a sawtooth and would dilute that of other tracks.
    The amplitude of the strongest line must agree with its period. The standard error of the
    height of the sawtooth is that over blocks of rows.
    """
    drive, residual = view.column(lambda _, track: track.drive), view.null.residual
    is_fine = _is_finer(view, 1.0 / MAX_STEPS)
    rows = is_fine if is_fine.any() else ~is_fine
    frequencies, spectrum = drive_spectrum(drive[rows], residual[rows])
    power = np.abs(spectrum) ** 2
    j, median = int(np.argmax(power)), float(np.median(power)) + 1e-300
    frequency = float(frequencies[j])
    amplitude = 2.0 * float(np.sqrt(power[j])) / np.count_nonzero(rows)
    has_other_height = abs(np.pi * amplitude * frequency - 1.0) > HEIGHT_ERROR
    if power[j] < MIN_POWER * median or has_other_height:
        return None
    # the transform counts from the lower end of the range, a cell represents its middle
    middle = RANGE / 2 - RANGE / CELLS / 2
    phase = float(np.angle(spectrum[j])) + 2.0 * np.pi * frequency * middle
    step, origin = 1.0 / frequency, (np.pi / 2 - phase) / (2.0 * np.pi * frequency)
    is_finer = _is_finer(view, step)
    if np.mean(is_finer) < MIN_FINE_ROWS:
        return None
    column = view.null.project_out(_sawtooth_error(drive, step, origin) * is_finer)
    blocks = np.array_split(np.arange(len(column)), BLOCKS)
    product = np.array([column[b] @ residual[b] for b in blocks])
    square = np.array([column[b] @ column[b] for b in blocks])
    height = float(product.sum() / square.sum())
    deviation = product - height * square
    std = float(np.sqrt(deviation @ deviation * BLOCKS / (BLOCKS - 1)) / square.sum())
    if abs(height / step - 1.0) > HEIGHT_ERROR or height < max(MIN_STEP, HEIGHT_Z * std):
        return None
    # the power of white noise is exponential: its median is ln 2 times its mean
    expected = len(spectrum) * np.exp(-float(power[j]) * np.log(2.0) / median)
    return Fault(
        tracks=tuple(
            replace(track, drive=track.drive + step * _sawtooth_error(track.drive, step, origin))
            for track in view.tracks
        ),
        value=1e9 * view.half_stroke_m * height,
        spread=1e9 * view.half_stroke_m * max(std, 0.01 * height),
        p_value=float(min(1.0, expected)),
    )


def _sawtooth_error(drive: Array, step: float, origin: float) -> Array:
    """Return the error of a converter with steps of the drive, in steps."""
    position = (drive - origin) / step
    return np.asarray(np.round(position) - position)


def _is_finer(view: View, step: float) -> NDArray[np.bool_]:
    """Tell for every row whether the drive of its track takes several values within a step.

    A drive that repeats after a few samples takes few values, so that any residual has steps.
    """
    is_finer = []
    for track in view.tracks:
        values = np.unique(np.round(track.drive, DRIVE_DECIMALS))
        gap = float(np.median(np.diff(values))) if len(values) > 1 else np.inf
        is_finer.append(np.full(len(track.rows), gap * VALUES_PER_STEP < step))
    return np.concatenate(is_finer)


def drive_spectrum(drive: Array, residual: Array) -> tuple[Array, NDArray[np.complex128]]:
    """Return the spectrum of a residual along its drive, with its frequencies."""
    cell = np.clip(((drive + RANGE / 2) * (CELLS / RANGE)).astype(int), 0, CELLS - 1)
    spectrum = np.fft.rfft(np.bincount(cell, residual, CELLS), PADDING * CELLS)
    frequency = np.arange(len(spectrum)) / (PADDING * RANGE)
    is_inside = (frequency > MIN_STEPS) & (frequency < MAX_STEPS)
    return frequency[is_inside], spectrum[is_inside]


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
