"""fit_extended: joint refit of an axis model and its extensions, with cross-validation.

With many rows and few numbers, each step forms the normal equations once. A fold is refitted by
chord steps: it uses the derivatives at the end of the search with the errors of its training rows.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from piezoid.identification.extensions.extension import Extension
from piezoid.identification.forward import Run
from piezoid.identification.hysteresis.coordinates import piece_start, to_si_units
from piezoid.identification.hysteresis.estimate import longest_lag_s
from piezoid.identification.joint.vector import (
    FOLDS,
    NEVER_OUT,
    Part,
    State,
    Structure,
    parts_of,
    state_of,
)
from piezoid.identification.model import AxisModel, Lag
from piezoid.identification.quality import BLOCKS, IN_SAMPLE, with_noise_bound
from piezoid.numerics.arrays import Array, Samples
from piezoid.numerics.executor import Once
from piezoid.numerics.levenberg_marquardt import NormalEquations, Rule, minimise
from piezoid.records.recording import Recording

MAX_STEPS = 10
TOLERANCE = 1e-4
# Of a fold: three chords, at first nearly undamped; if none reduces the error, numbers stay.
CHORDS = Rule(tolerance=0.0, iterations=3, tries=4, damping=1e-6, easier=1.0, harder=100.0)
FULL_STRUCTURE = Structure()


@dataclass(frozen=True, kw_only=True, eq=False)
class Extended:
    """Result of a joint fit.

    model           fitted axis with its extensions
    rms_m           residual at all rows
    held_out_rms_m  error at left-out rows
    held_m          (rows,)  error at left-out rows
    spread          standard errors of the numbers of each extension, from leaving out folds
    converged       whether the last step hardly changed the error
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
    further_starts: Sequence[AxisModel] = (),
    structure: Structure = FULL_STRUCTURE,
    samples: Sequence[Samples] | None = None,
    ringing: Sequence[Extension] = (),
    steps: int = MAX_STEPS,
) -> Extended:
    """Refit weights, thresholds, memory and zero of an axis together with extensions.

        min over all parameters of sum over rows of (simulated - measured)^2

    model           fitted axis: start of the search, with its numbers of plays and dead zones
    recordings      of this axis; recordings that the model does not contain start with all
                    plays at the first drive
    extensions      with start values near the true ones
    further_starts  further models to start from, because thresholds have many local minima; only
                    the closest fit is returned and cross-validated
    structure       components of the hysteresis that are fitted
    samples         samples that may be fitted, for each piece; None: all, thinned evenly
    ringing         further modes whose unresolved ringing is excluded, as that of ``extensions``:
                    errors of several fits are comparable only over the same samples

    Every piece has one constant zero; ``ThermalDrift`` represents slow motion. The held-out error
    is that of blocks of several seconds that are excluded from the fit of all parameters, but not
    from the simulation. A parameter that the rows do not determine keeps its start value, and a
    mode that starts more than its width from the true frequency is not found.
    """
    searches = []
    for start in (model, *further_starts):
        parts = parts_of(start, recordings, samples, (*extensions, *ringing))
        state = state_of(start, parts, extensions, structure)
        bounds = state.bounds(longest_lag_s([part.piece for part in parts]))
        minimum = minimise(
            partial(_point_at, state, parts),
            state.vector,
            bounds,
            rule=Rule(tolerance=TOLERANCE, iterations=steps, tries=8, damping=1e-4),
        )
        searches.append((start, bounds, minimum))
    start, bounds, best = min(searches, key=lambda search: search[2].point.rms_m)
    end, stroke_m = best.point, abs(best.point.state.scales.displacement_m)
    # Sum over folds instead of total minus one fold: a column may be zero outside one fold.
    grams = {}
    for fold in (NEVER_OUT, *range(FOLDS)):
        pairs = zip(end.tangents, end.parts, strict=True)
        tables = [tangents[part.fold == fold] for tangents, part in pairs]
        grams[fold] = sum((table.T @ table for table in tables), np.zeros((1, 1)))
    folds = []
    for fold in range(FOLDS):
        gram = sum((g for k, g in grams.items() if k != fold), np.zeros((1, 1)))
        folds.append(_refit_without(fold, end, bounds, gram))
    held_m = np.concatenate([error for _, errors in folds for error in errors]) * stroke_m
    vectors = np.array([vector for vector, _ in folds])
    # Standard errors from leaving out folds: (F - 1) / sqrt(F) times their scatter.
    std = np.std(vectors, axis=0, ddof=1) * (FOLDS - 1) / np.sqrt(FOLDS)
    return Extended(
        model=_model(start, end, std, held_m, best.converged),
        rms_m=end.rms_m,
        held_out_rms_m=float(np.sqrt(np.mean(held_m**2))),
        held_m=held_m,
        spread=tuple(std[numbers] for numbers in end.state.slices),
        converged=best.converged,
    )


def _model(
    model: AxisModel, end: "_Point", std: Array, held_m: Array, converged: bool
) -> AxisModel:
    """Return the axis model with the parameters at the end of a search.

    std     (numbers,)  standard errors
    held_m  (rows,)     error at left-out rows
    """
    state = end.state
    coordinates, operator, scales = state.coordinates, state.operator, state.scales
    starts = tuple(
        piece_start(part.piece, index, state.theta, coordinates, scales, float(run.drive[0]))
        for index, (part, run) in enumerate(zip(end.parts, end.runs, strict=True))
    )
    uncertainty, lag = model.uncertainty, coordinates.slices["lag"]
    if lag.stop > lag.start:  # the previous fit may have lacked a mode
        uncertainty = uncertainty.updated("lag_s", operator.lag_s, float(std[lag][0]))
    held_rms_m = float(np.sqrt(np.mean(held_m**2)))
    is_tested = model.quality.is_tested
    return replace(
        model,
        hysteresis=to_si_units(
            operator, scales, float(np.mean([s.zero_m.mean() for s in starts]))
        ),
        lag=Lag(kind=coordinates.shape.lag, time_s=operator.lag_s),
        extensions=tuple(
            replace(extension, std=tuple(std[numbers].tolist()))
            for extension, numbers in zip(state.extensions, state.slices, strict=True)
        ),
        starts=starts,
        uncertainty=uncertainty,
        quality=with_noise_bound(
            replace(
                model.quality,
                rms_m=end.rms_m,
                held_out_rms_m=held_rms_m if is_tested else end.rms_m,
                held_out_kind=BLOCKS if is_tested else IN_SAMPLE,
                rows=sum(map(len, end.errors)),
                effective_parameters=float(len(state.vector)),
                converged=converged,
            )
        ),
        certificate=replace(
            model.certificate, remainder_m=float(np.quantile(np.abs(held_m), 0.999))
        ),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Point:
    """Runs and errors of every part at one point of the search; derivatives when needed.

    squares  sum of squared errors at all rows
    priors   relations, numbers and slice of each extension with a prior
    """

    state: State
    parts: Sequence[Part]
    runs: Sequence[Run]
    errors: Sequence[Array]
    squares: float
    priors: Sequence[tuple[Array, Array, slice]]

    @property
    def rms_m(self) -> float:
        rms = float(np.sqrt(self.squares / sum(map(len, self.errors))))
        return rms * abs(self.state.scales.displacement_m)

    @property
    def cost(self) -> float:
        return self.squares + self.prior_cost

    @property
    def prior_cost(self) -> float:
        return sum(float(np.sum((rows @ value) ** 2)) for rows, value, _ in self.priors)

    @Once
    def tangents(self) -> list[Array]:
        """d reading / d vector of every part, (rows, numbers)."""
        coordinates = self.state.coordinates
        plays, lag = coordinates.shape.plays, coordinates.slices["lag"]
        tables = []
        for index, (part, run) in enumerate(zip(self.parts, self.runs, strict=True)):
            sample = part.samples
            rows = np.zeros((len(sample), len(self.state.vector)), order="F")
            columns = run.by_hysteresis(sample)
            rows[:, : lag.start] = columns[:, plays:]
            rows[:, coordinates.memory_slice(index)] = columns[:, :plays]
            rows[:, coordinates.offset_slice(index)] = 1.0
            if lag.stop > lag.start:
                rows[:, lag] = run.by_lag(sample)[:, None]
            for number, columns_of_extension in enumerate(self.state.slices):
                rows[:, columns_of_extension] = run.by_extension(number, sample)
            tables.append(rows)
        return tables

    @Once
    def gram(self) -> Array:
        """Gram matrix of the tangents at all rows."""
        return sum((part.T @ part for part in self.tangents), np.zeros((1, 1)))

    def linearised(self) -> NormalEquations:
        return self.normal_equations(self.gram, self.tangents, self.errors, self.cost)

    def normal_equations(
        self, gram: Array, tangents: Sequence[Array], errors: Sequence[Array], cost: float
    ) -> NormalEquations:
        """Return normal equations with the prior of each extension, with the weight of one row."""
        pairs = zip(tangents, errors, strict=True)
        slope = sum((part.T @ error for part, error in pairs), np.zeros(1))
        gram, slope = gram.copy(), slope.copy()
        for rows, value, numbers in self.priors:
            gram[numbers, numbers] += rows.T @ rows
            slope[numbers] += rows.T @ (rows @ value)
        return NormalEquations(gram=gram, slope=slope, cost=cost)


def _point_at(state: State, parts: Sequence[Part], vector: Array) -> _Point:
    """Simulate all parts at a point of the search."""
    state = state.at(vector)
    runs = [state.run(k, part) for k, part in enumerate(parts)]
    errors = [
        np.asarray(run.reading - part.piece.response)[part.samples]
        for run, part in zip(runs, parts, strict=True)
    ]
    priors = []
    for extension, numbers in zip(state.extensions, state.slices, strict=True):
        scale = abs(state.scales.displacement_m) if extension.is_prior_in_metres else 1.0
        rows = extension.prior()
        if len(rows):
            priors.append((rows / scale, extension.free().value, numbers))
    squares = sum(float(error @ error) for error in errors)
    return _Point(
        state=state, parts=parts, runs=runs, errors=errors, squares=squares, priors=priors
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _FoldPoint:
    """A point on the training rows of a fold, with the tangents at the end of the search.

    errors  0 at held-out rows: a selection would copy megabytes of columns
    gram    of the tangents at the training rows
    """

    point: _Point
    errors: Sequence[Array]
    tangents: Sequence[Array]
    gram: Array
    cost: float

    def linearised(self) -> NormalEquations:
        return self.point.normal_equations(self.gram, self.tangents, self.errors, self.cost)


def _refit_without(
    fold: int, end: _Point, bounds: tuple[Array, Array], gram: Array
) -> tuple[Array, list[Array]]:
    """Refit without one fold by a few chord steps; return the vector and the held-out errors.

    gram  of the tangents at the training rows
    """
    is_training = [part.fold != fold for part in end.parts]
    start = end.state.vector

    def point_at(vector: Array) -> _FoldPoint:
        is_start = np.array_equal(vector, start)  # saves one simulation
        point = end if is_start else _point_at(end.state, end.parts, vector)
        pairs = zip(point.errors, is_training, strict=True)
        errors = [np.where(is_used, error, 0.0) for error, is_used in pairs]
        return _FoldPoint(
            point=point,
            errors=errors,
            tangents=end.tangents,
            gram=gram,
            cost=sum(float(e @ e) for e in errors) + point.prior_cost,
        )

    fold_minimum = minimise(point_at, start, bounds, rule=CHORDS)
    errors = fold_minimum.point.point.errors
    return fold_minimum.x, [error[~k] for error, k in zip(errors, is_training, strict=True)]
