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

from piezoid.diagnosis.appearance import Appearance, unsigned
from piezoid.diagnosis.drive_response import Driven
from piezoid.diagnosis.effect import (
    Effect,
    EffectEstimate,
    Parameters,
    SearchScaling,
    Tangent,
    Trial,
    without_part,
)
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.signals import stroke_of, with_displacement
from piezoid.identification.extensions.extension import Extension
from piezoid.identification.extensions.periodic_error import PeriodicError
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Recording
from piezoid.records.sample_statistics import step_size

FEWEST, MOST = 6.0, 420.0  # periods in the stroke
STEP = 0.1
CELLS = 16_384  # of the range, which waves are told apart by
RANGE = 4.0  # in half strokes: more than any track has
SHARP = 0.6  # periods around the peak that belong to it
PASSED = 3.0  # periods that a track must pass to show one
ROUNDS, CALM = 5, 0.8  # of fitting the error where it is and placing it, and how far each goes
MEAN = 9  # readings of which the mean is where the sensor stood
PLANNED_PERIODS = 60.0  # in the stroke


def _read(view: View, k: int, error: Array) -> Array:
    """Return where a track stood, (samples,): as read less an error, and freed of most noise."""
    static = view.static[k]
    apart = view.tracks[k].response - static - error
    padded = np.cumsum(np.pad(apart, (MEAN // 2 + 1, MEAN // 2), mode="edge"))
    mean = (padded[MEAN:] - padded[:-MEAN]) / MEAN
    return np.asarray(static + mean[: len(apart)])


def _where(view: View, k: int) -> Array:
    """Return where the sensor of a track says that it stood, at its rows."""
    track = view.tracks[k]
    return _read(view, k, np.zeros(len(track.response)))[track.place]


def _of(place: Array, periods: float) -> Array:
    """Return the waves of first and second order, (samples, 4)."""
    turn = np.pi * periods * place
    cosine, sine = np.cos(turn), np.sin(turn)
    return np.column_stack([cosine, sine, 2.0 * cosine**2 - 1.0, 2.0 * sine * cosine])


def _of_track(view: View, k: int, periods: float) -> Array:
    """Return the waves of a track over where it stood, which is where it was read less the error.

    Over the reading itself a sine is none: of an amplitude of a tenth of the period a third goes
    into higher orders [Kepler's equation].
    """
    track, error = view.tracks[k], np.zeros(len(view.static[k]))
    for _ in range(ROUNDS):
        place = _read(view, k, error)
        apart = track.response - view.static[k]
        waves = _of(place, periods)
        rows = np.column_stack([waves[track.place], np.ones(len(track.place))])
        found = np.linalg.lstsq(rows, apart[track.place], rcond=None)[0]
        error += CALM * (waves @ found[:-1] - error)
    return _of(_read(view, k, error)[track.place], periods)


def _waves(view: View, periods: float) -> Array:
    """Return first and second order, each with a phase of every track that shows them."""
    columns = []
    for k in range(len(view.tracks)):
        if np.ptp(_where(view, k)) * periods / 2.0 < PASSED:
            continue
        columns += [view.of_track(k, wave) for wave in _of_track(view, k, periods).T]
    return np.column_stack(columns) if columns else np.zeros((len(view.response), 0))


def _power(view: View) -> tuple[Array, Array]:
    """Return spatial frequencies, and how much of the residual one wave of each follows.

    Of a coarse converter a wave counts that is higher than half a step.
    """
    edges = view.nuisance.edges
    tried = STEP * np.arange(round(MOST / STEP) + 1, dtype=np.float64)
    power: Array = np.zeros(len(tried))
    for k in range(len(view.tracks)):
        place = _where(view, k)
        cell = np.clip(((place + RANGE / 2) * (CELLS / RANGE)).astype(int), 0, CELLS - 1)
        residual = view.null.residual[edges[k] : edges[k + 1]]
        # one cell of the transform is a spatial frequency of 1 / (length of the padded range)
        padded = round(2.0 / STEP / RANGE * CELLS)
        wave = np.abs(np.fft.rfft(np.bincount(cell, residual, CELLS), padded)[: len(tried)])
        rows = max(len(place), 1)
        code = step_size(np.round(view.tracks[k].response, 9))
        shown = (np.ptp(place) * tried / 2.0 > PASSED) & (2.0 * wave / rows > code / 2.0)
        power += np.where(shown, wave**2 / rows, 0.0)
    return tried, power


def _trials(view: View) -> list[Trial]:
    tried, power = _power(view)
    power = np.where(tried < FEWEST, 0.0, power)
    if not np.any(power > 0.0):
        return []
    best = float(tried[int(np.argmax(power))])
    found = [_trial(view, best, real=True)]
    away = np.where(np.abs(tried - best) > SHARP, power, 0.0)
    for _ in range(3):
        placebo = float(tried[int(np.argmax(away))])
        # half and twice the frequency belong to the same error
        if min(abs(placebo - 2 * best), abs(placebo - best / 2)) > 2 * SHARP:
            found.append(_trial(view, placebo, real=False))
        away = np.where(np.abs(tried - placebo) > SHARP, away, 0.0)
    return found


def _trial(view: View, periods: float, *, real: bool) -> Trial:
    return Trial(
        columns=_waves(view, periods),
        parameters={"periods": periods},
        physical=real,
        free={"periods": STEP},
    )


def _size(view: View, _: Parameters, coefficient: Array) -> float:
    """Return the amplitude of the first order, or of the second if that is larger."""
    each = coefficient.reshape(-1, 4)
    first, second = (np.hypot(each[:, j], each[:, j + 1]) for j in (0, 2))
    return 1e9 * view.stroke_m * float(max(np.median(first), np.median(second)))


def _tangent(drive: Driven, _: float) -> Array:
    stroke_m = float(np.sum(drive.model.hysteresis.plays.weight)) * 2 * drive.half_range_V
    turn = 2 * np.pi * PLANNED_PERIODS * drive.static_m / stroke_m
    return 1e-6 * np.column_stack([np.cos(turn), np.sin(turn)])


def _near_middle(recording: Recording) -> tuple[Array, Array]:
    """Return a twentieth of the stroke around the middle, so that periods can be seen."""
    measured_m = recording.displacement_m().copy()
    measured_m[list(recording.bridged)] = np.nan
    middle = float(np.nanmedian(measured_m))
    range_m = float(np.nanmax(measured_m) - np.nanmin(measured_m))
    near = np.abs(measured_m - middle) < range_m / 40.0
    return unsigned(np.where(near, measured_m, np.nan))


def inject(recording: Recording, share: float) -> Recording:
    """Let the reading ripple thirty times over the stroke."""
    moved_m, stroke_m = recording.displacement_m(), stroke_of(recording)
    ripple = np.sqrt(2.0) * share * stroke_m * np.sin(2 * np.pi * 30.0 * moved_m / stroke_m)
    return with_displacement(recording, moved_m + ripple)


def extend(found: EffectEstimate, setting: SearchScaling) -> tuple[Extension, ...]:
    """Return the part of the model that begins where a search found it."""
    wavelength_m = 2.0 * setting.stroke_m / found.parameters["periods"]
    return (PeriodicError(wavelength_m=wavelength_m, cosine_m=(0.0, 0.0), sine_m=(0.0, 0.0)),)


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
    tangent=Tangent(columns=_tangent),
    trials=_trials,
    columns=lambda view, parameters: _waves(view, parameters["periods"]),
    size=_size,
    inject=inject,
    extend=extend,
    without=without_part(PeriodicError),
)
