"""Evaluate candidate effects: the model refitted with an effect and without it, and its size.

The size is a function of coefficients and nonlinear parameters. Their joint covariance is that of
the columns of the coefficients and the tangents of the parameters, beside the whole null:

    var size = g' cov g + (k size)^2,    g the gradient of the size by small steps,

k the relative error of the size by the law of the effect.

A size as a share of the stroke is the root of the explained power, and its relative error half of
that of the power.

``Outcome`` is the result of a search: the candidates that are causes, and the faults of the data.

Source: the delta method; Liang & Zeger, Biometrika 73 (1986) for the covariance.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import hypot, sqrt

import numpy as np

from piezoid.diagnosis.blocked_regression import CrossValidated, compare_nulls
from piezoid.diagnosis.diagnosis import Size
from piezoid.diagnosis.effect import Effect, Fault
from piezoid.diagnosis.nuisance_search import with_bouc_wen_of
from piezoid.diagnosis.refinement import NUDGE, SelectedEffect, parameter_tangent, with_step
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.score_test import Placebo, ScoreTest, null_of, score_test, screen_trials

MINIMUM_Z = 3.3  # standard errors, one-sided 0.0005: a false name is worse than a missing one
MINIMUM_SHARE = 5e-5  # of the stroke: smaller effects need not be detected
MIN_LENGTH = 0.15  # of the longest column: smallest part orthogonal to the null for one recording
MAX_DEVIATION = 0.35  # of the fitted time, in one recording
QUANTILE = 2.0  # of Student's distribution for some sixty blocks, of a size
DEVIATION_Z = 4.0  # standard errors of such a deviation
# An effect beats its placebo if its gain with the placebo in the model is significant, and larger
# by this factor than that of the placebo with the effect in the model. Set on 34 stages of elder
# and rowan (seeds 62000 on). True effects that only this comparison recognises had 2.9 standard
# errors or more. Two false periodic errors had 2.5; false gain changes and drifts beat their
# placebo with up to 9.5, most of them before initial states were in the model.
MIN_GAIN_RATIO = 1.6
PLACEBO_Z = 2.8
EQUAL_ERROR = 1.005  # ratio of errors up to which a Bouc-Wen state is as good
NOISE_UNCERTAINTY = 0.03  # of the noise power
# Smallest ratio of the size of a structural effect to the structure of the residual. Set on wrong
# and right names of other effects (docs/measured/zoo.md), whose final model now decides.
MIN_STRUCTURE_RATIO = 0.8
QUANTISATION = "quantisation"
Confounded = dict[str, tuple[str, ...]]  # names of effects that could replace an effect, by name


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """Evaluation of an effect beside the other selected effects.

    selected  the effect with its parameters
    cv        cross-validated gain
    placebo   its best placebo, None if it has no placebo
    share     rms of its contribution beyond the null, of the whole stroke
    physical  whether its parameters are physically possible
    without   the view with the other effects
    view      the view with this effect as well
    strength_with_loop_shape  strength in the final model, whose class of hysteresis is wider; 0 if
              the effect was not tested there
    others    the other selected effects, refined beside it
    """

    selected: SelectedEffect
    cv: CrossValidated
    placebo: Placebo | None
    share: float
    physical: bool
    without: View
    view: View
    strength_with_loop_shape: float = 0.0
    others: tuple[SelectedEffect, ...] = ()

    @property
    def effect(self) -> Effect:
        """Return the definition of the effect."""
        return self.selected.effect

    @property
    def may_be_named(self) -> bool:
        """Whether the effect is significant and not small beside the structure of the residual."""
        return self.is_significant and exceeds_structure(
            self.share, self.view.rms, self.view.noise
        )

    @property
    def strength(self) -> float:
        """Return the ratio of the rms of the effect to that of the structure of the residual.

            2 share / sqrt(max(rms^2 - noise^2, NOISE_UNCERTAINTY noise^2))

        Its null distribution is that of healthy stages of other laws (``null_distribution``).
        """
        return strength_of(2.0 * self.share, self.view.rms, self.view.noise)

    @property
    def evidence(self) -> float:
        """Return the larger of the strengths in the search and in the final model."""
        return max(self.strength, self.strength_with_loop_shape)

    @property
    def is_significant(self) -> bool:
        """Whether the effect is physical, its gain significant, large, and above its placebo's."""
        return (
            self.physical
            and self.cv.z > MINIMUM_Z
            and self.cv.gain > self.effect.minimum_gain
            and self.beats_placebo
        )

    @property
    def beats_placebo(self) -> bool:
        """Whether the effect explains clearly more that its placebo does not than the reverse.

        What both explain is no evidence: a drive that is a ramp explains as much backwards.
        """
        if self.placebo is None:
            return True
        effect, placebo = self.placebo.effect_given_placebo, self.placebo.placebo_given_effect
        return effect.z > PLACEBO_Z and effect.gain > MIN_GAIN_RATIO * placebo.gain


@dataclass(frozen=True, kw_only=True, eq=False)
class Outcome:
    """Result of a search.

    first        view before any fault was repaired
    clean        view with faults repaired
    final        view with all causes in the model
    faults       by effect
    causes       every selected effect, evaluated beside all others
    confounded   effects that would explain as much instead of a selected effect, by its name
    score_tests  the last score test of each effect that was not selected
    dismissed    selected effects and significant structure that may not be named
    doubtful     selected effects that are not named because the model does not need them
    rejection    why the model class does not apply and no cause was searched; empty if it applies
    """

    first: View
    clean: View
    final: View
    faults: Mapping[str, Fault]
    causes: tuple[Candidate, ...]
    confounded: Confounded
    score_tests: Mapping[str, ScoreTest]
    dismissed: tuple[Candidate, ...] = ()
    doubtful: tuple[Candidate, ...] = ()
    rejection: str = ""

    @property
    def inseparable(self) -> tuple[str, ...]:
        """Return the significant structural effects that the causes cannot be separated from."""
        return tuple(c.effect.name for c in self.dismissed if c.effect.structural is not None)

    @property
    def repaired_faults(self) -> tuple[str, ...]:
        """Return the names of the faults that were repaired; others need a new measurement."""
        tracks, names = self.first.tracks, []
        for name, fault in self.faults.items():
            if any(a is not b for a, b in zip(tracks, fault.tracks, strict=True)):
                names.append(name)
            tracks = fault.tracks
        return tuple(names)

    @property
    def coarse_readings(self) -> Fault | None:
        """Return the fault of readings in coarse steps, which no repair removes."""
        is_repaired = QUANTISATION in self.repaired_faults
        return None if is_repaired else self.faults.get(QUANTISATION)


def strength_of(effect: float, rms: float, noise: float) -> float:
    """Return the rms of an effect over that of the structure of the residual."""
    structure = sqrt(max(rms**2 - noise**2, NOISE_UNCERTAINTY * noise**2))
    return effect / max(structure, 1e-300)


def exceeds_structure(share: float, rms: float, noise: float) -> bool:
    """Tell whether an effect is not small beside the residual structure of the nuisance class.

        2 share > MIN_STRUCTURE_RATIO sqrt(max(rms^2 - noise^2, 0))

    share  rms of the effect, of the whole stroke
    rms    of the residual with all effects in the model, of half the stroke
    noise  of the sensor, of half the stroke

    The residual of a misspecified class has some shape, and always resembles some effect.
    """
    return 2.0 * share > MIN_STRUCTURE_RATIO * sqrt(max(rms**2 - noise**2, 0.0))


def evaluate(selected: SelectedEffect, view: View, without: View, *, test: ScoreTest) -> Candidate:
    """Evaluate an effect beside the other selected effects.

    view     the view with this effect and the others
    without  the view with the others
    test     score test of the effect on ``without``, for its placebos and physical limits
    """
    effect, placebo = selected.effect, test.placebo
    if not selected.adds_columns:
        cv = compare_nulls(without.null, view.null)
        share = sqrt(max(without.rms**2 - view.rms**2, 0.0)) / 2.0
        is_physical = selected.within_limits and (
            effect.response_filter is None or is_consistent(selected, view)
        )
    else:
        assert effect.columns is not None
        columns = effect.columns(view, selected.parameters)
        cv, share, is_physical = test.cv, 0.0, False
        if np.any(columns):  # else the refitted static response already contains the contribution
            trial = replace(test.trial, columns=columns, parameters=selected.parameters)
            null = null_of(effect, without)
            trials = [trial] if placebo is None else [trial, placebo.trial]
            refitted = screen_trials(effect, null, trials, one_speed=view.one_speed)
            cv, placebo, share = refitted.cv, refitted.placebo, refitted.share
            is_physical = refitted.physical and selected.within_limits
    return Candidate(
        selected=selected,
        cv=cv,
        placebo=placebo,
        share=share,
        physical=is_physical,
        without=without,
        view=view,
    )


def structural_candidate(effect: Effect, final: View) -> tuple[ScoreTest, Candidate] | None:
    """Evaluate a structural effect, which is part of the nuisance class, beside all causes.

    A Bouc-Wen state may represent the effect. If the class without the effect, but with its best
    Bouc-Wen state, has as small an error, the effect must be significant beside that state.

    Returns None if the effect has no trials on these recordings.
    """
    test = score_test(effect, final)
    if test is None:
        return None
    candidate, structural = _candidate_of_test(test, final), effect.structural
    if structural is None or not (candidate.is_significant and structural.may_be_bouc_wen):
        return test, candidate
    with_state = with_bouc_wen_of(final, structural.null_without)
    second_test = score_test(effect, with_state)
    is_as_good = structural.null_without(with_state).rms < EQUAL_ERROR * final.rms
    if second_test is None or not is_as_good:
        return test, candidate
    return second_test, _candidate_of_test(second_test, with_state)


def _candidate_of_test(test: ScoreTest, view: View) -> Candidate:
    return Candidate(
        selected=SelectedEffect(effect=test.effect, parameters=test.trial.parameters),
        cv=test.cv,
        placebo=test.placebo,
        share=test.share,
        physical=test.physical,
        without=view,
        view=view,
    )


def is_consistent(selected: SelectedEffect, view: View) -> bool:
    """Tell whether single recordings agree with the first free parameter of a response filter.

    A filter of the signal chain is the same in every recording that can show it. Each track gets a
    deviation d_k from the fitted parameter tau, for most filters a time,

        y = h(t - tau) + sum_k d_k dh/dtau [track k],

    and no deviation may be large and significant.
    """
    name = next(iter(selected.free))
    nudged = with_step(selected, name, NUDGE)
    ratio = nudged.parameters[name] / selected.parameters[name] - 1.0
    change = NUDGE * parameter_tangent(view, view, selected, name)
    columns = np.column_stack(
        [view.track_column(k, change[view.track_rows(k)] / ratio) for k in range(len(view.tracks))]
    )
    length = np.linalg.norm(view.null.project_out(columns), axis=0)
    columns = columns[:, length > MIN_LENGTH * length.max()]
    deviation = np.linalg.lstsq(view.null.project_out(columns), view.null.residual, rcond=1e-9)[0]
    error = np.sqrt(np.diag(view.null.clustered_covariance(columns)))
    is_large = (np.abs(deviation) > MAX_DEVIATION) & (np.abs(deviation) > DEVIATION_Z * error)
    return not bool(np.any(is_large))


def size_of(cause: Candidate) -> Size:
    """Return the size of a cause with its 95 % interval."""
    effect, selected, view, beta = cause.effect, cause.selected, cause.view, cause.cv.coefficient
    if effect.size is None:
        value = 100.0 * cause.share
        # the relative error of the explained power is 1/z; its root has half of that
        margin = QUANTILE * value / (2.0 * max(cause.cv.z, 1.0))
        return Size(value=value, unit=effect.unit, ci95=(value - margin, value + margin))
    # an effect that filters the drive has its size at the unfiltered drive
    size_view = cause.without if effect.drive_filter is not None else view
    value = effect.size(size_view, selected.parameters, beta)
    columns = [parameter_tangent(view, cause.without, selected, name) for name in selected.free]
    gradient = [
        (effect.size(size_view, with_step(selected, name, NUDGE).parameters, beta) - value) / NUDGE
        for name in selected.free
    ]
    if selected.adds_columns and effect.columns is not None:
        columns += list(effect.columns(view, selected.parameters).T)
        for k in range(len(beta)):
            nudged = beta + np.eye(len(beta))[k] * max(abs(beta[k]), 1e-9) * NUDGE
            step = nudged[k] - beta[k]
            gradient.append((effect.size(view, selected.parameters, nudged) - value) / step)
    # a parameter without influence on these recordings does not change the size either
    influential = [k for k, column in enumerate(columns) if np.any(column)]
    null = replace(view, selected=cause.without.selected).null
    cov = null.clustered_covariance(np.column_stack([columns[k] for k in influential]))
    slope = np.array([gradient[k] for k in influential])
    error = sqrt(max(float(slope @ cov @ slope), 0.0))
    margin = QUANTILE * hypot(error, effect.model_error * value)
    return Size(value=value, unit=effect.unit, ci95=(value - margin, value + margin))
