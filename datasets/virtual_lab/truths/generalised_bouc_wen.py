"""A generalised Bouc-Wen ceramic: loading and unloading differ in all six signs.

    dz/dx = 1 - |z|^n psi,     x = E - E0,     s = sgn(dx)
    psi = b1 sgn(s z) + b2 sgn(s x) + b3 sgn(x z) + b4 s + b5 sgn(z) + b6 sgn(x)

The strain is the difference ``g x - z`` of field and state, with g a bound of the slope of z.
Loops are asymmetric with a kink where x changes sign; minor loops do not close exactly and do not
wipe each other out.

Source: Song & Der Kiureghian, J. Eng. Mech. 132 (2006) 610.
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
class GeneralisedBoucWen:
    """Sharpness n, the six shape factors b1 to b6, and the centre E0 of the scale."""

    sharpness: float
    shape: tuple[float, float, float, float, float, float]
    centre: float

    def slope(self, field: float, state: float, sign: float) -> float:
        """Return dz/dx."""
        b1, b2, b3, b4, b5, b6 = self.shape
        z, x = math.copysign(1.0, state), math.copysign(1.0, field - self.centre)
        psi = b1 * sign * z + b2 * sign * x + b3 * x * z + b4 * sign + b5 * z + b6 * x
        return 1.0 - float(abs(state) ** self.sharpness) * psi

    @property
    def rest(self) -> float:
        """Sum of all shape factors but the first; it must be smaller than the first."""
        return sum(map(abs, self.shape[1:]))

    @property
    def saturation(self) -> float:
        """A bound of the state."""
        return float((self.shape[0] - self.rest) ** (-1.0 / self.sharpness))

    @property
    def steepest(self) -> float:
        """A bound of the slope."""
        return 1.0 + float(self.saturation**self.sharpness) * (self.shape[0] + self.rest)


def generalised_bouc_wen_memory(law: GeneralisedBoucWen, path: Array) -> Array:
    """Return ``g x - z`` along a path that starts saturated."""
    path = settled(path)
    b1, b2, b3, b4, b5, b6 = law.shape
    first = -float((b1 - b2 + b3 + b4 - b5 - b6) ** (-1.0 / law.sharpness))
    return law.steepest * path - states_along(law.slope, path, first, jumps=(law.centre,))


def draw_generalised_bouc_wen(rng: np.random.Generator) -> Ceramic:
    """Draw a law whose loops saturate within about the drive range."""
    first = float(rng.uniform(1.6, 2.8))
    b2, b3, b4, b5, b6 = (first * rng.uniform(-0.08, 0.08, 5)).tolist()
    law = GeneralisedBoucWen(
        sharpness=float(rng.uniform(1.0, 1.8)),
        shape=(first, b2, b3, b4, b5, b6),
        centre=float(rng.uniform(-0.3, 0.3)),
    )
    reversible = gentle_curve(rng)
    return ceramic_with_opening(
        float(rng.uniform(0.08, 0.14)),
        reversible,
        lambda path: generalised_bouc_wen_memory(law, path),
    )


TRUTH = Truth(name="generalised_bouc_wen", draw=draw_generalised_bouc_wen)
