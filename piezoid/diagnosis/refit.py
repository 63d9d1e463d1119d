"""Refit the shipped model with the selected effects, and measure the contribution of each.

Each effect becomes extensions of the axis model, whose start values are those of the search. All
are refitted together, and again without each effect; all errors are of the same held-out rows. The
baseline is the static model with the declared rig and without every effect. A fault of the data is
repaired in the recordings themselves, as it was in the search.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.diagnosis.budget import relative_scatter
from piezoid.diagnosis.diagnosis import SOMETHING_ELSE
from piezoid.diagnosis.effect import EffectEstimate, scaling_of
from piezoid.diagnosis.effects import effect_named
from piezoid.diagnosis.identified_modes import NAME as RESONANCE
from piezoid.diagnosis.residual_structure import SearchResult, add_structure
from piezoid.diagnosis.segments import Track
from piezoid.diagnosis.selection import Outcome
from piezoid.formatting import words
from piezoid.identification.dynamics.fit_dynamics import resolved_modes
from piezoid.identification.extensions import in_order
from piezoid.identification.extensions.converter_hold import ConverterHold
from piezoid.identification.extensions.creep_ladder import CreepLadder
from piezoid.identification.extensions.delay import Delay
from piezoid.identification.extensions.extension import Extension
from piezoid.identification.extensions.first_order_lag import FirstOrderLag
from piezoid.identification.extensions.gain_change import GainChange
from piezoid.identification.extensions.linear_mode import LinearMode
from piezoid.identification.hysteresis.pieces import MINIMUM_SAMPLES, Scales
from piezoid.identification.joint.fit_extended import Extended, fit_extended
from piezoid.identification.joint.vector import Structure
from piezoid.identification.model import AxisModel, Lag
from piezoid.identification.piece_start import drifting_zeros
from piezoid.numerics.arrays import Samples
from piezoid.records.lab import Lab
from piezoid.records.recording import Quantity, Recording

CLEARLY_WORSE = 1.1  # times the held-out error of the model without a part
FREE_RUNGS = 0.85  # of the error: largest error with free shares of a creep ladder
SMALL_LAG = 0.1  # of the lag of the model: start value beside a mode that the lag had represented
STATIC = Structure(lag=False)


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelErrors:
    """Held-out errors of the model, rms in m.

    baseline_m  of the static model on the recordings as they came, without every effect: with an
                initial state of its own unless that is one of them
    final_m     with every effect, faults repaired
    without_m   with every effect but one, by its name; also without the modes of the dynamics, if
                these ring in the recordings
    scatter     relative standard error of the mean square of the final error
    model       that ships: with the fitted lag where no lag or delay was found; unchanged where
                its class does not apply
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
    """Compute the errors of the baseline, of the full model, and without each detected effect.

    recordings  those of the search, not repaired
    model       the axis as fitted to them, or to earlier ones
    scales      of the search
    """
    outcome, structure = result.outcome, result.structure
    raw, tracks, faults = result.raw.tracks, outcome.clean.tracks, repaired_faults(outcome)
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
        lab=lab,
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
    lab: Lab,
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
    lab             its clock is part of the rig
    raw             the recordings, not repaired
    faults          names of repaired faults: without them the model is fitted to ``raw``
    rows            samples to fit, for each track; None: all, thinned evenly
    with_structure  the recordings with unexplained structure; None: there is none
    structure_rows  samples of these to fit
    """
    extensions, starts, structure = _with_effects(model, recordings, estimates, lab, scales)
    progress("refitting the simulation")
    declared = _declared_hold(lab, model)
    modes = _known_modes(model, extensions)
    ringing = [e for e in (*extensions, *modes) if isinstance(e, LinearMode)]
    unrepaired = _Rows(recordings=raw, samples=None, ringing=ringing)
    repaired = _Rows(recordings=recordings, samples=rows, ringing=ringing)
    baseline = unrepaired.fit(model, declared, STATIC)
    alternatives, without = (baseline.model,), {}
    final = _best(
        repaired.fit(model, parts, structure, alternatives)
        for parts in _with_whole_modes(extensions)
    )
    if modes:
        with_modes = in_order([*extensions, *modes])
        ringing_fit = repaired.fit(model, with_modes, structure, alternatives)
        if ringing_fit.held_out_rms_m < CLEARLY_WORSE * final.held_out_rms_m:
            without[RESONANCE], final, extensions = final, ringing_fit, with_modes
    # A change between recordings leaves none of them with a gain on both sides of it.
    if any(e.effect == "gain_change" and e.parameters["place"] > 0.0 for e in estimates):
        final = _with_later_recordings(final, repaired, structure)
    final = _with_free_rungs(final, repaired, structure)
    fitted = final.model.extensions
    plain = STATIC
    for estimate in estimates:  # a part of the static model that was found is none of the baseline
        plain = _structure_of(plain, estimate, model, has_effect=False)
    if plain != STATIC:
        baseline = unrepaired.fit(final.model, declared, plain, alternatives)
    for estimate in estimates:
        progress(f"refitting without {words(estimate.effect)}")
        removed = starts.get(estimate.effect, ())
        remaining = [
            extension
            for start, extension in zip(extensions, fitted, strict=True)
            if not any(start is part for part in removed)
        ]
        reduced = _structure_of(structure, estimate, model, has_effect=False)
        without[estimate.effect] = repaired.fit(final.model, remaining, reduced, alternatives)
    if faults:
        with_faults = unrepaired.fit(final.model, fitted, structure, alternatives)
        without |= dict.fromkeys(faults, with_faults)
    if with_structure is not None:
        progress("refitting without the unnamed structure")
        structured = _Rows(recordings=with_structure, samples=structure_rows, ringing=ringing)
        without[SOMETHING_ELSE] = structured.fit(final.model, fitted, structure, alternatives)
    # a refit without a drift would drop a zero that moves
    drifts = drifting_zeros(model.starts, model.quality.rms_m, model.quality.range_m)
    ships = starts or (not drifts and (model.verdict.applies or estimates))
    return ModelErrors(
        baseline_m=baseline.held_out_rms_m,
        final_m=final.held_out_rms_m,
        without_m={name: fit.held_out_rms_m for name, fit in without.items()},
        scatter=relative_scatter(final.held_m),
        model=_shipped(model, final, repaired, structure) if ships else model,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Rows:
    """Rows over which joint fits compare.

    samples  that may be fitted, for each piece; None: all, thinned evenly
    ringing  modes whose unresolved ringing is left out of every fit
    """

    recordings: Sequence[Recording]
    samples: Sequence[Samples] | None
    ringing: Sequence[LinearMode]

    def fit(
        self,
        model: AxisModel,
        extensions: Sequence[Extension],
        structure: Structure,
        further_starts: Sequence[AxisModel] = (),
    ) -> Extended:
        return fit_extended(
            model,
            self.recordings,
            extensions,
            further_starts=further_starts,
            structure=structure,
            samples=self.samples,
            ringing=self.ringing,
        )


def _declared_hold(lab: Lab, model: AxisModel) -> tuple[ConverterHold, ...]:
    """Return the hold of the declared clock, as far as the recordings are late at all.

    A generator, or a voltage that was measured, moves between samples.
    """
    clock_Hz = lab.acquisition.sampling_rate_Hz
    if clock_Hz is None:
        return ()
    late_s = np.inf if model.lag.kind == "none" else model.lag.time_s
    hold_s = min(0.5 / clock_Hz, late_s)
    return (ConverterHold(hold_s=hold_s),) if hold_s > 0.0 else ()


def _with_effects(
    model: AxisModel,
    recordings: Sequence[Recording],
    estimates: Sequence[EffectEstimate],
    lab: Lab,
    scales: Scales,
) -> tuple[tuple[Extension, ...], dict[str, tuple[Extension, ...]], Structure]:
    """Return all extensions in their order, those of each effect, and the static structure."""
    scaling, structure = scaling_of(model, recordings, scales), STATIC
    starts: dict[str, tuple[Extension, ...]] = {}
    for estimate in estimates:
        extend = effect_named(estimate.effect).extend
        if extend is not None:
            starts[estimate.effect] = extend(estimate, scaling)
        structure = _structure_of(structure, estimate, model, has_effect=True)
    parts = (part for of_effect in starts.values() for part in of_effect)
    return tuple(in_order([*_declared_hold(lab, model), *parts])), starts, structure


def _known_modes(model: AxisModel, extensions: Sequence[Extension]) -> list[LinearMode]:
    """Return the resolved modes of the dynamics, unless the search has found one."""
    dynamics = model.dynamics
    if dynamics is None or any(isinstance(e, LinearMode) for e in extensions):
        return []
    modes = resolved_modes(dynamics)
    return [
        LinearMode(frequency_Hz=float(frequency_Hz), quality=float(0.5 / damping))
        for frequency_Hz, damping in zip(
            dynamics.mode_frequency_Hz[modes], dynamics.mode_damping[modes], strict=True
        )
    ]


def _best(fits: Iterable[Extended]) -> Extended:
    return min(fits, key=lambda fit: fit.held_out_rms_m)


def _with_whole_modes(extensions: tuple[Extension, ...]) -> list[tuple[Extension, ...]]:
    """Return the extensions, and again with all motion through every mode that carries a part.

    A small fast motion on a large slow one is smaller than the static response of the search says,
    which lowers the share: from there a fit ended with 0.18 in place of 1.
    """
    whole = tuple(
        replace(e, participation=1.0) if isinstance(e, LinearMode) else e for e in extensions
    )
    return [extensions] if whole == extensions else [extensions, whole]


def _structure_of(
    structure: Structure, estimate: EffectEstimate, model: AxisModel, *, has_effect: bool
) -> Structure:
    """Return the static structure with or without an effect that is a part of it."""
    structural = effect_named(estimate.effect).structural
    if structural is None:
        return structure
    return structural.structure(structure, model, has_effect)


def _with_later_recordings(final: Extended, rows: _Rows, structure: Structure) -> Extended:
    """Decide by their gains which recordings were made after a change within one of them.

    Files are given in the order of their names as often as in that of their time.
    """
    extensions = final.model.extensions
    change = next((e for e in extensions if isinstance(e, GainChange)), None)
    if change is None or len(rows.recordings) == 1:
        return final

    def refit(further: Sequence[GainChange], later: tuple[str, ...]) -> Extended:
        parts = [replace(e, later=later) if isinstance(e, GainChange) else e for e in extensions]
        return rows.fit(final.model, in_order([*parts, *further]), structure)

    free = [
        GainChange(recording=recording.name, instant_s=0.0, ratio=1.0)
        for recording in rows.recordings
        if recording.name != change.recording
    ]
    fitted = refit(free, ()).model.extensions
    gains = {e.recording: e.ratio for e in fitted if isinstance(e, GainChange)}
    middle = 0.5 * (1.0 + gains[change.recording])
    is_larger = gains[change.recording] > 1.0
    later = tuple(e.recording for e in free if (gains[e.recording] > middle) == is_larger)
    if set(later) == set(change.later):
        return final
    changed = refit((), later)
    return changed if changed.held_out_rms_m < final.held_out_rms_m else final


def _with_free_rungs(final: Extended, rows: _Rows, structure: Structure) -> Extended:
    """Free the share of each rung of a creep ladder if the error is then clearly smaller.

    Free rungs also follow hysteresis that differs a little from the model's.
    """
    extensions = final.model.extensions
    if not any(isinstance(extension, CreepLadder) for extension in extensions):
        return final
    free = [replace(e, even=False) if isinstance(e, CreepLadder) else e for e in extensions]
    refit = rows.fit(final.model, free, structure)
    return refit if refit.held_out_rms_m < FREE_RUNGS * final.held_out_rms_m else final


def _shipped(model: AxisModel, final: Extended, rows: _Rows, structure: Structure) -> AxisModel:
    """Return the final model with its one lag where the runtime looks for it.

    A lag that was fitted before any effect was found stands for a mode as well, so beside a mode
    it also starts from a fraction of its value.
    """
    extensions = final.model.extensions
    lag = next((e for e in extensions if isinstance(e, Delay | FirstOrderLag)), None)
    if lag is None:
        small = replace(model.lag, time_s=SMALL_LAG * model.lag.time_s)
        first, second = (replace(final.model, lag=lag) for lag in (model.lag, small))
        return rows.fit(first, extensions, replace(structure, lag=True), (second,)).model
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


def repaired_faults(outcome: Outcome) -> tuple[str, ...]:
    """Return the faults that were repaired; the others need a new measurement."""
    tracks, names = outcome.first.tracks, []
    for name, fault in outcome.faults.items():
        if any(a is not b for a, b in zip(tracks, fault.tracks, strict=True)):
            names.append(name)
        tracks = fault.tracks
    return tuple(names)


def repair_recordings(
    recordings: Sequence[Recording],
    axis: str,
    original: Sequence[Track],
    repaired: Sequence[Track],
    scales: Scales,
) -> tuple[Recording, ...]:
    """Apply the changes that a search made to its tracks to the recordings."""
    pairs = iter(zip(original, repaired, strict=True))
    return tuple(_repair(recording, axis, pairs, scales) for recording in recordings)


def _repair(
    recording: Recording, axis: str, pairs: Iterator[tuple[Track, Track]], scales: Scales
) -> Recording:
    change = {
        Quantity.VOLTAGE: np.zeros(recording.samples),
        Quantity.DISPLACEMENT: np.zeros(recording.samples),
    }
    for piece in recording.pieces:
        if piece.stop - piece.start < MINIMUM_SAMPLES:
            continue  # too short for a track
        old, new = next(pairs)
        change[Quantity.VOLTAGE][piece] = scales.voltage_V * (new.drive - old.drive)
        change[Quantity.DISPLACEMENT][piece] = scales.displacement_m * (
            new.response - old.response
        )
    if not any(values.any() for values in change.values()):
        return recording
    channels = tuple(
        replace(channel, values=channel.values + change[channel.quantity])
        if channel.axis == axis and channel.quantity in change
        else channel
        for channel in recording.channels
    )
    return replace(recording, channels=channels)
