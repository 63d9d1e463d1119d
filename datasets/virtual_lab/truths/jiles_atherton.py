"""A Jiles-Atherton ceramic with a mean field, read as strain.

    dM/dE = (A - M) / (s k - alpha (A - M))  where s (A - M) > 0, else 0;    s = +-1 up, down
    A = L((E + bias + alpha P) / a),     P = c A + (1 - c) M,     L(x) = coth x - 1/x
    strain = P + q P^2

M is the irreversible part of the polarisation P; walls move only towards the anhysteretic A, and
the polarisation itself helps the field (alpha). Strain has an electrostrictive share q. Minor
loops do not close exactly; a reversal is forgotten gradually.

Source: Jiles & Atherton, J. Magn. Magn. Mater. 61 (1986) 48; for piezo ceramics and their strain
Smith & Ounaies, J. Intell. Mater. Syst. Struct. 11 (2000) 62.
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

ROUNDS = 12  # of P = c A(P) + (1 - c) M, which contracts by c alpha / (3 a), below 0.05
SMALL = 1e-3  # below it Langevin's function is its first two terms, to 1e-17


@dataclass(frozen=True, kw_only=True)
class JilesAtherton:
    """Width a, pinning k, mean field alpha, reversible share c, bias, electrostrictive share q."""

    width: float
    pinning: float
    mean_field: float
    reversible: float
    bias: float
    electrostriction: float

    def slope(self, field: float, state: float, sign: float) -> float:
        """Return dM/dE."""
        polarisation = state
        for _ in range(ROUNDS):
            towards = _langevin((field + self.bias + self.mean_field * polarisation) / self.width)
            polarisation = self.reversible * towards + (1.0 - self.reversible) * state
        pull = sign * (towards - state)
        return pull / (self.pinning - self.mean_field * pull) if pull > 0.0 else 0.0

    def polarisation(self, field: Array, state: Array) -> Array:
        """Return P of a field and of M."""
        found = state
        for _ in range(ROUNDS):
            towards = _langevins((field + self.bias + self.mean_field * found) / self.width)
            found = self.reversible * towards + (1.0 - self.reversible) * state
        return found


def jiles_atherton_memory(law: JilesAtherton, path: Array) -> Array:
    """Return the strain along a path that starts unpinned, far below the range."""
    path = settled(path)
    start = -1.0 + law.width / (-float(path[0]) - law.bias + law.mean_field)
    state = states_along(law.slope, path, start)
    polarisation = law.polarisation(path, state)
    return polarisation + law.electrostriction * polarisation**2


def draw_jiles_atherton(rng: np.random.Generator) -> Ceramic:
    """Draw a ceramic that is far from saturated at the ends of the drive range."""
    law = JilesAtherton(
        width=float(rng.uniform(0.5, 0.9)),
        pinning=float(rng.uniform(0.3, 0.6)),
        mean_field=float(rng.uniform(0.1, 0.4)),
        reversible=float(rng.uniform(0.1, 0.3)),
        bias=float(rng.uniform(-0.3, 0.3)),
        electrostriction=float(rng.choice([-1.0, 1.0]) * rng.uniform(0.05, 0.25)),
    )
    reversible = gentle_curve(rng)
    return ceramic_with_opening(
        float(rng.uniform(0.08, 0.14)), reversible, lambda path: jiles_atherton_memory(law, path)
    )


def _langevin(x: float) -> float:
    return x / 3.0 - x**3 / 45.0 if abs(x) < SMALL else 1.0 / math.tanh(x) - 1.0 / x


def _langevins(x: Array) -> Array:
    small = np.abs(x) < SMALL
    safe = np.where(small, 1.0, x)
    return np.where(small, x / 3.0 - x**3 / 45.0, 1.0 / np.tanh(safe) - 1.0 / safe)


TRUTH = Truth(name="jiles_atherton", draw=draw_jiles_atherton)
