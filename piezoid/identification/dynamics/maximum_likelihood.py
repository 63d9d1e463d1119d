"""The weighted output-error fit of the modal form: gains eliminated, shape searched for."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezoid.errors import IdentificationError
from piezoid.identification.dynamics.frequency_response import ComplexArray
from piezoid.identification.dynamics.modal import LinearDynamics
from piezoid.identification.dynamics.modal_basis import (
    Lines,
    Structure,
    basis,
    term_columns,
    terms_of,
)
from piezoid.identification.dynamics.vector_fitting import stacked
from piezoid.numerics.arrays import Array
from piezoid.numerics.executor import Once
from piezoid.numerics.levenberg_marquardt import (
    Eliminated,
    NormalEquations,
    Rule,
    eliminated,
    minimise,
)

EVALUATIONS = 40
ENOUGH = 1e-2  # half of it is the gain in log likelihood: a tenth of a standard deviation
STEP = 1e-5  # of the central differences: truncation 1e-10, rounding 1e-11
LONGEST_MOVE = 0.3  # of a log frequency or log damping in one round
OUT_OF_BAND = 4.0  # largest damping, and how far beyond the band a pole may lie
LEAST_DAMPING = 1e-5


@dataclass(frozen=True, kw_only=True, eq=False)
class ModalFit:
    """The minimum of sum |G_hat - G|^2 / variance, and its curvature.

    shape             (shapes,)             as in ``modal_basis.basis``
    gains             (outputs, inputs, columns)
    cost              twice the negative log likelihood but for a constant
    shape_covariance  (shapes, shapes)      inflated where the residual is larger than its variance
    mode_worth        (modes,)              rise of the cost if a mode were left out
    gain_std          (outputs, inputs, columns)
    static_std        (outputs, inputs)     of the gain at frequency zero
    values            complex values that counted
    """

    shape: Array
    gains: Array
    cost: float
    shape_covariance: Array
    gain_std: Array
    static_std: Array
    mode_worth: Array
    values: int


@dataclass(frozen=True, kw_only=True, eq=False)
class Point:
    """One evaluation: cost, gradient and curvature with the gains eliminated.

    line_scores  (lines, shapes)  share of each line in the gradient
    gain_roots   for each path, outputs first: K with gain covariance K K^T / 2 at a fixed shape
    gain_slopes  for each path: d gains / d shape
    """

    shape: Array
    cost: float
    gains: Array
    gradient: Array
    curvature: Array
    line_scores: Array
    gain_roots: list[Array]
    gain_slopes: list[Array]


def with_covariance(point: Point, weight: Array, structure: Structure) -> ModalFit:
    """Curvature and the sandwich over lines, whichever is wider for each parameter.

    A complex value of variance one has parts of variance one half, hence the halves. The sandwich
    counts a line as one draw: distortion is shared by all outputs at that line.
    """
    values = int((weight > 0).sum())
    unknowns = structure.shapes + point.gains.size
    spare = max(values - unknowns / 2, 1.0)
    excess = max(1.0, point.cost / spare)
    inverse = _scaled_inverse(point.curvature)
    plain = 0.5 * excess * inverse
    lines = int((weight > 0).any(axis=(1, 2)).sum())
    meat = point.line_scores.T @ point.line_scores * lines / max(lines - unknowns / 2, 1.0)
    sandwich = inverse @ meat @ inverse
    ratio = np.diag(sandwich) / np.maximum(np.diag(plain), np.finfo(float).tiny)
    wider = np.sqrt(np.maximum(ratio, 1.0))
    covariance = plain * np.outer(wider, wider)
    gain_std, static_std = _gain_spread(point, covariance, excess, structure)
    return ModalFit(
        shape=point.shape,
        gains=point.gains,
        cost=point.cost,
        shape_covariance=covariance,
        gain_std=gain_std,
        static_std=static_std,
        mode_worth=_mode_worth(point, structure),
        values=values,
    )


def _scaled_inverse(curvature: Array) -> Array:
    scale = np.sqrt(np.maximum(np.diag(curvature), np.finfo(float).tiny))
    inverse = np.linalg.pinv(curvature / np.outer(scale, scale), rcond=1e-14, hermitian=True)
    return np.asarray(inverse / np.outer(scale, scale))


def _gain_spread(
    point: Point, covariance: Array, excess: float, structure: Structure
) -> tuple[Array, Array]:
    static = structure.static_columns()
    spread, static_spread = [], []
    for root, drag in zip(point.gain_roots, point.gain_slopes, strict=True):
        whole = 0.5 * excess * root @ root.T + drag @ covariance @ drag.T
        spread.append(np.sqrt(np.diag(whole)))
        static_spread.append(np.sqrt(max(float(static @ whole @ static), 0.0)))
    shape = point.gains.shape
    return np.reshape(spread, shape), np.reshape(static_spread, shape[:2])


def _mode_worth(point: Point, structure: Structure) -> Array:
    """g_S^T (K_S K_S^T)^-1 g_S over all paths, S the columns of a mode."""
    gains = point.gains.reshape(len(point.gain_roots), -1)
    worth = np.zeros(structure.modes)
    for m, term in enumerate(terms_of(structure)[: structure.modes]):
        chosen = list(term.columns)
        for g, root in zip(gains, point.gain_roots, strict=True):
            spread = root[chosen] @ root[chosen].T
            worth[m] += float(g[chosen] @ np.linalg.solve(spread, g[chosen]))
    return worth


def resolved_modes(dynamics: LinearDynamics) -> NDArray[np.bool_]:
    """Tell which modes the data determine, (modes,).

    The others are overdamped, or known to no better than a factor: they stand for what lies
    outside the band, and their numbers mean nothing by themselves.
    """
    frequency = dynamics.mode_frequency_interval_Hz()
    damping = dynamics.mode_damping_interval()
    known = (frequency[:, 1] < 1.1 * frequency[:, 0]) & (damping[:, 1] < 3 * damping[:, 0])
    return np.asarray(known & (dynamics.mode_damping < 1.0), dtype=np.bool_)


def maximise_likelihood(
    response: ComplexArray, weight: Array, lines: Lines, structure: Structure, shape: Array
) -> ModalFit:
    """Minimise sum |weight (response - columns(shape) gains)|^2 over shape and gains.

    For each shape the best gains are a linear problem and are eliminated (variable projection).

    response  (lines, outputs, inputs)  measured
    weight    (lines, outputs, inputs)  one over the standard deviation; zero leaves a value out
    shape     (shapes,)                 a start, for example from vector fitting
    """
    low, high = _bounds(lines, structure)
    found = minimise(
        lambda shape: _fitted(response, weight, lines, structure, shape),
        shape,
        (low, high),
        rule=Rule(tolerance=0.0, enough=ENOUGH, evaluations=EVALUATIONS),
        longest=np.append(np.full(len(low) - 1, LONGEST_MOVE), high[-1] / 10),
    )
    return with_covariance(found.point.point, weight, structure)


def _bounds(lines: Lines, structure: Structure) -> tuple[Array, Array]:
    """How far a shape may go: beyond, a term is a constant to this data, or a single line.

    Delays are causal, and at most as long as the slowest measured period.
    """
    n, lags = structure.modes, structure.lags
    lowest, highest = lines.frequency_Hz[[0, -1]]
    log_f = np.log([lowest / OUT_OF_BAND, highest * OUT_OF_BAND])
    counts = [n, n, lags, 1]
    low = np.repeat([log_f[0], np.log(LEAST_DAMPING), log_f[0], 0.0], counts)
    high = np.repeat([log_f[1], np.log(OUT_OF_BAND), log_f[1], 1 / lowest], counts)
    return low, high


@dataclass(frozen=True, kw_only=True, eq=False)
class _Fitted:
    """A shape with its best gains, path after path, outputs first, and what they leave."""

    lines: Lines
    structure: Structure
    shape: Array
    weight: Array
    paths: list[Eliminated]

    @property
    def cost(self) -> float:
        """The sum of squares of all residuals."""
        return float(sum(float(path.residual @ path.residual) for path in self.paths))

    @Once
    def point(self) -> Point:
        """Return where the shape leads to."""
        shapes, (lines, outputs, inputs) = self.structure.shapes, self.weight.shape
        slopes = _slopes(self.lines, self.structure, self.shape)
        curvature, scores = np.zeros((shapes, shapes)), np.zeros((lines, shapes))
        drags = []
        weights = self.weight.reshape(lines, -1, 1)
        for number, path in enumerate(self.paths):
            tangent = stacked(_tangent(slopes, path.coefficients) * weights[:, number])
            tangent, drag = path.across(tangent)
            curvature += tangent.T @ tangent
            weighted = tangent * path.residual[:, None]
            scores += weighted.reshape(2, lines, -1).sum(axis=0)
            drags.append(drag)
        gains = np.array([path.coefficients for path in self.paths])
        return Point(
            shape=self.shape,
            cost=self.cost,
            gains=gains.reshape(outputs, inputs, -1),
            gradient=scores.sum(axis=0),
            curvature=curvature,
            line_scores=scores,
            gain_roots=[path.root for path in self.paths],
            gain_slopes=drags,
        )

    def linearised(self) -> NormalEquations:
        """Return the linear model, the gains eliminated."""
        point = self.point
        return NormalEquations(gram=point.curvature, slope=-point.gradient, cost=self.cost)


def _fitted(
    response: ComplexArray, weight: Array, lines: Lines, structure: Structure, shape: Array
) -> _Fitted:
    columns = basis(lines, structure, shape)
    paths = [(i, j) for i in range(response.shape[1]) for j in range(response.shape[2])]
    try:
        solved = [
            eliminated(
                stacked(columns * weight[:, i, j, None]),
                stacked(response[:, i, j, None] * weight[:, i, j, None])[:, 0],
            )
            for i, j in paths
        ]
    except np.linalg.LinAlgError as error:
        raise IdentificationError(
            f"the modal form is singular: {error}",
            needed="more measured values than gains, and no two terms alike",
            remedy="Take fewer modes, leave out the direct term, or measure more lines.",
        ) from error
    return _Fitted(lines=lines, structure=structure, shape=shape, weight=weight, paths=solved)


@dataclass(frozen=True, eq=False)
class _Slope:
    """What one shape parameter does to the columns it touches."""

    columns: list[int]
    change: ComplexArray


def _slopes(lines: Lines, structure: Structure, shape: Array) -> list[_Slope]:
    """Central differences of the columns by each shape parameter, the delay last."""
    terms = terms_of(structure)
    found: dict[int, _Slope] = {}
    late = []
    for term in terms:
        numbers = [*term.parameters, len(shape) - 1]
        step = np.zeros((len(numbers), len(shape)))
        step[range(len(numbers)), numbers] = STEP
        step[-1, -1] /= lines.sampling_rate_Hz
        both = np.concatenate([shape + step, shape - step])
        both[:, -1] = np.maximum(both[:, -1], 0.0)  # at delay zero the difference is one-sided
        width = (both[: len(step)] - both[len(step) :]).sum(axis=1)
        up, down = np.split(term_columns(lines, term, both), 2)
        change = (up - down) / width[:, None, None]
        columns = list(term.columns)
        found |= {p: _Slope(columns, c) for p, c in zip(term.parameters, change, strict=False)}
        late.append(_Slope(columns, change[-1]))
    together = [column for slope in late for column in slope.columns]
    delay = _Slope(together, np.concatenate([slope.change for slope in late], axis=1))
    return [*(found[p] for p in range(len(found))), delay]


def _tangent(slopes: list[_Slope], gains: Array) -> ComplexArray:
    return np.stack([slope.change @ gains[slope.columns] for slope in slopes], axis=1)
