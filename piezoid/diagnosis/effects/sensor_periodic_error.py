"""Sensor periodic error: the error of the reading repeats with the displacement.

What you see
    Slow ramps show a ripple with a fixed spacing in displacement, the same up and down.
Why it happens
    Two beams of an interferometer mix, or the two phases of an encoder are of unequal size.
How it is detected
    A sinusoid of one spatial frequency explains what static hysteresis cannot, far better than all
    other spatial frequencies that were tried. Each recording may have its own phase, because an
    interferometer counts from the position at which it was switched on. An amplitude below half a
    step of a coarse converter is ignored: rounding alone causes one of step / pi.
What the extension adds
    First and second order of the cyclic error of the sensor, to be corrected there.
Source
    Heydemann (1981)
"""

import numpy as np

from piezoid.diagnosis.converter_steps import lattice_step
from piezoid.diagnosis.drive_response import DriveResponse
from piezoid.diagnosis.effect import (
    Appearance,
    Effect,
    EffectEstimate,
    Parameters,
    SearchScaling,
    Tangent,
    Trial,
    unsigned,
    without_part,
)
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.signals import stroke_of, with_displacement
from piezoid.identification.extensions.extension import Extension
from piezoid.identification.extensions.periodic_error import PeriodicError, Phase
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Recording

MAX_PERIODS = 420.0  # in the stroke
STEP = 0.1  # periods in the stroke
CELLS = 16_384  # of the range, for its spectrum
RANGE = 4.0  # half strokes: more than any track has
PEAK_WIDTH = 0.6  # periods on either side of a peak
PERIODS_IN_TRACK = 3.0  # that show an error
ROUNDS, DAMPING = 5, 0.8  # of fitting the error and correcting the position by it
MEAN_SAMPLES, MEAN_s = 9, 0.02  # of readings that are averaged, so that hum cancels
MIN_MOTION = 1e-4  # of a period, in one sample: rest ends the average after 10,000 samples
PLANNED_PERIODS = 60.0  # in the stroke


def _position(view: View, k: int, error: Array, period: float = 0.0) -> Array:
    """Return the position of a track, from averaged readings without the error, (samples,).

    period  of the error [half strokes], over which readings are averaged: correcting a position
            sample by sample diverges where the error is steeper than the motion
    """
    motion, track = view.motion[k], view.tracks[k]
    deviation = track.response - motion - error
    if period > 0.0:
        weight = np.abs(np.gradient(motion)) + MIN_MOTION * period
        deviation = _mean_along(np.cumsum(weight), weight, deviation, period)
    count = float(max(MEAN_SAMPLES, round(MEAN_s * track.rate_Hz)))
    samples = np.arange(1.0, len(deviation) + 1.0)
    return motion + _mean_along(samples, np.ones(len(samples)), deviation, count)


def _mean_along(distance: Array, weight: Array, values: Array, length: float) -> Array:
    """Return the means of values over a distance around each sample, or the nearest inside.

    distance  (samples,)  cumulative sum of the weights
    """
    length = min(length, float(distance[-1]))
    start = np.clip(distance - 0.5 * (weight + length), 0.0, distance[-1] - length)
    edges, total = np.append(0.0, distance), np.append(0.0, np.cumsum(weight * values))
    sums = np.interp(start + length, edges, total) - np.interp(start, edges, total)
    return np.asarray(sums / length)


def _reading_at_rows(view: View, k: int) -> Array:
    track = view.tracks[k]
    return _position(view, k, np.zeros(len(track.response)))[track.rows]


def _harmonics(position: Array, periods: float) -> Array:
    """Return the waves of first and second order, (samples, 4)."""
    phase = np.pi * periods * position
    cosine, sine = np.cos(phase), np.sin(phase)
    return np.column_stack([cosine, sine, 2.0 * cosine**2 - 1.0, 2.0 * sine * cosine])


def _columns(view: View, periods: float) -> Array:
    """Return first and second order with separate phases of all tracks that show the error.

    The waves are those along the position, the reading without the error: over the reading a sine
    is distorted, and an amplitude of a tenth of the period has a third of its size in higher
    orders [Kepler's equation].
    """
    columns = []
    for k, (track, motion) in enumerate(zip(view.tracks, view.motion, strict=True)):
        if np.ptp(_reading_at_rows(view, k)) * periods / 2.0 < PERIODS_IN_TRACK:
            continue
        deviation, error = track.response - motion, np.zeros(len(motion))
        for _ in range(ROUNDS):
            waves = _harmonics(_position(view, k, error, 2.0 / periods), periods)
            rows = np.column_stack([waves[track.rows], np.ones(len(track.rows))])
            coefficients = np.linalg.lstsq(rows, deviation[track.rows], rcond=None)[0]
            error += DAMPING * (waves @ coefficients[:-1] - error)
        waves = _harmonics(_position(view, k, error, 2.0 / periods)[track.rows], periods)
        columns += [view.track_column(k, wave) for wave in waves.T]
    return np.column_stack(columns) if columns else np.zeros((len(view.response), 0))


def _trials(view: View) -> list[Trial]:
    """Return the strongest spatial frequency; the three strongest others are its placebos.

    A wave below half a step of a coarse converter does not count.
    """
    frequencies = STEP * np.arange(round(MAX_PERIODS / STEP) + 1, dtype=np.float64)
    padded = round(2.0 / STEP / RANGE * CELLS)  # cells, for a resolution of STEP
    power: Array = np.zeros(len(frequencies))  # of the residual that a wave explains
    for k, track in enumerate(view.tracks):
        position, residual = _reading_at_rows(view, k), view.null.residual[view.track_rows(k)]
        cell = np.clip(((position + RANGE / 2) * (CELLS / RANGE)).astype(int), 0, CELLS - 1)
        spectrum = np.fft.rfft(np.bincount(cell, residual, CELLS), padded)
        wave, rows = np.abs(spectrum[: len(frequencies)]), max(len(position), 1)
        is_resolved = np.ptp(position) * frequencies / 2.0 > PERIODS_IN_TRACK
        is_large = 2.0 * wave / rows > lattice_step(track.measured) / 2.0
        power += np.where(is_resolved & is_large, wave**2 / rows, 0.0)
    if not np.any(power > 0.0):
        return []
    best = float(frequencies[int(np.argmax(power))])
    trials = [_trial(view, best, physical=True)]
    remaining = np.where(np.abs(frequencies - best) > PEAK_WIDTH, power, 0.0)
    for _ in range(3):
        placebo = float(frequencies[int(np.argmax(remaining))])
        # half and twice the frequency belong to the same error
        if min(abs(placebo - 2 * best), abs(placebo - best / 2)) > 2 * PEAK_WIDTH:
            trials.append(_trial(view, placebo, physical=False))
        remaining = np.where(np.abs(frequencies - placebo) > PEAK_WIDTH, remaining, 0.0)
    return trials


def _trial(view: View, periods: float, *, physical: bool) -> Trial:
    return Trial(
        columns=_columns(view, periods),
        parameters={"periods": periods},
        physical=physical,
        free={"periods": STEP},
    )


def _size(view: View, _: Parameters, coefficient: Array) -> float:
    """Return the amplitude of the first order, or of the second if that is larger."""
    of_tracks = coefficient.reshape(-1, 4)
    first, second = (np.hypot(of_tracks[:, j], of_tracks[:, j + 1]) for j in (0, 2))
    return 1e9 * view.half_stroke_m * float(max(np.median(first), np.median(second)))


def _tangent(drive: DriveResponse, _: float) -> Array:
    stroke_m = float(np.sum(drive.model.hysteresis.plays.weight)) * 2 * drive.half_range_V
    turn = 2 * np.pi * PLANNED_PERIODS * drive.static_m / stroke_m
    return 1e-6 * np.column_stack([np.cos(turn), np.sin(turn)])


def _near_middle(recording: Recording) -> tuple[Array, Array]:
    """Select a twentieth of the stroke around the middle, so that periods are visible."""
    measured_m = recording.displacement_m().copy()
    measured_m[list(recording.bridged)] = np.nan
    middle = float(np.nanmedian(measured_m))
    range_m = float(np.nanmax(measured_m) - np.nanmin(measured_m))
    is_near = np.abs(measured_m - middle) < range_m / 40.0
    return unsigned(np.where(is_near, measured_m, np.nan))


def inject(recording: Recording, share: float) -> Recording:
    """Add a ripple of thirty periods over the stroke to the reading."""
    moved_m, stroke_m = recording.displacement_m(), stroke_of(recording)
    ripple = np.sqrt(2.0) * share * stroke_m * np.sin(2 * np.pi * 30.0 * moved_m / stroke_m)
    return with_displacement(recording, moved_m + ripple)


def extend(estimate: EffectEstimate, setting: SearchScaling) -> tuple[Extension, ...]:
    """Return the model extension, starting from the estimate of the search.

    A counter is often set to zero before a recording: each but the first has its own phase.
    """
    return (
        PeriodicError(
            wavelength_m=2.0 * setting.half_stroke_m / estimate.parameters["periods"],
            cosine_m=(0.0, 0.0),
            sine_m=(0.0, 0.0),
            phases=tuple(Phase(recording=r, angle=0.0) for r in setting.recordings[1:]),
        ),
    )


EFFECT = Effect(
    name="sensor_periodic_error",
    explanation=__doc__ or "",
    unit="nm, amplitude",
    experiment="Record slow ramps over the whole range, up and down, with a hundred rows or more "
    "for each period, and compare with a second sensor.",
    control="Feedback controls the reading, so this error becomes motion of the stage. "
    "Correct the sensor first.",
    shows=Appearance(
        label="displacement",
        unit="m",
        kind="classes",
        along=_near_middle,
        reading="A wave that repeats with displacement, whatever the speed.",
    ),
    tangent=Tangent(columns=_tangent, advised=("slow_ramp",)),
    trials=_trials,
    columns=lambda view, parameters: _columns(view, parameters["periods"]),
    is_sensor_error=True,
    size=_size,
    inject=inject,
    extend=extend,
    without=without_part(PeriodicError),
)
