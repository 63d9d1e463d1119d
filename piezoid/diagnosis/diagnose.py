"""Diagnose one axis: explain the difference between its simulation and its recordings.

recordings -> repaired view -> effects selected against the widest class of hysteresis
-> model refitted with the effects -> findings, detection limits and error budget
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from math import sqrt

import numpy as np

from piezoid.diagnosis.budget import RemainingErrors, with_budget
from piezoid.diagnosis.candidate import Candidate, Outcome, strength_of
from piezoid.diagnosis.closed_loop_recordings import with_creep_of_holds
from piezoid.diagnosis.constant_drive import diagnose_at_rest
from piezoid.diagnosis.diagnosis import SOMETHING_ELSE, Diagnosis, HeldOut, fraction_explained
from piezoid.diagnosis.effects import every_effect
from piezoid.diagnosis.findings import findings_of, not_detected
from piezoid.diagnosis.forward_selection import SLIP
from piezoid.diagnosis.identified_modes import split_by_mode, with_modes
from piezoid.diagnosis.null_distribution import ALPHA, evidence_p_value, smallest_structure_p_value
from piezoid.diagnosis.refit import CLEARLY_WORSE, ModelErrors, attribute_errors, repair_recordings
from piezoid.diagnosis.residual_structure import SearchResult, add_structure, locate_residual
from piezoid.diagnosis.residual_view import (
    View,
    has_continuous_drive,
    view_of,
    with_continuous_drive,
)
from piezoid.diagnosis.segments import tracks_of
from piezoid.diagnosis.selection import (
    search_all,
    search_faults,
    with_ingest_faults,
    without_causes,
)
from piezoid.diagnosis.step_responses import step_response_view
from piezoid.errors import IdentificationError
from piezoid.formatting import words
from piezoid.identification.fit import (
    axes_of,
    complete_extended,
    driven_recordings,
    fit_axis,
    missing_channels_error,
    recordings_of_axis,
    rig_of,
)
from piezoid.identification.hysteresis.applicability import MAX_RESIDUAL
from piezoid.identification.hysteresis.pieces import Scales, pieces_of, scales_of
from piezoid.identification.hysteresis.scope import scope_of
from piezoid.identification.loop_shape_fit import errors_with_loop_shape_m
from piezoid.identification.model import AxisModel
from piezoid.identification.simulation import simulate_fitted_rows
from piezoid.numerics.executor import Executor
from piezoid.records.drive_signal import is_at_rest
from piezoid.records.frequency_response import FrequencyResponseRecord
from piezoid.records.lab import Lab
from piezoid.records.recording import Recording, counted_in

Progress = Callable[[str], None]
# Rms of a curve over the error of the model without it: 1.9 and 2.7 for true structure of the
# reading; 22, 51 and 13,000 for ends of the range that three sensors do not have.
MAX_CURVE_SIZE = 8.0
# Error of loop shape in sample without a cause over that with it, which a true cause exceeds. Ten
# true causes had 1.035 (rate dependence at a quarter) to 17, and later six 1.11 to 1.8. Without
# false ones the error held out grew by up to 280 %, and this error by less than 1 %.
MIN_INCREASE = 1.03
# Strength of evidence above which a cause is not tested that way: of the false causes that the
# model that ships did not need the strongest had 4.1; true ones have 3.3 to 33.
MAX_TESTED_STRENGTH = 8.0
AttributeErrors = Callable[[SearchResult], ModelErrors]


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
    axis        to diagnose; None: the first axis with both drive and displacement
    lab         declarations of the laboratory; declared poles are part of the simulation
    model       the axis as ``fit`` returned it, of these or of earlier recordings; None: it is
                fitted first. The diagnosis contains this model, refitted with the findings
    response    measured frequency response of the axis
    progress    called with a short text at each step, from any thread, one call at a time
    threads     number of threads; the result does not depend on it

    Raises ``ExcitationError`` if drive or displacement is missing or does not move. A cause
    outside the catalogue is ``something_else`` if it depends on one coordinate. If it depends on
    several, it may be attributed to the effect that resembles it most. ``unexplained`` states the
    size of the residual that remains.
    """
    axes = axes_of(recordings)
    selected_axis = next(iter(axes), "") if axis is None else axis
    if selected_axis not in axes:
        of_axis = f" of axis {selected_axis}" if selected_axis else " of the same axis"
        raise missing_channels_error(recordings, f"a drive voltage and a displacement{of_axis}")
    constant = recordings_of_axis(recordings, selected_axis)
    if constant and all(
        is_at_rest(recording.voltage_V(selected_axis), recording.displacement_m(selected_axis))
        for recording in constant
    ):
        progress("diagnosing recordings at constant drive")
        diagnosis = diagnose_at_rest(constant, selected_axis)
        return replace(diagnosis, counted=counted_in(recordings))
    declared = lab or Lab()
    is_rejected = model is not None and not model.verdict.applies
    if model is None:
        model = fit_axis(
            recordings,
            selected_axis,
            declared,
            response=response,
            has_loop_shape=False,
            progress=progress,
        )
    start = model.without_loop_shape()
    executor = Executor(progress=progress, threads=threads)
    selection = _select_effects(
        recordings, selected_axis, start, declared, executor, is_rejected=is_rejected
    )

    def complete(selection: _Selection) -> AxisModel:
        progress("fitting dynamics and loop shape of the extended model")
        repaired = selection.repaired(recordings)
        return complete_extended(selection.errors.model, repaired, declared, response)

    selection, final = _drop_doubtful_causes(selection, complete, recordings, executor)
    return _assembled(selection, start, final, recordings)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Selection:
    """Effects that explain the recordings, and the errors of the model with these effects.

    attribute        computes the errors for another result of the search
    recordings       recordings that were searched
    mode_recordings  recordings that an identified mode shapes, which were not searched
    """

    axis: str
    result: SearchResult
    errors: ModelErrors
    attribute: AttributeErrors
    recordings: tuple[Recording, ...]
    mode_recordings: tuple[Recording, ...]
    scales: Scales

    def repaired(self, recordings: Sequence[Recording]) -> tuple[Recording, ...]:
        """Return the recordings, with the selected faults repaired in the searched ones."""
        raw, clean = self.result.raw.tracks, self.result.outcome.clean.tracks
        if self.result.structure is not None:
            clean = add_structure(self.result.outcome.clean, self.result.structure)
        repaired = repair_recordings(self.recordings, self.axis, raw, clean, self.scales)
        by_name = {recording.name: recording for recording in repaired}
        return tuple(by_name.get(recording.name, recording) for recording in recordings)


def _select_effects(
    recordings: Sequence[Recording],
    axis: str,
    model: AxisModel,
    lab: Lab,
    executor: Executor,
    *,
    is_rejected: bool,
) -> _Selection:
    """Select faults and effects, and refit the model with them.

    Only faults of the data are searched if the class of the model of the caller does not apply
    (``is_rejected``), or if the error with all selected effects is too large: an effect would
    compensate for the missing class. A model that was fitted here may not apply because of an
    effect, so it is not rejected at first.

    Clock slips are detected against the nuisance class, and its error may look like a slip. A slip
    is dropped if its repair does not reduce the held-out error of the model.
    """
    executor.report("fitting the widest class of hysteresis")
    searched, mode_recordings = split_by_mode(driven_recordings(recordings, axis), model, lab)
    scales, view = scales_of(searched, axis), view_on(searched, axis=axis, lab=lab)
    attribute = partial(
        attribute_errors,
        recordings=searched,
        model=model,
        lab=lab,
        scales=scales,
        progress=executor.report,
    )
    rejection = model.verdict.reason if is_rejected else None
    if rejection is None:
        result, errors = _prefer_named_effects(search_all(view, executor), attribute)
        error = errors.final_m / view.half_stroke_m
        if error > 2.0 * MAX_RESIDUAL:
            large_error = f"with all findings the error is {50.0 * error:.1f} % of the range"
            rejection = large_error if model.verdict.applies else model.verdict.reason
    if rejection is not None:
        result = locate_residual(view, search_faults(view, rejection, executor))
        errors = attribute(result)
    # on new stages of the zoo undoing two wrong slips increased the held-out error, and undoing
    # ten right slips reduced it
    faults = result.outcome.faults
    if SLIP in faults and errors.without_m.get(SLIP, np.inf) <= errors.final_m:
        remaining_faults = {name: fault for name, fault in faults.items() if name != SLIP}
        result = replace(result, outcome=replace(result.outcome, faults=remaining_faults))
    return _Selection(
        axis=axis,
        result=result,
        errors=errors,
        attribute=attribute,
        recordings=searched,
        mode_recordings=mode_recordings,
        scales=scales,
    )


def _drop_doubtful_causes(
    selection: _Selection,
    complete: Callable[[_Selection], AxisModel],
    recordings: Sequence[Recording],
    executor: Executor,
) -> tuple[_Selection, AxisModel]:
    """Drop causes of weak evidence, and those that the final model does not need.

    Loop shape fits as well without the latter: such a cause represents hysteresis that only loop
    shape follows. They are dropped one by one, that of the smallest error first. A cause of
    overwhelming evidence is not tested. If the final model has no loop shape, a cause that clearly
    reduces its error stays. Structural effects stay: the healthy stages contain no evidence for an
    initial state, and non-congruence has a test of its own.

    The final model decides whether the causes are named, because the class of the search and the
    refits may be too narrow: on a LuGre stage with a true drift the refits were better without it
    (121 and 186 nm), and the final model was worse (81 and 17 nm). Evidence that is weak in the
    search may be strong in the final model, whose residual is smaller.

    complete  (selection) -> its final model
    """
    final, outcome, errors = complete(selection), selection.result.outcome, selection.errors
    quality, model = final.quality, final.without_loop_shape()
    causes = [cause for cause in outcome.causes if cause.effect.structural is None]
    weak = [cause for cause in causes if evidence_p_value(cause.strength) > ALPHA]
    driven = driven_recordings(selection.repaired(recordings), model.axis)
    tested = [cause for cause in causes if cause.strength < MAX_TESTED_STRENGTH]
    if model is final:  # without loop shape
        max_error_m = CLEARLY_WORSE * errors.final_m
        tested = [c for c in tested if c in weak or errors.without_m[c.effect.name] <= max_error_m]
    explained_m = quality.explained_rms_m
    if tested:  # compare at equal regularisation: that of the final model may be stronger
        explained_m = min(explained_m, errors_with_loop_shape_m(model, driven).explained)
    doubtful: list[Candidate] = []
    supported: dict[Candidate, Candidate] = {}
    while tested:
        errors_m = {}
        for cause in tested:
            remaining = cause.effect.without(model, driven[0])
            if remaining is None:
                continue
            executor.report(f"fitting loop shape without {words(cause.effect.name)}")
            errors_m[cause] = errors_with_loop_shape_m(remaining, driven).explained
            added_m = sqrt(max(errors_m[cause] ** 2 - explained_m**2, 0.0))
            strength = strength_of(added_m, explained_m, quality.noise_rms_m)
            supported[cause] = replace(cause, strength_with_loop_shape=strength)
        doubtful += [cause for cause in tested if cause in weak and cause not in errors_m]
        unsupported = [
            cause
            for cause, error_m in errors_m.items()
            if error_m <= MIN_INCREASE * explained_m
            or (cause in weak and evidence_p_value(supported[cause].evidence) > ALPHA)
        ]
        if not unsupported:
            break
        dropped = min(unsupported, key=lambda cause: errors_m[cause])
        doubtful.append(dropped)
        tested = [cause for cause in errors_m if cause is not dropped]
        model = dropped.effect.without(model, driven[0]) or model
        explained_m = min(explained_m, errors_m[dropped])
    if doubtful:
        result = replace(selection.result, outcome=without_causes(outcome, doubtful))
        reduced = replace(selection, result=result, errors=selection.attribute(result))
        reduced_final = complete(reduced)
        if reduced_final.quality.explained_rms_m <= CLEARLY_WORSE * quality.explained_rms_m:
            selection, final = reduced, reduced_final
    outcome = selection.result.outcome
    outcome = replace(outcome, causes=tuple(supported.get(c, c) for c in outcome.causes))
    return replace(selection, result=replace(selection.result, outcome=outcome)), final


def _prefer_named_effects(
    result: SearchResult, attribute: AttributeErrors
) -> tuple[SearchResult, ModelErrors]:
    """Prefer the named effects if they predict held-out data as well as the free curve.

    If the model is as good without the curve, the curve is hysteresis that the nuisance class does
    not follow and the model does; it is kept only if no healthy stage of any law has as systematic
    a residual. A curve that makes the model clearly worse is always dropped, and so is a curve
    many times larger than the error of the model without it: the search misses those readings, and
    the model follows them. Otherwise the end of a sensor's range is kept, because the search left
    out the rows beyond it: on a Duhem stage its error was a fifth of that with a limit of the
    amplifier, while the errors of the models differed by 1 %.
    """
    errors = attribute(result)
    without_structure, structure = result.without_structure, result.structure
    if without_structure is None or structure is None:
        return result, errors
    without_m = errors.without_m[SOMETHING_ELSE]
    if sqrt(structure.mean_power) * result.raw.half_stroke_m > MAX_CURVE_SIZE * without_m:
        return without_structure, attribute(without_structure)
    if structure.range_end is not None:
        return result, errors
    is_worse = errors.final_m > CLEARLY_WORSE * without_m
    is_usual = structure.healthy_p_value > smallest_structure_p_value()
    if is_worse or (is_usual and errors.final_m >= without_m):
        return without_structure, attribute(without_structure)
    named_effects, further_effects = (
        {cause.effect.name for cause in candidate.outcome.causes}
        for candidate in (result, without_structure)
    )
    if further_effects - named_effects:
        named_errors = attribute(without_structure)
        if named_errors.final_m <= errors.final_m:
            return without_structure, named_errors
    return result, errors


def view_on(recordings: Sequence[Recording], *, axis: str, lab: Lab) -> View:
    """Return the view of all recordings in which this axis moves.

    A converter with a declared clock holds every value of the drive, unless the recordings agree
    better with a drive that moves between samples, as that of a generator does.
    """
    moving_recordings = driven_recordings(recordings, axis)
    scales, rig = scales_of(moving_recordings, axis), rig_of(lab, axis)
    scope = scope_of(pieces_of(moving_recordings, axis, scales, rig))
    clock_Hz = lab.acquisition.sampling_rate_Hz
    view = view_of(
        tracks_of(moving_recordings, axis, scales, rig, clock_Hz=clock_Hz),
        half_stroke_m=abs(scales.displacement_m),
        voltage_V=scales.voltage_V,
        rest_drive=-scales.voltage_offset_V / scales.voltage_V,
    )
    if clock_Hz is not None:
        continuous = tracks_of(moving_recordings, axis, scales, rig)
        view = replace(view, continuous=tuple((t.command, t.drive) for t in continuous))
        view = with_continuous_drive(view) if has_continuous_drive(view) else view
    return replace(view, one_speed=scope.has_one_speed and step_response_view(view) is None)


def _assembled(
    selection: _Selection,
    start: AxisModel,
    final: AxisModel,
    recordings: Sequence[Recording],
) -> Diagnosis:
    """Assemble findings, detection limits and the error budget."""
    axis, errors, scales = selection.axis, selection.errors, selection.scales
    half_stroke_m = selection.result.raw.half_stroke_m
    stroke_m = 2.0 * half_stroke_m
    outcome = with_ingest_faults(selection.result.outcome, selection.recordings, half_stroke_m)
    result = replace(selection.result, outcome=outcome)
    searched = findings_of(result, errors, selection.recordings, axis, scales)
    searched_names = {finding.effect for finding in searched}
    quality = final.quality
    diagnosis = Diagnosis(
        axis=axis,
        stroke_m=stroke_m,
        baseline=HeldOut.of(errors.baseline_m, stroke_m),
        final=HeldOut.of(quality.held_out_rms_m, stroke_m),
        envelope_rms_m=outcome.final.rms * half_stroke_m,
        noise_floor_rms_m=quality.noise_rms_m,
        explained_fraction=fraction_explained(
            errors.baseline_m, quality.held_out_rms_m, quality.noise_rms_m
        ),
        findings=searched,
        not_detected=tuple(
            not_detected(effect, outcome)
            for effect in every_effect()
            if effect.name not in searched_names
        ),
        unexplained=result.unexplained,
        counted=counted_in(recordings),
        model=final,
        strengths={
            cause.effect.name: cause.strength
            for cause in sorted(
                (*outcome.causes, *outcome.dismissed, *outcome.doubtful),
                key=lambda cause: cause.strength,
            )
        },
    )
    gain_m_per_V = scales.displacement_m / scales.voltage_V
    diagnosis = with_creep_of_holds(diagnosis, recordings_of_axis(recordings, axis), gain_m_per_V)
    diagnosis = with_modes(diagnosis, start, selection.mode_recordings, outcome.final)
    final_power = errors.final_m**2
    gains = {
        name: max(errors.without_m[name] ** 2 - final_power, 0.0)
        for name in sorted({*diagnosis.names} - searched_names)
        if name in errors.without_m
    }
    effects_of_other_recordings = {*diagnosis.names} - searched_names - {*gains}
    return with_budget(
        diagnosis,
        _remaining_errors(outcome, errors, final, selection.repaired(recordings)),
        {
            name: f"{words(name).capitalize()}: its error is not part of the baseline's."
            for name in sorted(effects_of_other_recordings)
        },
        gains,
    )


def _remaining_errors(
    outcome: Outcome, errors: ModelErrors, final: AxisModel, recordings: Sequence[Recording]
) -> RemainingErrors:
    quality, recordings_m = final.quality, {}
    if quality.held_out_rms_m**2 >= 2.0 * quality.explained_rms_m**2:
        # most of the power of the held-out error is extrapolation
        for recording in recordings:
            with suppress(IdentificationError):  # other pieces than those of the fit
                simulated_m = simulate_fitted_rows(final, recording)
                error_m = recording.displacement_m(final.axis) - simulated_m
                recordings_m[recording.name] = float(np.sqrt(np.nanmean(error_m**2)))
    rows, columns = outcome.final.null.all_columns.shape
    correction = sqrt(rows / max(rows - columns, 0.5 * rows))  # for the number of parameters
    has_wide_class = final.without_loop_shape() is not final
    with_structure_m = errors.without_m.get(SOMETHING_ELSE, errors.final_m)
    coarse = outcome.coarse_readings
    return RemainingErrors(
        explained_m=quality.explained_rms_m,
        wide_m=outcome.final.rms * outcome.first.half_stroke_m * correction,
        scatter=errors.scatter,
        before_m=min(with_structure_m, errors.baseline_m) if has_wide_class else None,
        structure_m=sqrt(max(with_structure_m**2 - errors.final_m**2, 0.0)),
        is_compared=not outcome.rejection,
        recordings_m=recordings_m,
        converter_m=0.0 if coarse is None else 1e-9 * coarse.value / sqrt(12.0),
    )
