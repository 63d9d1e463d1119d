"""Mains interference: the grid hums in the reading.

What you see
    A steady ripple of 50 or 60 Hz and its harmonics, the same whether the stage moves or not.
Why it happens
    Stray fields and ground loops couple the grid into sensor and amplifier.
How it is detected
    Lines at the grid's frequency, whose phase may wander, explain what static hysteresis cannot,
    and lines at seven other frequencies nearby do not.
What the extension adds
    A note for the observer; the remedy is shielding.
Source
    Thomson (1982); grid statistics of ENTSO-E
"""

import numpy as np

from piezoid.diagnosis.effect import Effect, Parameters, Trial
from piezoid.diagnosis.signals import scaled_to, seconds_of, with_displacement
from piezoid.diagnosis.view import View
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Recording

GRIDS_Hz = (50.0, 60.0)
TWINS_Hz = (41.7, 46.3, 53.9, 56.1, 63.7, 66.9)
WANDER_s = 8.0  # how long the grid keeps a phase
MOST_KNOTS = 6
ROWS_PER_PERIOD = 2.2


def _untestable(view: View) -> str:
    fastest_Hz = max(track.rate_Hz for track in view.tracks)
    if fastest_Hz > ROWS_PER_PERIOD * min(GRIDS_Hz):
        return ""
    return f"the fastest recording has {fastest_Hz:.4g} Hz; the grid needs more than 110 Hz"


def _lines(view: View, grid_Hz: float, harmonics: tuple[int, ...]) -> Array:
    columns = []
    for k, track in enumerate(view.tracks):
        time_s = track.place / track.rate_Hz
        knots = min(1 + int(track.duration_s / WANDER_s), MOST_KNOTS)
        place = time_s / max(track.duration_s, 1e-9) * (knots - 1)
        hats = np.maximum(1.0 - np.abs(place[:, None] - np.arange(knots)), 0.0)
        for n in harmonics:
            if track.rate_Hz < ROWS_PER_PERIOD * n * grid_Hz:
                continue
            turn = 2 * np.pi * n * grid_Hz * time_s
            for wave in (np.cos(turn), np.sin(turn)):
                columns += [view.of_track(k, wave * hat) for hat in hats.T]
    return np.column_stack(columns) if columns else np.zeros((len(view.response), 0))


def _trials(view: View) -> list[Trial]:
    found = []
    for frequency_Hz in (*GRIDS_Hz, *TWINS_Hz):
        columns = _lines(view, frequency_Hz, (1,))
        if columns.shape[1]:
            way = {"frequency_Hz": frequency_Hz}
            found.append(Trial(columns=columns, parameters=way, real=frequency_Hz in GRIDS_Hz))
    return found


def _columns(view: View, parameters: Parameters) -> Array:
    return _lines(view, parameters["frequency_Hz"], (1, 2, 3))


def inject(recording: Recording, share: float) -> Recording:
    """Let 50 Hz hum."""
    hum = np.sin(2 * np.pi * 50.0 * seconds_of(recording) + 1.0)
    return with_displacement(
        recording, recording.displacement_m() + scaled_to(hum, share, recording)
    )


EFFECT = Effect(
    name="mains_interference",
    explanation=__doc__ or "",
    unit="percent of the stroke, rms",
    experiment="Record one minute with the drive at rest at 1 kHz or more, then once more with "
    "the amplifier unplugged: what stays comes from the sensor's side.",
    untestable=_untestable,
    trials=_trials,
    columns=_columns,
    inject=inject,
)
