"""The least of a function without derivatives, within bounds and, where asked, a limit.

    min_x f(x),   l <= x <= u,   g(x) <= 0

Without a limit by subspaces of the simplex (Sbplx), behind a search of the whole box (DIRECT-L)
where the start says little; with one by linear models on a simplex (COBYLA).

Source: Rowan, PhD thesis, University of Texas (1990); Gablonsky & Kelley, J. Global Optim. 21
(2001); Powell, in Advances in Optimization and Numerical Analysis (1994). What goes wrong: in more
than some ten numbers the search creeps. The same input gives the same output.
"""

from collections.abc import Callable

import numpy as np

from piezoid.numerics.arrays import Array

NONE = 1e30  # what the solver takes for no bound
EQUAL = 5  # its word for a number that bounds fix
SOLVED = 1
TOLERANCE = 1e-11  # of a number about 1: how far it may stand outside before it is moved

Function = Callable[[Array], float]


def least(
    function: Function,
    start: Array,
    bounds: tuple[Array, Array],
    *,
    step: Array | float,
    evaluations: int,
    limit: Function | None = None,
    within: float = 0.0,
    globally: int = 0,
) -> tuple[Array, float]:
    """Return the best numbers found, and the function there.

    start        (numbers,)
    bounds       (numbers,) each, finite
    step         (numbers,)  how far to look at first
    evaluations  most values of the function asked for
    limit        g, met where it is not above 0
    within       how small steps get before the search ends; 0: at the evaluations alone
    globally     how many values of the whole box are asked for first
    """
    import nlopt

    chosen = nlopt.LN_SBPLX if limit is None else nlopt.LN_COBYLA
    stages = [(nlopt.GN_DIRECT_L, globally)] if globally else []
    x, found = start, np.inf
    for algorithm, count in [*stages, (chosen, evaluations)]:
        search = nlopt.opt(algorithm, len(start))
        search.set_lower_bounds(bounds[0])
        search.set_upper_bounds(bounds[1])
        search.set_min_objective(lambda x, _: function(x))
        search.set_maxeval(count)
        if algorithm == chosen:
            search.set_initial_step(step)
            search.set_xtol_abs(within)
        if limit is not None:
            search.add_inequality_constraint(lambda x, _: limit(x), 0.0)
        x = search.optimize(x)
        found = float(search.last_optimum_value())
    return np.asarray(x), found


def bounded_minimum(gram: Array, right: Array, lower: Array, upper: Array) -> Array:
    """Minimise x' G x / 2 - b' x with l <= x <= u.

    G, b  (numbers, numbers), (numbers,)  G positive definite
    l, u  (numbers,)  l <= u; equal bounds fix a number

    Nothing is small or large by itself: b and the bounds in other units give x in other units. A
    number that its bound holds back stands on it exactly.

    Source: Arnstroem, Bemporad & Axehill, IEEE Transactions on Automatic Control 67 (2022), as
    daqp has it. What goes wrong: ``LinAlgError`` for a G that is not definite to rounding; whoever
    damps it avoids that.
    """
    import daqp

    length = np.sqrt(np.maximum(np.diag(gram), 0.0))
    length[length == 0.0] = 1.0
    asked = np.clip(np.zeros_like(length), lower, upper) * length
    height = float(max(np.linalg.norm(right / length), np.linalg.norm(asked))) or 1.0
    below, above = lower * (length / height), upper * (length / height)
    found, _, flag, told = daqp.solve(
        gram / np.outer(length, length),
        -right / (length * height),
        np.empty((0, len(length))),
        np.minimum(above, NONE),
        np.maximum(below, -NONE),
        np.where(lower >= upper, EQUAL, 0).astype(np.int32),
        primal_tol=TOLERANCE,
    )
    if flag != SOLVED:
        raise np.linalg.LinAlgError(f"the quadratic form was not minimised: daqp says {flag}")
    pressed = told["lam"][: len(length)]
    x = np.where(pressed < 0.0, lower, np.where(pressed > 0.0, upper, found * (height / length)))
    return np.clip(x, lower, upper)
