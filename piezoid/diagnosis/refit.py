"""The simulation's own error, refitted before and after: a diagnosis put into the shipped model.

Each effect that was found becomes extensions of the axis model, with start values from what the
search found; everything is then refitted together, with each one left out in turn, and judged on
rows left out in the same way. The baseline is the static model with the declared rig alone.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

from piezoid.diagnosis.effect import EffectEstimate, scaling_of
from piezoid.diagnosis.effects import every_effect
from piezoid.diagnosis.residual_structure import NAME
from piezoid.formatting import words
from piezoid.identification.extensions.converter_hold import ConverterHold
from piezoid.identification.extensions.creep_ladder import CreepLadder
from piezoid.identification.extensions.delay import Delay
from piezoid.identification.extensions.extension import Extension, Samples
from piezoid.identification.extensions.first_order_lag import FirstOrderLag
from piezoid.identification.joint.fit_extended import Extended, fit_extended
from piezoid.identification.joint.vector import Structure
from piezoid.identification.model import AxisModel, Lag
from piezoid.identification.piece_start import wandering_zeros
from piezoid.numerics.arrays import Array
from piezoid.records.lab import Lab
from piezoid.records.recording import Recording

LOOSE = 0.85  # of the error: what shares of its own for every rung of creep must leave
LEFT_OF_LAG = 0.1  # of it, beside the mode that it had stood for
STATIC = Structure(lag=False)


@dataclass(frozen=True, kw_only=True, eq=False)
class Refitted:
    """Errors on rows left out, in m, and the model they belong to.

    baseline    of the static model on the recordings as they came
    final       with everything that was found
    without     with everything but one, by its name
    extensions  the extensions each effect became, as fitted
    spread      for each effect the standard errors of their numbers
    model       what ships: with the fitted lag where no lag or delay was found; as it was given
                where its class does not apply
    """

    baseline: Extended
    final: Extended
    without: Mapping[str, Extended]
    extensions: Mapping[str, tuple[Extension, ...]]
    spread: Mapping[str, tuple[Array, ...]]
    model: AxisModel


def refitted(
    recordings: Sequence[Recording],
    found: Sequence[EffectEstimate],
    *,
    model: AxisModel,
    lab: Lab,
    scales: Mapping[str, float],
    raw: Sequence[Recording] | None = None,
    faults: Sequence[str] = (),
    whole: Sequence[Recording] | None = None,
    places: Sequence[Samples] | None = None,
    places_of_whole: Sequence[Samples] | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> Refitted:
    """Put what was found into the model and measure what each finding is worth.

    recordings  in which the axis moves, faults repaired, in the order in which they were made
    found       effects as the search left them; those of the data themselves are ``faults``
    model       the axis as fitted: where all searches begin
    lab         its clock is part of the rig
    scales      ``voltage_V``, ``voltage_offset_V``, ``stroke_m``: what 1 and 0 meant
    raw         the recordings as they came; None: the same
    faults      names of faults that were repaired: without them everything is fitted to ``raw``
    whole       the same with something in them that no effect stands for; None: nothing is
    places      samples that may count, track by track; None: all, spread thinly
    places_of_whole  those of ``whole``
    progress    told what is being done
    """
    setting = scaling_of(model, recordings, scales)
    declared = _declared(lab)
    effects = {effect.name: effect for effect in every_effect()}
    given, structure = {}, STATIC
    for one in found:
        effect = effects[one.effect]
        if effect.extend is not None:
            given[one.effect] = effect.extend(one, setting)
        if effect.structural is not None:
            structure = effect.structural.structure(structure, model, True)
    every = [*declared, *(part for parts in given.values() for part in parts)]
    progress("refitting the simulation")
    baseline = fit_extended(model, raw or recordings, declared, structure=STATIC)
    final = fit_extended(
        model, recordings, every, others=(baseline.model,), structure=structure, places=places
    )
    final = _loosened(final, recordings, structure, places)
    fitted = _fitted(given, every, final)
    again = partial(fit_extended, final.model, others=(baseline.model,))
    without = {}
    for one in found:
        progress(f"refitting without {words(one.effect)}")
        mine = fitted.get(one.effect, ())
        rest = [part for part in final.model.extensions if not any(part is own for own in mine)]
        own = effects[one.effect].structural
        bare = structure if own is None else own.structure(structure, model, False)
        without[one.effect] = again(recordings, rest, structure=bare, places=places)
    if faults:
        broken = again(raw or recordings, final.model.extensions, structure=structure)
        without |= dict.fromkeys(faults, broken)
    if whole is not None:
        progress("refitting without the unnamed structure")
        without[NAME] = again(
            whole,
            final.model.extensions,
            structure=structure,
            places=places_of_whole,
        )
    return Refitted(
        baseline=baseline,
        final=final,
        without=without,
        extensions=fitted,
        spread={name: _spread_of(parts, final) for name, parts in fitted.items()},
        model=_shipped(model, recordings, final, structure, places)
        if given or (not _drifts(model) and (model.verdict.applies or found))
        else model,
    )


def _drifts(model: AxisModel) -> bool:
    """Return whether the zero of a piece moves, which a refit without a drift would leave out."""
    quality = model.quality
    return bool(wandering_zeros(model.starts, quality.rms_m, quality.range_m))


def _loosened(
    final: Extended,
    recordings: Sequence[Recording],
    structure: Structure,
    places: Sequence[Samples] | None,
) -> Extended:
    """Let every rung of a creep have a share of its own where that is clearly better.

    Free rungs follow whatever hysteresis is not quite as the model's, so they must earn it.
    """
    free = tuple(
        replace(e, even=False) if isinstance(e, CreepLadder) else e for e in final.model.extensions
    )
    if not any(isinstance(e, CreepLadder) for e in free):
        return final
    loose = fit_extended(final.model, recordings, free, structure=structure, places=places)
    return loose if loose.held_out_rms_m < LOOSE * final.held_out_rms_m else final


def _declared(lab: Lab) -> tuple[Extension, ...]:
    clock_Hz = lab.acquisition.sampling_rate_Hz
    return () if clock_Hz is None else (ConverterHold(hold_s=0.5 / clock_Hz),)


def _fitted(
    given: Mapping[str, tuple[Extension, ...]], every: Sequence[Extension], final: Extended
) -> dict[str, tuple[Extension, ...]]:
    """Return for each effect its extensions with fitted numbers."""
    from piezoid.identification.extensions import in_order

    became = list(zip(in_order(every), final.model.extensions, strict=True))
    return {
        name: tuple(after for part in parts for before, after in became if before is part)
        for name, parts in given.items()
    }


def _spread_of(parts: Sequence[Extension], final: Extended) -> tuple[Array, ...]:
    pairs = list(zip(final.model.extensions, final.spread, strict=True))
    return tuple(spread for part in parts for other, spread in pairs if other is part)


def _shipped(
    model: AxisModel,
    recordings: Sequence[Recording],
    final: Extended,
    structure: Structure,
    places: Sequence[Samples] | None,
) -> AxisModel:
    """Return the final model with its one lag where the runtime looks for it.

    A lag that was fitted before anything was found stands for all of it, a mode as well: beside
    the mode itself it begins as what may be left of it too.
    """
    late = [e for e in final.model.extensions if isinstance(e, Delay | FirstOrderLag)]
    if not late:
        lags = (model.lag, replace(model.lag, time_s=LEFT_OF_LAG * model.lag.time_s))
        start, other = (replace(final.model, lag=lag) for lag in lags)
        kept, every = replace(structure, lag=True), final.model.extensions
        return fit_extended(
            start, recordings, every, others=(other,), structure=kept, places=places
        ).model
    one = late[0]
    if isinstance(one, Delay) and one.delay_samples > 0.0:
        return final.model
    lag = (
        Lag(kind="delay", time_s=one.delay_s)
        if isinstance(one, Delay)
        else Lag(kind="first_order", time_s=one.lag_s)
    )
    rest = tuple(e for e in final.model.extensions if e is not one)
    known = final.model.uncertainty.known_anew("lag_s", lag.time_s, one.std[0] if one.std else 0.0)
    return replace(final.model, lag=lag, extensions=rest, uncertainty=known)
