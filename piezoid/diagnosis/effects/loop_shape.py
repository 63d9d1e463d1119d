"""Loop shape: the loops have a shape that plays with dead zones cannot represent.

What you see
    The error repeats from cycle to cycle as a function of the drive and of its last turns; minor
    loops are wider or narrower than the model's, or bend in another way.
Why it happens
    A sum of plays behind one curve is a small class of hysteresis. Ferroelectric loops widen with
    their amplitude by a law of their own, and their branches start with another slope.
How it is detected
    The model's error in sample, corrected for its parameters, against that of the widest class of
    hysteresis, with every other effect in both.
What the extension adds
    Plays behind functions of their states, where they predict left-out data better.
Source
    Krejci (1996); Mayergoyz (1991)
"""

import numpy as np

from piezoid.diagnosis.effect import OVER_DRIVE, Effect
from piezoid.diagnosis.signals import with_added
from piezoid.operators.play import play_columns
from piezoid.records.recording import Recording

NAME = "loop_shape"
THRESHOLDS = np.linspace(0.05, 0.95, 10)  # in half ranges of the drive


def inject(recording: Recording, share: float) -> Recording:
    """Add plays behind a sine of their states."""
    drive_V = recording.voltage_V()
    drive = 2.0 * (drive_V - drive_V.min()) / max(float(np.ptp(drive_V)), 1e-30) - 1.0
    _, cycled = play_columns(np.array([-1.0, 1.0, drive[0]]), THRESHOLDS, np.zeros(10))
    states, _ = play_columns(drive, THRESHOLDS, cycled)
    return with_added(recording, np.sin(3.0 * np.pi * states).sum(axis=1), share)


EFFECT = Effect(
    name=NAME,
    explanation=__doc__ or "",
    unit="nm, rms",
    experiment="Record minor loops of five sizes at three biases, each twice: they decide between "
    "classes of hysteresis.",
    control="In open loop this error remains, because the exported inverse has an envelope, plays "
    "and dead zones, but not this class. Feedback removes it. A drive computed in advance removes "
    "it as far as the model is known; piezoid export --target waveform states the expected error.",
    shows=OVER_DRIVE,
    tangent="its size is the difference of two classes of hysteresis, which no single drive sets",
    inject=inject,
    without=lambda axis, _: (
        None if (plays_only := axis.without_loop_shape()) is axis else plays_only
    ),
)
