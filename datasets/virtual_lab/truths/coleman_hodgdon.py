"""A Coleman-Hodgdon ceramic, with the piecewise linear functions of its authors.

    dP/dE = alpha s (f(E) - P) + g(E),     s = +1 rising, -1 falling

f is odd about E0, of slope 1 up to the knee and of a smaller slope beyond; g is the slope of f
times a fraction below the knee, and the slope of f beyond, without losses. Loops close at the
knees, kink there, and drift towards the anhysteretic curve before they close.

Source: Coleman & Hodgdon, Int. J. Eng. Sci. 24 (1986) 897; for piezo stages Banning, de Koning,
Adriaens & Koops, Automatica 37 (2001) 1883.
"""

from dataclasses import dataclass

import numpy as np

from piezoid_datasets.virtual_lab.signals import Array
from piezoid_datasets.virtual_lab.truths.branches import settled
from piezoid_datasets.virtual_lab.truths.differential import states_along
from piezoid_datasets.virtual_lab.truths.truth import (
    Ceramic,
    Truth,
    ceramic_with_opening,
    gentle_curve,
)


@dataclass(frozen=True, kw_only=True)
class ColemanHodgdon:
    """Pull alpha, share of g in the slope of f, centre, knee, and the slope of f beyond it."""

    pull: float
    share: float
    centre: float
    knee: float
    beyond: float

    @property
    def jumps(self) -> tuple[float, float]:
        """Fields of the two knees."""
        return self.centre - self.knee, self.centre + self.knee

    def anhysteretic(self, field: float) -> float:
        """Return f."""
        place = field - self.centre
        inner = min(max(place, -self.knee), self.knee)
        return inner + self.beyond * (place - inner)

    def slope(self, field: float, state: float, sign: float) -> float:
        """Return dP/dE."""
        low, high = self.jumps
        lossy = self.share if low < field < high else self.beyond
        return self.pull * sign * (self.anhysteretic(field) - state) + lossy


def coleman_hodgdon_memory(law: ColemanHodgdon, path: Array) -> Array:
    """Return P along a path that starts on the anhysteretic curve, far below the knee."""
    path = settled(path)
    start = law.anhysteretic(float(path[0]))
    return states_along(law.slope, path, start, jumps=law.jumps)


def draw_coleman_hodgdon(rng: np.random.Generator) -> Ceramic:
    """Draw knees towards the ends of the drive range."""
    law = ColemanHodgdon(
        pull=float(rng.uniform(1.1, 1.7)),
        share=float(rng.uniform(0.5, 0.58)),
        centre=float(rng.uniform(-0.25, 0.25)),
        knee=float(rng.uniform(0.8, 1.1)),
        beyond=float(rng.uniform(0.6, 0.8)),
    )
    reversible = gentle_curve(rng)
    return ceramic_with_opening(
        float(rng.uniform(0.08, 0.13)), reversible, lambda path: coleman_hodgdon_memory(law, path)
    )


TRUTH = Truth(name="coleman_hodgdon", draw=draw_coleman_hodgdon)
