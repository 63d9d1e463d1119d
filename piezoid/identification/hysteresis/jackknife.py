"""Uncertainty that survives correlated residuals: the fit without each block of time in turn.

Residuals of a hysteresis fit are correlated over many samples, so formulas that count samples are
wrong by large factors. Here the data are cut into blocks of whole cycles, and one Gauss-Newton
step gives the fit without each block:

    theta_(c) = theta + (A - A_c)^-1 g_c,   A = J'J, g_c = J_c' e_c,
    var f = (G - 1)/G  sum_c (f(theta_(c)) - mean f)^2,   intervals with Student's t at G - 1

Numbers on a bound stay there; of those an upper limit is given instead.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezoid.identification.hysteresis.gauss_newton import Task
from piezoid.identification.hysteresis.pieces import Piece
from piezoid.identification.hysteresis.rows import column_places, rows_of
from piezoid.numerics.arrays import Array
from piezoid.numerics.robust import student_quantile

BLOCKS = 24
_RIDGE = 1e-12
# Directions the data hardly see (eigenvalues of the scaled normal matrix below this share of the
# largest) keep the fit's values: there a linear step says nothing, and the output hardly changes.
TRUNCATED = 1e-5


@dataclass(frozen=True, kw_only=True, eq=False)
class Jackknife:
    """The fit and what it would have been without each block.

    theta       (total,)
    replicates  (blocks, total)
    free        (total,)  which numbers were not on a bound
    normal      (total, total)  A
    gradient    (blocks, total) g_c
    """

    theta: Array
    replicates: Array
    free: NDArray[np.bool_]
    normal: Array
    gradient: Array

    @property
    def blocks(self) -> int:
        """How many blocks the data were cut into."""
        return len(self.replicates)

    @property
    def quantile(self) -> float:
        """Return the factor from a standard error to half a 95 % interval."""
        return float(student_quantile(0.975, self.blocks - 1))

    def spread(self, functional: Callable[[Array], Array]) -> Array:
        """Return the covariance of a vector-valued function of theta."""
        values = np.array([functional(replicate) for replicate in self.replicates])
        centred = values - values.mean(axis=0)
        return np.asarray(centred.T @ centred * (self.blocks - 1) / self.blocks)

    def half_width(self, functional: Callable[[Array], Array]) -> Array:
        """Return half the 95 % interval of each value of a function of theta."""
        return np.asarray(self.quantile * np.sqrt(np.diag(self.spread(functional))))

    def upper_limit(self, place: int) -> float:
        """Return the one-sided 95 % limit of a number that lies on its lower bound.

        The number is freed for one step; its limit is that step, if upwards, and 1.645 standard
        errors: the boundary turns the two-sided test into a mixture.
        """
        free = self.free.copy()
        free[place] = True
        inverse = np.linalg.pinv(self.normal[np.ix_(free, free)], rcond=_RIDGE, hermitian=True)
        row = inverse[np.flatnonzero(np.flatnonzero(free) == place)[0]]
        steps = self.gradient[:, free] @ row
        estimate = -float(steps.sum())
        error = float(np.sqrt((steps**2).sum() * self.blocks / (self.blocks - 1)))
        return float(self.theta[place] + max(estimate, 0.0) + 1.645 * error)


def jackknife(theta: Array, task: Task) -> Jackknife:
    """Return the fit without each block of whole cycles in turn."""
    grams, (kinks, _) = grams_of(theta, task), task.prior
    bounds = task.coordinates.bounds(task.longest_lag_s)
    return left_out(theta, bounds, grams.normal, grams.gradient, kinks.T @ kinks)


def left_out(
    theta: Array,
    bounds: tuple[Array, Array],
    normals: Array,
    gradients: Array,
    prior: Array | float = 0.0,
) -> Jackknife:
    """Return the fit without each block, from J_c'J_c and J_c'e_c of every block.

    prior  what stands beside the data in A whichever block is left out
    """
    data = normals.sum(axis=0)
    whole = data + prior
    lower, upper = bounds
    free = (theta > lower + 1e-9) & (theta < upper - 1e-9) & (np.diag(data) > 0)
    replicates = np.repeat(theta[None], len(normals), axis=0)
    scale = np.sqrt(np.diag(data)[free])
    for block, (normal, gradient) in enumerate(zip(normals, gradients, strict=True)):
        seen, rest = (
            (matrix - normal)[np.ix_(free, free)] / np.outer(scale, scale)
            for matrix in (data, whole)
        )
        eigenvalue, direction = np.linalg.eigh(seen)
        known = direction[:, eigenvalue > TRUNCATED * eigenvalue[-1]]
        step = np.linalg.solve(known.T @ rest @ known, known.T @ (gradient[free] / scale))
        replicates[block, free] += known @ step / scale
    replicates = np.clip(replicates, lower, upper)
    return Jackknife(
        theta=theta, replicates=replicates, free=free, normal=whole, gradient=gradients
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Grams:
    """What least squares knows of every block of time.

    normal    (blocks, total, total)  J_c'J_c, in the order of the whole vector
    gradient  (blocks, total)         J_c'e_c
    """

    normal: Array
    gradient: Array


def grams_of(theta: Array, task: Task) -> Grams:
    """Return the normal matrices of every block."""
    coordinates = task.coordinates
    edges = block_edges(task.pieces)
    blocks = sum(len(edge) - 1 for edge in edges)
    normals = np.zeros((blocks, coordinates.total, coordinates.total))
    gradients = np.zeros((blocks, coordinates.total))
    before = 0
    for index, piece in enumerate(task.pieces):
        place = column_places(coordinates, index)
        for rows in rows_of(
            theta,
            coordinates,
            index,
            piece,
            sensor_pole=task.sensor_pole_Hz,
            stride=task.stride,
        ):
            block = before + np.searchsorted(edges[index][1:-1], rows.sample, side="right")
            for c in np.unique(block):
                tangent, residual = rows.tangent[block == c], rows.residual[block == c]
                normals[c][np.ix_(place, place)] += tangent.T @ tangent
                gradients[c][place] += tangent.T @ residual
        before += len(edges[index]) - 1
    return Grams(normal=normals, gradient=gradients)


def block_edges(pieces: Sequence[Piece]) -> list[NDArray[np.int_]]:
    """Cut each piece into blocks that begin where the drive crosses its middle upwards.

    returned  for each piece the edges, from its first row to its last; about 24 blocks in all
    """
    total = sum(piece.rows for piece in pieces)
    return [_edges(piece, max(1, round(BLOCKS * piece.rows / total))) for piece in pieces]


def _edges(piece: Piece, blocks: int) -> NDArray[np.int_]:
    blocks = max(blocks, 2)
    wanted = np.linspace(piece.first, piece.last, blocks + 1).astype(int)
    drive = piece.drive[piece.first : piece.last]
    above = drive > np.median(drive)
    starts = piece.first + 1 + np.flatnonzero(~above[:-1] & above[1:])
    if len(starts) < blocks:
        return wanted
    nearest = starts[np.abs(starts[:, None] - wanted[1:-1]).argmin(axis=0)]
    return np.unique(np.concatenate([wanted[:1], nearest, wanted[-1:]]))
