"""fit_extended: an axis model and its extensions, all numbers at once, judged on rows left out.

The rows are many and the numbers few, so normal equations are formed once for every step. On a
fold the columns of the whole search serve again: only the error is new (a chord step), and what is
left out has no say.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.identification.extensions.extension import Extension, Samples
from piezoid.identification.forward import Run
from piezoid.identification.hysteresis.estimate import longest_lag_s
from piezoid.identification.hysteresis.physical import physical, piece_start
from piezoid.identification.joint.vector import FOLDS, Part, State, Structure, parts_of, state_of
from piezoid.identification.model import AxisModel, Lag
from piezoid.identification.quality import BLOCKS, IN_SAMPLE, Uncertainty
from piezoid.numerics.arrays import Array
from piezoid.numerics.executor import Once
from piezoid.numerics.levenberg_marquardt import Minimum, NormalEquations, Rule, minimise
from piezoid.records.recording import Recording

STEPS = 10  # at most
CONVERGED = 1e-4
# On the rows kept: three chords, at first nearly undamped; where none helps, the fold has no say.
CHORDS = Rule(tolerance=0.0, iterations=3, tries=4, damping=1e-6, easier=1.0, harder=100.0)
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


@dataclass(frozen=True, kw_only=True, eq=False)
class _Reached:
    """Where a search ended.

    state  there
    rms    of the residual at all rows, scaled
    held   (rows,)  residual at the rows left out, fold after fold
    rows   rows of all parts
    folds  (folds, numbers)  the vectors of the folds
    converged  whether the search ended of itself
    """

    state: State
    rms: float
    held: Array
    rows: int
    folds: Array
    converged: bool

    @property
    def held_out_rms(self) -> float:
        """Return the rms on rows left out."""
        return float(np.sqrt(np.mean(self.held**2)))


def fit_extended(
    model: AxisModel,
    recordings: Sequence[Recording],
    extensions: Sequence[Extension] = (),
    *,
    others: Sequence[AxisModel] = (),
    structure: Structure = WHOLE,
    places: Sequence[Samples] | None = None,
    steps: int = STEPS,
) -> Extended:
    """Refit weights, thresholds, memory and zero of an axis together with extensions.

        min over everything of sum over rows of (simulated - measured)^2

    model       fitted axis: where the search begins, and how many plays and dead zones there are
    recordings  of this axis; those the model does not know begin at rest
    extensions  with start values near the truth
    others      models to begin at as well, for thresholds have many good places: the closest fit
                is returned, and that alone is judged on rows left out
    structure   what of the hysteresis itself may be used
    places      samples that may count, piece by piece; None: all, spread thinly

    Every piece has one constant zero; slow motion is ``ThermalDrift``'s. The error on rows left
    out is of blocks of several seconds that neither hysteresis nor extension nor a recording's
    own zero, drift or hum was fitted to; the states are carried through them by simulation.
    What goes wrong: a number the rows do not determine stays where it began, and a mode that
    begins more than its width away is not found.
    """
    ends = []
    for start in (model, *others):
        parts = parts_of(start, recordings, places)
        state = state_of(start, parts, extensions, structure)
        bounds = state.bounds(longest_lag_s([part.piece for part in parts]))
        found = _search(state, parts, bounds, steps)
        ends.append((start, bounds, found.point, found.converged))
    begun, bounds, end, converged = min(ends, key=lambda one: one[2].rms_m)
    reached = _judged(end, bounds, converged)
    stroke_m = abs(reached.state.scales.displacement_m)
    held_m = reached.held * stroke_m
    return Extended(
        model=_model(begun, end, reached, held_m),
        rms_m=reached.rms * stroke_m,
        held_out_rms_m=reached.held_out_rms * stroke_m,
        held_m=held_m,
        spread=_spread(reached),
        converged=reached.converged,
    )


def _errors(reached: _Reached) -> Array:
    """Return standard errors from leaving out folds, (F - 1) / sqrt(F) times their scatter."""
    count = len(reached.folds)
    return np.asarray(np.std(reached.folds, axis=0, ddof=1) * (count - 1) / np.sqrt(count))


def _spread(reached: _Reached) -> tuple[Array, ...]:
    """Return the standard errors of the numbers of each extension."""
    errors = _errors(reached)
    return tuple(errors[place] for place in reached.state.slices)


def _uncertainty(model: AxisModel, reached: _Reached) -> Uncertainty:
    """Return the model's, with the lag as this fit knows it.

    The fit before may have known the lag beside a mode that was still missing, or not at all.
    """
    place = reached.state.coordinates.slices["lag"]
    if place.start == place.stop:
        return model.uncertainty
    (standard,) = _errors(reached)[place]
    return model.uncertainty.known_anew("lag_s", reached.state.operator.lag_s, float(standard))


def _model(model: AxisModel, end: "_Point", reached: _Reached, held_m: Array) -> AxisModel:
    state = end.state
    stroke_m = abs(state.scales.displacement_m)
    starts = tuple(
        piece_start(
            part.piece,
            run.forward.memory(run.drive[0], run.memory_slope),
            state.theta[state.coordinates.offset_slice(index)],
            state.operator,
            state.scales,
        )
        for index, (part, run) in enumerate(zip(end.parts, end.runs, strict=True))
    )
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
        uncertainty=_uncertainty(model, reached),
        quality=replace(
            model.quality,
            rms_m=reached.rms * stroke_m,
            held_out_rms_m=(reached.held_out_rms if tested else reached.rms) * stroke_m,
            held_out_kind=BLOCKS if tested else IN_SAMPLE,
            rows=reached.rows,
            effective_parameters=float(len(state.vector)),
            converged=reached.converged,
        ),
        certificate=replace(
            model.certificate, remainder_m=float(np.quantile(np.abs(held_m), 0.999))
        ),
    )


@dataclass(frozen=True, eq=False)
class _Point:
    """A state, and the residual of every part there."""

    state: State
    parts: Sequence[Part]

    @Once
    def runs(self) -> list[Run]:
        return [self.state.run(k, part) for k, part in enumerate(self.parts)]

    @Once
    def errors(self) -> list[Array]:
        pairs = zip(self.runs, self.parts, strict=True)
        return [np.asarray(run.reading - part.piece.response)[part.place] for run, part in pairs]

    @Once
    def tangents(self) -> list[Array]:
        pairs = enumerate(zip(self.parts, self.runs, strict=True))
        return [tangents_of(self.state, k, part, run) for k, (part, run) in pairs]

    @Once
    def squares(self) -> float:
        """Return the sum of squares at all rows."""
        return sum(float(error @ error) for error in self.errors)

    @property
    def rows(self) -> int:
        return sum(len(error) for error in self.errors)

    @property
    def rms(self) -> float:
        return float(np.sqrt(self.squares / self.rows))

    @property
    def rms_m(self) -> float:
        return self.rms * abs(self.state.scales.displacement_m)

    @Once
    def gram(self) -> Array:
        """The products of the tangents with each other, all rows together."""
        return sum((part.T @ part for part in self.tangents), np.zeros((1, 1)))

    @Once
    def cost(self) -> float:
        return self.squares + _prior_cost(self.state)

    def linearised(self) -> NormalEquations:
        pairs = zip(self.tangents, self.errors, strict=True)
        slope = sum((part.T @ error for part, error in pairs), np.zeros(1))
        return _with_prior(self.state, self.gram, slope, self.cost)


@dataclass(frozen=True, eq=False)
class _OnFold:
    """The same on the rows kept of a fold, with the columns of the whole search's end."""

    point: _Point
    kept: Sequence[Array]
    columns: Sequence[Array]
    gram: Array

    @Once
    def left(self) -> list[Array]:
        """The errors, 0 at the rows left out: the columns are megabytes, and are not copied."""
        return [np.where(k, e, 0.0) for e, k in zip(self.point.errors, self.kept, strict=True)]

    @Once
    def cost(self) -> float:
        return sum(float(e @ e) for e in self.left) + _prior_cost(self.point.state)

    def linearised(self) -> NormalEquations:
        pairs = zip(self.columns, self.left, strict=True)
        slope = sum((part.T @ error for part, error in pairs), np.zeros(1))
        return _with_prior(self.point.state, self.gram, slope, self.cost)


def _search(
    state: State, parts: Sequence[Part], bounds: tuple[Array, Array], steps: int
) -> Minimum[_Point]:
    """Search from a point for the least error."""
    return minimise(
        lambda vector: _Point(state.at(vector), parts),
        state.vector,
        bounds,
        rule=Rule(tolerance=CONVERGED, iterations=steps, tries=8, damping=1e-4),
    )


def _judged(end: _Point, bounds: tuple[Array, Array], converged: bool) -> _Reached:
    """Repeat a search that has ended on the rows kept of each fold."""
    # Added up, not subtracted from the whole: a column may lie in one fold but for rounding.
    grams = [_gram_of_fold(end, fold) for fold in range(FOLDS)]
    kept = [sum(grams[:k] + grams[k + 1 :], np.zeros((1, 1))) for k in range(FOLDS)]
    folds = [_on_fold(fold, end, bounds, gram) for fold, gram in enumerate(kept)]
    return _Reached(
        state=end.state,
        rms=end.rms,
        held=np.concatenate([error for _, left_out in folds for error in left_out]),
        rows=end.rows,
        folds=np.array([vector for vector, _ in folds]),
        converged=converged,
    )


def _gram_of_fold(end: _Point, fold: int) -> Array:
    pairs = zip(end.tangents, end.parts, strict=True)
    rows = [tangents[part.fold == fold] for tangents, part in pairs]
    return sum((part.T @ part for part in rows), np.zeros((1, 1)))


def _on_fold(
    fold: int, end: _Point, bounds: tuple[Array, Array], gram: Array
) -> tuple[Array, list[Array]]:
    """Return where a few chords on the rows kept lead, and the residual at the rows left out.

    gram  of the tangents at the rows kept
    """
    kept = [part.fold != fold for part in end.parts]
    start = end.state.vector

    def at(vector: Array) -> _OnFold:
        known = np.array_equal(vector, start)  # the end's residual is worth a simulation
        point = end if known else _Point(end.state.at(vector), end.parts)
        return _OnFold(point, kept, end.tangents, gram)

    found = minimise(at, start, bounds, rule=CHORDS)
    errors = found.point.point.errors
    return found.x, [error[~k] for error, k in zip(errors, kept, strict=True)]


def _with_prior(state: State, gram: Array, slope: Array, cost: float) -> NormalEquations:
    """Add what is known beforehand, with the weight of one row each."""
    gram, slope = gram.copy(), slope.copy()
    for rows, value, place in _priors(state):
        gram[place, place] += rows.T @ rows
        slope[place] += rows.T @ (rows @ value)
    return NormalEquations(gram=gram, slope=slope, cost=cost)


def _priors(state: State) -> list[tuple[Array, Array, slice]]:
    found = []
    for extension, place in zip(state.extensions, state.slices, strict=True):
        scale = abs(state.scales.displacement_m) if extension.in_metres else 1.0
        rows = extension.prior()
        if len(rows):
            found.append((rows / scale, extension.free().value, place))
    return found


def _prior_cost(state: State) -> float:
    return sum(float(np.sum((rows @ value) ** 2)) for rows, value, _ in _priors(state))


def tangents_of(state: State, index: int, part: Part, run: Run) -> Array:
    """Return d reading / d vector, (rows, numbers)."""
    coordinates, place = state.coordinates, part.place
    rows = np.zeros((len(place), len(state.vector)), order="F")
    plays, lag = coordinates.shape.plays, coordinates.slices["lag"]
    columns = run.by_hysteresis(place)
    rows[:, : lag.start] = columns[:, plays:]
    rows[:, coordinates.memory_slice(index)] = columns[:, :plays]
    rows[:, coordinates.offset_slice(index)] = 1.0
    if lag.stop > lag.start:
        rows[:, lag] = run.by_lag(place)[:, None]
    for number, own in enumerate(state.slices):
        rows[:, own] = run.by_extension(number, place)
    return rows
