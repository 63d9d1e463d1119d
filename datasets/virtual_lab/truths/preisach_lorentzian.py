"""A Preisach ceramic with a Lorentzian density: long tails, where small fields switch as well.

    density(up, down) = l(up - h) l(down + h'),     l(x) = 1 / (1 + (x / w)^2),     up >= down

A product has an Everett function of one-dimensional tables: with F, G the integrals of the two
factors and H the integral of l(up) G(up),

    E(a, b) = H(a) - H(b) - G(b) (F(a) - F(b))

Wiping-out and congruency hold exactly, as for every Preisach operator.

Source: Bertotti, Hysteresis in Magnetism (1998), chapter 13; Mayergoyz, Mathematical Models of
Hysteresis (1991), chapter 1.
"""

import numpy as np

from piezoid_datasets.virtual_lab.signals import Array
from piezoid_datasets.virtual_lab.truths.preisach import EverettFunction, preisach_memory
from piezoid_datasets.virtual_lab.truths.truth import (
    FLOOR,
    Ceramic,
    Truth,
    ceramic_with_opening,
    gentle_curve,
)

GRID = np.linspace(FLOOR, -FLOOR, 2401)  # cubics between its points err by 1e-11


def lorentzian_everett(
    coercive: tuple[float, float], width: tuple[float, float]
) -> EverettFunction:
    """Return E of thresholds up about h and down about -h'."""
    from scipy.interpolate import CubicSpline

    def switched(field: Array, place: float, spread: float) -> Array:
        return np.asarray(spread * np.arctan((field - place) / spread))

    def rising(field: Array) -> Array:
        return switched(field, coercive[0], width[0])

    def falling(field: Array) -> Array:
        return switched(field, -coercive[1], width[1])

    density = 1.0 / (1.0 + ((GRID - coercive[0]) / width[0]) ** 2)
    both = CubicSpline(GRID, density * falling(GRID)).antiderivative()

    def everett(high: Array, low: Array) -> Array:
        switched_up = rising(high) - rising(low)
        return np.asarray(both(high) - both(low) - falling(low) * switched_up)

    return everett


def draw_preisach_lorentzian(rng: np.random.Generator) -> Ceramic:
    """Draw coercive fields inside the drive range, unlike for either direction."""
    everett = lorentzian_everett(
        (float(rng.uniform(0.0, 0.4)), float(rng.uniform(0.0, 0.4))),
        (float(rng.uniform(0.35, 0.75)), float(rng.uniform(0.35, 0.75))),
    )
    reversible = gentle_curve(rng)
    return ceramic_with_opening(
        float(rng.uniform(0.08, 0.14)), reversible, lambda path: preisach_memory(everett, path)
    )


TRUTH = Truth(name="preisach_lorentzian", draw=draw_preisach_lorentzian)
