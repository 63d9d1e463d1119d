"""Findings of a search: faults and effects, each with the errors of the model with and without it.

The errors are held-out errors of the refitted model.
"""

from collections.abc import Sequence
from dataclasses import replace
from math import sqrt

import numpy as np

from piezoid.diagnosis.candidate import Candidate
from piezoid.diagnosis.diagnosis import SOMETHING_ELSE, Finding, HeldOut, Size, held_out_gain
from piezoid.diagnosis.effect import Effect, Fault
from piezoid.diagnosis.effect_size import size_of
from piezoid.diagnosis.effects import effect_named, every_effect
from piezoid.diagnosis.noise_level import noise_level
from piezoid.diagnosis.null_distribution import evidence_p_value
from piezoid.diagnosis.refit import ModelErrors
from piezoid.diagnosis.residual_structure import MAX_P_VALUE, SearchResult
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.selection import Outcome
from piezoid.diagnosis.structure_findings import noise_finding, structure_finding
from piezoid.formatting import words
from piezoid.identification.hysteresis.pieces import Scales
from piezoid.records.recording import Recording

MAX_PLACES = 5  # of a fault that its explanation lists
CERTAIN_Z = 8.0  # standard errors above which an effect contains no part of another


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
    outcome, half_stroke_m = result.outcome, result.raw.half_stroke_m
    findings = [
        *(
            fault_finding(name, fault, errors, half_stroke_m)
            for name, fault in outcome.faults.items()
        ),
        *(effect_finding(cause, outcome, errors) for cause in outcome.causes),
    ]
    final, structure = held_out(errors.final_m, half_stroke_m), result.structure
    if structure is not None:
        findings.append(
            structure_finding(
                structure,
                without_curve=held_out(errors.without_m[SOMETHING_ELSE], half_stroke_m),
                with_curve=final,
                scale_m=scales.displacement_m,
                middle_m=_middle_m(structure.view, recordings, axis, scales),
            )
        )
    elif _has_hysteresis_only(outcome):
        noise = noise_level(outcome.final, MAX_P_VALUE)
        if noise is not None:
            middle_m = _middle_m(outcome.final, recordings, axis, scales)
            findings.append(
                noise_finding(noise, error=final, scale_m=scales.displacement_m, middle_m=middle_m)
            )
    return tuple(sorted(findings, key=lambda finding: finding.held_out_gain, reverse=True))


def _has_hysteresis_only(outcome: Outcome) -> bool:
    """Tell whether only hysteresis was detected: other effects could pass for noise."""
    has_effects = any(cause.effect.structural is None for cause in outcome.causes)
    return not (outcome.rejection or outcome.faults or has_effects)


def _middle_m(view: View, recordings: Sequence[Recording], axis: str, scales: Scales) -> float:
    """Return the displacement at which the static response is 0."""
    displacement_m = recordings[0].displacement_m(axis)[: len(view.tracks[0].drive)]
    static_m = scales.displacement_m * view.static[0][: len(displacement_m)]
    return float(np.median(displacement_m - static_m))


def held_out(rms_m: float, half_stroke_m: float) -> HeldOut:
    """Return a held-out error in metres and in percent of the stroke."""
    return HeldOut(rms_m=rms_m, rms_percent=50.0 * rms_m / half_stroke_m)


def fault_finding(name: str, fault: Fault, errors: ModelErrors, half_stroke_m: float) -> Finding:
    """Return the finding of a fault of the data.

    The gain of a fault that ingest repaired, or that cannot be repaired, is 0.
    """
    effect = effect_named(name)
    before_m, after_m = errors.without_m.get(name, errors.final_m), errors.final_m
    gain, margin = held_out_gain(before_m, after_m), 1.96 * fault.spread
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
        explanation=effect.summary + (f" {_list_places(fault)}" if fault.locations else ""),
        next_experiment=effect.experiment,
        parameters={},
    )


def _list_places(fault: Fault) -> str:
    further = len(fault.locations) - MAX_PLACES
    suffix = f" and {further} more" if further > 0 else ""
    return f"Seen in {', '.join(fault.locations[:MAX_PLACES])}{suffix}."


def effect_finding(cause: Candidate, outcome: Outcome, errors: ModelErrors) -> Finding:
    """Return the finding of a selected effect.

    The interval includes zero if the effect cannot be separated from a structural effect.
    """
    effect, parameters = cause.effect, cause.selected.parameters
    before_m, after_m = errors.without_m[effect.name], errors.final_m
    confounded = outcome.confounded.get(effect.name, ())
    resembling = _resembling_effects(cause, outcome)
    structural = [
        alternative
        for alternative in map(effect_named, (*confounded, *resembling))
        if alternative.structural is not None
    ]
    size, share = size_of(cause), cause.share
    if effect.structural is not None and before_m > after_m and share > 0.0:
        share = sqrt(before_m**2 - after_m**2) / (2.0 * outcome.first.half_stroke_m)
        size = size.scaled(100.0 * share / size.value)
    if structural:
        low, high = size.ci95
        size = replace(size, ci95=(min(low, 0.0), max(high, 0.0)))
    return Finding(
        effect=effect.name,
        held_out_gain=held_out_gain(before_m, after_m),
        held_out_rms_before_m=before_m,
        held_out_rms_after_m=after_m,
        p_value=evidence_p_value(cause.strength),
        rms_percent=100.0 * share,
        size=size,
        not_separable_from=(
            *confounded,
            *(s.name for s in structural if s.name not in confounded),
        ),
        explanation=_explanation(cause, share, structural),
        next_experiment=" ".join(
            [effect.experiment, *(f"For {words(e.name)}: {e.experiment}" for e in structural)]
        ),
        parameters=dict(parameters),
    )


def _resembling_effects(cause: Candidate, outcome: Outcome) -> list[str]:
    """Return selected effects that may contain a part of this one, unless it is certain."""
    if cause.cv.z > CERTAIN_Z or cause.effect.structural is not None:
        return []
    other_effects = [candidate.effect for candidate in outcome.causes if candidate is not cause]
    return [effect.name for effect in other_effects if effect.resembles(cause.effect)]


def _explanation(cause: Candidate, share: float, structural: Sequence[Effect]) -> str:
    effect = cause.effect
    where = "Behind jumps of the drive" if cause.selected.from_jumps else "Here"
    size = f"{100 * share:.3g} % of the stroke (rms)"
    if effect.structural is None:
        evidence = f"{where} {size} cannot be imitated by any hysteresis."
    else:
        evidence = f"A simulation without it misses {size}; the model includes it."
    sentences = [effect.summary, evidence]
    if structural:
        names = " or ".join(words(alternative.name) for alternative in structural)
        sentences.append(f"Not separable from {names}; the interval therefore includes zero.")
    if effect.note is not None:
        sentences.append(effect.note(cause.selected.parameters))
    return " ".join(sentences)
