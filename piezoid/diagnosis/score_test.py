"""Screening: what every effect would bring to a view by its tangent, and its placebos by theirs.

It tells where to look. Effects are accepted in ``candidate``, after a refit.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.diagnosis.blocked_regression import CrossValidated, Null
from piezoid.diagnosis.effect import Effect, Trial
from piezoid.diagnosis.residual_view import View
from piezoid.numerics.arrays import Array

LEAST_SHARE = 0.05
APART = 0.03  # of a column, by length: what the null must leave of a lag to tell it from a loop
TINY = 1e-12  # of a column: nothing is left of it
Row = tuple[Trial, CrossValidated, Array]


@dataclass(frozen=True, kw_only=True, eq=False)
class ScoreTest:
    """The best of an effect's trials.

    trial       the best real one that physics allows, or the best real one
    cv          what it brings
    placebo     what the best placebo brings, None where there is none
    share       rms of what it adds, of the whole stroke
    bound       the largest such share the data allow, one-sided 95 %
    floor       the share below which the trial counts its first coefficient as none
    absorption  how many times more it adds than that: the rest the null takes up
    physical    whether physics allows it
    separable   whether the null leaves enough of it to tell it from hysteresis
    total_gain  1 - rms / rms without, all that comes with it included
    """

    effect: Effect
    trial: Trial
    cv: CrossValidated
    placebo: CrossValidated | None
    share: float
    bound: float
    floor: float
    absorption: float
    physical: bool
    separable: bool
    total_gain: float


def score_test(effect: Effect, view: View) -> ScoreTest | None:
    """Return the best of an effect's trials, None where it has none on these recordings."""
    trials = [t for t in effect.trials(view) if np.any(t.columns)] if effect.trials else []
    null = null_of(effect, view)
    if not any(trial.physical for trial in trials):
        return None
    found = screened(effect, null, trials, one_speed=view.one_speed)
    beside = null.rms / view.null.rms if effect.covariates is not None else 1.0
    return replace(found, total_gain=1.0 - (1.0 - found.cv.gain) * beside)


def null_of(effect: Effect, view: View) -> Null:
    """Return what an effect has to beat."""
    if effect.structural is not None:
        return effect.structural.null_without(view)
    if effect.covariates is None:
        return view.null
    return replace(view, selected=np.hstack([view.selected, effect.covariates(view)])).null


def screened(effect: Effect, null: Null, trials: Sequence[Trial], *, one_speed: bool) -> ScoreTest:
    """Judge trials against a null.

    one_speed  of the view: what needs time is then a width of the loop, whatever the null leaves
    """
    widths = np.cumsum([0, *(t.columns.shape[1] for t in trials)])
    across = null.without(np.hstack([t.columns for t in trials]))
    judged = [
        (t, null.cross_validated(across[:, a:b], projected=True), across[:, a:b])
        for t, a, b in zip(trials, widths[:-1], widths[1:], strict=True)
    ]
    placebos = [held for t, held, _ in judged if not t.physical]
    real = [(t, held, c) for t, held, c in judged if t.physical]
    separable = [row for row in real if not (one_speed and row[0].needs_time) and _is_apart(row)]
    allowed = [row for row in separable if _sound(effect, row[0], row[1])]
    trial, held, columns = max(allowed or real, key=lambda row: row[1].gain)
    share, bound = _shares(held, columns)
    return ScoreTest(
        effect=effect,
        trial=trial,
        cv=held,
        placebo=max(placebos, key=lambda held: held.gain, default=None),
        share=share,
        bound=bound,
        floor=trial.minimum_coefficient * float(np.sqrt(np.mean(columns[:, 0] ** 2))) / 2.0,
        absorption=_absorption(trial, columns),
        physical=bool(allowed),
        separable=bool(separable),
        total_gain=held.gain,
    )


def _sound(effect: Effect, trial: Trial, held: CrossValidated) -> bool:
    low, high = trial.coefficient_range
    if not trial.unique:
        return False
    if effect.drive_filter is not None or effect.response_filter is not None:
        # such a tangent errs by factors, but not in its sign; the share is one after the refit
        low, high = LEAST_SHARE, float("inf")
    return bool(
        low <= held.coefficient[0] <= high
        and abs(held.coefficient[0]) >= trial.minimum_coefficient
    )


def _is_apart(row: Row) -> bool:
    trial, _, across = row
    if not trial.needs_time:
        return True
    whole = trial.columns[:, 0] - trial.columns[:, 0].mean()
    return bool(np.linalg.norm(across[:, 0]) >= APART * np.linalg.norm(whole))


def _absorption(trial: Trial, across: Array) -> float:
    """Return how many times longer a trial's columns are than what the null leaves of them."""
    whole = trial.columns - trial.columns.mean(axis=0)
    return max(float(np.linalg.norm(whole) / (np.linalg.norm(across) + TINY)), 1.0)


def _shares(held: CrossValidated, across: Array) -> tuple[float, float]:
    """Return the rms of what a trial adds beyond the null, of the whole stroke, and its bound."""
    own = float(np.sqrt(np.mean((across @ held.coefficient) ** 2)))
    length = np.sqrt(np.mean(across**2, axis=0))
    doubt = float(np.sqrt(np.sum((length * held.spread) ** 2)))
    return own / 2.0, (own + 1.645 * doubt) / 2.0
