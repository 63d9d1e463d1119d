"""Score tests: gain of each effect by its tangent, compared with placebos.

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
APART = 0.03  # of a column, by length: smallest part beside the null that separates lag and loop
TINY = 1e-12  # of a column: numerically zero
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
    """Return the score test of the best trial; None if there is no physical trial."""
    trials = [t for t in effect.trials(view) if np.any(t.columns)] if effect.trials else []
    null = null_of(effect, view)
    if not any(trial.physical for trial in trials):
        return None
    test = screened(effect, null, trials, one_speed=view.one_speed)
    null_ratio = null.rms / view.null.rms if effect.covariates is not None else 1.0
    return replace(test, total_gain=1.0 - (1.0 - test.cv.gain) * null_ratio)


def null_of(effect: Effect, view: View) -> Null:
    """Return the null hypothesis of an effect."""
    if effect.structural is not None:
        return effect.structural.null_without(view)
    if effect.covariates is None:
        return view.null
    return replace(view, selected=np.hstack([view.selected, effect.covariates(view)])).null


def screened(effect: Effect, null: Null, trials: Sequence[Trial], *, one_speed: bool) -> ScoreTest:
    """Cross-validate the trials of an effect against a null and select the best one.

    one_speed  whether the view has one speed: effects that need time are then loop width
    """
    widths = np.cumsum([0, *(t.columns.shape[1] for t in trials)])
    across = null.without(np.hstack([t.columns for t in trials]))
    validated = [
        (t, null.cross_validated(across[:, a:b], projected=True), across[:, a:b])
        for t, a, b in zip(trials, widths[:-1], widths[1:], strict=True)
    ]
    placebos = [cv for t, cv, _ in validated if not t.physical]
    real = [(t, cv, c) for t, cv, c in validated if t.physical]
    separable = [row for row in real if not (one_speed and row[0].needs_time) and _is_apart(row)]
    allowed = [row for row in separable if _sound(effect, row[0], row[1])]
    trial, cv, columns = max(allowed or real, key=lambda row: row[1].gain)
    share, bound = _shares(cv, columns)
    return ScoreTest(
        effect=effect,
        trial=trial,
        cv=cv,
        placebo=max(placebos, key=lambda cv: cv.gain, default=None),
        share=share,
        bound=bound,
        floor=trial.minimum_coefficient * float(np.sqrt(np.mean(columns[:, 0] ** 2))) / 2.0,
        absorption=_absorption(trial, columns),
        physical=bool(allowed),
        separable=bool(separable),
        total_gain=cv.gain,
    )


def _sound(effect: Effect, trial: Trial, cv: CrossValidated) -> bool:
    low, high = trial.coefficient_range
    if not trial.unique:
        return False
    if effect.drive_filter is not None or effect.response_filter is not None:
        # the tangent of a filter has the right sign, but its length is off by factors
        low, high = LEAST_SHARE, float("inf")
    return bool(
        low <= cv.coefficient[0] <= high and abs(cv.coefficient[0]) >= trial.minimum_coefficient
    )


def _is_apart(row: Row) -> bool:
    trial, _, across = row
    if not trial.needs_time:
        return True
    centred = trial.columns[:, 0] - trial.columns[:, 0].mean()
    return bool(np.linalg.norm(across[:, 0]) >= APART * np.linalg.norm(centred))


def _absorption(trial: Trial, across: Array) -> float:
    """Return the ratio of the norm of a trial to its norm orthogonal to the null."""
    centred = trial.columns - trial.columns.mean(axis=0)
    return max(float(np.linalg.norm(centred) / (np.linalg.norm(across) + TINY)), 1.0)


def _shares(cv: CrossValidated, across: Array) -> tuple[float, float]:
    """Return the rms of a trial beyond the null as a share of the stroke, and its upper bound."""
    added_rms = float(np.sqrt(np.mean((across @ cv.coefficient) ** 2)))
    length = np.sqrt(np.mean(across**2, axis=0))
    doubt = float(np.sqrt(np.sum((length * cv.spread) ** 2)))
    return added_rms / 2.0, (added_rms + 1.645 * doubt) / 2.0
