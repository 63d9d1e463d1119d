"""Jackknife uncertainty, robust to correlated residuals: refits without each block of time.

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

from piezoid.identification.hysteresis.coordinates import Coordinates, operator_of
from piezoid.identification.hysteresis.gauss_newton import Task
from piezoid.identification.hysteresis.physical import (
    envelope_stretch,
    parameter_names,
    parameter_values,
    physical,
)
from piezoid.identification.hysteresis.pieces import Piece, Scales
from piezoid.identification.hysteresis.rows import column_places, rows_of
from piezoid.identification.quality import Uncertainty
from piezoid.numerics.arrays import Array
from piezoid.numerics.robust import student_quantile

BLOCKS = 24
POINTS = 41  # of the loading curve
_RIDGE = 1e-12
# Directions the data hardly see (eigenvalues of the scaled normal matrix below this share of the
# largest) keep the fit's values: there a linear step says nothing, and the output hardly changes.
TRUNCATED = 1e-5


@dataclass(frozen=True, kw_only=True, eq=False)
class Jackknife:
    """The fit, and refits without each block.

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

    def upper_limit(self, index: int) -> float:
        """Return the one-sided 95 % limit of a number that lies on its lower bound.

        The number is freed for one step; its limit is that step, if upwards, and 1.645 standard
        errors: the boundary turns the two-sided test into a mixture.
        """
        free = self.free.copy()
        free[index] = True
        inverse = np.linalg.pinv(self.normal[np.ix_(free, free)], rcond=_RIDGE, hermitian=True)
        row = inverse[np.flatnonzero(np.flatnonzero(free) == index)[0]]
        steps = self.gradient[:, free] @ row
        estimate = -float(steps.sum())
        error = float(np.sqrt((steps**2).sum() * self.blocks / (self.blocks - 1)))
        return float(self.theta[index] + max(estimate, 0.0) + 1.645 * error)


def jackknife(theta: Array, task: Task) -> Jackknife:
    """Return the fit without each block of whole cycles in turn."""
    normals, gradients = block_normals(theta, task)
    kinks, _ = task.prior
    bounds = task.coordinates.bounds(task.longest_lag_s)
    return left_out(theta, bounds, normals, gradients, kinks.T @ kinks)


def left_out(
    theta: Array,
    bounds: tuple[Array, Array],
    normals: Array,
    gradients: Array,
    prior: Array | float = 0.0,
) -> Jackknife:
    """Return the fit without each block, from J_c'J_c and J_c'e_c of every block.

    prior  what is added to the data in A whichever block is left out
    """
    data = normals.sum(axis=0)
    lower, upper = bounds
    free = (theta > lower + 1e-9) & (theta < upper - 1e-9) & (np.diag(data) > 0)
    replicates = np.repeat(theta[None], len(normals), axis=0)
    scale = np.sqrt(np.diag(data)[free])
    for block, (normal, gradient) in enumerate(zip(normals, gradients, strict=True)):
        remaining, regularised = (
            (matrix - normal)[np.ix_(free, free)] / np.outer(scale, scale)
            for matrix in (data, data + prior)
        )
        eigenvalue, direction = np.linalg.eigh(remaining)
        axes = direction[:, eigenvalue > TRUNCATED * eigenvalue[-1]]
        step = np.linalg.solve(axes.T @ regularised @ axes, axes.T @ (gradient[free] / scale))
        replicates[block, free] += axes @ step / scale
    return Jackknife(
        theta=theta,
        replicates=np.clip(replicates, lower, upper),
        free=free,
        normal=data + prior,
        gradient=gradients,
    )


def block_normals(theta: Array, task: Task) -> tuple[Array, Array]:
    """Return J_c'J_c, (blocks, total, total), and J_c'e_c, (blocks, total), of every block."""
    coordinates = task.coordinates
    edges = block_edges(task.pieces)
    blocks = sum(len(edge) - 1 for edge in edges)
    normals = np.zeros((blocks, coordinates.total, coordinates.total))
    gradients = np.zeros((blocks, coordinates.total))
    first = 0
    for index, piece in enumerate(task.pieces):
        columns = column_places(coordinates, index)
        for rows in rows_of(
            theta,
            coordinates,
            index,
            piece,
            sensor_pole=task.sensor_pole_Hz,
            stride=task.stride,
        ):
            block = first + np.searchsorted(edges[index][1:-1], rows.sample, side="right")
            for c in np.unique(block):
                tangent, residual = rows.tangent[block == c], rows.residual[block == c]
                normals[c][np.ix_(columns, columns)] += tangent.T @ tangent
                gradients[c][columns] += tangent.T @ residual
        first += len(edges[index]) - 1
    return normals, gradients


def block_edges(pieces: Sequence[Piece]) -> list[NDArray[np.int_]]:
    """Cut each piece into blocks that start where the drive rises through its middle.

    returned  for each piece the edges, from its first row to its last; about 24 blocks in all
    """
    total = sum(piece.rows for piece in pieces)
    edges = []
    for piece in pieces:
        blocks = max(2, round(BLOCKS * piece.rows / total))
        even = np.linspace(piece.first, piece.last, blocks + 1).astype(int)
        drive = piece.drive[piece.first : piece.last]
        above = drive > np.median(drive)
        starts = piece.first + 1 + np.flatnonzero(~above[:-1] & above[1:])
        if len(starts) >= blocks:
            nearest = starts[np.abs(starts[:, None] - even[1:-1]).argmin(axis=0)]
            even = np.unique(np.concatenate([even[:1], nearest, even[-1:]]))
        edges.append(even)
    return edges


def summarise(jack: Jackknife, coordinates: Coordinates, scales: Scales) -> Uncertainty:
    """Return intervals of parameters, loading curve and loop width.

    Play weights that lie on zero get one-sided upper limits.
    """
    reach_V = np.linspace(0.0, scales.voltage_V, POINTS)

    def parameters(theta: Array) -> Array:
        return parameter_values(theta, coordinates, scales)

    def loading(theta: Array) -> Array:
        model = physical(operator_of(theta, coordinates), scales)
        return model.run(model.voltage_offset_V + reach_V, model.virgin_memory())[0]

    def width(theta: Array) -> Array:
        return np.array([loop_width_m(theta, coordinates, scales)])

    operator = operator_of(jack.theta, coordinates)
    unit = abs(scales.displacement_m) / (envelope_stretch(operator) * scales.voltage_V)
    first = coordinates.slices["weight"].start
    return Uncertainty(
        blocks=jack.blocks,
        names=parameter_names(operator),
        values=parameters(jack.theta),
        covariance=jack.spread(parameters),
        upper_limit={
            f"play_weight_m_per_V[{i}]": jack.upper_limit(first + i) * unit
            for i in range(1, coordinates.shape.plays + 1)
            if jack.theta[first + i] <= 0.0
        },
        reach_V=reach_V,
        loading_m=loading(jack.theta),
        loading_half_m=jack.half_width(loading),
        loop_width_m=(float(width(jack.theta)[0]), float(jack.half_width(width)[0])),
    )


def loop_width_m(theta: Array, coordinates: Coordinates, scales: Scales) -> float:
    """Return how far the full steady loop is open where the drive passes its middle.

    2 sum_i w_i min(r_i, A - r_i)_+ seen through Psi, A half the range of the drive
    """
    model = physical(operator_of(theta, coordinates), scales)
    plays = model.plays
    half = float(
        (plays.weight * np.clip(scales.voltage_V - plays.threshold, 0.0, plays.threshold)).sum()
    )
    low_m, high_m = model.dead_zones.run(np.array([-half, half]))
    return float(high_m - low_m)
