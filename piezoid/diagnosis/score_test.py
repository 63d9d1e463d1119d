"""Score tests: gain of each effect by its tangent, compared with placebos.

A score test only selects the effects to refit; ``candidate`` decides after the refit.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from piezoid.diagnosis.blocked_regression import CrossValidated, Null
from piezoid.diagnosis.effect import Effect, Trial
from piezoid.diagnosis.residual_view import View
from piezoid.numerics.arrays import Array

MIN_FILTER_SHARE = 0.05  # smallest coefficient of a filter's tangent
# of the length of a column: smallest part orthogonal to the null that separates a lag from a loop
MIN_ORTHOGONAL = 0.03
TINY = 1e-12  # of a column: numerically zero


@dataclass(frozen=True, kw_only=True, eq=False)
class Placebo:
    """The best placebo of an effect, with the gains of each with the other in the model.

    The placebo of a drive is the drive backwards; for a ramp the two are equal but for the sign.
    Only what one explains and the other does not tells them apart.

    trial                 the placebo
    cv                    its cross-validated gain
    effect_given_placebo  gain of the effect with the placebo in the model
    placebo_given_effect  gain of the placebo with the effect in the model
    """

    trial: Trial
    cv: CrossValidated
    effect_given_placebo: CrossValidated
    placebo_given_effect: CrossValidated


@dataclass(frozen=True, kw_only=True, eq=False)
class ScoreTest:
    """Result of the best trial of an effect.

    trial       the best trial with a physically possible coefficient; if none has, the best trial
    cv          its cross-validated gain
    placebo     the best placebo; None if there is no placebo
    share       rms of its contribution beyond the null, of the whole stroke
    bound       upper bound of this share, one-sided 95 %
    floor       share that corresponds to the smallest coefficient of the trial
    absorption  rms of its whole contribution over that beyond the null, >= 1
    physical    whether its coefficient is physically possible
    separable   whether any trial can be separated from hysteresis
    total_gain  1 - rms / rms without the effect and its covariates
    """

    effect: Effect
    trial: Trial
    cv: CrossValidated
    placebo: Placebo | None
    share: float
    bound: float
    floor: float
    absorption: float
    physical: bool
    separable: bool
    total_gain: float


def score_test(effect: Effect, view: View) -> ScoreTest | None:
    """Return the score test of the best trial; None if every trial is a placebo or zero."""
    trials = [t for t in effect.trials(view) if np.any(t.columns)] if effect.trials else []
    null = null_of(effect, view)
    if not any(trial.physical for trial in trials):
        return None
    test = screen_trials(effect, null, trials, one_speed=view.one_speed)
    null_ratio = null.rms / view.null.rms if effect.covariates is not None else 1.0
    return replace(test, total_gain=1.0 - (1.0 - test.cv.gain) * null_ratio)


def null_of(effect: Effect, view: View) -> Null:
    """Return the null hypothesis of an effect."""
    if effect.structural is not None:
        return effect.structural.null_without(view)
    if effect.covariates is None:
        return view.null
    return replace(view, selected=np.hstack([view.selected, effect.covariates(view)])).null


def screen_trials(
    effect: Effect, null: Null, trials: Sequence[Trial], *, one_speed: bool
) -> ScoreTest:
    """Cross-validate the trials of an effect against a null and select the best trial.

    one_speed  whether the view has one speed: effects that need time then change the loop width
    """
    edges = np.cumsum([0, *(trial.columns.shape[1] for trial in trials)])
    orthogonal = null.project_out(np.hstack([trial.columns for trial in trials]))
    placebos, physical, separable = [], [], []
    for trial, (first, stop) in zip(trials, pairwise(edges.tolist()), strict=True):
        columns = orthogonal[:, first:stop]
        cv = null.cross_validated(columns, projected=True)
        if not trial.physical:
            placebos.append((trial, cv))
            continue
        physical.append((trial, cv, columns))
        centred = trial.columns[:, 0] - trial.columns[:, 0].mean()
        min_norm = MIN_ORTHOGONAL * np.linalg.norm(centred)
        is_loop_width = one_speed or np.linalg.norm(columns[:, 0]) < min_norm
        if not (trial.needs_time and is_loop_width):
            separable.append((trial, cv, columns))
    # a trial is possible if its first coefficient is; the tangent of a filter has the right sign,
    # but its length is off by factors
    is_filter = effect.drive_filter is not None or effect.response_filter is not None
    possible = []
    for trial, cv, columns in separable:
        low, high = (MIN_FILTER_SHARE, np.inf) if is_filter else trial.coefficient_range
        size = abs(cv.coefficient[0])
        if trial.unique and low <= cv.coefficient[0] <= high and size >= trial.minimum_coefficient:
            possible.append((trial, cv, columns))
    trial, cv, columns = max(possible or physical, key=lambda result: result[1].gain)
    # rms of the contribution beyond the null with its error, and the norm of the whole trial
    added_rms = float(np.sqrt(np.mean((columns @ cv.coefficient) ** 2)))
    length = np.sqrt(np.mean(columns**2, axis=0))
    error = float(np.sqrt(np.sum((length * cv.spread) ** 2)))
    norm = np.linalg.norm(trial.columns - trial.columns.mean(axis=0))
    return ScoreTest(
        effect=effect,
        trial=trial,
        cv=cv,
        placebo=_best_placebo(null, trial, placebos),
        share=added_rms / 2.0,
        bound=(added_rms + 1.645 * error) / 2.0,
        floor=trial.minimum_coefficient * float(np.sqrt(np.mean(columns[:, 0] ** 2))) / 2.0,
        absorption=max(float(norm / (np.linalg.norm(columns) + TINY)), 1.0),
        physical=bool(possible),
        separable=bool(separable),
        total_gain=cv.gain,
    )


def _best_placebo(
    null: Null, trial: Trial, placebos: Sequence[tuple[Trial, CrossValidated]]
) -> Placebo | None:
    if not placebos:
        return None
    placebo, cv = max(placebos, key=lambda pair: pair[1].gain)

    def gain_given(columns: Array, conditioning: Array) -> CrossValidated:
        extra = conditioning if null.extra is None else np.hstack([null.extra, conditioning])
        return replace(null, extra=extra).cross_validated(columns)

    return Placebo(
        trial=placebo,
        cv=cv,
        effect_given_placebo=gain_given(trial.columns, placebo.columns),
        placebo_given_effect=gain_given(placebo.columns, trial.columns),
    )
