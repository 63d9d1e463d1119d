"""fit_extended: an axis model and its extensions, all numbers at once, judged on rows left out."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.identification.extensions.extension import Extension, Samples
from piezoid.identification.hysteresis.estimate import longest_lag_s
from piezoid.identification.hysteresis.physical import envelope_stretch, physical
from piezoid.identification.joint.chain import first_memory, follow
from piezoid.identification.joint.descent import Reached, search
from piezoid.identification.joint.parts import Part, parts_of
from piezoid.identification.joint.vector import State, Structure, state_of
from piezoid.identification.model import AxisModel, Lag, PieceStart
from piezoid.identification.quality import BLOCKS, IN_SAMPLE
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Recording

STEPS = 10  # Gauss-Newton steps at most
WHOLE = Structure()


@dataclass(frozen=True, kw_only=True, eq=False)
class Extended:
    """A joint fit.

    model             the axis with its extensions, as fitted
    rms_m             of the residual at all rows
    held_out_rms_m    at rows whose block the fit did not see
    held_m            (rows,)  that residual
    spread            for each extension the standard errors of its numbers, from leaving out folds
    converged         whether the last step hardly changed the error
    """

    model: AxisModel
    rms_m: float
    held_out_rms_m: float
    held_m: Array
    spread: tuple[Array, ...]
    converged: bool


def fit_extended(
    model: AxisModel,
    recordings: Sequence[Recording],
    extensions: Sequence[Extension] = (),
    *,
    structure: Structure = WHOLE,
    places: Sequence[Samples] | None = None,
    steps: int = STEPS,
) -> Extended:
    """Refit weights, thresholds, memory and zero of an axis together with extensions.

        min over everything of sum over rows of (simulated - measured)^2

    model       fitted axis: where the search begins, and how many plays and dead zones there are
    recordings  of this axis; those the model does not know begin at rest
    extensions  with start values near the truth
    structure   what of the hysteresis itself may be used
    places      samples that may count, piece by piece; None: all, spread thinly

    Every piece has one constant zero; slow motion is ``ThermalDrift``'s. The error on rows left
    out is of blocks of several seconds that neither hysteresis nor extension nor a recording's
    own zero, drift or hum was fitted to; the states are carried through them by simulation.
    What goes wrong: a number the rows do not determine stays where it began, and a mode that
    begins more than its width away is not found.
    """
    parts = parts_of(model, recordings, places)
    state = state_of(model, parts, extensions, structure)
    longest_s = longest_lag_s([part.piece for part in parts])
    reached = search(state, parts, longest_lag_s=longest_s, steps=steps)
    return _extended(model, parts, reached)


def _extended(model: AxisModel, parts: Sequence[Part], reached: Reached) -> Extended:
    stroke_m = abs(reached.state.scales.displacement_m)
    held_m = reached.held * stroke_m
    return Extended(
        model=_model(model, parts, reached, held_m),
        rms_m=reached.rms * stroke_m,
        held_out_rms_m=reached.held_out_rms * stroke_m,
        held_m=held_m,
        spread=_spread(reached),
        converged=reached.converged,
    )


def _spread(reached: Reached) -> tuple[Array, ...]:
    """Return standard errors from leaving out folds, (F - 1) / sqrt(F) times their scatter."""
    count = len(reached.folds)
    errors = np.std(reached.folds, axis=0, ddof=1) * (count - 1) / np.sqrt(count)
    return tuple(errors[place] for place in reached.state.slices)


def _model(model: AxisModel, parts: Sequence[Part], reached: Reached, held_m: Array) -> AxisModel:
    state = reached.state
    stroke_m = abs(state.scales.displacement_m)
    starts = tuple(_start(state, index, part) for index, part in enumerate(parts))
    zero_m = float(np.mean([start.zero_m.mean() for start in starts]))
    kind, tested = state.coordinates.shape.lag, model.quality.is_tested
    return replace(
        model,
        hysteresis=physical(state.operator, state.scales, zero_m),
        lag=Lag(kind=kind, time_s=state.operator.lag_s),
        extensions=tuple(
            replace(extension, std=tuple(std.tolist()))
            for extension, std in zip(state.extensions, _spread(reached), strict=True)
        ),
        starts=starts,
        quality=replace(
            model.quality,
            rms_m=reached.rms * stroke_m,
            held_out_rms_m=(reached.held_out_rms if tested else reached.rms) * stroke_m,
            held_out_kind=BLOCKS if tested else IN_SAMPLE,
            rows=reached.rows,
            converged=reached.converged,
        ),
        certificate=replace(
            model.certificate, remainder_m=float(np.quantile(np.abs(held_m), 0.999))
        ),
    )


def _start(state: State, index: int, part: Part) -> PieceStart:
    drive = follow(state, index, part).drive
    inner = state.operator.envelope.run(drive[:1])
    memory = np.concatenate([inner, first_memory(state, index, drive)])
    zero = state.theta[state.coordinates.offset_slice(index)]
    return PieceStart(
        recording=part.piece.name,
        memory_V=memory * (envelope_stretch(state.operator) * state.scales.voltage_V),
        zero_m=part.piece.centre_m + state.scales.displacement_m * zero,
        first=part.piece.first,
        last=part.piece.last,
    )
