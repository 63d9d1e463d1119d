"""Asymmetry: rising and falling branches bend to the same side.

What you see
    The loop is not symmetric about its centre.
Why it happens
    Strain grows with the square of the polarisation, and the ceramic is poled.
How it is detected
    Only a simulation without dead zones misses it; the simulation used here has dead zones.
What the extension adds
    Dead zones behind the plays, which the simulation has already.
Source
    Kuhnen (2003); Damjanovic (1998)
"""

import numpy as np

from piezoid.diagnosis.effect import OVER_DRIVE, Effect
from piezoid.diagnosis.signals import with_added
from piezoid.records.recording import Recording

REASON = "the dead zones of the model already represent asymmetry"


def inject(recording: Recording, share: float) -> Recording:
    """Bend both branches to the same side; the ends stay where they are."""
    moved_m = recording.displacement_m()
    s = (moved_m - moved_m.min()) / max(float(np.ptp(moved_m)), 1e-30)
    return with_added(recording, s * (1 - s), share)


EFFECT = Effect(
    name="asymmetry",
    explanation=__doc__ or "",
    unit="% of the stroke, rms",
    experiment="Nothing is needed: compare the loading curve of the model with a straight line.",
    control="A symmetric inverse has a larger error on one side; the dead zones of the model "
    "represent the asymmetry exactly.",
    shows=OVER_DRIVE,
    tangent="the dead zones of the model already represent it",
    confounded=("non_congruence",),
    untestable=lambda _: REASON,
    inject=inject,
)
