"""A slowly driven LuGre wall: bristles with a Coulomb level that depends on the position.

    dz/dE = sigma (1 - s z / L(E)),     L(E) = 1 + a tanh((E - E0) / w) + b exp(-(E - E0)^2 / w^2)

This is LuGre's law below the Stribeck speed without bristle damping, which is rate independent.
The strain is the difference ``g E - z`` of field and friction, with g a bound of the slope of z.
Because L varies over the range, loops of equal span depend on bias. A reversal is forgotten
gradually; minor loops drift before they close.

Source: Canudas de Wit, Olsson, Astrom & Lischinsky, IEEE Trans. Autom. Control 40 (1995) 419; a
level that varies with position as in Hensen, van de Molengraft & Steinbuch, ibid. 47 (2002).
"""

import math
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
class LuGre:
    """Bristle stiffness, and the Coulomb level: its tilt, its hump, their centre and width."""

    stiffness: float
    tilt: float
    hump: float
    centre: float
    width: float

    def level(self, field: float) -> float:
        """Return the friction after a long motion in one direction."""
        place = (field - self.centre) / self.width
        return 1.0 + self.tilt * math.tanh(place) + self.hump * math.exp(-place * place)

    def slope(self, field: float, state: float, sign: float) -> float:
        """Return dz/dE."""
        return self.stiffness * (1.0 - sign * state / self.level(field))

    @property
    def steepest(self) -> float:
        """A bound of the slope: full friction of the highest level against the lowest."""
        most, least = 1.0 + abs(self.tilt) + max(self.hump, 0.0), 1.0 - abs(self.tilt)
        return self.stiffness * (1.0 + most / (least + min(self.hump, 0.0)))


def lugre_memory(law: LuGre, path: Array) -> Array:
    """Return ``g E - z`` along a path that starts at full friction."""
    path = settled(path)
    return law.steepest * path - states_along(law.slope, path, -law.level(float(path[0])))


def draw_lugre(rng: np.random.Generator) -> Ceramic:
    """Draw a wall whose friction differs by some ten percent over the drive range."""
    law = LuGre(
        stiffness=float(rng.uniform(1.8, 2.8)),
        tilt=float(rng.choice([-1.0, 1.0]) * rng.uniform(0.1, 0.25)),
        hump=float(rng.uniform(-0.15, 0.25)),
        centre=float(rng.uniform(-0.4, 0.4)),
        width=float(rng.uniform(0.6, 1.2)),
    )
    reversible = gentle_curve(rng)
    return ceramic_with_opening(
        float(rng.uniform(0.08, 0.11)), reversible, lambda path: lugre_memory(law, path)
    )


TRUTH = Truth(name="lugre", draw=draw_lugre)
