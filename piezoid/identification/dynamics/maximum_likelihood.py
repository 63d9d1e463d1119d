"""The weighted output-error fit of the modal form: gains eliminated, shape by Gauss-Newton."""

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

ROUNDS = 40
ENOUGH = 1e-2  # half of it is the gain in log likelihood: a tenth of a standard deviation
STEP = 1e-5  # of the central differences: truncation 1e-10, rounding 1e-11
LONGEST_MOVE = 0.3  # of a log frequency or log damping in one round
OUT_OF_BAND = 4.0  # largest damping, and how far beyond the band a pole may lie
LEAST_DAMPING = 1e-5


def maximise_likelihood(
    response: ComplexArray, weight: Array, lines: Lines, structure: Structure, shape: Array
) -> ModalFit:
    """Minimise sum |weight (response - columns(shape) gains)|^2 over shape and gains.

    For each shape the best gains are a linear problem; the shape moves by Gauss-Newton on what
    is left, with damped steps (variable projection, Golub & Pereyra 2003, Kaufman's form).

    response  (lines, outputs, inputs)  measured
    weight    (lines, outputs, inputs)  one over the standard deviation; zero leaves a value out
    shape     (shapes,)                 a start, for example from vector fitting
    """
    bounds = _bounds(lines, structure)
    here = _point(_fitted(response, weight, lines, structure, np.clip(shape, *bounds)))
    damping = 1e-3
    for _ in range(ROUNDS):
        there = _fitted(response, weight, lines, structure, _move(here, damping, bounds))
        gained = here.cost - there.cost
        if gained > 0:  # only where it goes on is it worth knowing where to
            here, damping = _point(there), max(damping / 10, 1e-12)
        else:
            damping *= 10
        if (0 <= gained < ENOUGH) or damping > 1e8:
            break
    return with_covariance(here, weight, structure)


def _move(point: Point, damping: float, bounds: tuple[Array, Array]) -> Array:
    """The damped Gauss-Newton step of what is free to move, in scaled unknowns."""
    low, high = bounds
    pushed = ((point.shape <= low) & (point.gradient < 0)) | (
        (point.shape >= high) & (point.gradient > 0)
    )
    free = np.flatnonzero(~pushed)
    curvature = point.curvature[np.ix_(free, free)]
    scale = np.sqrt(np.maximum(np.diag(curvature), np.finfo(float).tiny))
    matrix = curvature / np.outer(scale, scale) + damping * np.eye(len(free))
    step = np.zeros(len(low))
    step[free] = np.linalg.solve(matrix, point.gradient[free] / scale) / scale
    longest = np.append(np.full(len(low) - 1, LONGEST_MOVE), high[-1] / 10)
    return np.clip(point.shape + np.clip(step, -longest, longest), low, high)


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
class _Path:
    """The best gains of one path at one shape: a linear problem, solved.

    Q, root   weighted columns = Q root^-1
    target    weighted response, (values,)
    residual  what the columns leave of it
    """

    weight: Array
    Q: Array
    root: Array
    gains: Array
    residual: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class _Fitted:
    """A shape with its best gains, (outputs, inputs) of paths, and what they leave."""

    lines: Lines
    structure: Structure
    shape: Array
    paths: list[list[_Path]]

    @property
    def cost(self) -> float:
        """The sum of squares of all residuals."""
        return float(
            sum(float(path.residual @ path.residual) for row in self.paths for path in row)
        )


def _fitted(
    response: ComplexArray, weight: Array, lines: Lines, structure: Structure, shape: Array
) -> _Fitted:
    columns = basis(lines, structure, shape)
    outputs, inputs = response.shape[1:]
    return _Fitted(
        lines=lines,
        structure=structure,
        shape=shape,
        paths=[
            [
                _solved(columns, response[:, i, j, None], weight[:, i, j, None])
                for j in range(inputs)
            ]
            for i in range(outputs)
        ],
    )


def _solved(columns: ComplexArray, response: ComplexArray, weight: Array) -> _Path:
    weighted = stacked(columns * weight)
    size = np.linalg.norm(weighted, axis=0)
    Q, R = np.linalg.qr(weighted / size)
    target = stacked(response * weight)[:, 0]
    root = _inverse_triangle(R) / size[:, None]
    inside = Q.T @ target
    return _Path(weight=weight, Q=Q, root=root, gains=root @ inside, residual=target - Q @ inside)


def _point(fitted: _Fitted) -> Point:
    """Return where a shape leads to."""
    structure = fitted.structure
    slopes = _slopes(fitted.lines, structure, fitted.shape)
    curvature = np.zeros((structure.shapes, structure.shapes))
    scores = np.zeros((len(fitted.lines.frequency_Hz), structure.shapes))
    roots, drags = [], []
    for path in (path for row in fitted.paths for path in row):
        tangent = stacked(_tangent(slopes, path.gains) * path.weight)
        inside = path.Q.T @ tangent
        tangent -= path.Q @ inside
        curvature += tangent.T @ tangent
        weighted = tangent * path.residual[:, None]
        scores += weighted.reshape(2, len(scores), -1).sum(axis=0)
        roots.append(path.root)
        drags.append(-path.root @ inside)
    return Point(
        shape=fitted.shape,
        cost=fitted.cost,
        gains=np.array([[path.gains for path in row] for row in fitted.paths]),
        gradient=scores.sum(axis=0),
        curvature=curvature,
        line_scores=scores,
        gain_roots=roots,
        gain_slopes=drags,
    )


def _inverse_triangle(R: Array) -> Array:
    diagonal = np.abs(np.diag(R))
    if len(R) < R.shape[1] or not diagonal.min() > 1e-13 * diagonal.max():
        raise IdentificationError(
            f"the modal form is singular: smallest pivot {diagonal.min():.1e} of "
            f"{diagonal.max():.1e}",
            needed="more measured values than gains, and no two terms alike",
            remedy="Take fewer modes, leave out the direct term, or measure more lines.",
        )
    return np.asarray(np.linalg.inv(R))


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
