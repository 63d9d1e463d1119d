"""A Takacs ceramic: branches are shifted hyperbolic tangents that return to turning points.

    P = P0 + (P1 - P0) (T(E - a) - T(E0 - a)) / (T(E1 - a) - T(E0 - a)),   E rising from E0 to E1

with T(E) = tanh(c (E - centre)), and -a instead of a on a falling branch. A branch leads to the
last but one turning point, continues there on the earlier branch, and both turning points are
wiped out: wiping-out holds exactly and minor loops close at once. They are also congruent: by the
addition theorem of T, ``sinh(c (x - y)) / (cosh(c x) cosh(c y))``, factors of nested branches
cancel.

Source: Takacs, COMPEL 20 (2001) 1002, and Mathematics of Hysteretic Phenomena (2003), chapter 2.
"""

from dataclasses import dataclass

import numpy as np

from piezoid_datasets.virtual_lab.signals import Array
from piezoid_datasets.virtual_lab.truths.branches import branches, settled
from piezoid_datasets.virtual_lab.truths.truth import (
    FLOOR,
    Ceramic,
    Truth,
    ceramic_with_opening,
    gentle_curve,
)


@dataclass(frozen=True, kw_only=True)
class Takacs:
    """Steepness c, shifts a of rising and falling branches, and the loop's centre."""

    steepness: float
    shift: tuple[float, float]
    centre: float

    def curve(self, field: Array, *, rising: bool) -> Array:
        """Return the hyperbolic tangent of the branches of one direction."""
        shift = self.shift[0] if rising else -self.shift[1]
        return np.asarray(np.tanh(self.steepness * (field - self.centre - shift)))


def takacs_memory(law: Takacs, path: Array) -> Array:
    """Return P along a path that starts at the lower end of the outermost loop."""
    path = settled(path)
    curves = {rising: law.curve(path, rising=rising) for rising in (True, False)}
    output = np.full_like(path, -1.0)
    turns = [(-FLOOR, 1.0), (FLOOR, -1.0)]  # ends of the outermost loop; no path leaves it
    for start, end, rising in branches(path):
        if start > 0:
            turns.append((float(path[start]), float(output[start])))
        sign = 1.0 if rising else -1.0
        ahead = sign * path[start + 1 : end + 1]
        done = 0
        while done < len(ahead):
            (to, arrive), (begun, left) = turns[-2:]
            stop = (
                int(np.searchsorted(ahead, sign * to, side="left"))
                if len(turns) > 2
                else len(ahead)
            )
            piece = slice(start + 1 + done, start + 1 + stop)
            low, high = law.curve(np.array([begun, to]), rising=rising).tolist()
            output[piece] = left + (arrive - left) * (curves[rising][piece] - low) / (high - low)
            if stop < len(ahead):
                del turns[-2:]
            done = stop
    return output


def draw_takacs(rng: np.random.Generator) -> Ceramic:
    """Draw branches that bend within the drive range, unlike for either direction."""
    law = Takacs(
        steepness=float(rng.uniform(0.9, 1.4)),
        shift=(float(rng.uniform(0.3, 0.5)), float(rng.uniform(0.3, 0.5))),
        centre=float(rng.uniform(-0.3, 0.3)),
    )
    reversible = gentle_curve(rng)
    return ceramic_with_opening(
        float(rng.uniform(0.08, 0.14)), reversible, lambda path: takacs_memory(law, path)
    )


TRUTH = Truth(name="takacs", draw=draw_takacs)
