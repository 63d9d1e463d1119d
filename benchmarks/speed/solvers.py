"""Weights from all rows: ours by way of the triangle, and general solvers on the whole matrix."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares, lsq_linear, nnls

from piezoid.identification.hysteresis.convex_start import constraints_of, kuhnen_start, optimum_of
from piezoid.identification.hysteresis.coordinates import Shape, vector_of
from piezoid.identification.hysteresis.gauss_newton import Task, rms_of, simulate
from piezoid.identification.hysteresis.pieces import Piece
from piezoid.identification.hysteresis.search import Settings, task_for
from piezoid.numerics.arrays import Array
from piezoid.numerics.quadratic_program import bounded_step, empty_triangle, gather

BLOCK = 4096  # rows gathered at once


@dataclass(frozen=True, kw_only=True, eq=False)
class Program:
    """Kuhnen's program on all rows: |rows x|^2 over lower <= constraint x <= upper."""

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
    """Return non-negative weights by way of the triangle."""
    return on_triangle(triangle_of(np.column_stack([columns, target])))


def on_triangle(triangle: Array) -> Array:
    """Return non-negative weights from the triangle, the target its last column."""
    unknowns = triangle.shape[1] - 1
    free = np.zeros(unknowns), np.full(unknowns, np.inf)
    return bounded_step(triangle[:, :-1], triangle[:, -1], *free)


def on_triangle_by_others(triangle: Array) -> Mapping[str, Callable[[], Array]]:
    """Return the same by solvers of small problems, by their names."""
    factor, target = np.ascontiguousarray(triangle[:, :-1]), triangle[:, -1].copy()
    return {
        "nnls": lambda: np.asarray(nnls(factor, target)[0]),
        "daqp": lambda: _by_daqp(factor, target),
    }


def _by_daqp(factor: Array, target: Array) -> Array:
    import daqp

    unknowns = factor.shape[1]
    found, _, flag, _ = daqp.solve(
        factor.T @ factor,
        -factor.T @ target,
        np.empty((0, unknowns)),
        np.full(unknowns, 1e30),
        np.zeros(unknowns),
        np.zeros(unknowns, dtype=np.int32),
    )
    if flag != 1:
        raise AssertionError(f"daqp ended with {flag}")
    return np.asarray(found)


def weights_by_others(columns: Array, target: Array) -> Mapping[str, Callable[[], Array]]:
    """Return the same by general solvers, by their names."""
    return {
        "nnls": lambda: np.asarray(nnls(columns, target)[0]),
        "lsq_linear": lambda: np.asarray(
            lsq_linear(columns, target, (0.0, np.inf), method="bvls").x
        ),
        "cvxpy": lambda: _by_cvxpy(columns, target, np.eye(columns.shape[1]), 0.0, None),
    }


def kuhnen(program: Program) -> Array:
    """Solve Kuhnen's program by way of the triangle."""
    return optimum_of(triangle_of(program.rows), program.threshold, program.zones)[0]


def kuhnen_by_cvxpy(program: Program) -> Array:
    """Solve it as it stands, on all rows."""
    constraint, lower, upper = program.limits
    return _by_cvxpy(program.rows, np.zeros(len(program.rows)), constraint, lower, upper)


def _by_cvxpy(
    rows: Array, target: Array, constraint: Array, lower: Array | float, upper: Array | None
) -> Array:
    import cvxpy as cp

    x = cp.Variable(rows.shape[1])
    held = [constraint @ x >= lower]
    if upper is not None:
        finite = np.isfinite(upper)
        held.append(constraint[finite] @ x <= upper[finite])
    problem = cp.Problem(cp.Minimize(cp.sum_squares(rows @ x - target)), held)
    problem.solve(solver=cp.CLARABEL)
    return np.asarray(x.value)


def begun(piece: Piece, shape: Shape) -> tuple[Array, Task]:
    """Return where the search for all numbers of a shape starts, and what it minimises."""
    settings = Settings(longest_lag_s=0.0, rows=piece.rows, follow_zero=False)
    start = kuhnen_start([piece], shape, 0.0)
    task = task_for([piece], start.operator, shape.lag, settings)
    theta = vector_of(start.operator, task.coordinates)
    theta[task.coordinates.offset_slice(0)] = start.offset
    return theta, task


def by_least_squares(theta: Array, task: Task) -> float:
    """Return the rms scipy's trust region reaches, its Jacobian by differences."""
    (piece,) = task.pieces

    def residual(x: Array) -> Array:
        return simulate(x, task, 0, piece) - piece.response

    bounds = task.coordinates.bounds(task.longest_lag_s)
    found = least_squares(residual, theta, bounds=bounds, ftol=1e-5)
    return rms_of(found.x, task)
