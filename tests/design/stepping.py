"""A loop stepped sample by sample: with the observer, or with its polynomials."""

import numpy as np

from piezoid.design.observer import DisturbanceObserver
from piezoid.design.plant import Plant
from piezoid.design.rst import RstController
from piezoid.numerics.arrays import Array


def with_observer(
    plant: Plant, o: DisturbanceObserver, reference: Array, d_V: Array, noise: Array
) -> tuple[Array, Array]:
    """Step plant and observer as the runtime does; return outputs and innovations."""
    A, B, C = plant.realised()
    c = o.disturbance.output
    x, x_, w_ = np.zeros(len(A)), np.zeros(len(o.A)), np.zeros(len(c))
    y, nu = np.empty(len(reference)), np.empty(len(reference))
    for k, r in enumerate(reference):
        y[k] = C @ x
        nu[k] = y[k] + noise[k] - o.C @ x_
        xh, wh = x_ + o.state_gain * nu[k], w_ + o.disturbance_gain * nu[k]
        v = o.reference_gain * r - o.feedback_gain @ xh - c @ wh
        x = A @ x + B * (v + d_V[k])
        x_, w_ = o.A @ xh + o.B * (v + c @ wh), o.disturbance.transition @ wh
    return y, nu


def with_polynomials(
    plant: Plant, c: RstController, reference: Array, d_V: Array, d_y: Array
) -> Array:
    """Step S u = T r - R y and A (y - d_y) = B (u + d_V); return outputs."""
    n = len(reference)
    u, y = np.zeros(n), np.zeros(n)
    for k in range(n):
        y[k] = d_y[k] + past(plant.B, u + d_V, k) - past(plant.A, y - d_y, k)
        u[k] = c.T[0] * reference[k] + past(c.T, reference, k)
        u[k] -= c.R[0] * y[k] + past(c.R, y, k) + past(c.S, u, k)
    return y


def past(polynomial: Array, signal: Array, k: int) -> float:
    """Return what a polynomial in q^-1 makes of samples before the k-th."""
    reach = range(1, min(k, len(polynomial) - 1) + 1)
    return float(sum(polynomial[j] * signal[k - j] for j in reach))
