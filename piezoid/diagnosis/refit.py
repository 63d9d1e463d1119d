"""Refit the shipped model with the effects of a search, and measure what each one is worth.

Each effect becomes extensions of the axis model, started where the search ended. Everything is
refitted together, and again without each effect; all errors are of the same left-out rows. The
baseline is the static model with the declared rig alone. A fault is repaired in the recordings
themselves, so that the model meets what the search met.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from piezoid.diagnosis.budget import relative_scatter
from piezoid.diagnosis.diagnosis import SOMETHING_ELSE
from piezoid.diagnosis.effect import EffectEstimate, scaling_of
from piezoid.diagnosis.effects import every_effect
from piezoid.diagnosis.residual_structure import SearchResult, add_structure
from piezoid.diagnosis.segments import Track
from piezoid.diagnosis.selection import Outcome
from piezoid.formatting import words
from piezoid.identification.extensions import in_order
from piezoid.identification.extensions.converter_hold import ConverterHold
from piezoid.identification.extensions.creep_ladder import CreepLadder
from piezoid.identification.extensions.delay import Delay
from piezoid.identification.extensions.extension import Extension, Samples
from piezoid.identification.extensions.first_order_lag import FirstOrderLag
from piezoid.identification.hysteresis.pieces import MINIMUM_SAMPLES, Scales
from piezoid.identification.joint.fit_extended import Extended, fit_extended
from piezoid.identification.joint.vector import Structure
from piezoid.identification.model import AxisModel, Lag
from piezoid.identification.piece_start import wandering_zeros
from piezoid.records.lab import Lab
from piezoid.records.recording import Quantity, Recording

FREE_RUNGS = 0.85  # of the error: what free shares of a creep ladder must leave to be kept
LEFT_OF_LAG = 0.1  # of a lag beside the mode that it had stood for
STATIC = Structure(lag=False)


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelErrors:
    """Held-out errors of the model that ships, rms in m.

    baseline_m  of the static model on the recordings as they came
    final_m     with every effect, faults repaired
    without_m   with every effect but one, by its name
    scatter     relative standard error of the mean square of the final error
    model       what ships: with the fitted lag where no lag or delay was found; as it was given
                where its class does not apply
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
    progress: Callable[[str], None] = lambda _: None,
) -> ModelErrors:
    """Return the errors of the model before, after, and without each effect of a search.

    recordings  those of the search, as they came
    model       the axis as fitted to them, or to earlier ones
    scales      of the search
    """
    outcome, raw = result.outcome, result.raw.tracks
    faults, clean = repaired_faults(outcome), outcome.clean.tracks
    curved = clean
    if result.structure is not None:
        curved = add_structure(outcome.clean, result.structure)
    rows_differ = any(len(a.place) > len(b.place) for a, b in zip(curved, clean, strict=True))
    return refitted(
        repaired(recordings, model.axis, raw, clean, scales),
        [
            EffectEstimate(
                effect=cause.effect.name,
                parameters=cause.selected.parameters,
                coefficient=cause.cv.coefficient,
                from_jumps=cause.selected.from_jumps,
            )
            for cause in outcome.causes
        ],
        model=model,
        lab=lab,
        scales=scales,
        raw=recordings,
        faults=faults,
        whole=None
        if result.structure is None
        else repaired(recordings, model.axis, raw, curved, scales),
        places=[track.place for track in clean] if faults or rows_differ else None,
        places_of_whole=[track.place for track in curved] if faults or rows_differ else None,
        progress=progress,
    )


def refitted(
    recordings: Sequence[Recording],
    estimates: Sequence[EffectEstimate],
    *,
    model: AxisModel,
    lab: Lab,
    scales: Scales,
    raw: Sequence[Recording],
    faults: Sequence[str] = (),
    whole: Sequence[Recording] | None = None,
    places: Sequence[Samples] | None = None,
    places_of_whole: Sequence[Samples] | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> ModelErrors:
    """Refit a model with effects, and again without each of them.

    recordings  in which the axis moves, faults repaired, in the order in which they were made
    estimates   of the effects, by the search
    model       the axis as fitted: where all refits begin
    lab         its clock is part of the rig
    raw         the recordings as they came
    faults      names of faults that were repaired: without them everything is fitted to ``raw``
    whole       the same with something in them that no effect stands for; None: nothing is
    places      samples that may count, track by track; None: all, spread thinly
    places_of_whole  those of ``whole``
    """
    scaling = scaling_of(model, recordings, scales)
    clock_Hz = lab.acquisition.sampling_rate_Hz
    declared = () if clock_Hz is None else (ConverterHold(hold_s=0.5 / clock_Hz),)
    effects = {effect.name: effect for effect in every_effect()}
    given: dict[str, tuple[Extension, ...]] = {}
    structure = STATIC
    for estimate in estimates:
        effect = effects[estimate.effect]
        if effect.extend is not None:
            given[estimate.effect] = effect.extend(estimate, scaling)
        if effect.structural is not None:
            structure = effect.structural.structure(structure, model, True)
    every = in_order([*declared, *(part for parts in given.values() for part in parts)])
    progress("refitting the simulation")
    baseline = fit_extended(model, raw, declared, structure=STATIC)
    final = _with_free_rungs(
        fit_extended(
            model, recordings, every, others=(baseline.model,), structure=structure, places=places
        ),
        recordings,
        structure,
        places,
    )
    again = partial(fit_extended, final.model, others=(baseline.model,))
    without = {}
    for estimate in estimates:
        progress(f"refitting without {words(estimate.effect)}")
        effect = effects[estimate.effect]
        own = given.get(estimate.effect, ())
        rest = [
            fitted
            for start, fitted in zip(every, final.model.extensions, strict=True)
            if not any(start is part for part in own)
        ]
        bare = structure
        if effect.structural is not None:
            bare = effect.structural.structure(structure, model, False)
        without[estimate.effect] = again(recordings, rest, structure=bare, places=places)
    if faults:
        broken = again(raw, final.model.extensions, structure=structure)
        without |= dict.fromkeys(faults, broken)
    if whole is not None:
        progress("refitting without the unnamed structure")
        without[SOMETHING_ELSE] = again(
            whole, final.model.extensions, structure=structure, places=places_of_whole
        )
    # a zero that moves would be left out by a refit without a drift
    drifts = wandering_zeros(model.starts, model.quality.rms_m, model.quality.range_m)
    ships = given or (not drifts and (model.verdict.applies or estimates))
    return ModelErrors(
        baseline_m=baseline.held_out_rms_m,
        final_m=final.held_out_rms_m,
        without_m={name: error.held_out_rms_m for name, error in without.items()},
        scatter=relative_scatter(final.held_m),
        model=_shipped(model, recordings, final, structure, places) if ships else model,
    )


def _with_free_rungs(
    final: Extended,
    recordings: Sequence[Recording],
    structure: Structure,
    places: Sequence[Samples] | None,
) -> Extended:
    """Free the share of each rung of a creep ladder where the error is clearly smaller.

    Free rungs follow hysteresis that differs a little from the model's, so they must earn it.
    """
    free = tuple(
        replace(e, even=False) if isinstance(e, CreepLadder) else e for e in final.model.extensions
    )
    if not any(isinstance(e, CreepLadder) for e in free):
        return final
    loose = fit_extended(final.model, recordings, free, structure=structure, places=places)
    return loose if loose.held_out_rms_m < FREE_RUNGS * final.held_out_rms_m else final


def _shipped(
    model: AxisModel,
    recordings: Sequence[Recording],
    final: Extended,
    structure: Structure,
    places: Sequence[Samples] | None,
) -> AxisModel:
    """Return the final model with its one lag where the runtime looks for it.

    A lag that was fitted before any effect was found stands for a mode as well: beside the mode it
    begins also as what may be left of it.
    """
    late = next((e for e in final.model.extensions if isinstance(e, Delay | FirstOrderLag)), None)
    if late is None:
        lags = (model.lag, replace(model.lag, time_s=LEFT_OF_LAG * model.lag.time_s))
        start, other = (replace(final.model, lag=lag) for lag in lags)
        return fit_extended(
            start,
            recordings,
            final.model.extensions,
            others=(other,),
            structure=replace(structure, lag=True),
            places=places,
        ).model
    if isinstance(late, FirstOrderLag):
        lag = Lag(kind="first_order", time_s=late.lag_s)
    elif late.delay_samples > 0.0:
        return final.model
    else:
        lag = Lag(kind="delay", time_s=late.delay_s)
    std_s = late.std[0] if late.std else 0.0
    return replace(
        final.model,
        lag=lag,
        extensions=tuple(e for e in final.model.extensions if e is not late),
        uncertainty=final.model.uncertainty.known_anew("lag_s", lag.time_s, std_s),
    )


def repaired_faults(outcome: Outcome) -> tuple[str, ...]:
    """Return the faults that were repaired; the others ask for a new measurement."""
    before, names = outcome.first.tracks, []
    for name, fault in outcome.faults.items():
        if any(a is not b for a, b in zip(before, fault.tracks, strict=True)):
            names.append(name)
        before = fault.tracks
    return tuple(names)


def repaired(
    recordings: Sequence[Recording],
    axis: str,
    before: Sequence[Track],
    after: Sequence[Track],
    scales: Scales,
) -> tuple[Recording, ...]:
    """Return recordings with the changes that repairs made to their tracks."""
    pairs = iter(zip(before, after, strict=True))
    mended = []
    for recording in recordings:
        change = {
            Quantity.VOLTAGE: np.zeros(recording.samples),
            Quantity.DISPLACEMENT: np.zeros(recording.samples),
        }
        for part in recording.pieces:
            if part.stop - part.start < MINIMUM_SAMPLES:
                continue
            old, new = next(pairs)
            change[Quantity.VOLTAGE][part] = scales.voltage_V * (new.drive - old.drive)
            change[Quantity.DISPLACEMENT][part] = scales.displacement_m * (
                new.response - old.response
            )
        if any(values.any() for values in change.values()):
            channels = tuple(
                replace(channel, values=channel.values + change[channel.quantity])
                if channel.axis == axis and channel.quantity in change
                else channel
                for channel in recording.channels
            )
            recording = replace(recording, channels=channels)
        mended.append(recording)
    return tuple(mended)
