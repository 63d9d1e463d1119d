"""Uncertainty of a fit: jackknife over blocks of time, and a bound on the error of the model.

Residuals of a hysteresis fit are correlated over many samples, so formulas that count samples are
wrong by large factors. Here the data are cut into blocks of whole cycles, and one Gauss-Newton
step gives the fit without each block:

    theta_(c) = theta + (A - A_c)^-1 g_c,   A = J'J, g_c = J_c' e_c,
    var f = (G - 1)/G  sum_c (f(theta_(c)) - mean f)^2,   intervals with Student's t at G - 1

Numbers on a bound stay there; of those an upper limit is given instead. The bound of the error
for any drive in the range is

    |Gamma_t[u] - Gamma_m[u]| <= Lip(Psi_m) (int |W_t - W_m| dr + Lip(H_m) sup |gamma_t - gamma_m|)
                                 + sup |Psi_t - Psi_m| + rho

The first terms are 95 % quantiles over models drawn from the fit's own uncertainty; rho is
the 99.9 % quantile of the held-out residual. Every term is finite, so the error of the model, and
with it that of the compensation by its inverse, is bounded for all bounded drives.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezoid.identification.hysteresis.coordinates import Coordinates, operator_of
from piezoid.identification.hysteresis.gauss_newton import Task, column_places, rows_of
from piezoid.identification.hysteresis.physical import (
    envelope_stretch,
    parameter_names,
    parameter_values,
    physical,
)
from piezoid.identification.hysteresis.pieces import Piece, Scales
from piezoid.identification.quality import Certificate, Uncertainty
from piezoid.numerics.arrays import Array
from piezoid.numerics.robust import student_quantile
from piezoid.operators.dead_zone import DeadZones
from piezoid.operators.modified_prandtl_ishlinskii import ModifiedPrandtlIshlinskii
from piezoid.operators.worst_case import worst_case

BLOCKS = 24
POINTS = 41  # of the loading curve
_RIDGE = 1e-12
# Directions the data hardly see (eigenvalues of the scaled normal matrix below this share of the
# largest) keep the fit's values: there a linear step says nothing, and the output hardly changes.
TRUNCATED = 1e-5
DRAWS = 200
DRIVES = 12  # of each arbitrary kind
TURNS = 24
STEPS = 6  # samples from one turning point to the next
SEED = 1


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

    def spread(self, functional: Callable[[Array], Array]) -> Array:
        """Return the covariance of a vector-valued function of theta."""
        values = np.array([functional(replicate) for replicate in self.replicates])
        centred = values - values.mean(axis=0)
        return np.asarray(centred.T @ centred * (self.blocks - 1) / self.blocks)

    def half_width(self, functional: Callable[[Array], Array]) -> Array:
        """Return half the 95 % interval of each value of a function of theta."""
        quantile = float(student_quantile(0.975, self.blocks - 1))
        return np.asarray(quantile * np.sqrt(np.diag(self.spread(functional))))

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
    for index in range(len(task.pieces)):
        columns = column_places(coordinates, index)
        for sample, rows in rows_of(theta, task, index):
            block = first + np.searchsorted(edges[index][1:-1], sample, side="right")
            for c in np.unique(block):
                tangent, residual = rows[block == c, :-1], rows[block == c, -1]
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
        drive = piece.fitted_drive
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


def certify(
    jack: Jackknife,
    coordinates: Coordinates,
    scales: Scales,
    residual_m: Array,
    slew_V_per_s: float,
    longest_lag_s: float,
) -> Certificate:
    """Return the bound for drives within the range of the data."""
    model = physical(operator_of(jack.theta, coordinates), scales)
    reach_V = scales.voltage_V
    # theta + sum_c xi_c sqrt((G - 1)/G) (theta_(c) - mean), xi standard normal, within the bounds
    centred, blocks = jack.replicates - jack.replicates.mean(axis=0), jack.blocks
    xi = np.random.default_rng(SEED).standard_normal((DRAWS, blocks))
    xi *= np.sqrt((blocks - 1) / blocks)
    vectors = np.clip(jack.theta + xi @ centred, *coordinates.bounds(longest_lag_s))
    drawn_models = [physical(operator_of(theta, coordinates), scales) for theta in vectors]
    terms = [distance_terms(model, alternative, reach_V) for alternative in drawn_models]
    plays_m, zones_m = np.quantile(np.array(terms), 0.95, axis=0)
    drives_V = adversarial_drives(reach_V, SEED)
    reached = [
        reached_difference(model, alternative, drives_V, reach_V) for alternative in drawn_models
    ]
    return Certificate(
        plays_m=float(plays_m),
        dead_zones_m=float(zones_m),
        remainder_m=float(np.quantile(np.abs(residual_m), 0.999)),
        found_m=float(np.quantile(reached, 0.95)),
        reach_V=reach_V,
        slew_V_per_s=slew_V_per_s,
    )


def adversarial_drives(reach_V: float, seed: int) -> Array:
    """Return drives through decaying, growing and arbitrary turning points, (samples,) in V.

    Each of them begins with a full swing, so that what came before is forgotten.
    """
    rng = np.random.default_rng(seed)
    sign = (-1.0) ** np.arange(TURNS)
    sizes = [np.linspace(1.0, 0.02, TURNS), np.linspace(0.02, 1.0, TURNS)]
    sizes += [np.sort(rng.uniform(0.02, 1.0, TURNS))[::-1] for _ in range(DRIVES)]
    levels = [sign * size for size in sizes]
    levels += [rng.uniform(-1.0, 1.0, TURNS) for _ in range(DRIVES)]
    turns = np.concatenate([np.concatenate([[1.0, -1.0], level]) for level in levels])
    steps = np.linspace(0.0, 1.0, STEPS, endpoint=False)
    return np.asarray(reach_V * (turns[:-1, None] + np.diff(turns)[:, None] * steps).ravel())


def reached_difference(
    model: ModifiedPrandtlIshlinskii,
    alternative: ModifiedPrandtlIshlinskii,
    drives_V: Array,
    reach_V: float,
) -> float:
    """Return the largest difference of two models over many drives and their worst-case input.

    A common zero is removed, because it is fitted for every recording. The worst-case input of two
    play sums starts at the end of the range, so any history may precede it; its mirror image is
    tried as well.
    """
    worst_V = worst_case(alternative.plays, model.plays, reach_V).extrema
    voltage_V = model.voltage_offset_V + np.concatenate([drives_V, worst_V, -worst_V])
    first, second = (m.run(voltage_V, m.virgin_memory())[0] for m in (model, alternative))
    difference = second - first
    return float(np.ptp(difference) / 2)


def distance_terms(
    model: ModifiedPrandtlIshlinskii, alternative: ModifiedPrandtlIshlinskii, reach_V: float
) -> tuple[float, float]:
    """Return the play and the dead-zone term of the distance between two models, m.

    The alternative is first rescaled until both loading curves have the same end: one operator has
    many equivalent scalings.
    """
    end = np.array([reach_V])
    ratio = float(model.plays.loading_curve(end)[0] / alternative.plays.loading_curve(end)[0])
    alternative = alternative.rescaled(ratio)
    steepest = float(model.dead_zones.slope.max())
    reach = np.array([-reach_V, reach_V])
    widest_V = float(np.abs(alternative.envelope.run(reach)).max())
    bends_V = _sup_difference(model.envelope, alternative.envelope, reach_V)
    plays_m = steepest * (
        worst_case(alternative.plays, model.plays, widest_V).bound
        + float(np.abs(model.plays.weight).sum()) * bends_V
    )
    top_m = float(alternative.plays.loading_curve(np.array([widest_V]))[0])
    return plays_m, _sup_difference(model.dead_zones, alternative.dead_zones, top_m)


def _sup_difference(first: DeadZones, second: DeadZones, reach: float) -> float:
    """Return the greatest distance of two piecewise-linear maps over [-reach, reach]."""
    knots = np.concatenate([first.threshold, second.threshold])
    grid = np.concatenate([[-reach, reach], knots[np.abs(knots) < reach]])
    return float(np.abs(first.run(grid) - second.run(grid)).max())
