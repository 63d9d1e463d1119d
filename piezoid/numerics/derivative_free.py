"""Derivative-free minimisation within bounds, with an optional constraint.

    min_x f(x),   l <= x <= u,   g(x) <= 0

Unconstrained problems are solved by subspace simplex search (Sbplx), optionally after a global
search of the box (DIRECT-L); constrained ones by linear models on a simplex (COBYLA). Slow in more
than ten variables. Deterministic.

Source: Rowan, PhD thesis, University of Texas (1990); Gablonsky & Kelley, J. Global Optim. 21
(2001); Powell, in Advances in Optimization and Numerical Analysis (1994).
"""

from collections.abc import Callable

import numpy as np

from piezoid.numerics.arrays import Array

Function = Callable[[Array], float]


def direct_search(
    function: Function,
    start: Array,
    bounds: tuple[Array, Array],
    *,
    initial_step: Array | float,
    max_evaluations: int,
    constraint: Function | None = None,
    step_tolerance: float = 0.0,
    global_evaluations: int = 0,
) -> tuple[Array, float]:
    """Minimise a function without derivatives; return the minimiser and the minimum.

    start               (variables,)
    bounds              (variables,) each, finite
    initial_step        (variables,)  size of the first steps
    max_evaluations     of the function in the local search
    constraint          g, satisfied if g <= 0
    step_tolerance      step size that ends the search; 0: only ``max_evaluations`` ends it
    global_evaluations  of the function over the whole box before the local search
    """
    import nlopt

    local = nlopt.LN_SBPLX if constraint is None else nlopt.LN_COBYLA
    stages = [(nlopt.GN_DIRECT_L, global_evaluations)] if global_evaluations else []
    x, minimum = start, np.inf
    for algorithm, evaluations in [*stages, (local, max_evaluations)]:
        search = nlopt.opt(algorithm, len(start))
        search.set_lower_bounds(bounds[0])
        search.set_upper_bounds(bounds[1])
        search.set_min_objective(lambda x, _: function(x))
        search.set_maxeval(evaluations)
        if algorithm == local:
            search.set_initial_step(initial_step)
            search.set_xtol_abs(step_tolerance)
        if constraint is not None:
            search.add_inequality_constraint(lambda x, _: constraint(x), 0.0)
        x = search.optimize(x)
        minimum = float(search.last_optimum_value())
    return np.asarray(x), minimum
