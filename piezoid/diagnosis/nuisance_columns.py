"""Columns of the nuisance class: powers of states and their products with the drive.

    sum_(i, n) c_in z_i^n + (d_i u + e_i u^2) z_i + sum_j f_j(x_j1, u) + g_j2 x_j2 + g_j3 x_j3

z_0 the drive itself, z_i plays, n = 1 .. 4, x_jn friction states of the n-th power of the drive,
f_j powers of x_j1 up to the third and its products with the drive and its square. A Bouc-Wen state
may stand beside them: its minor loops do not close and may vary with bias.

Source: Bouc (1967); Wen, J. Eng. Mech. Div. 102 (1976); Al Janaideh, Rakheja & Su (2009).
"""

from collections.abc import Sequence

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.operators.bouc_wen import bouc_wen_states
from piezoid.operators.friction import friction_states
from piezoid.operators.polynomials import sum_of_polynomials

PLAYS = 18
POWERS = 4
FINE = 6  # plays below TURN_AT, with equal ratios; the others with equal steps
TURN_AT = 0.15
THRESHOLD = np.concatenate(
    [np.geomspace(0.01, TURN_AT, FINE + 1)[:-1], np.linspace(TURN_AT, 0.97, PLAYS - FINE)]
)
FRICTION = np.geomspace(0.05, 3.0, 8)  # how far the drive goes until a friction state forgot
PINNING = FRICTION[2:6]  # likewise of walls that are drawn to a curved anhysteretic,
RESTS = (2.0, 3.0)  # of which these are the powers of the drive beside the first
REACH = np.concatenate([FRICTION, *[PINNING for _ in RESTS]])
POWER = np.concatenate([np.ones(len(FRICTION)), np.repeat(RESTS, len(PINNING))])
RUBS = len(FRICTION)
CURVED = len(REACH) - RUBS
SHARED = (PLAYS + 1) * POWERS + 2 * PLAYS + 5 * RUBS + CURVED
BOUC_WEN_COLUMNS = 5


def shape_columns(states: Array, friction: Array, drive: Array) -> Array:
    """Return all shared columns at some rows: first powers of the drive and of the plays.

    states    (rows, plays)
    friction  (rows, friction states)
    drive     (rows,)
    """
    columns = np.empty((len(drive), SHARED), order="F")
    write_shape(columns, states, friction, drive)
    return columns


def write_shape(columns: Array, states: Array, friction: Array, drive: Array) -> None:
    """Write the shared columns in place, which saves a copy."""
    plays, u = PLAYS + 1, drive[:, None]
    base = columns[:, :plays]
    base[:, 0] = drive
    np.divide(states, 1.05 - THRESHOLD, out=base[:, 1:])
    for power in range(1, POWERS):
        lower, higher = (columns[:, plays * n : plays * (n + 1)] for n in (power - 1, power))
        np.multiply(lower, base, out=higher)
    first = plays * POWERS
    for lower in (base[:, 1:], columns[:, first : first + PLAYS]):
        np.multiply(u, lower, out=columns[:, first : first + PLAYS])
        first += PLAYS
    parts = [columns[:, first + RUBS * n : first + RUBS * (n + 1)] for n in range(5)]
    np.divide(friction[:, :RUBS], np.minimum(FRICTION, 1.0), out=parts[0])
    np.multiply(parts[0], parts[0], out=parts[1])
    np.multiply(parts[1], parts[0], out=parts[2])
    np.multiply(u, parts[0], out=parts[3])
    np.multiply(u, parts[3], out=parts[4])
    columns[:, SHARED - CURVED : SHARED] = friction[:, RUBS:]


def shape(states: Array, friction: Array, drive: Array, weight: Array) -> Array:
    """Return ``shape_columns(...) @ weight`` without making the columns, (rows,)."""
    plays = PLAYS + 1
    power = weight[: plays * POWERS].reshape(POWERS, plays)
    bias = weight[plays * POWERS :][: 2 * PLAYS].reshape(2, PLAYS)
    rub = weight[plays * POWERS + 2 * PLAYS : SHARED - CURVED].reshape(5, RUBS)
    u = drive
    of_drive = sum_of_polynomials(
        u[:, None], u, scale=np.ones(1), power=power[:, :1], bias=np.zeros((2, 1))
    )
    of_plays = sum_of_polynomials(
        states, u, scale=1.0 / (1.05 - THRESHOLD), power=power[:, 1:], bias=bias
    )
    of_friction = sum_of_polynomials(
        friction[:, :RUBS], u, scale=1.0 / np.minimum(FRICTION, 1.0), power=rub[:3], bias=rub[3:]
    )
    curved = friction[:, RUBS:] @ weight[SHARED - CURVED : SHARED]
    return np.asarray(of_drive + of_plays + of_friction + curved)


def bias_places() -> tuple[int, ...]:
    """Return which of the shared columns are products with the drive."""
    plays = (PLAYS + 1) * POWERS
    friction = plays + 2 * PLAYS + 3 * RUBS
    return (*range(plays, plays + 2 * PLAYS), *range(friction, SHARED - CURVED))


def bouc_wen_columns(state: Array, drive: Array) -> Array:
    """Return the columns of a Bouc-Wen state: its powers and its products with the drive."""
    square, biased = state * state, drive * state
    columns = (state, square, square * state, biased, drive * biased)
    return np.array(columns).T


def rubbing(drive: Array, first: Array) -> Array:
    """Return all friction states along a drive, (samples, states)."""
    return friction_states(drive, REACH, first, power=POWER)


def rubbed(drive: Array, reversals: Sequence[float]) -> Array:
    """Return the friction states at the first sample after these reversals of the drive."""
    path = np.array([*reversals, float(drive[0])])
    return np.asarray(rubbing(path, np.zeros(len(REACH)))[-1])


BoucWenLaw = tuple[float, float, float, float]
"""beta, gamma, n, b"""


def states_under(bouc_wen: BoucWenLaw, reversals: Sequence[float], drive: Array) -> Array:
    """Return the Bouc-Wen state along a drive after given reversals, (samples,).

        dz/dt = dp/dt - (beta |dp/dt| |z|^(n-1) z + gamma dp/dt |z|^n),    p = u + b u^2 / 2

    The scale p bends the drive in front of the hysteresis, as in the generalised
    Prandtl-Ishlinskii model; it rises for |b u| < 1.
    """
    beta, gamma, exponent, bend = bouc_wen
    path = np.array([*reversals, float(drive[0])])
    start = float(bouc_wen_states(_scaled(path, bend), beta, gamma, exponent)[-1])
    return bouc_wen_states(_scaled(drive, bend), beta, gamma, exponent, start)


def _scaled(drive: Array, bend: float) -> Array:
    return np.asarray(drive * (1.0 + 0.5 * bend * drive))
