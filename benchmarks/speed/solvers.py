"""Weights from all rows: by the triangle of piezoid, and by general solvers on the full matrix."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares, lsq_linear, nnls

from piezoid.identification.hysteresis.coordinates import Shape, vector_of
from piezoid.identification.hysteresis.gauss_newton import Task, residuals, rms_of
from piezoid.identification.hysteresis.pieces import Piece
from piezoid.identification.hysteresis.search import (
    Settings,
    constraints_of,
    kuhnen_start,
    optimum_of,
    task_for,
)
from piezoid.numerics.arrays import Array
from piezoid.numerics.quadratic_program import bounded_step, empty_triangle, gather

BLOCK = 4096  # rows


@dataclass(frozen=True, kw_only=True, eq=False)
class Program:
    """Kuhnen's program on all rows: minimise |rows x|^2 over lower <= constraint x <= upper."""

    rows: Array
    threshold: Array
    zones: Array

    @property
    def limits(self) -> tuple[Array, Array, Array]:
        """Constraint, lower and upper."""
        return constraints_of(self.threshold, self.zones, self.rows.shape[1])


def triangle_of(rows: Array) -> Array:
    """Return the triangular factor of all rows, gathered in blocks."""
    triangle = empty_triangle(rows.shape[1])
    for first in range(0, len(rows), BLOCK):
        triangle = gather(triangle, rows[first : first + BLOCK])
    return triangle


def weights(columns: Array, target: Array) -> Array:
    """Return non-negative weights from the triangle of all rows."""
    return on_triangle(triangle_of(np.column_stack([columns, target])))


def on_triangle(triangle: Array) -> Array:
    """Return non-negative weights from the triangle, whose last column is the target."""
    unknowns = triangle.shape[1] - 1
    free = np.zeros(unknowns), np.full(unknowns, np.inf)
    return bounded_step(triangle[:, :-1], triangle[:, -1], *free)


def general_on_triangle(triangle: Array) -> Mapping[str, Callable[[], Array]]:
    """Return solvers of small problems by name."""
    factor, target = np.ascontiguousarray(triangle[:, :-1]), triangle[:, -1].copy()
    return {
        "nnls": lambda: np.asarray(nnls(factor, target)[0]),
        "daqp": lambda: _by_daqp(factor, target),
    }


def _by_daqp(factor: Array, target: Array) -> Array:
    import daqp

    unknowns = factor.shape[1]
    solution, _, flag, _ = daqp.solve(
        factor.T @ factor,
        -factor.T @ target,
        np.empty((0, unknowns)),
        np.full(unknowns, 1e30),
        np.zeros(unknowns),
        np.zeros(unknowns, dtype=np.int32),
    )
    if flag != 1:
        raise AssertionError(f"daqp ended with {flag}")
    return np.asarray(solution)


def general_weights(columns: Array, target: Array) -> Mapping[str, Callable[[], Array]]:
    """Return general solvers of the weights by name."""
    return {
        "nnls": lambda: np.asarray(nnls(columns, target)[0]),
        "lsq_linear": lambda: np.asarray(
            lsq_linear(columns, target, (0.0, np.inf), method="bvls").x
        ),
        "cvxpy": lambda: _by_cvxpy(columns, target, np.eye(columns.shape[1]), 0.0, None),
    }


def kuhnen(program: Program) -> Array:
    """Solve Kuhnen's program from the triangle of all rows."""
    return optimum_of(triangle_of(program.rows), program.threshold, program.zones).x


def kuhnen_by_cvxpy(program: Program) -> Array:
    """Solve Kuhnen's program on all rows."""
    constraint, lower, upper = program.limits
    return _by_cvxpy(program.rows, np.zeros(len(program.rows)), constraint, lower, upper)


def _by_cvxpy(
    rows: Array, target: Array, constraint: Array, lower: Array | float, upper: Array | None
) -> Array:
    import cvxpy as cp

    x = cp.Variable(rows.shape[1])
    constraints = [constraint @ x >= lower]
    if upper is not None:
        finite = np.isfinite(upper)
        constraints.append(constraint[finite] @ x <= upper[finite])
    problem = cp.Problem(cp.Minimize(cp.sum_squares(rows @ x - target)), constraints)
    problem.solve(solver=cp.CLARABEL)
    return np.asarray(x.value)


def start_of(piece: Piece, shape: Shape) -> tuple[Array, Task]:
    """Return the initial parameters of a shape, and the task of the fit."""
    settings = Settings(longest_lag_s=0.0, rows=piece.rows, follow_zero=False)
    operator, offset, _ = kuhnen_start([piece], shape, 0.0)
    task = task_for([piece], operator, shape.lag, settings)
    theta = vector_of(operator, task.coordinates)
    theta[task.coordinates.offset_slice(0)] = offset
    return theta, task


def by_least_squares(theta: Array, task: Task) -> float:
    """Return the rms residual of SciPy's trust region with a Jacobian by differences."""
    bounds = task.coordinates.bounds(task.longest_lag_s)
    optimum = least_squares(lambda x: next(residuals(x, task)), theta, bounds=bounds, ftol=1e-5)
    return rms_of(optimum.x, task)
