"""A Maxwell-slip ceramic: springs that slide, each at a force that grows along the range.

    df = dx,   |f| <= b (1 + e x),    x = E + c2 E^2 + c3 E^3;     strain = sum of k (x - f)

Many elements with breaks b spread over the range make a smooth loop; a break that depends on the
position, and a bent scale, make loops depend on bias. On a rising branch an element is
``min(f0 + x - x0, b (1 + e x))``. Wiping-out holds: element by element it is a play with two
increasing sides.

Source: Goldfarb & Celanovic, IEEE Control Syst. 17 (1997) 69, and J. Dyn. Syst. Meas. Control 119
(1997) 478.
"""

from dataclasses import dataclass

import numpy as np

from piezoid_datasets.virtual_lab.signals import Array
from piezoid_datasets.virtual_lab.truths.branches import branches, settled
from piezoid_datasets.virtual_lab.truths.truth import (
    Ceramic,
    Truth,
    ceramic_with_opening,
    gentle_curve,
)

ELEMENTS = 40
AT_ONCE = 4096  # samples, so that a long branch stays within a few megabytes


@dataclass(frozen=True, kw_only=True, eq=False)
class MaxwellSlip:
    """Breaks b, stiffnesses k (elements,), growth e of the breaks, bends c2, c3 of the scale."""

    breaks: Array
    stiffness: Array
    growth: float
    bends: tuple[float, float]

    def scale(self, field: Array) -> Array:
        """Return x of a field; it goes straight on outside the drive range."""
        inside = np.clip(field, -1.2, 1.2)
        bent = inside + self.bends[0] * inside**2 + self.bends[1] * inside**3
        return bent + (field - inside)

    def limit(self, place: Array) -> Array:
        """Return the largest force of each element (..., elements)."""
        return np.multiply.outer(1.0 + self.growth * np.clip(place, -1.3, 1.3), self.breaks)


def maxwell_slip_memory(law: MaxwellSlip, path: Array) -> Array:
    """Return the strain along a path that starts with every element sliding."""
    path = settled(path)
    place = law.scale(path)
    force = -law.limit(place[0])
    output = np.full(len(path), float(law.stiffness @ (place[0] - force)))
    for start, end, rising in branches(path):
        sign = 1.0 if rising else -1.0
        for first in range(start, end, AT_ONCE):
            piece = slice(first + 1, min(first + AT_ONCE, end) + 1)
            stuck = sign * (force + (place[piece] - place[first])[:, None])
            forces = sign * np.minimum(stuck, law.limit(place[piece]))
            output[piece] = (place[piece, None] - forces) @ law.stiffness
            force = forces[-1]
    return output


def draw_maxwell_slip(rng: np.random.Generator) -> Ceramic:
    """Draw breaks of all sizes up to a good part of the range."""
    breaks = np.linspace(0.0, 1.0, ELEMENTS + 1)[1:]
    law = MaxwellSlip(
        breaks=breaks,
        stiffness=np.exp(-breaks / rng.uniform(0.3, 0.8)) * rng.uniform(0.7, 1.3, ELEMENTS),
        growth=float(rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 0.4)),
        bends=(float(rng.uniform(-0.1, 0.1)), float(rng.uniform(-0.05, 0.05))),
    )
    reversible = gentle_curve(rng)
    return ceramic_with_opening(
        float(rng.uniform(0.08, 0.14)), reversible, lambda path: maxwell_slip_memory(law, path)
    )


TRUTH = Truth(name="maxwell_slip", draw=draw_maxwell_slip)
