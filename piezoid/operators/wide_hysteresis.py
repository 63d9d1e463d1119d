"""A wide class of hysteresis, linear in its coefficients: columns along a drive.

    y = p(u) + sum_i f_i(P_i[u]) + sum_j (g_j l_j + h_j l_j^2 + ...) + friction + Bouc-Wen

P_i are plays of 24 half-widths and f_i piecewise-linear functions: a Preisach density over width
and position [Krejci 1996]. Its prior is a Gaussian process of three correlation lengths,
represented by the leading eigenvectors of its covariance. l_j = P_j - u enter with powers and
products. Friction states forget exponentially with the distance travelled [Dahl 1968],
[Coleman & Hodgdon 1986], and Bouc-Wen states have minor loops that do not close [Wen 1976].

The drive is scaled to -1 .. 1. All states are rate independent, and all start from full cycles.
"""

from collections.abc import Sequence
from functools import cache
from itertools import pairwise

import numpy as np
from numpy.polynomial.legendre import legvander

from piezoid.numerics.arrays import Array
from piezoid.operators.bouc_wen import bouc_wen_states
from piezoid.operators.friction import friction_states
from piezoid.operators.play import play_columns

WIDTHS = np.concatenate([[0.005, 0.01, 0.02, 0.035], np.linspace(0.055, 1.0, 20)])
EDGES = np.linspace(-1.0, 1.0, 13)  # between the cells of position
# Correlation lengths of the density in width and in position, and number of eigenvectors.
SCALES = ((0.6, 0.8, 14), (0.25, 0.3, 40), (0.08, 0.12, 110))
LAGGING = np.array([0, 2, 4, 6, 8, 10, 12, 14, 17, 20, 23])  # plays that enter with powers
PAIRED = LAGGING[3:]  # plays that enter with products of two
REACH = np.array([0.04, 0.08, 0.15, 0.25, 0.4, 0.65, 1.0, 1.8])  # of friction states
FRICTION_POWERS = (1.0, 2.0, 3.0)
# Limit of a Bouc-Wen state, its exponent, and unloading relative to loading.
BOUC_WEN = np.array(
    [
        (limit, exponent, unloading)
        for limit in (0.1, 0.2, 0.35, 0.6)
        for exponent in (1.0, 1.5, 2.0)
        for unloading in (0.1, 0.5, 1.0)
        if (exponent, unloading) != (1.0, 1.0)  # that is a friction state
    ]
)
POLYNOMIAL = 5  # degree of the Legendre polynomials of the drive
CYCLES = (0.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0)  # in front of every history
PATH_STEP = 0.02  # of a history: friction states of products need no finer one
CHUNK = 4096  # samples whose states are held at once
States = tuple[Array, Array, Array]
"""Plays, friction states and Bouc-Wen states, (samples, states) each."""


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
    """States of the class at the end of a drive; they start after full cycles and a history."""

    def __init__(self, history: Sequence[float]) -> None:
        """Follow full cycles, then the turning points of ``history``."""
        self._drive = 0.0
        self._plays = np.zeros(len(WIDTHS))
        self._friction = np.zeros(len(REACH) * len(FRICTION_POWERS))
        self._bouc_wen = np.zeros(len(BOUC_WEN))
        segments = [
            np.linspace(a, b, max(2, int(abs(b - a) / PATH_STEP) + 1))[1:]
            for a, b in pairwise(np.array([*CYCLES, *history]))
        ]
        self.follow(np.concatenate(segments))

    def follow(self, drive: Array) -> States:
        """Return plays, friction states and Bouc-Wen states at the samples, (samples, states)."""
        plays, self._plays = play_columns(drive, WIDTHS, self._plays)
        path = np.concatenate([[self._drive], drive])
        reach = np.tile(REACH, len(FRICTION_POWERS))
        power = np.repeat(FRICTION_POWERS, len(REACH))
        friction = friction_states(path, reach, self._friction, power=power)[1:]
        bouc_wen = np.empty((len(drive), len(BOUC_WEN)), order="F")
        for i, (limit, exponent, unloading) in enumerate(BOUC_WEN):
            loaded = limit**-exponent
            beta, gamma = 0.5 * loaded * (1.0 + unloading), 0.5 * loaded * (1.0 - unloading)
            start = float(self._bouc_wen[i])
            bouc_wen[:, i] = bouc_wen_states(path, beta, gamma, exponent, start)[1:]
        self._drive, self._friction, self._bouc_wen = drive[-1], friction[-1], bouc_wen[-1]
        return plays, friction, bouc_wen


def cells(position: Array) -> Array:
    """Return how much of every cell lies below a position, (samples, cells)."""
    return np.asarray(np.clip(position[:, None], EDGES[:-1], EDGES[1:]) - EDGES[:-1])


def smooth_columns(drive: Array, states: States) -> dict[str, Array]:
    """Return the columns of all families but the Preisach density, {family: (rows, columns)}."""
    plays, friction, bouc_wen = states
    v = drive[:, None]
    lag = plays[:, LAGGING] - v
    wide = plays[:, PAIRED] - v
    first, second = np.tril_indices(wide.shape[1], -1)
    dahl, few = friction[:, : len(REACH)], bouc_wen[:, ::3]
    families: dict[str, Array] = {
        "polynomial": np.asarray(legvander(drive, POLYNOMIAL)[:, 1:], dtype=np.float64),
        "plays times drive": np.hstack([lag * v, lag * v**2]),
        "powers of plays": np.hstack([lag**2, lag**2 * v, lag**3]),
        "products of plays": wide[:, first] * wide[:, second],
    }
    for power, block in zip(FRICTION_POWERS, np.split(friction, 3, axis=1), strict=True):
        families[f"friction {power:g}"] = block
    families["products of friction"] = np.hstack(
        [dahl * v, dahl * v**2, dahl**2, dahl**2 * v, dahl**3]
    )
    families["Bouc-Wen"] = bouc_wen
    families["products of Bouc-Wen"] = np.hstack([few * v, few**2, few**3])
    return families


def class_columns(drive: Array, states: States) -> dict[str, Array]:
    """Return the columns of all families, {family: (rows, columns)}."""
    smooth = smooth_columns(drive, states)
    reversible = cells(drive)
    density = np.hstack([cells(play) - reversible for play in states[0].T])
    components = {
        f"density {scale}": density @ density_components(scale) for scale in range(len(SCALES))
    }
    return {"polynomial": smooth.pop("polynomial"), **components, **smooth}


def coefficients(weights: Array) -> tuple[Array, Array]:
    """Return the density, (widths, cells), and the coefficients of all other families."""
    parts = np.split(weights[POLYNOMIAL:], np.cumsum([count for _, _, count in SCALES]))
    density = sum(density_components(k) @ part for k, part in enumerate(parts[:-1]))
    smooth = np.concatenate([weights[:POLYNOMIAL], parts[-1]])
    return np.reshape(density, (len(WIDTHS), len(EDGES) - 1)), smooth


def smooth_count() -> int:
    """Return the number of columns of all families but the density."""
    drive = np.zeros(1)
    states = HysteresisStates(()).follow(drive)
    return sum(x.shape[1] for x in smooth_columns(drive, states).values())
