"""Small convex least squares with linear constraints, and the triangular factor of tall problems.

Least squares with a million rows [J | e] needs only the small triangle R of their QR
factorisation: |J x + e|^2 = |R (x, 1)|^2. Updating R block by block keeps memory constant and,
unlike the Gram matrix J'J, does not square the condition number, which reaches 2e7 for play
regressors.
"""

from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from scipy import optimize, sparse
from scipy.linalg import lapack

from piezoid.errors import InfeasibleFitError
from piezoid.numerics.arrays import Array

_TOLERANCE = 1e-10
# Added to the diagonal for columns of norm 1: the first value with which the active-set method
# converges, for nearly dependent columns.
RIDGES = (0.0, 1e-13, 1e-11, 1e-9)
JITTER = 1e-14  # of a column's norm squared: keeps R'R definite in spite of rounding
AT_BOUND = 1e-7  # of the sum of the sizes of a constraint's terms
ROUNDING = 1e-11  # of columns and a target of norm 1
_UNBOUNDED = 1e30  # daqp's infinite bound
_EQUALITY = 5  # daqp's constraint type of equal bounds
_SOLVED = 1  # daqp's status
_PRIMAL_TOLERANCE = 1e-11  # of variables of order one
_REFLECTED_COLUMNS = 16  # together, in an update of the triangular factor


@dataclass(frozen=True, kw_only=True, eq=False)
class Optimum:
    """Solution of a convex program, with a bound of its distance from the optimum.

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

    OSQP solves the problem with the residual as an additional variable, so that the conditioning
    is that of R and not of R'R: with R'R of play regressors and default tolerances the weights
    are wrong by half. Columns, target and constraints are scaled to norm 1, since the tolerances
    are absolute.

    R     triangle      (rows, unknowns)
    c     target        (rows,)
    A     constraint    (constraints, unknowns)
    l, u  lower, upper  (constraints,), infinite without a limit

    Raises ``InfeasibleFitError`` when the constraints contradict each other.
    """
    import osqp

    scale = column_norms(triangle)
    factor, height = triangle / scale, float(np.linalg.norm(target)) or 1.0
    rows, unknowns = factor.shape
    sides = constraint / scale * height
    length = column_norms(sides.T)
    # The rows R x - e = c and A x, for the unknowns x and then the residual e.
    residual = sparse.hstack([sparse.csc_matrix(factor), -sparse.eye(rows)])
    zeros = sparse.csc_matrix((len(sides), rows))
    limited = sparse.hstack([sparse.csc_matrix(sides / length[:, None]), zeros])
    solver: Any = osqp.OSQP()
    solver.setup(
        P=sparse.csc_matrix(sparse.diags(np.repeat([0.0, 1.0], [unknowns, rows]))),
        q=np.zeros(unknowns + rows),
        A=sparse.csc_matrix(sparse.vstack([residual, limited])),
        l=np.concatenate([target / height, lower / length]),
        u=np.concatenate([target / height, upper / length]),
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
        kkt_gap=stationarity(triangle, x, target, constraint, (lower, upper)),
    )


def column_norms(columns: Array) -> Array:
    """Return the norms of columns, 1 for columns of zeros, (columns,)."""
    scale = np.linalg.norm(columns, axis=0)
    scale[scale == 0.0] = 1.0
    return np.asarray(scale)


def stationarity(
    triangle: Array, x: Array, target: Array, constraint: Array, limits: tuple[Array, Array]
) -> float:
    """Return the relative part of the gradient at x that active constraints cannot balance.

    The arguments are those of ``constrained_least_squares``, with columns scaled to norm 1. The
    result is 0 at an exact optimum.
    """
    scale = column_norms(triangle)
    gradient = triangle.T @ (triangle @ x - target) / scale
    value = constraint @ x
    # Rounding error of a constraint if all its terms were as large as the largest.
    slack = (
        AT_BOUND * float(np.abs(scale * x).max(initial=0.0)) * np.abs(constraint / scale).sum(1)
    )
    at_lower, at_upper = value <= limits[0] + slack, value >= limits[1] - slack
    # An equality is in both sets.
    normals = np.vstack([constraint[at_lower], -constraint[at_upper]]) / scale
    size = float(np.linalg.norm(triangle.T @ target / scale)) or 1.0
    if len(normals) == 0:
        return float(np.linalg.norm(gradient)) / size
    return float(optimize.nnls(normals.T, gradient)[1]) / size


def bounded_minimum(gram: Array, right: Array, lower: Array, upper: Array) -> Array:
    """Minimise x' G x / 2 - b' x with l <= x <= u.

    G, b  (unknowns, unknowns), (unknowns,)  G positive definite
    l, u  (unknowns,)  l <= u; equal bounds fix an unknown

    Independent of the units of b and the bounds. A variable at an active bound equals the bound
    exactly.

    Raises ``LinAlgError`` for a G that is not positive definite to 1e-9 of its diagonal.

    Source: Arnstroem, Bemporad & Axehill, IEEE Transactions on Automatic Control 67 (2022), daqp.
    """
    import daqp

    length = np.sqrt(np.maximum(np.diag(gram), 0.0))
    length[length == 0.0] = 1.0
    nearest = np.clip(np.zeros_like(length), lower, upper) * length
    height = float(max(np.linalg.norm(right / length), np.linalg.norm(nearest))) or 1.0
    below, above = lower * (length / height), upper * (length / height)
    for ridge in RIDGES:
        scaled, _, flag, details = daqp.solve(
            gram / np.outer(length, length) + ridge * np.eye(len(length)),
            -right / (length * height),
            np.empty((0, len(length))),
            np.minimum(above, _UNBOUNDED),
            np.maximum(below, -_UNBOUNDED),
            np.where(lower >= upper, _EQUALITY, 0).astype(np.int32),
            primal_tol=_PRIMAL_TOLERANCE,
        )
        if flag == _SOLVED:
            break
    else:
        raise np.linalg.LinAlgError(
            f"the quadratic form was not minimised: daqp ended with status {flag}"
        )
    multiplier = details["lam"][: len(length)]
    x = np.where(
        multiplier < 0.0, lower, np.where(multiplier > 0.0, upper, scaled * (height / length))
    )
    return np.clip(x, lower, upper)


def bounded_step(triangle: Array, target: Array, lower: Array, upper: Array) -> Array:
    """Minimise |R x - c|^2 subject to l <= x <= u, exactly.

    R, c   (rows, unknowns), (rows,)
    l, u   (unknowns,)  l <= u; equal bounds fix the unknown

    The active bounds are found from R'R, which is fast but squares R's condition number; the free
    unknowns are then solved for with R. If the Karush-Kuhn-Tucker conditions do not hold to
    rounding, an active-set method on R is used instead. The result does not depend on units.
    """
    scale = column_norms(triangle)
    nearest = np.linalg.norm(np.clip(np.zeros_like(scale), lower, upper) * scale)
    height = float(max(np.linalg.norm(target), nearest)) or 1.0
    factor, right = triangle / scale, target / height
    below, above = lower * (scale / height), upper * (scale / height)
    gram = factor.T @ factor + JITTER * np.eye(len(below))
    try:
        x = bounded_minimum(gram, factor.T @ right, below, above)
    except np.linalg.LinAlgError:
        is_minimum = False
    else:
        free = (x > below) & (x < above)
        if free.any():
            x[free] = 0.0
            _, solution, _ = lapack.dgels(factor[:, free], right - factor @ x)
            x[free] = solution[: int(free.sum())]
        slope = factor.T @ (factor @ x - right)
        is_stationary = np.where(x <= below, slope >= -ROUNDING, np.abs(slope) <= ROUNDING)
        is_stationary |= (x >= above) & (slope <= ROUNDING)
        is_feasible = (x >= below - ROUNDING) & (x <= above + ROUNDING)
        is_minimum = bool((is_stationary & is_feasible).all())
    if not is_minimum:
        movable = above > below
        x = np.clip(np.zeros_like(below), below, above)
        if movable.any():
            x[movable] = optimize.lsq_linear(
                factor[:, movable],
                right - factor[:, ~movable] @ x[~movable],
                (below[movable], above[movable]),
                method="bvls",
                tol=1e-12,
            ).x
    return np.asarray(np.clip(x * (height / scale), lower, upper))


def empty_triangle(columns: int) -> Array:
    """Return the factor of an empty problem: zeros, (columns, columns)."""
    return np.zeros((columns, columns), order="F")


def gather(triangle: Array, rows: Array, *, spend: bool = False) -> Array:
    """Update a triangular factor with further rows.

    triangle  (columns, columns)  from ``empty_triangle`` or ``gather``
    rows      (samples, columns)
    spend     whether column-major rows may be overwritten
    returned  (columns, columns), upper triangular

    The zeros of the triangle are not accessed.
    """
    columns = len(triangle)
    if triangle.shape != (columns, columns):
        raise ValueError(f"a triangle of shape {triangle.shape}, expected {columns, columns}")
    if not columns or not len(rows):
        return triangle
    block = np.asfortranarray(rows)
    may_overwrite = spend or block is not rows
    factorisation = lapack.dtpqrt(
        0,
        min(_REFLECTED_COLUMNS, columns),
        np.asfortranarray(triangle),
        block,
        overwrite_b=may_overwrite,
    )
    return cast(Array, factorisation[0])
