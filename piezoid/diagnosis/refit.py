"""Refit the shipped model with the selected effects, and measure the contribution of each.

Each effect becomes extensions of the axis model, whose start values are those of the search. All
are refitted together, and again without each effect; all errors are of the same held-out rows. The
baseline is the static model with the declared rig and without every effect. A fault of the data is
repaired in the recordings themselves, as it was in the search.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from piezoid.diagnosis.blocked_regression import relative_scatter
from piezoid.diagnosis.diagnosis import SOMETHING_ELSE
from piezoid.diagnosis.effect import EffectEstimate, SearchScaling
from piezoid.diagnosis.effects import effect_named
from piezoid.diagnosis.residual_structure import SearchResult, add_structure
from piezoid.diagnosis.segments import Track
from piezoid.formatting import words
from piezoid.identification.dynamics.fit_dynamics import resolved_modes
from piezoid.identification.extended_fit import Extended, fit_extended, parts_of
from piezoid.identification.extensions import in_order
from piezoid.identification.extensions.creep_ladder import CreepLadder
from piezoid.identification.extensions.extension import Extension
from piezoid.identification.extensions.gain_change import GainChange
from piezoid.identification.extensions.lags import ConverterHold, Delay, FirstOrderLag
from piezoid.identification.extensions.linear_mode import FixedMode, LinearMode
from piezoid.identification.hysteresis.coordinates import Structure
from piezoid.identification.hysteresis.pieces import MINIMUM_SAMPLES, Scales, drifting_zeros
from piezoid.identification.model import AxisModel, Lag
from piezoid.numerics.arrays import Samples
from piezoid.records.lab import Lab
from piezoid.records.recording import Quantity, Recording

RESONANCE = "resonance"
CLEARLY_WORSE = 1.1  # ratio of held-out errors, of the model with a part over that without it
FREE_RUNGS = 0.85  # of the error: largest error with free shares of a creep ladder
SMALL_LAG = 0.1  # of the lag of the model: start value beside a mode that the lag had represented
STATIC = Structure(lag=False)
Fit = Callable[..., Extended]  # ``fit_extended`` with the recordings bound


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelErrors:
    """Held-out errors of the model, rms in m.

    baseline_m  of the static model without any effect, on unrepaired recordings; it has fitted
                initial states unless the initial state is a selected effect
    final_m     of the model with all effects, on repaired recordings
    without_m   of the model without one effect, by the name of that effect; also without the modes
                of the dynamics, if these ring in the recordings
    scatter     relative standard error of the mean square of the final error
    model       to ship: with a fitted lag if the search selected no lag or delay; the model of the
                fit if its class does not apply
    """

    baseline_m: float
    final_m: float
    without_m: Mapping[str, float]
    scatter: float
    model: AxisModel


def attribute_errors(
    result: SearchResult,
    recordings: Sequence[Recording],
    *,
    model: AxisModel,
    lab: Lab,
    scales: Scales,
    progress: Callable[[str], None],
) -> ModelErrors:
    """Compute the errors of the baseline, of the full model, and without each detected effect.

    recordings  of the search, not repaired
    model       the axis as fitted to these or to earlier recordings
    lab         declares the clock of the converters
    scales      of the search
    """
    # the search decided from the recordings whether the converter holds the drive
    clock_Hz = lab.acquisition.sampling_rate_Hz
    hold_s = 0.5 / clock_Hz if clock_Hz and result.raw.continuous else 0.0
    outcome, structure = result.outcome, result.structure
    raw, tracks, faults = result.raw.tracks, outcome.clean.tracks, outcome.repaired_faults
    structured = tracks if structure is None else add_structure(outcome.clean, structure)
    rows_differ = any(len(a.rows) > len(b.rows) for a, b in zip(structured, tracks, strict=True))
    has_rows = bool(faults) or rows_differ
    estimates = [
        EffectEstimate(
            effect=cause.effect.name,
            parameters=cause.selected.parameters,
            coefficient=cause.cv.coefficient,
            from_jumps=cause.selected.from_jumps,
        )
        for cause in outcome.causes
    ]
    return refit_model(
        repair_recordings(recordings, model.axis, raw, tracks, scales),
        estimates,
        model=model,
        hold_s=hold_s,
        scales=scales,
        raw=recordings,
        faults=faults,
        rows=[track.rows for track in tracks] if has_rows else None,
        with_structure=None
        if structure is None
        else repair_recordings(recordings, model.axis, raw, structured, scales),
        structure_rows=[track.rows for track in structured] if has_rows else None,
        progress=progress,
    )


def refit_model(
    recordings: Sequence[Recording],
    estimates: Sequence[EffectEstimate],
    *,
    model: AxisModel,
    hold_s: float = 0.0,
    scales: Scales,
    raw: Sequence[Recording],
    faults: Sequence[str] = (),
    rows: Sequence[Samples] | None = None,
    with_structure: Sequence[Recording] | None = None,
    structure_rows: Sequence[Samples] | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> ModelErrors:
    """Refit a model with all detected effects, and without each of them in turn.

    recordings      in which the axis moves, faults repaired, in the order of their recording
    estimates       of the effects, by the search
    model           the axis as fitted, from which all refits start
    hold_s          delay by the hold of the converter; 0: the drive moves between samples
    raw             the recordings, not repaired
    faults          names of repaired faults; the error without them is that of a fit to ``raw``
    rows            samples to fit, for each track; None: all, thinned evenly
    with_structure  the recordings before unexplained structure was subtracted; None: there is none
    structure_rows  samples to fit of these recordings
    """
    hold = (ConverterHold(hold_s=hold_s),) if hold_s > 0.0 else ()
    starts, structure = _with_effects(model, recordings, estimates, scales)
    extensions = tuple(in_order([*hold, *(e for effect in starts.values() for e in effect)]))
    progress("refitting the simulation")
    modes = _identified_modes(model, extensions)
    ringing = [e for e in (*extensions, *modes) if isinstance(e, LinearMode)]
    # rows in which the ringing of these modes is not resolved are excluded from every fit
    fit_raw = partial(fit_extended, recordings=raw, ringing=ringing)
    baseline = fit_raw(model, extensions=hold, structure=STATIC)
    alternatives = (baseline.model,)
    fit = partial(
        fit_extended,
        recordings=recordings,
        samples=rows,
        ringing=ringing,
        further_starts=alternatives,
        structure=structure,
    )
    final, extensions, without_modes = _fit_with_effects(
        model, extensions, modes, estimates, recordings, fit
    )
    without = {} if without_modes is None else {RESONANCE: without_modes}
    fitted_extensions = final.model.extensions
    baseline_structure = STATIC
    for estimate in estimates:
        baseline_structure = _structure_of(baseline_structure, estimate, model, has_effect=False)
    if baseline_structure != STATIC:
        baseline = fit_raw(
            final.model,
            extensions=hold,
            structure=baseline_structure,
            further_starts=alternatives,
        )
    for estimate in estimates:
        progress(f"refitting without {words(estimate.effect)}")
        effect_starts = starts.get(estimate.effect, ())
        remaining_extensions = [
            extension
            for start, extension in zip(extensions, fitted_extensions, strict=True)
            if not any(start is effect_start for effect_start in effect_starts)
        ]
        remaining_structure = _structure_of(structure, estimate, model, has_effect=False)
        without[estimate.effect] = fit(
            final.model, extensions=remaining_extensions, structure=remaining_structure
        )
    if faults:
        with_faults = fit_raw(
            final.model,
            extensions=fitted_extensions,
            structure=structure,
            further_starts=alternatives,
        )
        without |= dict.fromkeys(faults, with_faults)
    if with_structure is not None:
        progress("refitting without the unnamed structure")
        without[SOMETHING_ELSE] = fit(
            final.model,
            recordings=with_structure,
            samples=structure_rows,
            extensions=fitted_extensions,
        )
    # a refit with constant zeros would lose a drift, and is then the worse fit
    quality = model.quality
    drifts = drifting_zeros(model.starts, quality.rms_m, quality.range_m)
    loses_drift = bool(drifts) and final.rms_m > quality.rms_m
    ships_refit = starts or (not loses_drift and (model.verdict.applies or estimates))
    return ModelErrors(
        baseline_m=baseline.held_out_rms_m,
        final_m=final.held_out_rms_m,
        without_m={name: result.held_out_rms_m for name, result in without.items()},
        scatter=relative_scatter(final.held_m),
        model=_shipped_model(model, final, fit, structure) if ships_refit else model,
    )


def _with_effects(
    model: AxisModel,
    recordings: Sequence[Recording],
    estimates: Sequence[EffectEstimate],
    scales: Scales,
) -> tuple[dict[str, tuple[Extension, ...]], Structure]:
    """Return the extensions of each effect, and the static structure with all effects."""
    structure = STATIC
    scaling = SearchScaling(
        voltage_V=scales.voltage_V,
        voltage_offset_V=scales.voltage_offset_V,
        half_stroke_m=abs(scales.displacement_m),
        pieces=tuple(part.piece.where for part in parts_of(model, recordings)),
        recordings=tuple(recording.name for recording in recordings),
    )
    starts: dict[str, tuple[Extension, ...]] = {}
    for estimate in estimates:
        extend = effect_named(estimate.effect).extend
        if extend is not None:
            starts[estimate.effect] = extend(estimate, scaling)
        structure = _structure_of(structure, estimate, model, has_effect=True)
    return starts, structure


def _identified_modes(model: AxisModel, extensions: Sequence[Extension]) -> list[FixedMode]:
    """Return the resolved modes of the dynamics; none if the extensions contain a mode."""
    dynamics = model.dynamics
    if dynamics is None or any(isinstance(e, LinearMode) for e in extensions):
        return []
    modes = resolved_modes(dynamics)
    return [
        FixedMode(frequency_Hz=float(frequency_Hz), quality=float(0.5 / damping))
        for frequency_Hz, damping in zip(
            dynamics.mode_frequency_Hz[modes], dynamics.mode_damping[modes], strict=True
        )
    ]


def _fit_with_effects(
    model: AxisModel,
    extensions: tuple[Extension, ...],
    modes: Sequence[FixedMode],
    estimates: Sequence[EffectEstimate],
    recordings: Sequence[Recording],
    fit: Fit,
) -> tuple[Extended, tuple[Extension, ...], Extended | None]:
    """Fit all extensions, and the modes of the dynamics unless the error is clearly larger.

    The search underestimates the participation of a mode, because small fast motion on large slow
    motion is smaller than its static response predicts: one fit from there ended with 0.18 instead
    of 1. A participation of 1 is therefore a second start value.

    Returns the fit, its extensions in model order, and the fit without modes if it has them.
    """
    full = tuple(
        replace(e, participation=1.0) if isinstance(e, LinearMode) else e for e in extensions
    )
    starts = [extensions] if full == extensions else [extensions, full]
    fits = [fit(model, extensions=start) for start in starts]
    final, without_modes = min(fits, key=lambda result: result.held_out_rms_m), None
    if modes:
        with_modes = in_order([*extensions, *modes])
        ringing_fit = fit(model, extensions=with_modes)
        if ringing_fit.held_out_rms_m < CLEARLY_WORSE * final.held_out_rms_m:
            final, extensions, without_modes = ringing_fit, with_modes, final
    refit = partial(fit, further_starts=())
    # after a change between two recordings (place 0) no recording has both gains
    if any(e.effect == "gain_change" and e.parameters["place"] > 0.0 for e in estimates):
        names = [recording.name for recording in recordings]
        final = _with_later_recordings(final, names, refit)
    # free shares of the rungs of a creep ladder also follow other hysteresis than the model's
    rungs = final.model.extensions
    if any(isinstance(extension, CreepLadder) for extension in rungs):
        free_rungs = [replace(e, even=False) if isinstance(e, CreepLadder) else e for e in rungs]
        with_free_rungs = refit(final.model, extensions=free_rungs)
        if with_free_rungs.held_out_rms_m < FREE_RUNGS * final.held_out_rms_m:
            final = with_free_rungs
    return final, extensions, without_modes


def _structure_of(
    structure: Structure, estimate: EffectEstimate, model: AxisModel, *, has_effect: bool
) -> Structure:
    """Return the static structure with or without an effect; unchanged if it is not structural."""
    structural = effect_named(estimate.effect).structural
    if structural is None:
        return structure
    return structural.structure(structure, model, has_effect)


def _with_later_recordings(final: Extended, recordings: Sequence[str], fit: Fit) -> Extended:
    """Decide by their gains which recordings were made after a gain change within one recording.

    The order of the files does not tell: it is often that of their names.
    """
    extensions = final.model.extensions
    change = next((e for e in extensions if isinstance(e, GainChange)), None)
    if change is None or len(recordings) == 1:
        return final

    def refit(further: Sequence[GainChange], later: tuple[str, ...]) -> Extended:
        start = [replace(e, later=later) if isinstance(e, GainChange) else e for e in extensions]
        return fit(final.model, extensions=in_order([*start, *further]))

    free_gains = [
        GainChange(recording=name, instant_s=0.0, ratio=1.0)
        for name in recordings
        if name != change.recording
    ]
    fitted_extensions = refit(free_gains, ()).model.extensions
    gains = {e.recording: e.ratio for e in fitted_extensions if isinstance(e, GainChange)}
    middle = 0.5 * (1.0 + gains[change.recording])
    is_larger = gains[change.recording] > 1.0
    later = tuple(e.recording for e in free_gains if (gains[e.recording] > middle) == is_larger)
    if set(later) == set(change.later):
        return final
    refitted = refit((), later)
    return refitted if refitted.held_out_rms_m < final.held_out_rms_m else final


def _shipped_model(model: AxisModel, final: Extended, fit: Fit, structure: Structure) -> AxisModel:
    """Move the lag from the extensions to the lag of the model, where the runtime reads it.

    Without a lag or delay among the extensions the lag of the model is fitted again. The lag of
    the first fit also represented any mode, so a fraction of it is a second start value.
    """
    extensions = final.model.extensions
    lag = next((e for e in extensions if isinstance(e, Delay | FirstOrderLag)), None)
    if lag is None:
        small_lag = replace(model.lag, time_s=SMALL_LAG * model.lag.time_s)
        starts = [replace(final.model, lag=start_lag) for start_lag in (model.lag, small_lag)]
        with_lag = replace(structure, lag=True)
        return fit(
            starts[0], extensions=extensions, structure=with_lag, further_starts=starts[1:]
        ).model
    if isinstance(lag, FirstOrderLag):
        model_lag = Lag(kind="first_order", time_s=lag.lag_s)
    elif lag.delay_samples > 0.0:
        return final.model
    else:
        model_lag = Lag(kind="delay", time_s=lag.delay_s)
    std_s = lag.std[0] if lag.std else 0.0
    return replace(
        final.model,
        lag=model_lag,
        extensions=tuple(e for e in extensions if e is not lag),
        uncertainty=final.model.uncertainty.updated("lag_s", model_lag.time_s, std_s),
    )


def repair_recordings(
    recordings: Sequence[Recording],
    axis: str,
    original: Sequence[Track],
    repaired: Sequence[Track],
    scales: Scales,
) -> tuple[Recording, ...]:
    """Apply the changes that a search made to its tracks to the recordings."""
    track_pairs, results = iter(zip(original, repaired, strict=True)), []
    for recording in recordings:
        drive_V, moved_m = np.zeros(recording.samples), np.zeros(recording.samples)
        for piece in recording.pieces:
            if piece.stop - piece.start >= MINIMUM_SAMPLES:  # else too short for a track
                old, new = next(track_pairs)
                drive_V[piece] = scales.voltage_V * (new.drive - old.drive)
                moved_m[piece] = scales.displacement_m * (new.response - old.response)
        if not (drive_V.any() or moved_m.any()):
            results.append(recording)
            continue
        change = {Quantity.VOLTAGE: drive_V, Quantity.DISPLACEMENT: moved_m}
        channels = tuple(
            replace(channel, values=channel.values + change[channel.quantity])
            if channel.axis == axis and channel.quantity in change
            else channel
            for channel in recording.channels
        )
        results.append(replace(recording, channels=channels))
    return tuple(results)
