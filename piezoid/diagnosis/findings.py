"""Results of a search for each effect: its finding, or an upper bound if it was not detected.

A finding states the held-out errors of the refitted model with and without a fault or effect.
"""

from collections.abc import Sequence
from dataclasses import replace
from math import sqrt

import numpy as np

from piezoid.diagnosis.candidate import (
    MINIMUM_SHARE,
    MINIMUM_Z,
    Candidate,
    Outcome,
    exceeds_structure,
    size_of,
)
from piezoid.diagnosis.diagnosis import SOMETHING_ELSE, Finding, NotDetected, Size, held_out_gain
from piezoid.diagnosis.effect import BETWEEN, Effect, Fault
from piezoid.diagnosis.effects import effect_named, every_effect
from piezoid.diagnosis.null_distribution import evidence_p_value
from piezoid.diagnosis.refit import ModelErrors
from piezoid.diagnosis.residual_structure import SearchResult
from piezoid.diagnosis.score_test import ScoreTest
from piezoid.diagnosis.structure_findings import noise_finding, noise_level, structure_finding
from piezoid.formatting import significant, with_unit, words
from piezoid.identification.hysteresis.pieces import Scales
from piezoid.records.recording import Recording

MAX_PLACES = 5  # of a fault that its explanation lists
CERTAIN_Z = 8.0  # standard errors above which an effect contains no part of another
SPEEDS = (
    "Record the same loops at half the speed or less as well: what needs time shrinks with speed, "
    "hysteresis stays."
)
POWER = 2.8 / 1.645  # limit for four cases in five, in units of a one-sided 95 % bound


def findings_of(
    result: SearchResult,
    errors: ModelErrors,
    recordings: Sequence[Recording],
    axis: str,
    scales: Scales,
) -> tuple[Finding, ...]:
    """Return the findings of a search, the largest gain first.

    Args:
        result: of the search.
        errors: of the model with all effects, and without each of them.
        recordings: that were searched.
        axis: that was searched.
        scales: of the search.
    """
    outcome, structure = result.outcome, result.structure
    half_stroke_m, scale_m = result.raw.half_stroke_m, scales.displacement_m
    findings = [
        fault_finding(name, fault, errors, half_stroke_m) for name, fault in outcome.faults.items()
    ]
    findings += [effect_finding(cause, outcome, errors) for cause in outcome.causes]
    # the displacement at which the static response is 0
    view = outcome.final if structure is None else structure.view
    displacement_m = recordings[0].displacement_m(axis)[: len(view.tracks[0].drive)]
    static_m = scale_m * view.static[0][: len(displacement_m)]
    middle_m = float(np.median(displacement_m - static_m))
    has_effects = any(cause.effect.structural is None for cause in outcome.causes)
    if structure is not None:
        before_m = errors.without_m[SOMETHING_ELSE]
        findings.append(
            structure_finding(
                structure,
                before_m=before_m,
                after_m=errors.final_m,
                scale_m=scale_m,
                middle_m=middle_m,
            )
        )
    elif not (outcome.rejection or outcome.faults or has_effects):
        # other effects than hysteresis could pass for noise
        noise, error_m = noise_level(outcome.final), errors.final_m
        if noise is not None:
            findings.append(
                noise_finding(noise, error_m=error_m, scale_m=scale_m, middle_m=middle_m)
            )
    return tuple(sorted(findings, key=lambda finding: finding.held_out_gain, reverse=True))


def fault_finding(name: str, fault: Fault, errors: ModelErrors, half_stroke_m: float) -> Finding:
    """Return the finding of a fault of the data.

    The gain of a fault that ingest repaired, or that cannot be repaired, is 0.
    """
    effect = effect_named(name)
    before_m, after_m = errors.without_m.get(name, errors.final_m), errors.final_m
    gain, margin = held_out_gain(before_m, after_m), 1.96 * fault.spread
    explanation, further = effect.summary, len(fault.locations) - MAX_PLACES
    if fault.locations:
        suffix = f" and {further} more" if further > 0 else ""
        explanation += f" Seen in {', '.join(fault.locations[:MAX_PLACES])}{suffix}."
    return Finding(
        effect=name,
        held_out_gain=gain,
        held_out_rms_before_m=before_m,
        held_out_rms_after_m=after_m,
        p_value=min(1.0, fault.p_value * len(every_effect())),
        rms_percent=50.0 * gain * before_m / half_stroke_m,
        size=Size(
            value=fault.value, unit=effect.unit, ci95=(fault.value - margin, fault.value + margin)
        ),
        not_separable_from=(),
        explanation=explanation,
        next_experiment=effect.experiment,
        parameters={},
    )


def effect_finding(cause: Candidate, outcome: Outcome, errors: ModelErrors) -> Finding:
    """Return the finding of a selected effect.

    The interval includes zero if the effect cannot be separated from a structural effect.
    """
    effect, parameters = cause.effect, cause.selected.parameters
    before_m, after_m = errors.without_m[effect.name], errors.final_m
    confounded, resembling = outcome.confounded.get(effect.name, ()), []
    if cause.cv.z <= CERTAIN_Z and effect.structural is None:
        # selected effects that may contain a part of this effect
        selected = [candidate.effect for candidate in outcome.causes if candidate is not cause]
        resembling = [e.name for e in selected if e.resembles(effect)]
    structural = [
        alternative
        for alternative in map(effect_named, (*confounded, *resembling))
        if alternative.structural is not None
    ]
    size, share = size_of(cause), cause.share
    if effect.structural is not None and before_m > after_m and share > 0.0:
        share = sqrt(before_m**2 - after_m**2) / (2.0 * outcome.first.half_stroke_m)
        factor, (low, high) = 100.0 * share / size.value, size.ci95
        size = replace(size, value=factor * size.value, ci95=(factor * low, factor * high))
    rms_text = with_unit(2.0 * share * outcome.first.half_stroke_m, "m")
    size_text = f"{100 * share:.3g} % of the stroke ({rms_text} rms)"
    if effect.structural is None:
        where = "behind jumps of the drive " if cause.selected.from_jumps else ""
        evidence = f"Of its contribution {where}no hysteresis can imitate {size_text}."
    else:
        evidence = f"A simulation without it misses {size_text}; the model includes it."
    sentences = [effect.summary, evidence]
    if structural:
        low, high = size.ci95
        size = replace(size, ci95=(min(low, 0.0), max(high, 0.0)))
        names = " or ".join(words(alternative.name) for alternative in structural)
        sentences.append(f"Not separable from {names}; the interval therefore includes zero.")
    if effect.note is not None:
        sentences.append(effect.note(parameters))
    return Finding(
        effect=effect.name,
        held_out_gain=held_out_gain(before_m, after_m),
        held_out_rms_before_m=before_m,
        held_out_rms_after_m=after_m,
        p_value=evidence_p_value(cause.evidence),
        rms_percent=100.0 * share,
        size=size,
        not_separable_from=(
            *confounded,
            *(s.name for s in structural if s.name not in confounded),
        ),
        explanation=" ".join(sentences),
        # The size of one of two confounded effects settles the other.
        next_experiment=" ".join(
            [effect.experiment, *(f"Or, for {words(e.name)}: {e.experiment}" for e in structural)]
        ),
        parameters=dict(parameters),
    )


def not_detected(effect: Effect, outcome: Outcome) -> NotDetected:
    """Return the upper bound and the detection limit of an effect that was not selected."""
    if outcome.rejection:
        reason = f"the model class does not apply: {outcome.rejection}"
        return _untested(effect, reason, effect.experiment)
    untestable = effect.untestable(outcome.final)
    if untestable:
        return _untested(effect, untestable, effect.experiment)
    # the last score test within or between recordings, whichever has the larger bound
    names = (effect.name, f"{effect.name} {BETWEEN}")
    tests = [outcome.score_tests[name] for name in names if name in outcome.score_tests]
    test = max(tests, key=lambda test: test.absorption * test.bound, default=None)
    if test is not None and test.separable:
        return _bounded(test, outcome)
    if test is not None:
        confounded = [
            words(name)
            for name, alternative in outcome.score_tests.items()
            if name in effect.confounded and not alternative.separable
        ]
        reason = (
            f"not separable from {', '.join(('hysteresis', *confounded))}: like branches "
            "were all driven at one speed, and there each is a width of the loop"
        )
        return _untested(effect, reason, SPEEDS)
    if effect.fault is None:
        return _untested(effect, "nothing in these recordings excites it", effect.experiment)
    limit_m = effect.fault.bound(outcome.clean) * 2.0 * outcome.final.half_stroke_m
    return NotDetected(
        effect=effect.name,
        upper_bound_m=limit_m,
        detection_limit_m=limit_m,
        reason=f"not detected; {with_unit(limit_m, 'm')} would have been",
        next_experiment=effect.experiment,
    )


def _untested(effect: Effect, reason: str, next_experiment: str) -> NotDetected:
    return NotDetected(
        effect=effect.name,
        upper_bound_m=None,
        detection_limit_m=None,
        reason=reason,
        next_experiment=next_experiment,
    )


def _bounded(test: ScoreTest, outcome: Outcome) -> NotDetected:
    """Return the bounds of a tested effect, including the part that hysteresis absorbs.

    The detection limit is at least the bound: an effect of that size may be present and was not
    named. A bound above the range is none.
    """
    effect, final = test.effect, outcome.final
    scale_m = test.absorption * 2.0 * final.half_stroke_m
    bound_m = scale_m * test.bound
    if bound_m > 2.0 * final.half_stroke_m:
        reason = "hysteresis absorbs it on these recordings: any size up to the range would fit"
        return _untested(effect, reason, effect.experiment)
    min_share = final.rms / 2.0 * sqrt(2.0 * effect.minimum_gain)
    margin = POWER * (test.bound - test.share)
    limit_m = max(scale_m * max(margin, min_share, MINIMUM_SHARE, test.floor), bound_m)
    # why it was not named although its score test alone is significant
    causes = ", ".join(words(cause.effect.name) for cause in outcome.causes)
    dismissal = ""
    if effect.name in outcome.inseparable:
        structure = "structure that no hysteresis class explains"
        alternative = f"a residue of {causes}" if causes else structure
        dismissal = f": not named, because these recordings cannot separate it from {alternative}"
    elif any(cause.effect.name == effect.name for cause in outcome.doubtful):
        dismissal = (
            ": not named, because the model predicts left-out data about as well without it"
        )
    elif test.cv.gain >= effect.minimum_gain and test.cv.z >= MINIMUM_Z:
        if not test.physical:
            dismissal = ": not named, because this size is physically impossible"
        elif effect.structural is not None and not exceeds_structure(
            test.share, final.rms, final.noise
        ):
            dismissal = (
                ": not named, because structure that no hysteresis class explains is as large"
            )
        else:
            residue = f", or it is a residue of {causes}" if causes else ""
            dismissal = (
                f": not named, because it is not significant beside the other effects{residue}"
            )
    change = significant(-100.0 * test.cv.gain, 2)
    placebo = ""
    if test.placebo is not None:
        placebo = f", its placebo by {significant(-100.0 * test.placebo.cv.gain, 2)} %"
    return NotDetected(
        effect=effect.name,
        upper_bound_m=bound_m,
        detection_limit_m=limit_m,
        reason=(
            f"at most {with_unit(bound_m, 'm')} rms; it changes the held-out error by "
            f"{change} % ({test.cv.z:.2g} standard errors)"
            f"{placebo}{dismissal}"
        ),
        next_experiment=effect.experiment,
    )
