"""A Preisach ceramic, given by its Everett function.

    E(a, b) = sum_k c_k (p_k(a) - p_k(b)) (q_k(a) - q_k(b)),     a >= b

with smooth increasing ``p_k, q_k``. The Preisach density ``-d2E/da db`` is then
``sum_k c_k (p_k'(a) q_k'(b) + q_k'(a) p_k'(b)) >= 0``: wiping-out and congruency hold exactly. For
small loops E grows with the square of their span (the Rayleigh law of soft ceramics). E depends on
a and b, not on a - b alone, so the operator is not translation invariant: no sum of plays, and no
play after one memoryless curve, equals it.

Source: Mayergoyz, Mathematical Models of Hysteresis (1991), chapter 1.
"""

from collections.abc import Callable
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

# (high, low) fields of equal shape -> what the relays between them are worth
EverettFunction = Callable[[Array, Array], Array]


@dataclass(frozen=True, kw_only=True, eq=False)
class Everett:
    """Weights (terms,), centres and widths (2, terms) of the sigmoids p and q."""

    weight: Array
    centre: Array
    width: Array

    def __call__(self, high: Array, low: Array) -> Array:
        """Return E for fields ``high >= low`` of equal shape."""
        total = np.zeros_like(high)
        for weight, centre, width in zip(self.weight, self.centre.T, self.width.T, strict=True):
            factors = [
                np.tanh((high - c) / w) - np.tanh((low - c) / w)
                for c, w in zip(centre, width, strict=True)
            ]
            total += weight * factors[0] * factors[1]
        return total


def preisach_memory(everett: EverettFunction, path: Array) -> Array:
    """Return the Preisach output along a path that starts with every hysteron down.

    The memory is the stack of extrema not yet wiped out. Each sample needs only the extremum its
    branch hangs from, so E is evaluated once, for all samples together.
    """
    path = settled(path)
    anchor, base = np.full_like(path, path[0]), np.zeros_like(path)
    sign = np.ones_like(path)
    stack = [(float(path[0]), 0.0)]
    for start, end, rising in branches(path):
        direction = 1.0 if rising else -1.0
        ahead = direction * path[start + 1 : end + 1]
        sign[start + 1 : end + 1] = direction
        done = 0
        while done < len(ahead):
            limit = direction * stack[-2][0] if len(stack) > 1 else np.inf
            stop = int(np.searchsorted(ahead, limit, side="left"))
            anchor[start + 1 + done : start + 1 + stop] = stack[-1][0]
            base[start + 1 + done : start + 1 + stop] = stack[-1][1]
            if stop < len(ahead):
                del stack[-2:]
            done = stop
        stack.append((float(path[end]), _value(everett, path[end], stack[-1], direction)))
    high, low = np.maximum(path, anchor), np.minimum(path, anchor)
    return base + sign * everett(high, low)


def draw_preisach(rng: np.random.Generator) -> Ceramic:
    """Draw a smooth, asymmetric density and a curved reversible part."""
    terms = 3
    centre = rng.uniform(-0.6, 0.6, (2, terms))
    everett = Everett(
        weight=rng.uniform(0.3, 1.0, terms),
        centre=centre,
        width=rng.uniform(0.9, 2.2, (2, terms)),
    )
    reversible = gentle_curve(rng)
    return ceramic_with_opening(
        float(rng.uniform(0.09, 0.15)),
        reversible,
        lambda path: preisach_memory(everett, path),
    )


def _value(
    everett: EverettFunction, field: float, root: tuple[float, float], direction: float
) -> float:
    high, low = max(field, root[0]), min(field, root[0])
    return root[1] + direction * float(everett(np.array([high]), np.array([low]))[0])


TRUTH = Truth(name="preisach", draw=draw_preisach)
