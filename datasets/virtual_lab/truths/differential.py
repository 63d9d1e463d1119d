"""Laws defined by a differential equation in the field: one state, one slope per direction.

    dz/dE = slope(E, z, s),      s = +1 rising, -1 falling

Between two turning points the field replaces the time. A branch is integrated [classical
Runge-Kutta] on a grid that depends only on its ends, with cubic interpolation between grid points,
so that the state does not depend on the sampling of the path.
"""

import itertools
import math
from collections.abc import Callable, Sequence

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from piezoid_datasets.virtual_lab.signals import Array
from piezoid_datasets.virtual_lab.truths.truth import (
    Ceramic,
    Truth,
    branches,
    draw_ceramic,
    settled,
)

# (field, state, sign) -> dz/dE
Slope = Callable[[float, float, float], float]

STEP = 0.02  # of the field: the error of a whole loop is then below 1e-7 of it
ROUNDS = 12  # of P = c A(P) + (1 - c) M, which contracts by c alpha / (3 a), below 0.05
SMALL = 1e-3  # below it Langevin's function is its first two terms, to 1e-17


def states_along(slope: Slope, path: Array, start: float, *, jumps: Sequence[float] = ()) -> Array:
    """Return the state along a path of fields.

    start  state at the path's first point
    jumps  fields at which the slope jumps; no step crosses one
    """
    path = settled(path)
    states = np.full_like(path, start)
    for first_row, last_row, rising in branches(path):
        sign = 1.0 if rising else -1.0
        begin, end, state = float(path[first_row]), float(path[last_row]), float(states[first_row])
        inside = sorted(sign * j for j in jumps if min(begin, end) < j < max(begin, end))
        stops = [begin, *(sign * j for j in inside), end]
        curve = np.empty(last_row + 1 - first_row)
        distance = sign * (path[first_row : last_row + 1] - begin)
        for low, high in itertools.pairwise(stops):
            knots, values, growth = _integrate(slope, low, high, state)
            is_piece = (distance >= abs(low - begin)) & (distance <= abs(high - begin))
            spline = CubicHermiteSpline(knots, values, growth)
            curve[is_piece] = spline(distance[is_piece] - abs(low - begin))
            state = values[-1]
        states[first_row + 1 : last_row + 1] = curve[1:]
        states[last_row] = state
    return states


def _integrate(
    slope: Slope, begin: float, end: float, state: float
) -> tuple[list[float], list[float], list[float]]:
    """Return distances along the branch, states, and their derivatives by distance."""
    sign = 1.0 if end > begin else -1.0
    steps = max(math.ceil(abs(end - begin) / STEP), 1)
    step = (end - begin) / steps
    # a hair inside the ends: there the slope is that of this piece
    offset = 1e-12 * (end - begin)
    travelled, states, growth = [0.0], [state], [sign * slope(begin + offset, state, sign)]
    for k in range(steps):
        field = begin + k * step
        slope_1 = sign * growth[-1]
        slope_2 = slope(field + 0.5 * step, state + 0.5 * step * slope_1, sign)
        slope_3 = slope(field + 0.5 * step, state + 0.5 * step * slope_2, sign)
        field_end = field + step - (offset if k == steps - 1 else 0.0)
        slope_4 = slope(field_end, state + step * slope_3, sign)
        state += step * (slope_1 + 2.0 * slope_2 + 2.0 * slope_3 + slope_4) / 6.0
        travelled.append(abs(step) * (k + 1))
        states.append(state)
        growth.append(sign * slope(field_end, state, sign))
    return travelled, states, growth


def coleman_hodgdon_memory(
    path: Array, pull: float, share: float, centre: float, knee: float, beyond: float
) -> Array:
    """Return P along a path that starts on the anhysteretic curve, far below the knee.

    pull    alpha
    share   g below the knee, where the slope of f is 1
    centre  E0
    beyond  slope of f and g beyond the knee
    """
    path = settled(path)
    jumps = centre - knee, centre + knee

    def anhysteretic(field: float) -> float:
        inner = min(max(field - centre, -knee), knee)
        return inner + beyond * (field - centre - inner)

    def slope(field: float, state: float, sign: float) -> float:
        lossy = share if jumps[0] < field < jumps[1] else beyond
        return pull * sign * (anhysteretic(field) - state) + lossy

    return states_along(slope, path, anhysteretic(float(path[0])), jumps=jumps)


def draw_coleman_hodgdon(rng: np.random.Generator) -> Ceramic:
    """A Coleman-Hodgdon ceramic, with the piecewise linear functions of its authors.

        dP/dE = alpha s (f(E) - P) + g(E),     s = +1 rising, -1 falling

    f is odd about E0, of slope 1 up to the knee and of a smaller slope beyond; g is the slope of f
    times a fraction below the knee, and the slope of f beyond, without losses. Loops close at the
    knees, kink there, and drift towards the anhysteretic curve before they close.

    Source: Coleman & Hodgdon, Int. J. Eng. Sci. 24 (1986) 897; for piezo stages Banning, de
    Koning, Adriaens & Koops, Automatica 37 (2001) 1883.
    """
    pull = float(rng.uniform(1.1, 1.7))
    share = float(rng.uniform(0.5, 0.58))
    centre = float(rng.uniform(-0.25, 0.25))
    knee = float(rng.uniform(0.8, 1.1))
    beyond = float(rng.uniform(0.6, 0.8))
    return draw_ceramic(
        rng,
        lambda path: coleman_hodgdon_memory(path, pull, share, centre, knee, beyond),
        (0.08, 0.13),
    )


def generalised_bouc_wen_memory(
    path: Array,
    sharpness: float,
    shape: tuple[float, float, float, float, float, float],
    centre: float,
) -> Array:
    """Return ``g x - z`` along a path that starts saturated.

    sharpness  n
    shape      b1 to b6; b1 exceeds the sum of the others
    centre     E0 of the scale
    """
    path = settled(path)
    b1, b2, b3, b4, b5, b6 = shape

    def slope(field: float, state: float, sign: float) -> float:
        z, x = math.copysign(1.0, state), math.copysign(1.0, field - centre)
        psi = b1 * sign * z + b2 * sign * x + b3 * x * z + b4 * sign + b5 * z + b6 * x
        return 1.0 - float(abs(state) ** sharpness) * psi

    remainder = sum(map(abs, shape[1:]))
    saturation = float((b1 - remainder) ** (-1.0 / sharpness))  # a bound of the state
    steepest = 1.0 + float(saturation**sharpness) * (b1 + remainder)  # a bound of the slope
    first = -float((b1 - b2 + b3 + b4 - b5 - b6) ** (-1.0 / sharpness))
    return steepest * path - states_along(slope, path, first, jumps=(centre,))


def draw_generalised_bouc_wen(rng: np.random.Generator) -> Ceramic:
    """A generalised Bouc-Wen ceramic: loading and unloading differ in all six signs.

        dz/dx = 1 - |z|^n psi,     x = E - E0,     s = sgn(dx)
        psi = b1 sgn(s z) + b2 sgn(s x) + b3 sgn(x z) + b4 s + b5 sgn(z) + b6 sgn(x)

    The strain is the difference ``g x - z`` of field and state, with g a bound of the slope of z.
    Loops are asymmetric with a kink where x changes sign; minor loops do not close exactly and do
    not wipe each other out.

    Source: Song & Der Kiureghian, J. Eng. Mech. 132 (2006) 610.
    """
    first = float(rng.uniform(1.6, 2.8))
    b2, b3, b4, b5, b6 = (first * rng.uniform(-0.08, 0.08, 5)).tolist()
    sharpness, shape = float(rng.uniform(1.0, 1.8)), (first, b2, b3, b4, b5, b6)
    centre = float(rng.uniform(-0.3, 0.3))
    return draw_ceramic(
        rng, lambda path: generalised_bouc_wen_memory(path, sharpness, shape, centre)
    )


def jiles_atherton_memory(
    path: Array,
    width: float,
    pinning: float,
    mean_field: float,
    reversible: float,
    bias: float,
    electrostriction: float,
) -> Array:
    """Return the strain along a path that starts unpinned, far below the range.

    width, pinning          a, k
    mean_field, reversible  alpha, c
    electrostriction        q
    """
    path = settled(path)

    def slope(field: float, state: float, sign: float) -> float:
        polarisation = state
        for _ in range(ROUNDS):
            x = (field + bias + mean_field * polarisation) / width
            target = x / 3.0 - x**3 / 45.0 if abs(x) < SMALL else 1.0 / math.tanh(x) - 1.0 / x
            polarisation = reversible * target + (1.0 - reversible) * state
        pull = sign * (target - state)
        return pull / (pinning - mean_field * pull) if pull > 0.0 else 0.0

    state = states_along(slope, path, -1.0 + width / (-float(path[0]) - bias + mean_field))
    polarisation = state
    for _ in range(ROUNDS):
        x = (path + bias + mean_field * polarisation) / width
        is_small = np.abs(x) < SMALL
        large = np.where(is_small, 1.0, x)
        target = np.where(is_small, x / 3.0 - x**3 / 45.0, 1.0 / np.tanh(large) - 1.0 / large)
        polarisation = reversible * target + (1.0 - reversible) * state
    return polarisation + electrostriction * polarisation**2


def draw_jiles_atherton(rng: np.random.Generator) -> Ceramic:
    """A Jiles-Atherton ceramic with a mean field, read as strain.

        dM/dE = (A - M) / (s k - alpha (A - M))  where s (A - M) > 0, else 0;    s = +-1 up, down
        A = L((E + bias + alpha P) / a),     P = c A + (1 - c) M,     L(x) = coth x - 1/x
        strain = P + q P^2

    M is the irreversible part of the polarisation P; walls move only towards the anhysteretic A,
    and the polarisation itself helps the field (alpha). Strain has an electrostrictive share q.
    Minor loops do not close exactly; a reversal is forgotten gradually.

    Source: Jiles & Atherton, J. Magn. Magn. Mater. 61 (1986) 48; for piezo ceramics and their
    strain Smith & Ounaies, J. Intell. Mater. Syst. Struct. 11 (2000) 62.
    """
    parameters = {
        "width": float(rng.uniform(0.5, 0.9)),
        "pinning": float(rng.uniform(0.3, 0.6)),
        "mean_field": float(rng.uniform(0.1, 0.4)),
        "reversible": float(rng.uniform(0.1, 0.3)),
        "bias": float(rng.uniform(-0.3, 0.3)),
        "electrostriction": float(rng.choice([-1.0, 1.0]) * rng.uniform(0.05, 0.25)),
    }
    return draw_ceramic(rng, lambda path: jiles_atherton_memory(path, **parameters))


def lugre_memory(
    path: Array, stiffness: float, tilt: float, hump: float, centre: float, width: float
) -> Array:
    """Return ``g E - z`` along a path that starts at full friction.

    stiffness      sigma of the bristles
    tilt, hump     a and b of the Coulomb level
    centre, width  E0 and w of the Coulomb level
    """
    path = settled(path)

    def level(field: float) -> float:
        """Return the friction after a long motion in one direction."""
        x = (field - centre) / width
        return 1.0 + tilt * math.tanh(x) + hump * math.exp(-x * x)

    def slope(field: float, state: float, sign: float) -> float:
        return stiffness * (1.0 - sign * state / level(field))

    # A bound of the slope: full friction of the highest level against the lowest.
    highest, lowest = 1.0 + abs(tilt) + max(hump, 0.0), 1.0 - abs(tilt) + min(hump, 0.0)
    steepest = stiffness * (1.0 + highest / lowest)
    return steepest * path - states_along(slope, path, -level(float(path[0])))


def draw_lugre(rng: np.random.Generator) -> Ceramic:
    """A slowly driven LuGre wall: bristles with a Coulomb level that depends on the position.

        dz/dE = sigma (1 - s z / L(E))
        L(E) = 1 + a tanh((E - E0) / w) + b exp(-(E - E0)^2 / w^2)

    This is LuGre's law below the Stribeck speed without bristle damping, which is rate
    independent. The strain is the difference ``g E - z`` of field and friction, with g a bound of
    the slope of z. Because L varies over the range, loops of equal span depend on bias. A reversal
    is forgotten gradually; minor loops drift before they close.

    Source: Canudas de Wit, Olsson, Astrom & Lischinsky, IEEE Trans. Autom. Control 40 (1995) 419;
    a level that varies with position as in Hensen, van de Molengraft & Steinbuch, ibid. 47 (2002).
    """
    stiffness = float(rng.uniform(1.8, 2.8))
    tilt = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.1, 0.25))
    hump, centre = float(rng.uniform(-0.15, 0.25)), float(rng.uniform(-0.4, 0.4))
    width = float(rng.uniform(0.6, 1.2))
    return draw_ceramic(
        rng, lambda path: lugre_memory(path, stiffness, tilt, hump, centre, width), (0.08, 0.11)
    )


COLEMAN_HODGDON = Truth(name="coleman_hodgdon", draw=draw_coleman_hodgdon)
GENERALISED_BOUC_WEN = Truth(name="generalised_bouc_wen", draw=draw_generalised_bouc_wen)
JILES_ATHERTON = Truth(name="jiles_atherton", draw=draw_jiles_atherton)
LUGRE = Truth(name="lugre", draw=draw_lugre)
