"""A wide class of hysteresis that is linear in its coefficients: columns along a drive.

    y = p(u) + sum_i f_i(P_i[u]) + sum_j (g_j l_j + h_j l_j^2 + ...) + friction + Bouc-Wen

P_i are plays of 24 half-widths and f_i piecewise-linear functions: a Preisach density over width
and position [Krejci 1996]. Its prior is a Gaussian process of three correlation lengths,
represented by the leading eigenvectors of its covariance. l_j = P_j - u enter with powers and
products. Friction states decay exponentially with the distance travelled,

    dx/dt = d(u^n)/dt - |du/dt| x / r

where n = 1 is Dahl's friction and the powers are the first terms of the series of an anhysteretic
curve in its place; Bouc-Wen states saturate smoothly, with minor loops that do not close,

    dz/du = 1 - |z|^n (gamma + beta sgn(z du))

The drive is scaled to -1 .. 1. All states are rate independent and start after full cycles.

Source: Dahl, Aerospace Corporation TR-0158 (1968); Jiles & Atherton, J. Magn. Magn. Mater. 61
(1986); Coleman & Hodgdon, Int. J. Eng. Sci. 24 (1986); Bouc (1967); Wen, J. Eng. Mech. 102 (1976).
"""

from collections.abc import Sequence
from functools import cache, lru_cache
from itertools import pairwise

import numpy as np
from numpy.polynomial.legendre import legval, legvander
from numpy.typing import ArrayLike

from piezoid.numerics.arrays import Array
from piezoid.operators.library import KERNELS, address, contiguous
from piezoid.operators.play import play_columns

WIDTHS = np.concatenate([[0.005, 0.01, 0.02, 0.035], np.linspace(0.055, 1.0, 20)])
EDGES = np.linspace(-1.0, 1.0, 13)  # between the cells of position
# Correlation lengths of the density in width and in position, and number of eigenvectors.
SCALES = ((0.6, 0.8, 14), (0.25, 0.3, 40), (0.08, 0.12, 110))
LAGGING = np.array([0, 2, 4, 6, 8, 10, 12, 14, 17, 20, 23])  # indices of plays with powers
PAIRS = tuple(index + 3 for index in np.tril_indices(8, -1))  # of ``LAGGING``, with products
REACH = np.array([0.04, 0.08, 0.15, 0.25, 0.4, 0.65, 1.0, 1.8])  # of friction states
FRICTION_POWERS = (1.0, 2.0, 3.0)  # n, the powers that the kernel knows
# Limit of a Bouc-Wen state, its exponent, and unloading relative to loading.
BOUC_WEN = np.array(
    [
        (limit, exponent, unloading)
        for limit in (0.1, 0.2, 0.35, 0.6)
        for exponent in (1.0, 1.5, 2.0)
        for unloading in (0.1, 0.5, 1.0)
        if (exponent, unloading) != (1.0, 1.0)  # which is a friction state
    ]
)
MAX_STEP = 0.01  # of the drive; the error of the midpoint rule is then some 1e-5 of the state
POLYNOMIAL = 5  # degree of the Legendre polynomials of the drive
LINEAR = ((0, 1),)
# Families beside polynomials and density: a group of states z, and products u^n z^m as (n, m).
FAMILIES = {
    "plays times drive": ("lag", ((1, 1), (2, 1))),
    "powers of plays": ("lag", ((0, 2), (1, 2), (0, 3))),
    "products of plays": ("pairs", LINEAR),
    **{f"friction {n:g}": (f"friction {n:g}", LINEAR) for n in FRICTION_POWERS},
    "products of friction": ("friction 1", ((1, 1), (2, 1), (0, 2), (1, 2), (0, 3))),
    "Bouc-Wen": ("Bouc-Wen", LINEAR),
    "products of Bouc-Wen": ("every third Bouc-Wen", ((1, 1), (0, 2), (0, 3))),
}
CYCLES = (0.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0)  # turning points before every history
PATH_STEP = 0.02  # of the drive in a history; friction states with powers need no smaller step
CHUNK = 2048  # samples: the states of a chunk fit into the cache
States = tuple[Array, Array, Array]
"""Plays, friction states and Bouc-Wen states, (samples, states) each."""
_End = tuple[float, Array, Array, Array]  # drive and states at its last sample


def friction_states(
    drive: Array, reach: Array, start: Array, *, power: Array | None = None
) -> Array:
    """Return friction states along a drive, dx/dt = d(u^n)/dt - |du/dt| x / r.

    Between samples a state relaxes exponentially to

        q_1 = s r,   q_2 = 2 s r u - 2 r^2,   q_3 = 3 s r u^2 - 6 r^2 u + 6 s r^3,   s = sgn(du)

    drive     (samples,)         any unit
    reach     (states,)          r, unit of the drive, > 0
    start     (states,)          x at the first sample
    power     (states,)          n, 1 to 3; None: all 1
    returned  (samples, states)  unit of the drive^n, column-major
    """
    powers = np.ones(len(reach)) if power is None else contiguous(power)
    if not np.isin(powers, FRICTION_POWERS).all():
        raise ValueError(f"powers are {np.unique(powers)}, expected some of (1, 2, 3)")
    order = np.argsort(reach, kind="stable")  # states of equal reach share an exponential
    u, state = contiguous(drive), np.array(start, dtype=np.float64)[order]
    states = np.empty((len(u), len(state)), order="F")
    KERNELS.pk_friction(
        len(u),
        address(u),
        len(state),
        address(contiguous(reach)[order]),
        address(powers[order]),
        address(order.astype(np.float64)),
        address(state),
        len(u),
        address(states),
    )
    return states


def bouc_wen_states(
    drive: Array,
    beta: ArrayLike,
    gamma: ArrayLike,
    exponent: ArrayLike,
    start: ArrayLike = 0.0,
) -> Array:
    """Return Bouc-Wen states along a drive, dz/du = 1 - |z|^n (gamma + beta sgn(z du)).

    drive            (samples,)            of the order of one
    beta, gamma      scalars or (states,)  loading and unloading; 1 / unit of the drive^n
    exponent         scalar or (states,)   n >= 1, sharpness of the knee
    start            scalar or (states,)   z at the first sample
    returned         (samples,) or (samples, states)  unit of the drive
    """
    numbers = np.broadcast_arrays(*(np.asarray(x, float) for x in (beta, gamma, exponent, start)))
    law, state = np.stack(numbers[:3], axis=-1), contiguous(numbers[3].ravel()).copy()
    drive = contiguous(drive)
    states = np.empty((len(drive), len(state)))
    KERNELS.pk_bouc_wen(
        len(drive),
        address(drive),
        len(state),
        address(contiguous(law)),
        MAX_STEP,
        address(state),
        address(states),
    )
    return states if numbers[0].ndim else states[:, 0]


@cache
def density_components(scale: int) -> Array:
    """Return the leading eigenvectors of the prior of the density, (cells, components).

        cov(density(w, c), density(w', c')) = exp(-(w - w')^2 / 2 a^2 - (c - c')^2 / 2 b^2)

    Each is scaled by the square root of its eigenvalue; cells are ordered width by width.
    """
    width_scale, position_scale, count = SCALES[scale]
    middle = 0.5 * (EDGES[1:] + EDGES[:-1])
    width, position = (a.ravel() for a in np.meshgrid(WIDTHS, middle, indexing="ij"))
    is_inside = np.abs(position) + width < 1.15
    area = np.repeat(np.gradient(WIDTHS), len(middle)) * is_inside
    prior = np.exp(
        -0.5 * ((width[:, None] - width) / width_scale) ** 2
        - 0.5 * ((position[:, None] - position) / position_scale) ** 2
    )
    value, vector = np.linalg.eigh(prior * area[:, None] * area)
    return np.asarray((vector * np.sqrt(np.maximum(value, 0.0)))[:, ::-1][:, :count])


class HysteresisStates:
    """States of the class along a drive, after full cycles and a history."""

    def __init__(self, history: Sequence[float]) -> None:
        """Start after full cycles and the turning points of ``history``."""
        self._end = _end_of_history(tuple(history))

    def follow(self, drive: Array) -> States:
        """Return the states along the next samples of the drive, (samples, states) each."""
        states, self._end = _states_along(drive, self._end)
        return states


@lru_cache(maxsize=256)
def _end_of_history(history: tuple[float, ...]) -> _End:
    """Return drive and states after full cycles and the turning points of a history."""
    segments = [
        np.linspace(a, b, max(2, int(abs(b - a) / PATH_STEP) + 1))[1:]
        for a, b in pairwise(np.array([*CYCLES, *history]))
    ]
    drive = np.concatenate(segments)
    friction = np.zeros(len(REACH) * len(FRICTION_POWERS))
    start = (0.0, np.zeros(len(WIDTHS)), friction, np.zeros(len(BOUC_WEN)))
    return _states_along(drive, start)[1]


def _states_along(drive: Array, start: _End) -> tuple[States, _End]:
    """Return the states along a drive that continues from the end of another one, and its end."""
    start_drive, plays, friction, bouc_wen = start
    path = np.concatenate([[start_drive], drive])
    reach = np.tile(REACH, len(FRICTION_POWERS))
    power = np.repeat(FRICTION_POWERS, len(REACH))
    limit, exponent, unloading = BOUC_WEN.T
    loading = 0.5 * limit**-exponent
    beta, gamma = loading * (1.0 + unloading), loading * (1.0 - unloading)
    states = (
        play_columns(drive, WIDTHS, plays)[0],
        friction_states(path, reach, friction, power=power)[1:],
        bouc_wen_states(path, beta, gamma, exponent, bouc_wen)[1:],
    )
    plays, friction, bouc_wen = (columns[-1].copy() for columns in states)
    return states, (float(drive[-1]), plays, friction, bouc_wen)


def cells(position: Array) -> Array:
    """Return the part of every cell below a position, (samples, cells)."""
    lower, upper = EDGES[:-1, None], EDGES[1:, None]
    return np.asarray((np.clip(position, lower, upper) - lower).T)


def _state_groups(drive: Array, states: States) -> dict[str, Array]:
    """Return the groups of states of ``FAMILIES`` except the pairs, (rows, states) each."""
    plays, friction, bouc_wen = states
    of_power = zip(FRICTION_POWERS, np.split(friction, len(FRICTION_POWERS), axis=1), strict=True)
    return {
        "lag": (plays.T[LAGGING] - drive).T,
        **{f"friction {n:g}": block for n, block in of_power},
        "Bouc-Wen": bouc_wen,
        "every third Bouc-Wen": np.asfortranarray(bouc_wen[:, ::3]),
    }


@cache
def smooth_families() -> tuple[str, ...]:
    """Return the family of every column of ``smooth_columns``."""
    groups = _state_groups(np.zeros(1), HysteresisStates(()).follow(np.zeros(1)))
    counts = {name: group.shape[1] for name, group in groups.items()} | {"pairs": len(PAIRS[0])}
    names = ["polynomial"] * POLYNOMIAL
    for name, (group, exponents) in FAMILIES.items():
        names += [name] * (len(exponents) * counts[group])
    return tuple(names)


@cache
def class_families() -> tuple[str, ...]:
    """Return the family of every column of ``class_columns``."""
    smooth = smooth_families()
    densities = [f"density {k}" for k, (_, _, count) in enumerate(SCALES) for _ in range(count)]
    return (*smooth[:POLYNOMIAL], *densities, *smooth[POLYNOMIAL:])


def smooth_columns(drive: Array, states: States) -> Array:
    """Return the columns of all families except the density, (rows, columns)."""
    groups, u = _state_groups(drive, states), drive[:, None]
    lag, (first, second) = groups["lag"].T, PAIRS
    groups["pairs"] = (lag[first] * lag[second]).T
    columns = np.empty((len(drive), len(smooth_families())), order="F")
    columns[:, :POLYNOMIAL] = legvander(drive, POLYNOMIAL)[:, 1:]
    stop = POLYNOMIAL
    for group, exponents in FAMILIES.values():
        z = groups[group]
        powers = {1: z, 2: z * z}  # ``z**3`` takes 28 times as long as two products
        powers[3] = powers[2] * z
        for n, m in exponents:
            first_column, stop = stop, stop + z.shape[1]
            np.multiply(u**n, powers[m], out=columns[:, first_column:stop])
    return columns


def smooth_response(drive: Array, states: States, coefficient: Array) -> Array:
    """Return the sum of all columns of ``smooth_columns`` times their coefficients, (rows,).

    >>> drive = np.array([0.0, 0.5])
    >>> states = HysteresisStates((-0.5, 0.0)).follow(drive)
    >>> smooth_response(drive, states, np.eye(len(smooth_families()))[0]).tolist()
    [0.0, 0.5]
    """
    groups, first = _state_groups(drive, states), POLYNOMIAL
    lag = groups["lag"]
    total = np.asarray(legval(drive, [0.0, *coefficient[:first]]))
    for group, exponents in FAMILIES.values():
        count = len(PAIRS[0]) if group == "pairs" else groups[group].shape[1]
        stop = first + len(exponents) * count
        weights = coefficient[first:stop].reshape(-1, count)
        first = stop
        if group == "pairs":
            matrix = np.zeros((len(LAGGING), len(LAGGING)))
            matrix[PAIRS] = weights[0]
            total += np.einsum("ij,ij->i", lag @ matrix, lag)
        elif exponents == LINEAR:
            total += groups[group] @ weights[0]
        else:
            weight = dict(zip(exponents, weights, strict=True))
            zero = np.zeros(count)
            total += sum_of_polynomials(
                groups[group],
                drive,
                scale=np.ones(count),
                power=np.array([weight.get((0, m), zero) for m in (1, 2, 3)]),
                bias=np.array([weight.get(e, zero) for e in ((1, 1), (2, 1), (1, 2))]),
            )
    return total


def class_columns(drive: Array, states: States) -> Array:
    """Return the columns of all families, (rows, columns)."""
    return mixed_columns(drive, (states,), np.ones(1))


def mixed_columns(drive: Array, states: Sequence[States], weight: Array) -> Array:
    """Return the weighted sum of the columns after several histories, (rows, columns).

    drive   (samples,)    the same after all histories
    states  (histories,)  along the drive
    weight  (histories,)
    """
    components = np.hstack([density_components(scale) for scale in range(len(SCALES))])
    behind_density, count = POLYNOMIAL + components.shape[1], len(EDGES) - 1
    columns = np.zeros((len(drive), len(class_families())), order="F")
    density = np.tile(-weight.sum() * cells(drive).T, (len(WIDTHS), 1)).T
    for w, of_history in zip(weight, states, strict=True):
        smooth = smooth_columns(drive, of_history)
        smooth *= w
        columns[:, :POLYNOMIAL] += smooth[:, :POLYNOMIAL]
        columns[:, behind_density:] += smooth[:, POLYNOMIAL:]
        for j, play in enumerate(of_history[0].T):
            density[:, j * count : (j + 1) * count] += w * cells(play)
    columns[:, POLYNOMIAL:behind_density] = density @ components
    return columns


def coefficients(weights: Array) -> tuple[Array, Array]:
    """Return the density, (widths, cells), and the coefficients of all other families."""
    parts = np.split(weights[POLYNOMIAL:], np.cumsum([count for _, _, count in SCALES]))
    density = sum(density_components(k) @ part for k, part in enumerate(parts[:-1]))
    smooth = np.concatenate([weights[:POLYNOMIAL], parts[-1]])
    return np.reshape(density, (len(WIDTHS), len(EDGES) - 1)), smooth


def sum_of_polynomials(
    states: Array, drive: Array, *, scale: Array, power: Array, bias: Array
) -> Array:
    """Return the sum of one polynomial per state, with slopes at zero that depend on the drive.

        y = sum_i z_i (c_i1 + u a_i + u^2 b_i + z_i (c_i2 + u d_i + z_i (c_i3 + z_i c_i4)))

    z  states * scale  (samples, states)     scale (states,)
    u  drive           (samples,)
    c  power           (<= 4, states)        missing powers are zero
    a, b, d  bias      (<= 3, states)       missing rows are zero
    y  returned        (samples,)
    """
    columns = np.asfortranarray(states, dtype=np.float64)
    samples, count = columns.shape
    total = np.zeros(samples)
    powers, biases = np.zeros((4, count)), np.zeros((3, count))
    powers[: len(power)], biases[: len(bias)] = power, bias
    KERNELS.pk_polynomials(
        samples,
        address(contiguous(drive)),
        count,
        samples,
        address(columns),
        address(contiguous(scale)),
        address(powers),
        address(biases),
        address(total),
    )
    return total
