"""Non-congruence: the same minor loop has another shape at another bias.

What you see
    Small loops of equal span are wider at one end of the range than at the other.
Why it happens
    Domain walls move more easily where the ceramic is less polarised, which no sum of plays or
    relays represents.
How it is detected
    The drive times the fitted loop without its centre line explains what plays, friction states,
    powers of these states and the best Bouc-Wen state cannot. It must explain a large part of
    what all products of states with the drive explain, and more than healthy ceramics show.
What the extension adds
    An envelope in front of the plays (the generalised model).
Source
    Mayergoyz (1991); Al Janaideh, Rakheja & Su (2009)
"""

from dataclasses import replace

import numpy as np

from piezoid.diagnosis.blocked_regression import Null
from piezoid.diagnosis.effect import OVER_DRIVE, Effect, Structural, Tangent, Trial
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.signals import stroke_of, with_displacement
from piezoid.numerics.arrays import Array
from piezoid.operators.play import play_columns
from piezoid.records.recording import Recording

MIN_OPENING = 0.15  # of loops over half the range; loops of healthy ceramics open by less
MIN_SHARE = 0.5  # of the power that all products with the drive explain
PLAYS = np.linspace(0.05, 0.95, 10)  # thresholds of the injected plays
POINTS = 401
BENDS = 3  # of the envelope, on each side


def _null_without(view: View) -> Null:
    """Return the nuisance class without products with the drive."""
    columns = np.delete(view.null.all_columns, list(view.nuisance.bias_columns), axis=1)
    return Null(columns=columns, response=view.response, block=view.block)


def _trials(view: View) -> list[Trial]:
    """Return the drive times the distance of congruent loops from the mean of the largest loop."""
    null, nuisance = _null_without(view), view.nuisance
    congruent = np.setdiff1d(np.arange(view.null.all_columns.shape[1]), nuisance.bias_columns)
    weight = np.zeros(nuisance.shared)
    shared = congruent[congruent < nuisance.shared]
    weight[shared] = null.fit(view.response)[: len(shared)]
    up = np.linspace(-1.0, 1.0, POINTS)
    loop = nuisance.static_along(np.concatenate([up, up[::-1]]), (1.0, -1.0), weight)
    middle = 0.5 * (loop[:POINTS] + loop[POINTS:][::-1])
    distance = view.column(
        lambda k, track: nuisance.static(k, weight) - np.interp(track.drive, up, middle)
    )
    column = view.column(lambda _, track: track.drive) * distance
    # whether the column explains most of the power of all products with the drive
    orthogonal, residual = null.project_out(column), null.residual
    explained = float(orthogonal @ residual) ** 2 / (float(orthogonal @ orthogonal) + 1e-300)
    n_products = len(nuisance.bias_columns)
    widest_error = float(np.sum(view.null.residual**2)) * (1.0 + n_products / len(residual))
    explains_most = explained > MIN_SHARE * (float(np.sum(residual**2)) - widest_error)
    return [Trial(columns=column[:, None], minimum_coefficient=MIN_OPENING, unique=explains_most)]


def inject(recording: Recording, share: float) -> Recording:
    """Add plays that open towards one end of the range, with a share of the stroke."""
    drive_V, moved_m = recording.voltage_V(), recording.displacement_m()
    drive = 2.0 * (drive_V - drive_V.min()) / max(float(np.ptp(drive_V)), 1e-30) - 1.0
    path = np.linspace(-1.0, 1.0, POINTS)
    largest = _biased_plays(np.concatenate([path[::-1], path, path[::-1]]))[POINTS:]
    rms_m = share * stroke_of(recording)
    added_m = rms_m / float(np.sqrt(np.mean(largest**2))) * _biased_plays(drive)
    return with_displacement(recording, moved_m + added_m)


def _biased_plays(drive: Array) -> Array:
    """Return the mean distance of plays from the middle of their largest loop, times the drive."""
    _, cycled = play_columns(np.array([-1.0, 1.0, drive[0]]), PLAYS, np.zeros(len(PLAYS)))
    states, _ = play_columns(drive, PLAYS, cycled)
    u = drive[:, None]
    middle = 0.5 * (np.maximum(u - PLAYS, PLAYS - 1.0) + np.minimum(u + PLAYS, 1.0 - PLAYS))
    return np.asarray(drive * (states - middle).mean(axis=1))


EFFECT = Effect(
    name="non_congruence",
    explanation=__doc__ or "",
    unit="% of the stroke, rms",
    experiment="Record the same small loop at five biases, each reached from above and "
    "from below.",
    control="The inverse does not represent how minor loops change with the bias: use "
    "feedback for small scans near the ends of the range.",
    shows=OVER_DRIVE,
    tangent=Tangent(
        columns=lambda drive, _: (
            drive.irreversible_m[:, None]
            * np.column_stack([(unit := drive.drive_V / drive.half_range_V), unit**2])
        )
    ),
    confounded=("asymmetry",),
    trials=_trials,
    structural=Structural(
        null_without=_null_without,
        # with a free envelope
        structure=lambda structure, model, is_selected: replace(
            structure, bends=(model.hysteresis.envelope.zero or BENDS) if is_selected else 0
        ),
        largest_noise_ratio=2.0,
        may_be_bouc_wen=True,
    ),
    inject=inject,
    detectable_share=4e-3,
    minimum_gain=0.025,  # classes of ceramics differ by less
)
