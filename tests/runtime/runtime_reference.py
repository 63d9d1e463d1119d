"""What the runtime is compared with: the same mathematics in numpy, sample by sample.

Nothing here imports piezoid. The inverse keeps its own memory and its own thresholds, which the
runtime does not: two ways to the same numbers.
"""

import numpy as np


def follow(u, r, z):
    """Plays: z_i = max(u - r_i, min(u + r_i, z_i))."""
    return np.maximum(u - r, np.minimum(u + r, z))


def dead_zones(h, knot, weight):
    parts = np.where(knot > 0, np.maximum(h - knot, 0), np.minimum(h - knot, 0))
    return float(weight @ np.where(knot == 0, h, parts))


def forward(u, r, w, z, knot, weight):
    """Displacement and memory after every sample."""
    y = np.empty(len(u))
    for k, volts in enumerate(u):
        z = follow(volts, r, z)
        y[k] = dead_zones(float(w @ z), knot, weight)
    return y, z


def inverse_plays(r, w):
    W = np.cumsum(w)
    threshold = np.array([(w[: i + 1] * (r[i] - r[: i + 1])).sum() for i in range(len(r))])
    return threshold, np.r_[1 / W[0], -w[1:] / (W[1:] * W[:-1])]


def inverse_memory(w, z):
    W = np.cumsum(w)
    return np.array([W[i] * z[i] + (w[i + 1 :] * z[i + 1 :]).sum() for i in range(len(w))])


def inverse_dead_zones(knot, weight):
    zero = int(np.flatnonzero(knot == 0)[0])
    out, inverse = np.zeros(len(knot)), np.zeros(len(knot))
    inverse[zero] = 1 / weight[zero]
    for places in (range(zero + 1, len(knot)), range(zero - 1, -1, -1)):
        slope = weight[zero]
        for i in places:
            between = slice(min(i, zero), max(i, zero) + 1)
            out[i] = (weight[between] * (knot[i] - knot[between])).sum()
            inverse[i] = -weight[i] / ((slope + weight[i]) * slope)
            slope += weight[i]
    return out, inverse


def compensate(y, r, w, z, knot, weight, *, limit_V, lsb_V, synchronise):
    """Closed-form inverse, converter, and memory rebuilt from the forward memory, or not."""
    inverse_r, inverse_w = inverse_plays(r, w)
    inverse_knot, inverse_weight = inverse_dead_zones(knot, weight)
    inverse_z = inverse_memory(w, z)
    u = np.empty(len(y))
    for k, wanted in enumerate(y):
        q = dead_zones(wanted, inverse_knot, inverse_weight)
        inverse_z = follow(q, inverse_r, inverse_z)
        u[k] = np.clip(inverse_w @ inverse_z, -limit_V, limit_V)
        if lsb_V:
            u[k] = lsb_V * np.round(u[k] / lsb_V)
        z = follow(u[k], r, z)
        if synchronise:
            inverse_z = inverse_memory(w, z)
    return u


def nested(z, u, r):
    """The nearest memory, in order, that an input ending at u can have left behind."""
    z = np.array(z, dtype=float)
    z[0] = u
    for i in range(1, len(r)):
        step = r[i] - r[i - 1]
        z[i] = min(max(z[i], z[i - 1] - step), z[i - 1] + step)
    return z


def random_model(rng, *, plays, knots_each_side, negative=False):
    """Thresholds, weights, memory and dead zones of an invertible model, and its input before."""
    r = np.r_[0.0, np.cumsum(rng.uniform(0.1, 1.0, plays - 1))]
    W = rng.uniform(0.3, 1.5, plays) if negative else np.cumsum(rng.uniform(0.05, 0.5, plays))
    w = np.diff(np.r_[0.0, W])
    last = float(rng.uniform(-1, 1))
    z = nested(rng.uniform(-2, 2, plays), last, r)
    side = [np.cumsum(rng.uniform(0.3, 2.0, knots_each_side)) for _ in range(2)]
    slope = [rng.uniform(0.5, 1.8, knots_each_side) for _ in range(2)]
    zero = rng.uniform(0.5, 1.8)
    up, down = (np.diff(np.r_[zero, s]) for s in slope)
    return {
        "r": r,
        "w": w,
        "z": z,
        "knot": np.r_[-side[1][::-1], 0.0, side[0]],
        "weight": np.r_[down[::-1], zero, up],
        "last": last,
    }
