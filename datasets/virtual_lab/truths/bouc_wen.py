"""A Bouc-Wen ceramic: one state that saturates smoothly.

    dz/dp = 1 - |z|^n (gamma + beta sgn(z dp)),       p = E + b (sqrt(1 + E^2) - 1)

The scale p of the field E is increasing for |b| < 1 and makes the loops depend on bias. The state
leads the field, so the strain is the difference ``g p - z``, with g the steepest slope of z, so
that no branch runs backwards.

Along a rising branch the equation is autonomous, so all rising branches are shifted pieces of one
master curve Z(p); falling branches are its mirror image. The curve is integrated once, and each
branch of a recording costs one interpolation. Minor loops do not close exactly and do not wipe
each other out, unlike any superposition of plays or Preisach hysterons.

Source: Wen, J. Eng. Mech. 102 (1976); for piezo stages Low & Guo, J. MEMS 4 (1995).
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

STEPS = 40_000  # of the master curve; interpolation then errs by less than 1e-9 of the loop
NEARLY = 1.0 - 1e-6  # of saturation, where the curve ends


@dataclass(frozen=True, kw_only=True)
class BoucWen:
    """Sharpness n, loading and unloading (beta > 0, |gamma| < beta), bend b of the scale."""

    sharpness: float
    beta: float
    gamma: float
    bend: float

    def scale(self, field: Array) -> Array:
        """Return p of a field."""
        return field + self.bend * (np.sqrt(1.0 + field**2) - 1.0)

    @property
    def saturation(self) -> float:
        """Upper limit of the state on rising branches."""
        return float((self.beta + self.gamma) ** (-1.0 / self.sharpness))

    @property
    def steepest(self) -> float:
        """The slope of a branch that has just left saturation."""
        return 2.0 * self.beta / (self.beta + self.gamma)

    def slope(self, state: Array) -> Array:
        """Return dz/dp on a rising branch."""
        grip = self.gamma + self.beta * np.sign(state)
        return np.asarray(1.0 - grip * np.abs(state) ** self.sharpness)


def bouc_wen_memory(law: BoucWen, path: Array) -> Array:
    """Return ``g p - z`` along a path of fields that starts saturated."""
    path = settled(path)
    drive = law.scale(path)
    position, state = master_curve(law)
    z = np.full_like(path, state[0])
    for start, end, rising in branches(path):
        sign = 1.0 if rising else -1.0
        entry = np.interp(sign * z[start], state, position)
        reached = entry + sign * (drive[start : end + 1] - drive[start])
        z[start : end + 1] = sign * np.interp(reached, position, state)
    return law.steepest * drive - z


def master_curve(law: BoucWen) -> tuple[Array, Array]:
    """Return (p, z) along the rising branch from one saturation to the other."""
    top = NEARLY * law.saturation
    # steps crowd towards saturation, where the curve takes long to arrive
    state = top * np.tanh(np.linspace(-7.0, 7.0, STEPS + 1)) / np.tanh(7.0)
    middle = 0.5 * (state[1:] + state[:-1])
    cost = (1.0 / law.slope(state[1:]) + 4.0 / law.slope(middle) + 1.0 / law.slope(state[:-1])) / 6
    position = np.concatenate(([0.0], np.cumsum(cost * np.diff(state))))
    return position, state


def draw_bouc_wen(rng: np.random.Generator) -> Ceramic:
    """Draw a law with loops that saturate within about the drive range, and a curved scale."""
    beta = float(rng.uniform(1.2, 2.5))
    law = BoucWen(
        sharpness=float(rng.uniform(1.0, 1.8)),
        beta=beta,
        gamma=beta * float(rng.uniform(-0.1, 0.5)),
        bend=float(rng.uniform(-0.3, 0.3)),
    )
    reversible = gentle_curve(rng)
    return ceramic_with_opening(
        float(rng.uniform(0.08, 0.14)),
        reversible,
        lambda path: bouc_wen_memory(law, path),
    )


TRUTH = Truth(name="bouc_wen", draw=draw_bouc_wen)
