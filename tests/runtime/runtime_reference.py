"""Reference implementation of the runtime in numpy, sample by sample, without piezoid."""

import numpy as np


def follow(u, r, z):
    """Return the next play states z_i = max(u - r_i, min(u + r_i, z_i))."""
    return np.maximum(u - r, np.minimum(u + r, z))


def dead_zones(h, knot, weight):
    parts = np.where(knot > 0, np.maximum(h - knot, 0), np.minimum(h - knot, 0))
    return float(weight @ np.where(knot == 0, h, parts))


def forward(u, r, w, z, knot, weight):
    """Return the displacement of every sample and the last memory."""
    y = np.empty(len(u))
    for k, volts in enumerate(u):
        z = follow(volts, r, z)
        y[k] = dead_zones(float(w @ z), knot, weight)
    return y, z


def admissible_memory(z, u, r):
    """Return the nearest memory that an input history ending at u can have."""
    z = np.array(z, dtype=float)
    z[0] = u
    for i in range(1, len(r)):
        step = r[i] - r[i - 1]
        z[i] = min(max(z[i], z[i - 1] - step), z[i - 1] + step)
    return z


def random_model(rng, *, plays, knots_each_side, negative=False):
    """Draw the parameters, the memory and the last input of an invertible model."""
    r = np.r_[0.0, np.cumsum(rng.uniform(0.1, 1.0, plays - 1))]
    W = rng.uniform(0.3, 1.5, plays) if negative else np.cumsum(rng.uniform(0.05, 0.5, plays))
    w = np.diff(np.r_[0.0, W])
    last_V = float(rng.uniform(-1, 1))
    z = admissible_memory(rng.uniform(-2, 2, plays), last_V, r)
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
        "last": last_V,
    }
