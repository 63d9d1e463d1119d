"""Laws whose branches have a closed form or one master curve, without return-point memory.

A reversal is forgotten gradually, and minor loops move from cycle to cycle before they close.
"""

import numpy as np
from scipy.special import erf

from piezoid_datasets.virtual_lab.signals import Array, first_order
from piezoid_datasets.virtual_lab.truths.truth import (
    FLOOR,
    Ceramic,
    Curve,
    Truth,
    branches,
    draw_ceramic,
    settled,
)

STEPS = 40_000  # of a master curve; interpolation then errs by less than 1e-9 of the loop
NEARLY = 1.0 - 1e-6  # of saturation, where the master curve ends
LINEAR = 1e-6  # of the exponent about 1, where the power turns into the exponential
GRID_PER_FIELD = 4000
FAR = -FLOOR  # fields tabulated: from -FAR to FAR


def bent_scale(field: Array, bend: float) -> Array:
    """Return ``E + b (sqrt(1 + E^2) - 1)``, which increases with the field for |b| < 1."""
    return field + bend * (np.sqrt(1.0 + field**2) - 1.0)


def bouc_wen_memory(
    path: Array, sharpness: float, beta: float, gamma: float, bend: float
) -> Array:
    """Return ``g p - z`` along a path of fields that starts saturated.

    sharpness    n
    beta, gamma  of loading and unloading, beta > |gamma|
    bend         b of the scale
    """
    path = settled(path)
    drive = bent_scale(path, bend)
    # Along the rising branch from one saturation to the other, steps crowd towards saturation,
    # where the curve takes long to arrive.
    top = NEARLY * float((beta + gamma) ** (-1.0 / sharpness))
    state = top * np.tanh(np.linspace(-7.0, 7.0, STEPS + 1)) / np.tanh(7.0)
    middle = 0.5 * (state[1:] + state[:-1])
    slopes, middle_slopes = (
        1.0 - (gamma + beta * np.sign(s)) * np.abs(s) ** sharpness for s in (state, middle)
    )
    cost = (1.0 / slopes[1:] + 4.0 / middle_slopes + 1.0 / slopes[:-1]) / 6
    position = np.concatenate(([0.0], np.cumsum(cost * np.diff(state))))
    z = np.full_like(path, state[0])
    for start, end, rising in branches(path):
        sign = 1.0 if rising else -1.0
        entry = np.interp(sign * z[start], state, position)
        positions = entry + sign * (drive[start : end + 1] - drive[start])
        z[start : end + 1] = sign * np.interp(positions, position, state)
    steepest = 2.0 * beta / (beta + gamma)  # slope of a branch that has just left saturation
    return steepest * drive - z


def draw_bouc_wen(rng: np.random.Generator) -> Ceramic:
    """A Bouc-Wen ceramic: one state that saturates smoothly.

        dz/dp = 1 - |z|^n (gamma + beta sgn(z dp)),       p = E + b (sqrt(1 + E^2) - 1)

    The scale p of the field E is increasing for |b| < 1 and makes the loops depend on bias. The
    state leads the field, so the strain is the difference ``g p - z``, with g the steepest slope
    of z, so that no branch runs backwards.

    Along a rising branch the equation is autonomous, so all rising branches are shifted pieces of
    one master curve Z(p); falling branches are its mirror image. The curve is integrated once, and
    each branch of a recording costs one interpolation. Minor loops do not close exactly and do not
    wipe each other out, unlike any superposition of plays or Preisach hysterons.

    Source: Wen, J. Eng. Mech. 102 (1976); for piezo stages Low & Guo, J. MEMS 4 (1995).
    """
    beta = float(rng.uniform(1.2, 2.5))
    sharpness = float(rng.uniform(1.0, 1.8))
    gamma = beta * float(rng.uniform(-0.1, 0.5))
    bend = float(rng.uniform(-0.3, 0.3))
    return draw_ceramic(rng, lambda path: bouc_wen_memory(path, sharpness, beta, gamma, bend))


def dahl_memory(path: Array, stiffness: float, exponent: float, bend: float) -> Array:
    """Return ``g x - z`` along a path that starts at full friction.

    stiffness  sigma per unit of the scale
    exponent   i
    bend       b of the scale
    """
    path = settled(path)
    scale, power = bent_scale(path, bend), 1.0 - exponent
    friction = np.full_like(path, -1.0)
    for start, end, rising in branches(path):
        sign = 1.0 if rising else -1.0
        distance = sign * (scale[start : end + 1] - scale[start])
        slack = 1.0 - sign * float(friction[start])  # distance w to full friction
        if abs(power) < LINEAR:
            slacks = slack * np.exp(-stiffness * distance)
        else:
            remaining = slack**power - power * stiffness * distance
            slacks = np.maximum(remaining, 0.0) ** (1.0 / power)
        friction[start : end + 1] = sign * (1.0 - slacks)
    # The slope of a branch that turns back from full friction.
    steepest = float(stiffness * 2.0**exponent)
    return steepest * scale - friction


def draw_dahl(rng: np.random.Generator) -> Ceramic:
    """A Dahl wall: solid friction between domain walls and lattice, with Dahl's exponent.

        dz/dx = sigma (1 - s z)^i,     x = E + b (sqrt(1 + E^2) - 1),     s = +1 rising, -1 falling

    The friction force z reaches its largest magnitude, 1, after a long motion in one direction.
    The strain is the difference ``g x - z`` of scale and friction, with g the steepest slope of z,
    so that no branch runs backwards. With w = 1 - s z a branch has a closed form,

        w = (w0^(1 - i) - (1 - i) sigma |x - x0|)^(1 / (1 - i)),
        w = w0 exp(-sigma |x - x0|)    if i = 1

    A reversal is forgotten gradually and never wiped out, and minor loops drift before they close.
    The curvature b of the scale makes loops depend on bias.

    Source: Dahl, A solid friction model, Aerospace Corp. TOR-0158 (1968); for piezo stages Xu &
    Li, J. Dyn. Syst. Meas. Control 132 (2010) 041011.
    """
    stiffness = float(rng.uniform(1.6, 2.6))
    exponent = float(rng.uniform(1.0, 1.4))
    bend = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.1, 0.35))
    return draw_ceramic(
        rng, lambda path: dahl_memory(path, stiffness, exponent, bend), (0.08, 0.13)
    )


def duhem_memory(
    path: Array,
    rate: float,
    centre: float,
    coercive: tuple[float, float],
    width: tuple[float, float],
) -> Array:
    """Return P along a path that starts with everything switched down.

    rate             r of switching per field
    centre           E0
    coercive, width  fields h and widths w, up and down
    """
    path = settled(path)
    up, down = (
        0.5 * np.sqrt(np.pi) * rate * w * (1.0 + erf((path - (centre + shift)) / w))
        for shift, w in zip((coercive[0], -coercive[1]), width, strict=True)
    )
    state = np.full_like(path, -1.0)
    for start, end, rising in branches(path):
        sign, switched = (1.0, up) if rising else (-1.0, down)
        distance = sign * (switched[start : end + 1] - switched[start])
        state[start : end + 1] = sign * (1.0 - (1.0 - sign * state[start]) * np.exp(-distance))
    return state


def draw_duhem(rng: np.random.Generator) -> Ceramic:
    """A Duhem ceramic: rising and falling fields switch by functions of their own.

        dP/dE = A+(E) (1 - P)   rising,       dP/dE = A-(E) (1 + P)   falling
        A+-(E) = r exp(-((E -+ h+- - E0) / w+-)^2)

    Rising, what is not yet switched up switches about the field E0 + h+; falling, what is up
    switches down about E0 - h-. Both slopes are never negative. A branch has a closed form with
    one table F of the integral of A: ``1 - P = (1 - P0) exp(-(F+(E) - F+(E0)))``, and likewise
    falling. It forgets a reversal gradually: minor loops move from cycle to cycle before they
    close, nothing is wiped out.

    Source: Duhem, Z. Phys. Chem. 22 (1897); Macki, Nistri & Zecca, SIAM Rev. 35 (1993) 94; for
    piezo stages Lin & Lin, Comput. Math. Appl. 64 (2012) 766.
    """
    rate = float(rng.uniform(1.6, 2.2))
    centre = float(rng.uniform(-0.15, 0.15))
    coercive = float(rng.uniform(0.55, 0.75)), float(rng.uniform(0.55, 0.75))
    width = float(rng.uniform(0.45, 0.6)), float(rng.uniform(0.45, 0.6))
    return draw_ceramic(rng, lambda path: duhem_memory(path, rate, centre, coercive, width))


def wall_pinning_memory(anhysteretic: Curve, pinning: float, path: Array) -> Array:
    """Return the polarisation along a path that starts on the rising branch from far away."""
    path = settled(path)
    field = np.linspace(-FAR, FAR, round(2 * FAR * GRID_PER_FIELD) + 1)
    target = anhysteretic(field)
    # A branch is a first-order lag along the field with the constant k.
    rising_curve = first_order(target, pinning, GRID_PER_FIELD, float(target[0]))
    falling_curve = first_order(target[::-1].copy(), pinning, GRID_PER_FIELD, float(target[-1]))
    on_rising = np.interp(path, field, rising_curve)
    on_falling = np.interp(path, field, falling_curve[::-1])
    output = np.full_like(path, on_rising[0])
    for start, end, rising in branches(path):
        asymptote = on_rising if rising else on_falling
        travelled = np.abs(path[start : end + 1] - path[start])
        memory = (output[start] - asymptote[start]) * np.exp(-travelled / pinning)
        output[start : end + 1] = asymptote[start : end + 1] + memory
    return output


def draw_wall_pinning(rng: np.random.Generator) -> Ceramic:
    """A ceramic of pinned domain walls: polarisation relaxes along the field, not in time.

        dP/dE = s (A(E) - P) / k,   s = +1 rising, -1 falling

    P approaches the anhysteretic curve A(E) of an unpinned wall over a field of about k. This is
    Jiles and Atherton's law without mean field, which is Coleman and Hodgdon's Duhem law with the
    derivative of A as its second function. It is linear in P, so a branch from (E0, P0) has a
    closed form with one quadrature M of the anhysteretic curve:

        P(E) = (P0 - M(E0)) exp(-|E - E0| / k) + M(E),   M = the branch from far away

    Because A is curved and skewed, loops of equal span depend on bias, and minor loops shift from
    cycle to cycle before they close.

    Source: Jiles & Atherton, J. Magn. Magn. Mater. 61 (1986); Smith & Hom, SPIE 3667 (1999);
    Coleman & Hodgdon, Int. J. Eng. Sci. 24 (1986).
    """
    pinning = float(rng.uniform(0.25, 0.6))
    centre, width = float(rng.uniform(-0.4, 0.4)), float(rng.uniform(1.0, 2.0))
    skew = float(rng.uniform(0.0, 0.3))

    def anhysteretic(field: Array) -> Array:
        shape = np.tanh((field - centre) / width)
        return shape + skew * shape**2

    return draw_ceramic(rng, lambda path: wall_pinning_memory(anhysteretic, pinning, path))


BOUC_WEN = Truth(name="bouc_wen", draw=draw_bouc_wen)
DAHL = Truth(name="dahl", draw=draw_dahl)
DUHEM = Truth(name="duhem", draw=draw_duhem)
WALL_PINNING = Truth(name="wall_pinning", draw=draw_wall_pinning)
