"""Small convex least squares under linear constraints, with the certificate of its optimum."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import optimize, sparse

from piezoid.errors import InfeasibleFitError
from piezoid.numerics.arrays import Array

_TOLERANCE = 1e-10


@dataclass(frozen=True, kw_only=True, eq=False)
class Optimum:
    """The solution of a convex program and how far it can be from optimal.

    x        (unknowns,)
    cost     |R x - c|^2
    kkt_gap  scaled stationarity residual: 0 at an exact optimum, dimensionless
    """

    x: Array
    cost: float
    kkt_gap: float


def constrained_least_squares(
    triangle: Array, target: Array, constraint: Array, lower: Array, upper: Array
) -> Optimum:
    """Minimise |R x - c|^2 subject to l <= A x <= u.

    Posed to OSQP with the residual as a variable of its own, so that the conditioning is R's and
    not that of R'R: forming R'R for play regressors and solving to default tolerances gives
    weights wrong by half.

    R     triangle    (rows, unknowns)
    c     target      (rows,)
    A     constraint  (constraints, unknowns)
    l, u  lower, upper (constraints,), infinite where there is none

    Raises ``InfeasibleFitError`` when the constraints contradict each other.
    """
    import osqp

    scale = np.linalg.norm(triangle, axis=0)
    scale[scale == 0.0] = 1.0
    factor, height = triangle / scale, float(np.linalg.norm(target)) or 1.0
    rows, unknowns = factor.shape
    solver: Any = osqp.OSQP()
    solver.setup(
        P=sparse.csc_matrix(sparse.diags(np.repeat([0.0, 1.0], [unknowns, rows]))),
        q=np.zeros(unknowns + rows),
        A=_equations(factor, constraint / scale * height),
        l=np.concatenate([target / height, lower]),
        u=np.concatenate([target / height, upper]),
        eps_abs=_TOLERANCE,
        eps_rel=_TOLERANCE,
        max_iter=200_000,
        polishing=True,
        verbose=False,
    )
    result = solver.solve(raise_error=False)
    if result.info.status not in {"solved", "solved inaccurate"}:
        raise InfeasibleFitError(
            f"the quadratic program of the fit ended as {result.info.status!r}",
            needed="constraints that some set of weights can meet",
            remedy="Lower the number of plays or dead zones, or check the drive's range.",
        )
    x = result.x[:unknowns] * height / scale
    return Optimum(
        x=x,
        cost=float(np.sum((triangle @ x - target) ** 2)),
        kkt_gap=_stationarity(factor, x * scale, target, constraint / scale, (lower, upper)),
    )


def _equations(factor: Array, constraint: Array) -> sparse.csc_matrix:
    """Return the rows R x - e = c and A x, for the unknowns x and then the residual e."""
    nothing = sparse.csc_matrix((len(constraint), len(factor)))
    residual = sparse.hstack([sparse.csc_matrix(factor), -sparse.eye(len(factor))])
    return sparse.csc_matrix(
        sparse.vstack([residual, sparse.hstack([sparse.csc_matrix(constraint), nothing])])
    )


def _stationarity(
    factor: Array, x: Array, target: Array, constraint: Array, limits: tuple[Array, Array]
) -> float:
    """Return the part of the gradient that no active constraint can balance, relative to it."""
    gradient = factor.T @ (factor @ x - target)
    value = constraint @ x
    slack = 1e-7 * (1.0 + np.abs(constraint) @ np.abs(x))
    at_lower, at_upper = value <= limits[0] + slack, value >= limits[1] - slack
    equal = at_lower & at_upper
    normals = np.vstack(
        [constraint[at_lower & ~equal], -constraint[at_upper & ~equal], constraint[equal]]
    )
    bound = np.zeros(len(normals))
    bound[len(normals) - int(equal.sum()) :] = -np.inf
    size = float(np.linalg.norm(factor.T @ target)) or 1.0
    if len(normals) == 0:
        return float(np.linalg.norm(gradient)) / size
    balance = optimize.lsq_linear(normals.T, gradient, (bound, np.inf), tol=1e-14)
    return float(np.linalg.norm(normals.T @ balance.x - gradient)) / size


def bounded_step(triangle: Array, target: Array, lower: Array, upper: Array) -> Array:
    """Minimise |R x - c|^2 subject to l <= x <= u by an active-set method, exactly.

    R, c   (rows, unknowns), (rows,)
    l, u   (unknowns,)  l <= u; equal bounds fix the unknown

    Unknowns on a bound are freed when their gradient points inwards, one wave at a time, so the
    result satisfies the Karush-Kuhn-Tucker conditions to rounding.
    """
    movable = upper > lower
    x = np.clip(np.zeros_like(lower), lower, upper)
    if not movable.any():
        return np.asarray(x)
    reduced = target - triangle[:, ~movable] @ x[~movable]
    scale = np.linalg.norm(triangle[:, movable], axis=0)
    scale[scale == 0.0] = 1.0
    found = optimize.lsq_linear(
        triangle[:, movable] / scale,
        reduced,
        (lower[movable] * scale, upper[movable] * scale),
        method="bvls",
        tol=1e-12,
    )
    x[movable] = np.clip(found.x / scale, lower[movable], upper[movable])
    return np.asarray(x)
