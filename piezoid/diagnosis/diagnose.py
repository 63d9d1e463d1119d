"""From recordings to a Diagnosis: what the simulation gets wrong, and why."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from piezoid.counts import refusing_in_counts
from piezoid.diagnosis.attribution import Simulated, attributed
from piezoid.diagnosis.budget import (
    RemainingErrors,
    corrected,
    with_budget,
)
from piezoid.diagnosis.candidate import Candidate
from piezoid.diagnosis.closed_loop_recordings import with_creep_of_holds
from piezoid.diagnosis.constant_drive import diagnose_at_rest
from piezoid.diagnosis.detection_limits import absent, not_sought
from piezoid.diagnosis.diagnosis import (
    Diagnosis,
    FinalError,
    Finding,
    HeldOut,
    Size,
    Unexplained,
    fraction_explained,
)
from piezoid.diagnosis.effect import Effect, Fault
from piezoid.diagnosis.effect_size import size_of
from piezoid.diagnosis.effects import effect_named, every_effect
from piezoid.diagnosis.forward_selection import SLIP
from piezoid.diagnosis.identified_modes import told_apart, with_modes
from piezoid.diagnosis.ingest_faults import with_ingested
from piezoid.diagnosis.noise_level import noise_level
from piezoid.diagnosis.null_distribution import chance_of, strengths_of_healthy
from piezoid.diagnosis.residual_structure import NAME as SOMETHING_ELSE
from piezoid.diagnosis.residual_structure import SURE, Explained, explained, without_names
from piezoid.diagnosis.residual_view import View, view_of
from piezoid.diagnosis.segments import tracks_of
from piezoid.diagnosis.selection import Outcome, without_causes
from piezoid.diagnosis.step_responses import behind_jumps
from piezoid.diagnosis.structure_findings import of_discovered, of_noise
from piezoid.formatting import words
from piezoid.identification.fit import (
    axes_of,
    fit_axis,
    lacking,
    moving,
    recorded_of,
    refined,
    rig_of,
)
from piezoid.identification.hysteresis.applicability import UNEXPLAINED
from piezoid.identification.hysteresis.pieces import Scales, pieces_of, scales_of
from piezoid.identification.hysteresis.scope import scope_of
from piezoid.identification.model import AxisModel
from piezoid.numerics.executor import Executor
from piezoid.records.constant_drive import is_at_rest
from piezoid.records.frequency_response import FrequencyResponseRecord
from piezoid.records.lab import Lab
from piezoid.records.recording import Recording, counted_in

Progress = Callable[[str], None]

MOST_PLACES = 5  # that are told of a fault
CERTAIN = 8.0  # standard errors: so sure a cause holds no part of another


def diagnose(
    recordings: Sequence[Recording],
    *,
    axis: str | None = None,
    lab: Lab | None = None,
    model: AxisModel | None = None,
    response: FrequencyResponseRecord | None = None,
    progress: Progress = lambda _: None,
    threads: int = 1,
) -> Diagnosis:
    """Explain the difference between simulation and recordings of one axis.

    recordings  of one stage, in the order in which they were made
    axis        which one; the first that has both drive and displacement
    lab         what the laboratory declares; declared poles are part of the simulation
    model       the axis as ``fit`` made it, of these recordings or of earlier ones; None: it is
                fitted first. The diagnosis carries this model refitted with what is found
    response    measured frequency response of the axis
    progress    told what is being done, by whichever thread does it, one at a time
    threads     so many work at once; what is found does not depend on it

    Raises ``ExcitationError`` where drive or displacement is missing or does not move. What goes
    wrong: a cause that no effect stands for is ``something_else`` where it lives in one
    coordinate; where it lives in several, it may be given to the effect that resembles it most.
    ``unexplained`` tells how much is left.
    """
    counted = counted_in(recordings)
    with refusing_in_counts(counted):
        found = _diagnosed(recordings, axis, lab or Lab(), model, response, progress, threads)
        return found.told_in_counts(counted)


def _diagnosed(
    recordings: Sequence[Recording],
    axis: str | None,
    declared: Lab,
    model: AxisModel | None,
    response: FrequencyResponseRecord | None,
    progress: Progress,
    threads: int,
) -> Diagnosis:
    axes = axes_of(recordings)
    wanted = next(iter(axes), "") if axis is None else axis
    if wanted not in axes:
        what = f" of axis {wanted}" if wanted else " of the same axis"
        raise lacking(recordings, f"a drive voltage and a displacement{what}")
    resting = recorded_of(recordings, wanted)
    if resting and all(is_at_rest(recording, wanted) for recording in resting):
        progress("looking at a stage at rest")
        return diagnose_at_rest(resting, wanted)
    if model is None:
        model = fit_axis(recordings, wanted, declared, response=response, progress=progress)
    model = model.without_minor_loops()
    progress("fitting the envelope")
    chosen, shaped = told_apart(moving(recordings, wanted), wanted, model, declared)
    scales, executor = scales_of(chosen, wanted), Executor(progress=progress, threads=threads)
    view = view_on(chosen, axis=wanted, lab=declared)
    against = "" if model.verdict.applies else model.verdict.reason
    found = _nothing_in(view, against, executor) if against else explained(view, executor)
    progress("refitting the simulation")
    weighed = partial(
        attributed,
        recordings=chosen,
        model=model,
        lab=declared,
        scales=scales,
        progress=progress,
    )
    found, numbers = _worth_most(found, weighed)
    if numbers.final > 2.0 * UNEXPLAINED and not against:
        against = f"everything found leaves {50.0 * numbers.final:.1f} % of the range"
        found = _nothing_in(view, against, executor)
        numbers = weighed(found)
    found = _without_idle_slips(found, numbers)
    found = replace(found, outcome=with_ingested(found.outcome, chosen, view.stroke_m))
    progress("dynamics and loop shape of the extended model")
    final = refined(numbers.model, recordings, declared, response)
    diagnosis = _diagnosis(wanted, found, numbers, final, chosen, scales)
    in_budget = set(diagnosis.names)
    gain_m_per_V = scales.displacement_m / scales.voltage_V
    diagnosis = with_creep_of_holds(diagnosis, recorded_of(recordings, wanted), gain_m_per_V)
    diagnosis = with_modes(diagnosis, model, shaped, len(every_effect()))
    return with_budget(
        diagnosis,
        _remaining_errors(found.outcome, numbers, final),
        {
            name: f"{words(name).capitalize()}: its error is not part of the baseline's."
            for name in diagnosis.names
            if name not in in_budget
        },
    )


def _remaining_errors(outcome: Outcome, numbers: Simulated, final: AxisModel) -> RemainingErrors:
    null, plain = outcome.final.null, final.minor_loops
    rows, columns = null.every.shape
    return RemainingErrors(
        explained_m=final.quality.explained_rms_m,
        wide_m=outcome.final.rms * outcome.first.stroke_m * corrected(rows, columns),
        scatter=numbers.scatter,
        before_m=None if plain is None else plain.plain.held_out_rms_m,
        is_compared=not outcome.against,
    )


def _worth_most(
    found: Explained, weighed: Callable[[Explained], Simulated]
) -> tuple[Explained, Simulated]:
    """Return what was discovered, or what names alone make of it where that is no worse.

    On data left out the simulation may be as good without the curve: the class of the search then
    did not follow the hysteresis, and the simulation does, unless no healthy stage of any law
    leaves as much. Or it may be as good with the names in whose place the curve stands. Beyond the
    end of a sensor's range the rows are not the same, and the second comparison is not made.
    """
    numbers, otherwise, discovered = weighed(found), found.otherwise, found.discovered
    if otherwise is None or discovered is None:
        return found, numbers
    if not discovered.is_unheard_of and numbers.final >= numbers.without[SOMETHING_ELSE]:
        return otherwise, weighed(otherwise)
    if discovered.end is None and _names_of(otherwise) - _names_of(found):
        named = weighed(otherwise)
        if named.final <= numbers.final:
            return otherwise, named
    return found, numbers


def _without_idle_slips(found: Explained, numbers: Simulated) -> Explained:
    """Return what was found, slips of a clock only where undoing them helps the simulation.

    They are told by readings against the nuisance class, whose own error may look like one: on
    fresh stages of the zoo undoing two wrong ones raised the held-out error, and undoing ten right
    ones lowered it.
    """
    faults = found.outcome.faults
    if SLIP not in faults or numbers.without.get(SLIP, np.inf) > numbers.final:
        return found
    others = {name: fault for name, fault in faults.items() if name != SLIP}
    return replace(found, outcome=replace(found.outcome, faults=others))


def _names_of(found: Explained) -> set[str]:
    return {cause.effect.name for cause in found.outcome.causes}


def _nothing_in(view: View, against: str, executor: Executor) -> Explained:
    """Look for faults of the data alone, and name no cause."""
    return without_names(view, without_causes(view, against, executor))


def view_on(recordings: Sequence[Recording], *, axis: str, lab: Lab) -> View:
    """Return the view of all recordings in which this axis moves."""
    chosen = moving(recordings, axis)
    scales, rig = scales_of(chosen, axis), rig_of(lab, axis)
    clock_Hz = lab.acquisition.sampling_rate_Hz
    tracks = tracks_of(chosen, axis, scales, rig, clock_Hz=clock_Hz)
    stroke_m = abs(scales.displacement_m)
    rest = -scales.voltage_offset_V / scales.voltage_V
    view = view_of(tracks, stroke_m=stroke_m, voltage_V=scales.voltage_V, rest=rest)
    scope = scope_of(pieces_of(chosen, axis, scales, rig))
    return replace(view, one_speed=scope.has_one_speed and behind_jumps(view) is None)


def _diagnosis(
    axis: str,
    found: Explained,
    numbers: Simulated,
    model: AxisModel,
    recordings: Sequence[Recording],
    scales: Scales,
) -> Diagnosis:
    outcome, rest = found.outcome, found.unexplained
    stroke_m = found.raw.stroke_m
    noise = model.quality.noise_rms_m / stroke_m
    final = model.quality.held_out_rms_m / stroke_m
    findings = [
        *(_of_fault(name, fault, numbers, stroke_m) for name, fault in outcome.faults.items()),
        *(_of_cause(cause, outcome, numbers) for cause in outcome.causes),
    ]
    if found.discovered is not None:
        findings.append(
            of_discovered(
                found.discovered,
                before=_held_out(numbers.without[SOMETHING_ELSE], stroke_m),
                after=_held_out(numbers.final, stroke_m),
                scale_m=scales.displacement_m,
                middle_m=_middle_m(found.discovered.view, recordings, axis, scales),
            )
        )
    elif _only_structure(outcome) and (level := noise_level(outcome.final, SURE)) is not None:
        findings.append(
            of_noise(
                level,
                error=_held_out(numbers.final, stroke_m),
                scale_m=scales.displacement_m,
                middle_m=_middle_m(outcome.final, recordings, axis, scales),
            )
        )
    findings.sort(key=lambda finding: finding.held_out_gain, reverse=True)
    named = {finding.effect for finding in findings}
    unseen = [
        not_sought(effect, outcome.against) if outcome.against else absent(effect, outcome)
        for effect in every_effect()
        if effect.name not in named
    ]
    return Diagnosis(
        axis=axis,
        stroke_m=2.0 * stroke_m,
        baseline=_held_out(numbers.baseline, stroke_m),
        final=FinalError(rms_m=final * stroke_m, rms_percent=50.0 * final),
        envelope_rms_m=outcome.final.rms * stroke_m,
        noise_floor_rms_m=noise * stroke_m,
        explained_fraction=fraction_explained(numbers.baseline, final, noise),
        findings=tuple(findings),
        not_detected=tuple(unseen),
        unexplained=Unexplained(
            rms_m=rest.rms * stroke_m,
            share=rest.share,
            p_value=rest.p_value,
            coordinate=rest.coordinate,
            gain=rest.gain,
        ),
        model=model,
        strengths={
            one.effect.name: one.strength
            for one in sorted((*outcome.causes, *outcome.dismissed), key=lambda one: one.strength)
        },
    )


def _only_structure(outcome: Outcome) -> bool:
    """Tell whether nothing named acts beside the static response: it could pass for noise."""
    others = (cause for cause in outcome.causes if cause.effect.structural is None)
    return not (outcome.against or outcome.faults or any(others))


def _middle_m(view: View, recordings: Sequence[Recording], axis: str, scales: Scales) -> float:
    """Return the displacement that 0 of the static response stands for."""
    first = recordings[0].displacement_m(axis)[: len(view.tracks[0].drive)]
    return float(np.median(first - scales.displacement_m * view.static[0][: len(first)]))


def _held_out(rms: float, stroke_m: float) -> HeldOut:
    return HeldOut(rms_m=rms * stroke_m, rms_percent=50.0 * rms)


def _of_fault(name: str, fault: Fault, numbers: Simulated, stroke_m: float) -> Finding:
    effect = effect_named(name)
    # what ingest repaired, and what cannot be repaired, changes nothing here
    before, after = numbers.without.get(name, numbers.final), numbers.final
    reach = 1.96 * fault.spread
    return Finding(
        effect=name,
        held_out_gain=_gain(before, after),
        held_out_rms_before_m=before * stroke_m,
        held_out_rms_after_m=after * stroke_m,
        p_value=min(1.0, fault.p_value * len(every_effect())),
        rms_percent=50.0 * _gain(before, after) * before,
        size=Size(
            value=fault.value, unit=effect.unit, ci95=(fault.value - reach, fault.value + reach)
        ),
        not_separable_from=fault.alike,
        explanation=effect.summary + (f" {_seen_in(fault)}" if fault.where else ""),
        next_experiment=effect.experiment,
        parameters={},
    )


def _of_cause(cause: Candidate, outcome: Outcome, numbers: Simulated) -> Finding:
    effect = cause.effect
    stroke_m = outcome.first.stroke_m
    before, after = numbers.without[effect.name], numbers.final
    confounded = outcome.confounded.get(effect.name, ())
    structure = _structure([*confounded, *_named_beside(cause, outcome)])
    return Finding(
        effect=effect.name,
        held_out_gain=_gain(before, after),
        held_out_rms_before_m=before * stroke_m,
        held_out_rms_after_m=after * stroke_m,
        p_value=chance_of(cause.strength, strengths_of_healthy()),
        rms_percent=100.0 * cause.share,
        size=_or_none_at_all(size_of(cause)) if structure else size_of(cause),
        not_separable_from=(*confounded, *(s.name for s in structure if s.name not in confounded)),
        explanation=effect.summary
        + f" {'Behind jumps of the drive' if cause.selected.from_jumps else 'Here'} "
        f"{100 * cause.share:.3g} % of the stroke (rms) of it is what no hysteresis could be; "
        f"beside everything else found it takes {100 * cause.cv.gain:.3g} % off the error that "
        "is left there."
        f"{_or_a_part(structure)}"
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


def _named_beside(cause: Candidate, outcome: Outcome) -> list[str]:
    """Return causes that may hold a part of this one, where it is not sure beyond doubt."""
    if cause.cv.z > CERTAIN or cause.effect.structural is not None:
        return []
    others = [other.effect for other in outcome.causes if other is not cause]
    return [other.name for other in others if other.resembles(cause.effect)]


def _or_none_at_all(size: Size) -> Size:
    """Let the interval of a size reach to zero: hysteresis of that kind may be all of it."""
    low, high = size.ci95
    return replace(size, ci95=(min(low, 0.0), max(high, 0.0)))


def _or_a_part(structure: Sequence[Effect]) -> str:
    if not structure:
        return ""
    names = " or ".join(words(one.name) for one in structure)
    return f" A part of it, or all, may be {names}: hence an interval that holds zero."


def _gain(before: float, after: float) -> float:
    return float(np.clip(1.0 - after / before, 0.0, 1.0)) if before > 0.0 else 0.0


def _seen_in(fault: Fault) -> str:
    more = len(fault.where) - MOST_PLACES
    rest = f" and {more} places more" if more > 0 else ""
    return f"Seen in {', '.join(fault.where[:MOST_PLACES])}{rest}."
