"""Non-congruence: the same minor loop has another shape at another bias.

What you see
    Small loops of equal span are wider at one end of the range than at the other.
Why it happens
    Walls are freer where the ceramic is less polarised; no sum of plays or relays knows of that.
How it is detected
    Products of the plays' states with the drive explain what plays, friction and powers of their
    states cannot.
What the extension adds
    An envelope in front of the plays (the generalised model), as far as it can follow.
Source
    Mayergoyz (1991); Al Janaideh, Rakheja & Su (2009)
"""

import numpy as np

from piezoid.diagnosis.effect import Effect, Trial
from piezoid.diagnosis.folds import Null
from piezoid.diagnosis.signals import scaled_to, with_displacement
from piezoid.diagnosis.view import View
from piezoid.records.recording import Recording


def _against(view: View) -> Null:
    """Return the envelope without products with the drive."""
    columns = np.delete(view.null.columns, list(view.envelope.bias_columns), axis=1)
    return Null(columns=columns, response=view.response, block=view.block)


def _trials(view: View) -> list[Trial]:
    return [Trial(columns=view.envelope.columns[:, list(view.envelope.bias_columns)])]


def inject(recording: Recording, share: float) -> Recording:
    """Let the irreversible part open at one end of the range."""
    drive_V, moved_m = recording.voltage_V(), recording.displacement_m()
    place = 2.0 * (drive_V - drive_V.min()) / max(float(np.ptp(drive_V)), 1e-30) - 1.0
    opened_m = place * (moved_m - np.polyval(np.polyfit(drive_V, moved_m, 3), drive_V))
    return with_displacement(recording, moved_m + scaled_to(opened_m, share, recording))


EFFECT = Effect(
    name="non_congruence",
    explanation=__doc__ or "",
    unit="percent of the stroke, rms",
    experiment="Record the same small loop at five biases, each reached from above and "
    "from below.",
    rivals=("asymmetry",),
    trials=_trials,
    against=_against,
    inject=inject,
    shows_at=8e-3,
    least=2e-4,
    quiet=1.5,
    sure=4.0,
    worth=0.11,  # no class of null is as wide as ceramics: a little of this is always there
)
