"""A Duhem ceramic: rising and falling fields switch by functions of their own.

    dP/dE = A+(E) (1 - P)   rising,       dP/dE = A-(E) (1 + P)   falling
    A+-(E) = r exp(-((E -+ h+- - E0) / w+-)^2)

Rising, what is not yet switched up switches about the field E0 + h+; falling, what is up switches
down about E0 - h-. Both slopes are never negative. A branch has a closed form with one table F of
the integral of A: ``1 - P = (1 - P0) exp(-(F+(E) - F+(E0)))``, and likewise falling. It forgets a
reversal gradually: minor loops move from cycle to cycle before they close, nothing is wiped out.

Source: Duhem, Z. Phys. Chem. 22 (1897); Macki, Nistri & Zecca, SIAM Rev. 35 (1993) 94; for piezo
stages Lin & Lin, Comput. Math. Appl. 64 (2012) 766.
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


@dataclass(frozen=True, kw_only=True)
class Duhem:
    """Rate r of switching per field, centre E0, coercive fields h and widths w, up and down."""

    rate: float
    centre: float
    coercive: tuple[float, float]
    width: tuple[float, float]

    def switched(self, field: Array, *, rising: bool) -> Array:
        """Return F, the integral of A+ or A- up to a field."""
        from scipy.special import erf

        place = self.centre + (self.coercive[0] if rising else -self.coercive[1])
        width = self.width[0 if rising else 1]
        whole = 0.5 * np.sqrt(np.pi) * self.rate * width
        return np.asarray(whole * (1.0 + erf((field - place) / width)))


def duhem_memory(law: Duhem, path: Array) -> Array:
    """Return P along a path that starts with everything switched down."""
    path = settled(path)
    up, down = law.switched(path, rising=True), law.switched(path, rising=False)
    state = np.full_like(path, -1.0)
    for start, end, rising in branches(path):
        sign, switched = (1.0, up) if rising else (-1.0, down)
        way = sign * (switched[start : end + 1] - switched[start])
        state[start : end + 1] = sign * (1.0 - (1.0 - sign * state[start]) * np.exp(-way))
    return state


def draw_duhem(rng: np.random.Generator) -> Ceramic:
    """Draw coercive fields inside the drive range, unlike for either direction."""
    law = Duhem(
        rate=float(rng.uniform(1.6, 2.2)),
        centre=float(rng.uniform(-0.15, 0.15)),
        coercive=(float(rng.uniform(0.55, 0.75)), float(rng.uniform(0.55, 0.75))),
        width=(float(rng.uniform(0.45, 0.6)), float(rng.uniform(0.45, 0.6))),
    )
    reversible = gentle_curve(rng)
    return ceramic_with_opening(
        float(rng.uniform(0.08, 0.14)), reversible, lambda path: duhem_memory(law, path)
    )


TRUTH = Truth(name="duhem", draw=draw_duhem)
