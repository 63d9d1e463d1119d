"""Steps of a coarse converter: of a reading, or of a drive that the file records without them.

Source: Widrow & Kollar (2008); Rayleigh (1880) on phases that point together.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from piezoid.diagnosis.effect import Fault
from piezoid.diagnosis.residual_view import View
from piezoid.numerics.arrays import Array
from piezoid.records.sample_statistics import step_size

MIN_STEP = 1.2e-3  # of half the stroke: an rms error of 0.02 % of the stroke

# a reading
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
