"""Laws with return-point memory: two turning points are wiped out when the drive passes them.

Minor loops close at once, and loops between the same two fields are congruent.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from piezoid_datasets.virtual_lab.signals import Array
from piezoid_datasets.virtual_lab.truths.truth import (
    FLOOR,
    Ceramic,
    Truth,
    branches,
    draw_ceramic,
    settled,
)

# (high, low) fields of equal shape -> output of the relays between them
EverettFunction = Callable[[Array, Array], Array]

GRID = np.linspace(FLOOR, -FLOOR, 2401)  # cubics between its points err by 1e-11
THRESHOLDS = np.linspace(-1.7, 1.3, 16)
RIDGE = 0.8  # four steps of the grid: no step of it can be seen in a branch
DOWN, UP = (np.array(side) for side in np.triu_indices(len(THRESHOLDS)))
ELEMENTS = 40
CHUNK = 4096  # samples, so that a long branch needs a few megabytes


def draw_preisach(rng: np.random.Generator) -> Ceramic:
    """A Preisach ceramic, given by its Everett function.

        E(a, b) = sum_k c_k (p_k(a) - p_k(b)) (q_k(a) - q_k(b)),     a >= b

    with smooth increasing ``p_k, q_k``. The Preisach density ``-d2E/da db`` is then ``sum_k c_k
    (p_k'(a) q_k'(b) + q_k'(a) p_k'(b)) >= 0``: wiping-out and congruency hold exactly. For small
    loops E grows with the square of their span (the Rayleigh law of soft ceramics). E depends on a
    and b, not on a - b alone, so the operator is not translation invariant: no sum of plays, and
    no play after one memoryless curve, equals it.

    Source: Mayergoyz, Mathematical Models of Hysteresis (1991), chapter 1.
    """
    terms = 3
    centre = rng.uniform(-0.6, 0.6, (2, terms))
    everett = Everett(
        weight=rng.uniform(0.3, 1.0, terms),
        centre=centre,
        width=rng.uniform(0.9, 2.2, (2, terms)),
    )
    return draw_ceramic(rng, lambda path: preisach_memory(everett, path), (0.09, 0.15))


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
        offset = 0
        while offset < len(ahead):
            limit = direction * stack[-2][0] if len(stack) > 1 else np.inf
            stop = int(np.searchsorted(ahead, limit, side="left"))
            anchor[start + 1 + offset : start + 1 + stop] = stack[-1][0]
            base[start + 1 + offset : start + 1 + stop] = stack[-1][1]
            if stop < len(ahead):
                del stack[-2:]
            offset = stop
        field, (root, value) = float(path[end]), stack[-1]
        high_low = np.array([max(field, root)]), np.array([min(field, root)])
        stack.append((field, value + direction * float(everett(*high_low)[0])))
    high, low = np.maximum(path, anchor), np.minimum(path, anchor)
    return base + sign * everett(high, low)


def draw_preisach_lorentzian(rng: np.random.Generator) -> Ceramic:
    """A Preisach ceramic with a Lorentzian density: long tails, where small fields switch as well.

        density(up, down) = l(up - h) l(down + h'),     l(x) = 1 / (1 + (x / w)^2),     up >= down

    A product has an Everett function of one-dimensional tables: with F, G the integrals of the two
    factors and H the integral of l(up) G(up),

        E(a, b) = H(a) - H(b) - G(b) (F(a) - F(b))

    Wiping-out and congruency hold exactly, as for every Preisach operator.

    Source: Bertotti, Hysteresis in Magnetism (1998), chapter 13; Mayergoyz, Mathematical Models of
    Hysteresis (1991), chapter 1.
    """
    everett = lorentzian_everett(
        (float(rng.uniform(0.0, 0.4)), float(rng.uniform(0.0, 0.4))),
        (float(rng.uniform(0.35, 0.75)), float(rng.uniform(0.35, 0.75))),
    )
    return draw_ceramic(rng, lambda path: preisach_memory(everett, path))


def lorentzian_everett(
    coercive: tuple[float, float], width: tuple[float, float]
) -> EverettFunction:
    """Return E of thresholds up about h and down about -h'."""
    from scipy.interpolate import CubicSpline

    def rising(field: Array) -> Array:
        return np.asarray(width[0] * np.arctan((field - coercive[0]) / width[0]))

    def falling(field: Array) -> Array:
        return np.asarray(width[1] * np.arctan((field + coercive[1]) / width[1]))

    density = 1.0 / (1.0 + ((GRID - coercive[0]) / width[0]) ** 2)
    integral = CubicSpline(GRID, density * falling(GRID)).antiderivative()

    def everett(high: Array, low: Array) -> Array:
        switched_up = rising(high) - rising(low)
        return np.asarray(integral(high) - integral(low) - falling(low) * switched_up)

    return everett


def draw_krasnoselskii_pokrovskii(rng: np.random.Generator) -> Ceramic:
    """A Krasnosel'skii-Pokrovskii ceramic: a sum of relays whose sides are slopes.

        k = max(k, r(E - up))  rising,      k = min(k, r(E - down))  falling,      down <= up

    The ridge r climbs smoothly from -1 to 1 over some width, so a finite sum of kernels (one for
    each pair of thresholds on a grid) is continuous. Weights are a bell over the triangle of
    pairs. Wiping- out and congruency hold as for Preisach's relays; loops of equal span differ
    with bias.

    Source: Krasnosel'skii & Pokrovskii, Systems with Hysteresis (1989); Banks, Kurdila & Webb,
    Math. Probl. Eng. 3 (1997) 287; for piezo stages Galinaitis, thesis, Virginia Tech (1999).
    """
    middle, half = 0.5 * (THRESHOLDS[UP] + THRESHOLDS[DOWN]), THRESHOLDS[UP] - THRESHOLDS[DOWN]
    along = (middle + 0.5 * RIDGE - rng.uniform(-0.3, 0.3)) / rng.uniform(0.5, 0.9)
    across = half / rng.uniform(0.5, 0.9)
    weight = np.exp(-0.5 * along**2 - across) * rng.uniform(0.7, 1.3, len(DOWN))
    return draw_ceramic(rng, lambda path: krasnoselskii_pokrovskii_memory(weight, path))


def krasnoselskii_pokrovskii_memory(weight: Array, path: Array) -> Array:
    """Return the sum of the kernels (pairs,) along a path that starts with all of them down."""
    path = settled(path)
    state = np.full(len(DOWN), -1.0)
    output = np.full(len(path), float(state @ weight))
    for start, end, rising in branches(path):
        for first in range(start, end, CHUNK):
            piece = slice(first + 1, min(first + CHUNK, end) + 1)
            side = ridge(path[piece, None] - THRESHOLDS)
            kernels = (
                np.maximum(state, side[:, UP]) if rising else np.minimum(state, side[:, DOWN])
            )
            output[piece] = kernels @ weight
            state = kernels[-1]
    return output


def ridge(field: Array) -> Array:
    """Return r, between -1 and 1, of fields before or behind a threshold."""
    climb = np.clip(field / RIDGE, 0.0, 1.0)
    return np.asarray(2.0 * climb**2 * (3.0 - 2.0 * climb) - 1.0)


def draw_takacs(rng: np.random.Generator) -> Ceramic:
    """A Takacs ceramic: branches are shifted hyperbolic tangents that return to turning points.

        P = P0 + (P1 - P0) (T(E - a) - T(E0 - a)) / (T(E1 - a) - T(E0 - a)),   E from E0 to E1

    with T(E) = tanh(c (E - centre)), and -a instead of a on a falling branch. A branch leads to
    the last but one turning point, continues there on the earlier branch, and both turning points
    are wiped out: wiping-out holds exactly and minor loops close at once. They are also congruent:
    by the addition theorem of T, ``sinh(c (x - y)) / (cosh(c x) cosh(c y))``, factors of nested
    branches cancel.

    Source: Takacs, COMPEL 20 (2001) 1002, and Mathematics of Hysteretic Phenomena (2003), chapter
    2.
    """
    steepness = float(rng.uniform(0.9, 1.4))
    shift = float(rng.uniform(0.3, 0.5)), float(rng.uniform(0.3, 0.5))
    centre = float(rng.uniform(-0.3, 0.3))
    return draw_ceramic(rng, lambda path: takacs_memory(path, steepness, shift, centre))


def takacs_memory(
    path: Array, steepness: float, shift: tuple[float, float], centre: float
) -> Array:
    """Return P along a path that starts at the lower end of the outermost loop.

    shift  a of rising and of falling branches
    """
    path = settled(path)
    output = np.full_like(path, -1.0)
    turns = [(-FLOOR, 1.0), (FLOOR, -1.0)]  # ends of the outermost loop; no path leaves it
    for start, end, rising in branches(path):
        if start > 0:
            turns.append((float(path[start]), float(output[start])))
        sign, branch_shift = (1.0, shift[0]) if rising else (-1.0, -shift[1])
        ahead = sign * path[start + 1 : end + 1]
        offset = 0
        while offset < len(ahead):
            (end_field, end_value), (start_field, start_value) = turns[-2:]
            stop = (
                int(np.searchsorted(ahead, sign * end_field, side="left"))
                if len(turns) > 2
                else len(ahead)
            )
            piece = slice(start + 1 + offset, start + 1 + stop)
            fields = np.concatenate(([start_field, end_field], path[piece]))
            curve = np.tanh(steepness * (fields - centre - branch_shift))
            low, high = curve[:2].tolist()
            rise = end_value - start_value
            output[piece] = start_value + rise * (curve[2:] - low) / (high - low)
            if stop < len(ahead):
                del turns[-2:]
            offset = stop
    return output


@dataclass(frozen=True, kw_only=True, eq=False)
class MaxwellSlip:
    """Breaks b, stiffnesses k (elements,), growth e of the breaks, bends c2, c3 of the scale."""

    breaks: Array
    stiffness: Array
    growth: float
    bends: tuple[float, float]

    def scale(self, field: Array) -> Array:
        """Return x of a field, with a straight continuation outside the drive range."""
        inside = np.clip(field, -1.2, 1.2)
        bent = inside + self.bends[0] * inside**2 + self.bends[1] * inside**3
        return bent + (field - inside)

    def limit(self, position: Array) -> Array:
        """Return the largest force of each element (..., elements)."""
        return np.multiply.outer(1.0 + self.growth * np.clip(position, -1.3, 1.3), self.breaks)


def maxwell_slip_memory(law: MaxwellSlip, path: Array) -> Array:
    """Return the strain along a path that starts with every element sliding."""
    path = settled(path)
    position = law.scale(path)
    force = -law.limit(position[0])
    output = np.full(len(path), float(law.stiffness @ (position[0] - force)))
    for start, end, rising in branches(path):
        sign = 1.0 if rising else -1.0
        for first in range(start, end, CHUNK):
            piece = slice(first + 1, min(first + CHUNK, end) + 1)
            stuck = sign * (force + (position[piece] - position[first])[:, None])
            forces = sign * np.minimum(stuck, law.limit(position[piece]))
            output[piece] = (position[piece, None] - forces) @ law.stiffness
            force = forces[-1]
    return output


def draw_maxwell_slip(rng: np.random.Generator) -> Ceramic:
    """A Maxwell-slip ceramic: springs that slide, each at a force that grows along the range.

        df = dx,   |f| <= b (1 + e x),    x = E + c2 E^2 + c3 E^3;     strain = sum of k (x - f)

    Many elements with breaks b spread over the range make a smooth loop; a break that depends on
    the position, and a bent scale, make loops depend on bias. On a rising branch an element is
    ``min(f0 + x - x0, b (1 + e x))``. Wiping-out holds: element by element it is a play with two
    increasing sides.

    Source: Goldfarb & Celanovic, IEEE Control Syst. 17 (1997) 69, and J. Dyn. Syst. Meas. Control
    119 (1997) 478.
    """
    breaks = np.linspace(0.0, 1.0, ELEMENTS + 1)[1:]
    law = MaxwellSlip(
        breaks=breaks,
        stiffness=np.exp(-breaks / rng.uniform(0.3, 0.8)) * rng.uniform(0.7, 1.3, ELEMENTS),
        growth=float(rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 0.4)),
        bends=(float(rng.uniform(-0.1, 0.1)), float(rng.uniform(-0.05, 0.05))),
    )
    return draw_ceramic(rng, lambda path: maxwell_slip_memory(law, path))


PREISACH = Truth(name="preisach", draw=draw_preisach)
PREISACH_LORENTZIAN = Truth(name="preisach_lorentzian", draw=draw_preisach_lorentzian)
KRASNOSELSKII_POKROVSKII = Truth(
    name="krasnoselskii_pokrovskii", draw=draw_krasnoselskii_pokrovskii
)
TAKACS = Truth(name="takacs", draw=draw_takacs)
MAXWELL_SLIP = Truth(name="maxwell_slip", draw=draw_maxwell_slip)
