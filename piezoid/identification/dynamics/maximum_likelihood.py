"""The weighted output-error fit of the modal form: gains eliminated, shape searched for."""

from dataclasses import dataclass

import numpy as np

from piezoid.errors import IdentificationError
from piezoid.identification.dynamics.curvature import ModalFit, Point, with_covariance
from piezoid.identification.dynamics.frequency_response import ComplexArray
from piezoid.identification.dynamics.modal_basis import (
    Lines,
    Structure,
    Term,
    basis,
    term_columns,
    terms_of,
)
from piezoid.identification.dynamics.vector_fitting import stacked
from piezoid.numerics.arrays import Array
from piezoid.numerics.levenberg_marquardt import (
    Eliminated,
    NormalEquations,
    Rule,
    eliminated,
    minimise,
)
from piezoid.numerics.once import Once

EVALUATIONS = 40
ENOUGH = 1e-2  # half of it is the gain in log likelihood: a tenth of a standard deviation
STEP = 1e-5  # of the central differences: truncation 1e-10, rounding 1e-11
LONGEST_MOVE = 0.3  # of a log frequency or log damping in one round
OUT_OF_BAND = 4.0  # largest damping, and how far beyond the band a pole may lie
LEAST_DAMPING = 1e-5


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


@dataclass(frozen=True, kw_only=True, eq=False)
class _Slope:
    """What one shape parameter does to the columns it touches."""

    columns: list[int]
    change: ComplexArray


def _slopes(lines: Lines, structure: Structure, shape: Array) -> list[_Slope]:
    """Central differences of the columns by each shape parameter, the delay last."""
    terms = terms_of(structure)
    found = {
        p: _difference(lines, (term,), shape, p, STEP) for term in terms for p in term.parameters
    }
    late = _difference(lines, terms, shape, len(shape) - 1, STEP / lines.sampling_rate_Hz)
    return [*(found[p] for p in range(len(found))), late]


def _difference(
    lines: Lines, terms: tuple[Term, ...], shape: Array, parameter: int, step: float
) -> _Slope:
    up, down = shape.copy(), shape.copy()
    up[parameter] += step
    down[parameter] -= step
    down[-1] = max(down[-1], 0.0)  # at delay zero the difference is one-sided
    width = up[parameter] - down[parameter]
    change = [term_columns(lines, t, up) - term_columns(lines, t, down) for t in terms]
    columns = [column for term in terms for column in term.columns]
    return _Slope(columns=columns, change=np.concatenate(change, axis=1) / width)


def _tangent(slopes: list[_Slope], gains: Array) -> ComplexArray:
    return np.stack([slope.change @ gains[slope.columns] for slope in slopes], axis=1)
