"""Sensor periodic error: the reading is wrong once every period of displacement.

What you see
    Slow ramps show a ripple with a fixed spacing in displacement, the same up and down.
Why it happens
    Two beams of an interferometer mix, or an encoder's two phases are of unequal size.
How it is detected
    Waves of one spatial frequency explain what static hysteresis cannot, far better than those of
    all other spatial frequencies that were tried, with the same phase all over the range.
What the extension adds
    A first and a second order of the cyclic error behind the stage, to be corrected there.
Source
    Heydemann (1981)
"""

import numpy as np

from piezoid.diagnosis.effect import Effect, Parameters, Trial
from piezoid.diagnosis.signals import stroke_of, with_displacement
from piezoid.diagnosis.view import View
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Recording

FEWEST, MOST = 6.0, 130.0  # periods in the stroke
STEP = 0.4
BATCH = 40
SHARP = 0.6  # periods around the peak that belong to it


def _waves(view: View, periods: float) -> Array:
    phase = np.pi * periods * view.rows(view.static)
    return np.column_stack([np.cos(phase), np.sin(phase), np.cos(2 * phase), np.sin(2 * phase)])


def _power(view: View, tried: Array) -> Array:
    """Return how much of the residual one wave of each spatial frequency follows."""
    response, residual = view.rows(view.static), view.null.residual
    power = []
    for first in range(0, len(tried), BATCH):
        turn = np.exp(1j * np.pi * np.outer(response, tried[first : first + BATCH]))
        power.append(np.abs(residual @ turn) ** 2)
    return np.concatenate(power)


def _trials(view: View) -> list[Trial]:
    tried = np.arange(FEWEST, MOST, STEP)
    power = _power(view, tried)
    best = float(tried[int(np.argmax(power))])
    near = best + np.linspace(-STEP, STEP, 21)
    best = float(near[int(np.argmax(_power(view, near)))])
    found = [_trial(view, best, real=True)]
    away = np.where(np.abs(tried - best) > SHARP, power, 0.0)
    for _ in range(3):
        twin = float(tried[int(np.argmax(away))])
        # half and twice the frequency belong to the same error
        if min(abs(twin - 2 * best), abs(twin - best / 2)) > 2 * SHARP:
            found.append(_trial(view, twin, real=False))
        away = np.where(np.abs(tried - twin) > SHARP, away, 0.0)
    return found


def _trial(view: View, periods: float, *, real: bool) -> Trial:
    return Trial(columns=_waves(view, periods), parameters={"periods": periods}, real=real)


def _columns(view: View, parameters: Parameters) -> Array:
    return _waves(view, parameters["periods"])


def _size(view: View, _: Parameters, coefficient: Array) -> float:
    amplitudes = np.hypot(coefficient[[0, 2]], coefficient[[1, 3]])
    return 1e9 * view.stroke_m * float(amplitudes.max())


def inject(recording: Recording, share: float) -> Recording:
    """Let the reading ripple thirty times over the stroke."""
    moved_m, stroke_m = recording.displacement_m(), stroke_of(recording)
    ripple = np.sqrt(2.0) * share * stroke_m * np.sin(2 * np.pi * 30.0 * moved_m / stroke_m)
    return with_displacement(recording, moved_m + ripple)


EFFECT = Effect(
    name="sensor_periodic_error",
    explanation=__doc__ or "",
    unit="nm, amplitude",
    experiment="Record slow ramps over the whole range, up and down, with a hundred rows or more "
    "for each period, and compare with a second sensor.",
    trials=_trials,
    columns=_columns,
    size=_size,
    inject=inject,
)
