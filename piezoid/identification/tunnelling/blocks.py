"""Covariance of an estimate whose residuals are correlated: leave out one block at a time.

Neighbouring points of a sweep share drift, creep and vibration; an interval that counts them as
independent is far too narrow. Blocks of neighbours, each holding an equal share of what is known
about the decay, are left out in turn, which also charges the estimate for a model that does not
quite fit (jackknife form of the clustered sandwich; Bell & McCaffrey 2002).
"""

import numpy as np

from piezoid.numerics.arrays import Array


def equal_information_blocks(height_m: Array, score: Array, *, count: int) -> Array:
    """Return the block of each point, (points,) whole numbers, neighbours in height together.

    height_m  (points,)  m; points of several sweeps at one height share a block
    score     (points,)  what each point knows about the parameter of interest, >= 0
    count     blocks at most; fewer when single heights hold more than a share
    """
    heights, place = np.unique(height_m, return_inverse=True)
    known = np.bincount(place, weights=score, minlength=len(heights))
    share = (np.cumsum(known) - 0.5 * known) / max(float(known.sum()), 1e-300)
    raw = np.minimum((share * count).astype(int), count - 1)
    block: Array = np.unique(raw, return_inverse=True)[1][place].astype(np.float64)
    return block


def leave_one_block_out(jacobian: Array, residual: Array, block: Array) -> Array:
    """Return the jackknife covariance of a least squares estimate, (parameters, parameters).

        C = (G - 1)/G sum_g delta_g delta_g',   delta_g = -(H - H_g)^-1 J_g' r_g,   H = J' J

    J  jacobian  (points, parameters)  whitened: divided by each point's standard deviation
    r  residual  (points,)             whitened
    g  block     (points,)             whole numbers from 0

    What only one block knows (an amplitude inside it) is left to the pseudo-inverse.
    """
    information = jacobian.T @ jacobian
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    scaled = jacobian * scale
    whole = scaled.T @ scaled
    count = int(block.max()) + 1
    covariance = np.zeros_like(whole)
    for g in range(count):
        part = scaled[block == g]
        delta = np.linalg.pinv(whole - part.T @ part, rcond=1e-10) @ (
            part.T @ residual[block == g]
        )
        covariance += np.outer(delta, delta)
    unscaled: Array = covariance * (count - 1) / max(count, 1) * np.outer(scale, scale)
    return unscaled


def partial_score(jacobian: Array, column: int) -> Array:
    """Return each point's share in the information about one parameter, the others unknown.

    jacobian  (points, parameters)  whitened
    returned  (points,)             squared, so that the sum is 1 / variance
    """
    others = np.delete(jacobian, column, axis=1)
    wanted = jacobian[:, column]
    explained = others @ np.linalg.lstsq(others, wanted, rcond=None)[0]
    share: Array = (wanted - explained) ** 2
    return share
