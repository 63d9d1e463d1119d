"""A Dahl wall: solid friction between domain walls and lattice, with Dahl's exponent.

    dz/dx = sigma (1 - s z)^i,     x = E + b (sqrt(1 + E^2) - 1),     s = +1 rising, -1 falling

The friction force z reaches its largest magnitude, 1, after a long motion in one direction. The
strain is the difference ``g x - z`` of scale and friction, with g the steepest slope of z, so
that no branch runs backwards. With w = 1 - s z a branch has a closed form,

    w = (w0^(1 - i) - (1 - i) sigma |x - x0|)^(1 / (1 - i)),     i = 1: w = w0 exp(-sigma |x - x0|)

A reversal is forgotten gradually and never wiped out, and minor loops drift before they close. The
curvature b of the scale makes loops depend on bias.

Source: Dahl, A solid friction model, Aerospace Corp. TOR-0158 (1968); for piezo stages Xu & Li,
J. Dyn. Syst. Meas. Control 132 (2010) 041011.
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

LINEAR = 1e-6  # of the exponent about 1, where the power turns into the exponential


@dataclass(frozen=True, kw_only=True)
class Dahl:
    """Stiffness sigma per unit of the scale, exponent i, bend b of the scale."""

    stiffness: float
    exponent: float
    bend: float

    def scale(self, field: Array) -> Array:
        """Return x of a field."""
        return field + self.bend * (np.sqrt(1.0 + field**2) - 1.0)

    @property
    def steepest(self) -> float:
        """The slope of a branch that turns back from full friction."""
        return float(self.stiffness * 2.0**self.exponent)

    def slack(self, begun: float, travelled: Array) -> Array:
        """Return the distance 1 - s z to full friction after a distance along one branch."""
        power = 1.0 - self.exponent
        if abs(power) < LINEAR:
            return np.asarray(begun * np.exp(-self.stiffness * travelled))
        left = begun**power - power * self.stiffness * travelled
        return np.asarray(np.maximum(left, 0.0) ** (1.0 / power))


def dahl_memory(law: Dahl, path: Array) -> Array:
    """Return ``g x - z`` along a path that starts at full friction."""
    path = settled(path)
    place = law.scale(path)
    friction = np.full_like(path, -1.0)
    for start, end, rising in branches(path):
        sign = 1.0 if rising else -1.0
        travelled = sign * (place[start : end + 1] - place[start])
        slack = law.slack(1.0 - sign * float(friction[start]), travelled)
        friction[start : end + 1] = sign * (1.0 - slack)
    return law.steepest * place - friction


def draw_dahl(rng: np.random.Generator) -> Ceramic:
    """Draw a wall that reaches full friction within about the drive range."""
    law = Dahl(
        stiffness=float(rng.uniform(1.6, 2.6)),
        exponent=float(rng.uniform(1.0, 1.4)),
        bend=float(rng.choice([-1.0, 1.0]) * rng.uniform(0.1, 0.35)),
    )
    reversible = gentle_curve(rng)
    return ceramic_with_opening(
        float(rng.uniform(0.08, 0.13)), reversible, lambda path: dahl_memory(law, path)
    )


TRUTH = Truth(name="dahl", draw=draw_dahl)
