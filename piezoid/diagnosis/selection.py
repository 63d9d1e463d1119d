"""Search for causes: faults of the data, forward selection, model comparison, residual structure.

Every effect gets a score test by its tangents. A shortlist is refitted with the whole model, and
the effect with the smallest error is selected if it is significant, physical and clearly better
than its placebos. All other effects are then tested again beside it. At the end each selected
effect must be significant beside all others and not be small beside the structure of the residual.

Each confounded effect is then refitted instead of the selected effect, with all others in the
model. The two are not separable on these recordings if the loss over blocks is not significantly
smaller with the selected effect (Vuong). The difference between two interpolations of the drive
may be significant, so a small difference does not separate effects either.

If the residual is then systematic along one coordinate, the curve along it is subtracted from the
readings and the search is repeated: an effect that had absorbed the structure is not selected
again, and effects that the structure had hidden are. The second search is accepted if its error is
clearly smaller.

Source: Vuong, Econometrica 57 (1989).
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import hypot, sqrt

from piezoid.diagnosis.blocked_regression import paired_z
from piezoid.diagnosis.candidate import (
    NOISE_UNCERTAINTY,
    QUANTISATION,
    Candidate,
    Confounded,
    Outcome,
    evaluate,
    structural_candidate,
)
from piezoid.diagnosis.effect import Effect, Fault
from piezoid.diagnosis.effects import every_effect
from piezoid.diagnosis.forward_selection import SLIP, select_forward
from piezoid.diagnosis.nuisance_search import (
    OTHER_INITIAL_STATES,
    InitialStates,
    is_shared_state_as_good,
    with_individual_initial_states,
    with_shared_initial_state,
)
from piezoid.diagnosis.refinement import (
    SelectedEffect,
    initial_guess,
    refine,
    with_effects,
    with_parameter_tangents,
)
from piezoid.diagnosis.residual_structure import SearchResult, locate_structure
from piezoid.diagnosis.residual_view import (
    View,
    has_continuous_drive,
    with_continuous_drive,
    with_shared_reversals,
    with_tracks,
)
from piezoid.diagnosis.score_test import ScoreTest, score_test
from piezoid.diagnosis.step_responses import step_response_view
from piezoid.formatting import words
from piezoid.numerics.executor import SERIAL, Executor
from piezoid.records.recording import Recording

CLEAR_SHARE = 0.65  # explained share of the power above the noise from which structure is clear
MAX_REPAIRS = 3
EVIDENT = 0.5  # largest relative error at which a shared initial state is evident
MIN_TANGENT_GAIN = 0.5  # of the effect's gain, by a confounded effect that is refitted
SEPARABLE = 1.96  # standard errors between two effects
MIN_DIFFERENCE = 0.02  # of the explained and of the remaining error, to separate two effects
STAMP_FAULTS = ("gap", "duplicate_time", "time_reversed")
INVALID = "lost_readings"
CERTAIN_P = 1e-12  # time stamps and flags are read, not estimated
CLOCK, SPIKES = "timestamp_fault", "outliers"
# Smallest error of a search without slips over that with them. On ten stages with a fault of the
# clock, five searches have the smaller error with slips: 1.39 to 7.8. On a stage with a resonance
# and a delay, which has no slips, it was 1.01.
MIN_ERROR_WITHOUT_SLIPS = 1.1
MAX_SECOND_RATIO = 0.97  # largest error after the second search, over that after the first


def search_all(view: View, executor: Executor) -> SearchResult:
    """Search for effects, and for structure of the residual that no effect explains."""
    first = _search_with_best_clock(view, executor)
    view = first.first
    executor.report("locating the unexplained residual")
    unexplained, structures = locate_structure(first)
    first_result = SearchResult(raw=view, outcome=first, unexplained=unexplained)
    best, best_rms = first_result, MAX_SECOND_RATIO * first.final.rms
    for structure in structures:
        executor.report("searching again without this structure")
        tracks = []
        for k, (track, error) in enumerate(zip(view.tracks, structure.curve, strict=True)):
            is_measured = ~structure.is_beyond_range(k)[track.rows]
            rows, block = track.rows[is_measured], track.block[is_measured]
            response = track.response - error
            tracks.append(replace(track, response=response, rows=rows, block=block))
        # minus a curve, readings may have spikes that the sensor did not have
        skipped = "" if SPIKES in first.faults else SPIKES
        second = search(with_tracks(view, tracks), executor, skipped=skipped)
        if first.coarse_readings is not None:  # minus a curve, readings have no equal steps
            fault = replace(first.coarse_readings, tracks=second.clean.tracks)
            second = replace(second, faults={**second.faults, QUANTISATION: fault})
        if second.final.rms < best_rms:
            best_rms = second.final.rms
            best = replace(
                first_result, outcome=second, structure=structure, without_structure=first_result
            )
    return best


def _search_with_best_clock(view: View, executor: Executor) -> Outcome:
    """Search with the drive held or not, and with slips only if they clearly reduce the error.

    Beside effects that are not selected yet, a drive that moves between samples is not recognised,
    and a resonance at a rising speed looks like slips of the clock.
    """
    outcome = search(view, executor)
    if SLIP in outcome.faults:
        executor.report("searching without slips of the clock")
        without_slips = search(view, executor, skipped=SLIP)
        if without_slips.final.rms < MIN_ERROR_WITHOUT_SLIPS * outcome.final.rms:
            outcome = without_slips
    if view.continuous:
        causes = [cause.selected for cause in outcome.causes]
        continuous = with_effects(with_continuous_drive(outcome.clean), causes)
        if has_continuous_drive(outcome.final, continuous):
            executor.report("searching with a drive that moves between samples")
            return _search_with_best_clock(with_continuous_drive(view), executor)
    return outcome


def search(view: View, executor: Executor = SERIAL, *, skipped: str = "") -> Outcome:
    """Search for the causes of the residual of the nuisance class.

    skipped  name of a fault that is not searched before the effects
    """
    clean, faults, initial = repair_faults(view, executor, skipped=skipped)
    state = select_forward(clean, faults, executor, initial)
    causes, confounded, dismissed = compare_models(state.clean, state.selected, executor)
    final = with_effects(state.clean, [cause.selected for cause in causes])
    outcome = Outcome(
        first=view,
        clean=state.clean,
        final=final,
        faults=state.faults,
        causes=tuple(causes),
        confounded=confounded,
        score_tests=_with_dropped_effects(state.score_tests, final, causes),
        dismissed=tuple(dismissed),
    )
    return _with_structure(outcome, executor)


def search_faults(view: View, rejection: str, executor: Executor) -> Outcome:
    """Search for faults of the data only, because the model class does not apply.

    rejection  why the class does not apply

    An effect would compensate for the missing class, and so would a clock slip, which is detected
    by comparing readings with a model. Neither is searched.
    """
    clean, faults, _ = repair_faults(view, executor, skipped=SLIP)
    return Outcome(
        first=view,
        clean=clean,
        final=clean,
        faults=faults,
        causes=(),
        confounded={},
        score_tests={},
        rejection=rejection,
    )


def without_causes(outcome: Outcome, causes: Sequence[Candidate]) -> Outcome:
    """Return the outcome without causes that the model does not need."""
    remaining = tuple(cause for cause in outcome.causes if cause not in causes)
    final = with_effects(outcome.clean, [cause.selected for cause in remaining])
    return replace(
        outcome,
        final=final,
        causes=remaining,
        doubtful=tuple(causes),
        score_tests=_with_dropped_effects(outcome.score_tests, final, remaining),
    )


def _with_dropped_effects(
    tests: Mapping[str, ScoreTest], final: View, causes: Sequence[Candidate]
) -> dict[str, ScoreTest]:
    """Add tests on the final view of effects that were selected and dropped again."""
    tested = {*tests, *(cause.effect.name for cause in causes)}
    dropped = [
        score_test(effect, final)
        for effect in every_effect()
        if effect.structural is None and effect.name not in tested and not effect.untestable(final)
    ]
    return {**{test.effect.name: test for test in dropped if test is not None}, **tests}


def _with_structure(outcome: Outcome, executor: Executor) -> Outcome:
    """Test the structural effects, beside all causes.

    The residual of a misspecified class resembles missing structure. A structural effect is
    therefore named only if it is clear or the nuisance class fits well.
    """
    final = outcome.final
    for effect in every_effect():
        structural = effect.structural
        if structural is None or effect.untestable(final):
            continue
        executor.report(f"testing {words(effect.name)}")
        result = structural_candidate(effect, final)
        if result is None:
            continue
        test, candidate = result
        baseline_power = (final.rms / (1.0 - candidate.cv.gain)) ** 2
        explained_power = baseline_power - final.rms**2
        noise_power = final.noise**2
        above_noise = max(baseline_power - noise_power, NOISE_UNCERTAINTY * noise_power)
        is_clear = explained_power / above_noise > CLEAR_SHARE
        fits_well = final.rms < structural.largest_noise_ratio * final.noise
        if candidate.may_be_named and (is_clear or fits_well):
            outcome = replace(outcome, causes=(*outcome.causes, candidate))
            continue
        outcome = replace(outcome, score_tests={**outcome.score_tests, effect.name: test})
        if candidate.is_significant:
            confounded = {
                name: (*alternatives, effect.name) if name in effect.confounded else alternatives
                for name, alternatives in outcome.confounded.items()
            }
            dismissed = (*outcome.dismissed, candidate)
            outcome = replace(outcome, dismissed=dismissed, confounded=confounded)
    return outcome


def repair_faults(
    view: View, executor: Executor, *, skipped: str = ""
) -> tuple[View, dict[str, Fault], InitialStates | None]:
    """Repair faults of the data, and return the repaired view and the faults by effect.

    The initial state is the shared hypothesis if it is evident, else a drive cycled over its
    range. The last value holds the fitted initial states, or None if anything was repaired.

    skipped  name of a fault that is not searched
    """
    faults: dict[str, Fault] = {}
    shared = with_shared_initial_state(view, executor)
    individual = with_individual_initial_states(view, shared)
    is_evident = shared.rms < EVIDENT * view.rms and is_shared_state_as_good(
        shared, individual, view
    )
    assumed = shared if is_evident else view
    # a wrong initial state looks like lost readings
    view = individual if individual.rms < OTHER_INITIAL_STATES * assumed.rms else assumed
    for effect in every_effect():
        if effect.fault is None or effect.name == skipped:
            continue
        for _ in range(MAX_REPAIRS):
            executor.report(f"looking for {words(effect.name)}")
            fault = effect.fault.find(view)
            if fault is None:
                break
            faults[effect.name] = fault.merged_with(faults.get(effect.name))
            if all(a is b for a, b in zip(fault.tracks, view.tracks, strict=True)):
                break
            view = with_tracks(view, fault.tracks)
    initial = (shared, individual) if view.tracks == individual.tracks else None
    return with_shared_reversals(view, assumed.nuisance.reversals), faults, initial


def compare_models(
    clean: View, selected: Sequence[SelectedEffect], executor: Executor
) -> tuple[list[Candidate], Confounded, list[Candidate]]:
    """Evaluate every selected effect beside the others, and find its confounded effects.

    Effects that are not significant are dismissed one by one, the smallest gain first. An effect
    detected in step responses is evaluated on these, where the drive is filtered.

    Returns significant effects, their confounded effects, and the dismissed effects.
    """
    dismissed: list[Candidate] = []
    while True:
        candidates, confounded = [], {}
        for k, effect in enumerate(selected):
            name, view = effect.effect.name, clean
            executor.report(f"comparing {words(name)} with confounded effects")
            remaining = [*selected[:k], *selected[k + 1 :]]
            if effect.from_jumps:
                step_responses = step_response_view(with_effects(clean, remaining))
                if step_responses is not None:
                    view = step_responses
                    remaining = [e for e in remaining if e.effect.drive_filter is None]
            (refined,), with_effect = refine([effect], view, remaining)
            without = with_parameter_tangents(with_effects(view, remaining), view, remaining)
            test = score_test(effect.effect, without)
            assert test is not None
            candidate = evaluate(refined, with_effect, without, test=test)
            candidates.append(candidate)
            confounded[name] = _find_confounded(candidate, view, remaining, executor)
        rejected = [c for c in candidates if not c.is_significant]
        if not rejected:
            return candidates, confounded, dismissed
        weakest = min(rejected, key=lambda candidate: candidate.cv.gain)
        dismissed.append(weakest)
        selected = [c.selected for c in candidates if c is not weakest]


def _find_confounded(
    candidate: Candidate,
    clean: View,
    remaining: Sequence[SelectedEffect],
    executor: Executor,
) -> tuple[str, ...]:
    """Return the effects that could replace a selected effect, the smallest error first."""
    without, in_model = candidate.without, {effect.effect.name for effect in remaining}

    def refit(effect: Effect) -> Candidate | None:
        """Refit a confounded effect instead of the selected one; None if its gain is too small."""
        if effect.trials is None or effect.structural is not None or effect.untestable(without):
            return None
        test = score_test(effect, without)
        if test is None or test.total_gain < MIN_TANGENT_GAIN * candidate.cv.gain:
            return None
        if test.separable and not test.physical:
            return None
        guess = initial_guess(effect, test.trial, float(test.cv.coefficient[0]))
        (refined,), view = refine([guess], clean, remaining)
        return evaluate(refined, view, without, test=test)

    alternatives = executor.map(
        refit,
        [
            effect
            for effect in every_effect()
            if effect.name in candidate.effect.confounded and effect.name not in in_model
        ],
    )
    confounded = [a for a in alternatives if a is not None and is_confounded(a, candidate)]
    return tuple(a.effect.name for a in sorted(confounded, key=lambda a: a.cv.rms))


def is_confounded(alternative: Candidate, candidate: Candidate) -> bool:
    """Tell whether the recordings cannot separate an alternative from a selected effect."""
    if not alternative.physical:
        # an impossible effect with a smaller error raises doubts about the selected effect
        return alternative.cv.rms < candidate.cv.rms
    excess = alternative.cv.rms**2 - candidate.cv.rms**2
    explained = candidate.without.rms**2 - candidate.cv.rms**2
    is_small = excess < MIN_DIFFERENCE * explained
    if is_small and alternative.cv.rms < (1.0 + MIN_DIFFERENCE) * candidate.cv.rms:
        return True
    return paired_z(alternative.cv.loss, candidate.cv.loss) < SEPARABLE


def with_ingest_faults(
    outcome: Outcome, recordings: Sequence[Recording], half_stroke_m: float
) -> Outcome:
    """Add the faults that ingest detected and repaired to the outcome of a search.

    The size of a clock fault is the number of samples that are missing, have a repeated stamp, or
    by which the clock stepped back, plus the samples of a slip. The size of invalid readings is
    their largest distance from the motion, in nm.

    recordings     the searched recordings
    half_stroke_m  half the range of the displacement
    """
    statements = [(r.name, s) for r in recordings for s in r.statements]
    faults, tracks = dict(outcome.faults), outcome.clean.tracks
    stamps = [(name, s.value) for name, s in statements if s.quantity in STAMP_FAULTS]
    counts = [value for _, value in stamps if value]
    if counts:
        slip = faults.pop(CLOCK, None)
        clock = Fault(
            tracks=tracks if slip is None else slip.tracks,
            value=sum(counts) + (abs(slip.value) if slip else 0.0),
            # each number is rounded to whole samples
            spread=hypot(sqrt(len(counts) / 12.0), slip.spread if slip else 0.0),
            p_value=CERTAIN_P,
            locations=tuple(
                dict.fromkeys([n for n, _ in stamps] + list(slip.locations if slip else ()))
            ),
        )
        faults = {CLOCK: clock, **faults}
    invalid = [(name, s) for name, s in statements if s.quantity == INVALID]
    if invalid:
        largest_nm = 1e9 * max(statement.value or 0.0 for _, statement in invalid)
        spikes = faults.pop(SPIKES, None)
        readings = Fault(
            tracks=tracks if spikes is None else spikes.tracks,
            value=largest_nm,
            # the error of the true reading is the noise
            spread=max(1e9 * outcome.final.noise * half_stroke_m, 0.01 * largest_nm),
            p_value=CERTAIN_P,
            locations=tuple(f"{name}: {statement.text}" for name, statement in invalid),
        )
        faults = {SPIKES: readings.merged_with(spikes), **faults}
    return replace(outcome, faults=faults)
