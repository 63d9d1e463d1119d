"""Columns of the nuisance class: powers of states and their products with the drive.

    sum_(i, n) c_in z_i^n + (d_i u + e_i u^2) z_i + sum_j f_j(x_j1, u) + g_j2 x_j2 + g_j3 x_j3

z_0 the drive itself, z_i plays, n = 1 .. 4, x_jn friction states of the n-th power of the drive,
f_j powers of x_j1 up to the third and its products with the drive and its square. A Bouc-Wen state
may be added: its minor loops do not close and may vary with bias.

Source: Bouc (1967); Wen, J. Eng. Mech. Div. 102 (1976); Al Janaideh, Rakheja & Su (2009).
"""

from collections.abc import Sequence

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.operators.wide_hysteresis import bouc_wen_states, friction_states, sum_of_polynomials

PLAYS = 18
POWERS = 4
FINE_PLAYS = 6  # plays below FINE_BELOW, with equal ratios; the others with equal steps
FINE_BELOW = 0.15
THRESHOLD = np.concatenate(
    [
        np.geomspace(0.01, FINE_BELOW, FINE_PLAYS + 1)[:-1],
        np.linspace(FINE_BELOW, 0.97, PLAYS - FINE_PLAYS),
    ]
)
FRICTION = np.geomspace(0.05, 3.0, 8)  # travel of the drive in which a friction state decays
CURVED_REACH = FRICTION[2:6]  # the same for walls attracted by a curved anhysteretic,
CURVED_POWERS = (2.0, 3.0)  # whose friction states follow these powers of the drive
REACH = np.concatenate([FRICTION, *[CURVED_REACH for _ in CURVED_POWERS]])
POWER = np.concatenate([np.ones(len(FRICTION)), np.repeat(CURVED_POWERS, len(CURVED_REACH))])
FRICTION_COUNT = len(FRICTION)
CURVED_COUNT = len(REACH) - FRICTION_COUNT
SHARED = (PLAYS + 1) * POWERS + 2 * PLAYS + 5 * FRICTION_COUNT + CURVED_COUNT
BOUC_WEN_COLUMNS = 5


def write_shared_columns(columns: Array, states: Array, friction: Array, drive: Array) -> None:
    """Write all shared columns in place, starting with powers of the drive and of the plays.

    columns   (rows, SHARED)
    states    (rows, plays)
    friction  (rows, friction states)
    drive     (rows,)
    """
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
    parts = [
        columns[:, first + FRICTION_COUNT * n : first + FRICTION_COUNT * (n + 1)] for n in range(5)
    ]
    np.divide(friction[:, :FRICTION_COUNT], np.minimum(FRICTION, 1.0), out=parts[0])
    np.multiply(parts[0], parts[0], out=parts[1])
    np.multiply(parts[1], parts[0], out=parts[2])
    np.multiply(u, parts[0], out=parts[3])
    np.multiply(u, parts[3], out=parts[4])
    columns[:, SHARED - CURVED_COUNT : SHARED] = friction[:, FRICTION_COUNT:]


def shared_response(states: Array, friction: Array, drive: Array, weight: Array) -> Array:
    """Return the sum of all shared columns with their weights, without the columns, (rows,)."""
    plays = PLAYS + 1
    power = weight[: plays * POWERS].reshape(POWERS, plays)
    bias = weight[plays * POWERS :][: 2 * PLAYS].reshape(2, PLAYS)
    of_states = weight[plays * POWERS + 2 * PLAYS : SHARED - CURVED_COUNT]
    of_states = of_states.reshape(5, FRICTION_COUNT)
    u = drive
    of_drive = sum_of_polynomials(
        u[:, None], u, scale=np.ones(1), power=power[:, :1], bias=np.zeros((2, 1))
    )
    of_plays = sum_of_polynomials(
        states, u, scale=1.0 / (1.05 - THRESHOLD), power=power[:, 1:], bias=bias
    )
    of_friction = sum_of_polynomials(
        friction[:, :FRICTION_COUNT],
        u,
        scale=1.0 / np.minimum(FRICTION, 1.0),
        power=of_states[:3],
        bias=of_states[3:],
    )
    curved = friction[:, FRICTION_COUNT:] @ weight[SHARED - CURVED_COUNT : SHARED]
    return np.asarray(of_drive + of_plays + of_friction + curved)


def bias_column_indices() -> tuple[int, ...]:
    """Return the indices of the shared columns that are products with the drive."""
    plays = (PLAYS + 1) * POWERS
    friction = plays + 2 * PLAYS + 3 * FRICTION_COUNT
    return (*range(plays, plays + 2 * PLAYS), *range(friction, SHARED - CURVED_COUNT))


def bouc_wen_columns(state: Array, drive: Array) -> Array:
    """Return the columns of a Bouc-Wen state: its powers and its products with the drive."""
    square, biased = state * state, drive * state
    columns = (state, square, square * state, biased, drive * biased)
    return np.array(columns).T


def friction_along(drive: Array, first: Array) -> Array:
    """Return all friction states along a drive, starting with ``first``, (samples, states)."""
    return friction_states(drive, REACH, first, power=POWER)


def initial_friction(drive: Array, reversals: Sequence[float]) -> Array:
    """Return the friction states at the first sample of a drive after earlier reversals."""
    path = np.array([*reversals, float(drive[0])])
    return np.asarray(friction_along(path, np.zeros(len(REACH)))[-1])


BoucWenLaw = tuple[float, float, float, float]
"""beta, gamma, n, b"""


def bouc_wen_along(bouc_wen: BoucWenLaw, reversals: Sequence[float], drive: Array) -> Array:
    """Return the Bouc-Wen state along a drive after earlier reversals, (samples,).

        dz/dt = dp/dt - (beta |dp/dt| |z|^(n-1) z + gamma dp/dt |z|^n),    p = u + b u^2 / 2

    The envelope p bends the drive in front of the hysteresis, as in the generalised
    Prandtl-Ishlinskii model; it increases with the drive for |b u| < 1.
    """
    beta, gamma, exponent, bend = bouc_wen
    path = np.array([*reversals, float(drive[0])])
    start = float(bouc_wen_states(_scaled(path, bend), beta, gamma, exponent)[-1])
    return bouc_wen_states(_scaled(drive, bend), beta, gamma, exponent, start)


def _scaled(drive: Array, bend: float) -> Array:
    return np.asarray(drive * (1.0 + 0.5 * bend * drive))
