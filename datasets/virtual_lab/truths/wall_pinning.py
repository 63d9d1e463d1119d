"""A ceramic of pinned domain walls: polarisation relaxes along the field, not in time.

    dP/dE = s (A(E) - P) / k,   s = +1 rising, -1 falling

P approaches the anhysteretic curve A(E) of an unpinned wall over a field of about k. This is Jiles
and Atherton's law without mean field, which is Coleman and Hodgdon's Duhem law with the derivative
of A as its second function. It is linear in P, so a branch from
(E0, P0) has a closed form with one quadrature M of the anhysteretic curve:

    P(E) = (P0 - M(E0)) exp(-|E - E0| / k) + M(E),   M = the branch from far away

Because A is curved and skewed, loops of equal span depend on bias, and minor loops shift from
cycle to cycle before they close.

Source: Jiles & Atherton, J. Magn. Magn. Mater. 61 (1986); Smith & Hom, SPIE 3667 (1999);
Coleman & Hodgdon, Int. J. Eng. Sci. 24 (1986).
"""

import numpy as np

from piezoid_datasets.virtual_lab.signals import Array, first_order
from piezoid_datasets.virtual_lab.truths.branches import branches, settled
from piezoid_datasets.virtual_lab.truths.truth import (
    FLOOR,
    Ceramic,
    Curve,
    Truth,
    ceramic_with_opening,
    gentle_curve,
)

GRID_PER_FIELD = 4000
FAR = -FLOOR  # fields tabulated: from -FAR to FAR


def wall_pinning_memory(anhysteretic: Curve, pinning: float, path: Array) -> Array:
    """Return the polarisation along a path that starts on the rising branch from far away."""
    path = settled(path)
    field = np.linspace(-FAR, FAR, round(2 * FAR * GRID_PER_FIELD) + 1)
    target = anhysteretic(field)
    # on a branch the field plays the part of time: a first-order lag of "time constant" k
    rising_curve = first_order(target, pinning, GRID_PER_FIELD, float(target[0]))
    falling_curve = first_order(target[::-1].copy(), pinning, GRID_PER_FIELD, float(target[-1]))
    on_rising = np.interp(path, field, rising_curve)
    on_falling = np.interp(path, field, falling_curve[::-1])
    output = np.full_like(path, on_rising[0])
    for start, end, rising in branches(path):
        far = on_rising if rising else on_falling
        travelled = np.abs(path[start : end + 1] - path[start])
        memory = (output[start] - far[start]) * np.exp(-travelled / pinning)
        output[start : end + 1] = far[start : end + 1] + memory
    return output


def draw_wall_pinning(rng: np.random.Generator) -> Ceramic:
    """Draw a skewed anhysteretic curve and a pinning field of a fraction of the drive range."""
    pinning = float(rng.uniform(0.25, 0.6))
    centre, width = float(rng.uniform(-0.4, 0.4)), float(rng.uniform(1.0, 2.0))
    skew = float(rng.uniform(0.0, 0.3))
    reversible = gentle_curve(rng)

    def anhysteretic(field: Array) -> Array:
        shape = np.tanh((field - centre) / width)
        return shape + skew * shape**2

    return ceramic_with_opening(
        float(rng.uniform(0.08, 0.14)),
        reversible,
        lambda path: wall_pinning_memory(anhysteretic, pinning, path),
    )


TRUTH = Truth(name="wall_pinning", draw=draw_wall_pinning)
