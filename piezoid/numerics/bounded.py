"""The least of a convex quadratic form within bounds, by a dual active-set solver."""

import numpy as np

from piezoid.numerics.arrays import Array

NONE = 1e30  # what the solver takes for no bound
EQUAL = 5  # its word for a number that bounds fix
SOLVED = 1
TOLERANCE = 1e-11  # of a number about 1: how far it may stand outside before it is moved


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
