"""Findings of a search: the faults and effects it selected, with the errors of the model.

Each finding states the held-out error of the model with the effect and refitted without it.
"""

from collections.abc import Sequence
from dataclasses import replace

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

MAX_PLACES = 5  # listed in the explanation of a fault
CERTAIN_Z = 8.0  # standard errors above which an effect holds no part of another


def findings_of(
    result: SearchResult,
    errors: ModelErrors,
    recordings: Sequence[Recording],
    axis: str,
    scales: Scales,
) -> tuple[Finding, ...]:
    """Return the findings of a search by falling gain.

    Args:
        result: of the search.
        errors: of the model with everything selected and without each of it, scaled.
        recordings: that were searched.
        axis: that was searched.
        scales: of the search.
    """
    outcome, stroke_m = result.outcome, result.raw.stroke_m
    findings = [
        *(fault_finding(name, fault, errors, stroke_m) for name, fault in outcome.faults.items()),
        *(effect_finding(cause, outcome, errors) for cause in outcome.causes),
    ]
    if result.structure is not None:
        findings.append(
            structure_finding(
                result.structure,
                before=held_out(errors.without_m[SOMETHING_ELSE], stroke_m),
                after=held_out(errors.final_m, stroke_m),
                scale_m=scales.displacement_m,
                middle_m=_middle_m(result.structure.view, recordings, axis, scales),
            )
        )
    elif (
        _only_structure(outcome) and (level := noise_level(outcome.final, MAX_P_VALUE)) is not None
    ):
        findings.append(
            noise_finding(
                level,
                error=held_out(errors.final_m, stroke_m),
                scale_m=scales.displacement_m,
                middle_m=_middle_m(outcome.final, recordings, axis, scales),
            )
        )
    return tuple(sorted(findings, key=lambda finding: finding.held_out_gain, reverse=True))


def _only_structure(outcome: Outcome) -> bool:
    """Tell whether nothing named acts beside the static response: it could pass for noise."""
    others = (cause for cause in outcome.causes if cause.effect.structural is None)
    return not (outcome.against or outcome.faults or any(others))


def _middle_m(view: View, recordings: Sequence[Recording], axis: str, scales: Scales) -> float:
    """Return the displacement that 0 of the static response stands for."""
    first = recordings[0].displacement_m(axis)[: len(view.tracks[0].drive)]
    return float(np.median(first - scales.displacement_m * view.static[0][: len(first)]))


def held_out(rms_m: float, stroke_m: float) -> HeldOut:
    """Return an error in metres and in percent of the stroke, of which ``stroke_m`` is half."""
    return HeldOut(rms_m=rms_m, rms_percent=50.0 * rms_m / stroke_m)


def fault_finding(name: str, fault: Fault, errors: ModelErrors, stroke_m: float) -> Finding:
    """Return the finding of a fault of the data."""
    effect = effect_named(name)
    # what ingest repaired, and what cannot be repaired, changes nothing here
    before_m, after_m = errors.without_m.get(name, errors.final_m), errors.final_m
    reach = 1.96 * fault.spread
    return Finding(
        effect=name,
        held_out_gain=held_out_gain(before_m, after_m),
        held_out_rms_before_m=before_m,
        held_out_rms_after_m=after_m,
        p_value=min(1.0, fault.p_value * len(every_effect())),
        rms_percent=50.0 * held_out_gain(before_m, after_m) * before_m / stroke_m,
        size=Size(
            value=fault.value, unit=effect.unit, ci95=(fault.value - reach, fault.value + reach)
        ),
        not_separable_from=fault.alike,
        explanation=effect.summary + (f" {_places(fault)}" if fault.where else ""),
        next_experiment=effect.experiment,
        parameters={},
    )


def effect_finding(cause: Candidate, outcome: Outcome, errors: ModelErrors) -> Finding:
    """Return the finding of a selected effect."""
    effect = cause.effect
    before_m, after_m = errors.without_m[effect.name], errors.final_m
    confounded = outcome.confounded.get(effect.name, ())
    structure = _structure([*confounded, *_resembling(cause, outcome)])
    return Finding(
        effect=effect.name,
        held_out_gain=held_out_gain(before_m, after_m),
        held_out_rms_before_m=before_m,
        held_out_rms_after_m=after_m,
        p_value=evidence_p_value(cause.strength),
        rms_percent=100.0 * cause.share,
        size=_extend_to_zero(size_of(cause)) if structure else size_of(cause),
        not_separable_from=(*confounded, *(s.name for s in structure if s.name not in confounded)),
        explanation=effect.summary
        + f" {'Behind jumps of the drive' if cause.selected.from_jumps else 'Here'} "
        f"{100 * cause.share:.3g} % of the stroke (rms) cannot be imitated by any hysteresis."
        f"{_confounding_note(structure)}"
        + ("" if effect.note is None else f" {effect.note(cause.selected.parameters)}"),
        next_experiment=" ".join(one.experiment for one in (effect, *structure)),
        parameters=dict(cause.selected.parameters),
    )


def _structure(confounded: Sequence[str]) -> list[Effect]:
    """Return the confounded effects that are hysteresis, which needs its own experiment."""
    return [
        alternative
        for alternative in map(effect_named, confounded)
        if alternative.structural is not None
    ]


def _resembling(cause: Candidate, outcome: Outcome) -> list[str]:
    """Return causes that may hold a part of this one, where it is not sure beyond doubt."""
    if cause.cv.z > CERTAIN_Z or cause.effect.structural is not None:
        return []
    others = [other.effect for other in outcome.causes if other is not cause]
    return [other.name for other in others if other.resembles(cause.effect)]


def _extend_to_zero(size: Size) -> Size:
    """Let the interval of a size reach to zero: hysteresis of that kind may be all of it."""
    low, high = size.ci95
    return replace(size, ci95=(min(low, 0.0), max(high, 0.0)))


def _confounding_note(structure: Sequence[Effect]) -> str:
    if not structure:
        return ""
    names = " or ".join(words(one.name) for one in structure)
    return f" Not separable from {names}; the interval therefore includes zero."


def _places(fault: Fault) -> str:
    more = len(fault.where) - MAX_PLACES
    rest = f" and {more} places more" if more > 0 else ""
    return f"Seen in {', '.join(fault.where[:MAX_PLACES])}{rest}."
