"""Thermal drift: the stage moves slowly, whatever the drive does.

What you see
    Levels that should repeat wander smoothly; both halves of a loop move together.
Why it happens
    Frame and sensor expand as the electronics warm up and the room temperature changes.
How it is detected
    A smooth curve of time for each recording (a cubic, less for short ones) explains what static
    hysteresis cannot, clearly better than the same number of half waves, which are too fast for
    heat.
What the extension adds
    A smooth zero for each recording; the controller leaves it to the observer.
Source
    Kuhnen (2003); Devasia, Eleftheriou & Moheimani (2007)
"""

import numpy as np
from numpy.polynomial.legendre import legval

from piezoid.diagnosis.effect import OVER_TIME, Effect, Tangent, Trial, without_part
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.signals import added_percent, with_added
from piezoid.identification.extensions.thermal_drift import ThermalDrift
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Recording

DEGREES_s = (5.0, 15.0, 60.0)  # durations from which drift is linear, quadratic, cubic
PLACEBOS = (8, 11)  # number of half waves of the first placebo wave
PLANNED_s = 100.0


def _curves(view: View, first_wave: int = 0) -> Array:
    """Return polynomials of time for every long track, or as many waves for placebos.

    first_wave  number of half waves of the first wave; 0: polynomials
    """
    columns = []
    for k, track in enumerate(view.tracks):
        share = 2.0 * track.rows / len(track.drive) - 1.0
        for n in range(sum(track.duration_s >= least_s for least_s in DEGREES_s)):
            wave = np.cos(0.5 * np.pi * (first_wave + n) * (share + 1.0))
            curve = wave if first_wave else legval(share, np.eye(n + 2)[n + 1])
            columns.append(view.track_column(k, curve))
    return np.column_stack(columns)


def inject(recording: Recording, share: float) -> Recording:
    """Add thermal drift: a slow sine and a straight line."""
    progress = recording.time_s / max(recording.duration_s, 1e-9)
    drift_m = np.sin(2.0 * np.pi * 0.8 * progress) + 0.5 * progress
    return with_added(recording, drift_m - drift_m.mean(), share)


EFFECT = Effect(
    name="thermal_drift",
    explanation=__doc__ or "",
    unit="% of the stroke, largest rms",
    experiment="Record ten minutes with the drive at rest, with the room's temperature; then a "
    "staircase and its mirror image, whose half sum is drift.",
    control="Feedforward cannot compensate drift; feedback from a sensor can. Without it, "
    "wait, and re-zero before long scans.",
    shows=OVER_TIME,
    tangent=Tangent(
        advised=("long_hold", "held_levels_mirrored"),
        columns=lambda drive, _: (
            1e-6 * np.column_stack([(unit := drive.time_s / PLANNED_s), unit**2])
        ),
        per_drive=True,
    ),
    confounded=("creep",),
    may_be_loop_shape=True,
    untestable=lambda view: (
        ""
        if view.longest_s >= DEGREES_s[0]
        else f"the longest recording lasts {view.longest_s:.4g} s, drift needs {DEGREES_s[0]:g} s"
    ),
    trials=lambda view: [
        Trial(columns=_curves(view)),
        *(Trial(columns=_curves(view, wave), physical=False) for wave in PLACEBOS),
    ],
    columns=lambda view, _: _curves(view),
    size=added_percent(lambda view, _: _curves(view)),
    inject=inject,
    extend=lambda _, setting: (ThermalDrift.of(setting.pieces),),
    without=without_part(ThermalDrift),
    detectable_share=4e-3,
)
