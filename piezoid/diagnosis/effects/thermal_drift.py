"""Thermal drift: the stage moves slowly whatever the drive does.

What you see
    Levels that should repeat wander smoothly; both halves of a loop move together.
Why it happens
    Frame and sensor expand as the electronics warm up and the room breathes.
How it is detected
    A smooth curve of time for each recording (three half waves) explains what static hysteresis
    cannot, clearly better than as many faster half waves, which heat cannot make.
What the extension adds
    A smooth zero for each recording; the controller leaves it to the observer.
Source
    Kuhnen (2003); Devasia, Eleftheriou & Moheimani (2007)
"""

import numpy as np

from piezoid.diagnosis.effect import Effect, Parameters, Trial
from piezoid.diagnosis.signals import scaled_to, seconds_of, with_displacement
from piezoid.diagnosis.view import View
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Recording

WAVES = (1, 2, 3)
TWINS = ((8, 9, 10), (11, 13, 15))
LEAST_s = 5.0


def _untestable(view: View) -> str:
    longest_s = max(track.duration_s for track in view.tracks)
    if longest_s < LEAST_s:
        return f"the longest recording lasts {longest_s:.2g} s; drift needs {LEAST_s:g} s or more"
    return ""


def _curves(view: View, waves: tuple[int, ...]) -> Array:
    columns = []
    for k, track in enumerate(view.tracks):
        if track.duration_s < LEAST_s:
            continue
        share = track.place / len(track.drive)
        columns += [view.of_track(k, np.cos(np.pi * n * share)) for n in waves]
    return np.column_stack(columns)


def _trials(view: View) -> list[Trial]:
    return [
        Trial(columns=_curves(view, WAVES)),
        *(Trial(columns=_curves(view, waves), real=False) for waves in TWINS),
    ]


def _columns(view: View, _: Parameters) -> Array:
    return _curves(view, WAVES)


def inject(recording: Recording, share: float) -> Recording:
    """Let a recording drift: the air conditioning and a straight line."""
    way = seconds_of(recording) / max(recording.duration_s, 1e-9)
    drift_m = np.sin(2.0 * np.pi * 0.8 * way) + 0.5 * way
    moved_m = recording.displacement_m()
    return with_displacement(
        recording, moved_m + scaled_to(drift_m - drift_m.mean(), share, recording)
    )


EFFECT = Effect(
    name="thermal_drift",
    explanation=__doc__ or "",
    unit="percent of the stroke, rms",
    experiment="Record ten minutes with the drive at rest, with the room's temperature; then a "
    "staircase and its mirror image, whose half sum is drift.",
    rivals=("creep",),
    untestable=_untestable,
    trials=_trials,
    columns=_columns,
    inject=inject,
    shows_at=4e-3,
    least=3e-4,
    worth=0.12,  # slow errors of structure are smooth as well
)
