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
