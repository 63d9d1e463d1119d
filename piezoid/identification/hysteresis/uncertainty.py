"""Uncertainty of a fit: jackknife over blocks of time, and a bound on the error of the model.

Residuals of a hysteresis fit are correlated over many samples, so formulas for independent samples
are wrong by large factors. The data are therefore cut into blocks of whole cycles, and one
Gauss-Newton step gives the fit without each block:

    theta_(c) = theta + (A - A_c)^-1 g_c,   A = J'J, g_c = J_c' e_c,
    var f = (G - 1)/G  sum_c (f(theta_(c)) - mean f)^2,   intervals with Student's t at G - 1

Parameters on a bound stay there and get an upper limit instead of an interval. The bound of the
error for any drive in the range is

    |Gamma_t[u] - Gamma_m[u]| <= Lip(Psi_m) (int |W_t - W_m| dr + Lip(H_m) sup |gamma_t - gamma_m|)
                                 + sup |Psi_t - Psi_m| + rho

The first two terms are 95 % quantiles over models drawn from the uncertainty of the fit; rho is
the 99.9 % quantile of the held-out residual. Every term is finite, so the error of the model, and
with it that of the compensation by its inverse, is bounded for all bounded drives.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezoid.identification.hysteresis.coordinates import (
    Coordinates,
    envelope_stretch,
    operator_of,
    parameters_of,
    to_si_units,
)
from piezoid.identification.hysteresis.gauss_newton import Task, column_indices, rows_of
from piezoid.identification.hysteresis.pieces import Scales, cycle_edges
from piezoid.identification.quality import Certificate, Uncertainty
from piezoid.numerics.arrays import Array
from piezoid.numerics.robust import jackknife_half
from piezoid.operators.dead_zone import DeadZones
from piezoid.operators.prandtl_ishlinskii import ModifiedPrandtlIshlinskii, worst_case

BLOCKS = 24
POINTS = 41  # of the loading curve
_RIDGE = 1e-12
# Directions that the data hardly determine (eigenvalues of the scaled normal matrix below this
# share of the largest) keep the fitted values: linear steps are meaningless there, and the output
# hardly changes.
MIN_EIGENVALUE = 1e-5
DRAWS = 200
DRIVES = 12  # random drives of each type
REVERSALS = 24  # of each drive
STEPS = 6  # samples from one reversal to the next
SEED = 1


@dataclass(frozen=True, kw_only=True, eq=False)
class Jackknife:
    """Fitted parameters, and those of refits without each block.

    theta       (total,)
    replicates  (blocks, total)
    is_free     (total,)  parameters that were not on a bound
    normal      (total, total)  A
    gradient    (blocks, total) g_c
    """

    theta: Array
    replicates: Array
    is_free: NDArray[np.bool_]
    normal: Array
    gradient: Array

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return len(self.replicates)

    def spread(self, functional: Callable[[Array], Array]) -> Array:
        """Return the covariance of a vector-valued function of theta."""
        values = np.array([functional(replicate) for replicate in self.replicates])
        centred = values - values.mean(axis=0)
        return np.asarray(centred.T @ centred * (self.blocks - 1) / self.blocks)

    def half_width(self, functional: Callable[[Array], Array]) -> Array:
        """Return half the width of the 95 % interval of each value of a function of theta."""
        return jackknife_half(np.array([functional(replicate) for replicate in self.replicates]))

    def upper_limit(self, index: int) -> float:
        """Return the one-sided 95 % limit of a parameter on its lower bound.

        The parameter is freed for one step. The limit is that step, if it is upwards, plus 1.645
        standard errors: at a bound the two-sided test becomes a mixture.
        """
        is_free = self.is_free.copy()
        is_free[index] = True
        normal = self.normal[np.ix_(is_free, is_free)]
        inverse = np.linalg.pinv(normal, rcond=_RIDGE, hermitian=True)
        row = inverse[np.flatnonzero(np.flatnonzero(is_free) == index)[0]]
        steps = self.gradient[:, is_free] @ row
        estimate = -float(steps.sum())
        error = float(np.sqrt((steps**2).sum() * self.blocks / (self.blocks - 1)))
        return float(self.theta[index] + max(estimate, 0.0) + 1.645 * error)


def jackknife(theta: Array, task: Task) -> Jackknife:
    """Return refits without each block of whole cycles in turn."""
    coordinates = task.coordinates
    share = BLOCKS / sum(piece.rows for piece in task.pieces)
    edges = [
        piece.first + cycle_edges(piece.fitted_drive, max(2, round(share * piece.rows)))
        for piece in task.pieces
    ]
    blocks = sum(len(edge) - 1 for edge in edges)
    normals = np.zeros((blocks, coordinates.total, coordinates.total))  # J_c'J_c
    gradients = np.zeros((blocks, coordinates.total))  # J_c'e_c
    first, operator = 0, operator_of(theta, coordinates)
    for index in range(len(task.pieces)):
        columns = column_indices(coordinates, index)
        for sample, rows in rows_of(theta, operator, task, index):
            block = first + np.searchsorted(edges[index][1:-1], sample, side="right")
            for c in np.unique(block):
                tangent, residual = rows[block == c, :-1], rows[block == c, -1]
                normals[c][np.ix_(columns, columns)] += tangent.T @ tangent
                gradients[c][columns] += tangent.T @ residual
        first += len(edges[index]) - 1
    kinks, _ = task.prior
    data, prior = normals.sum(axis=0), kinks.T @ kinks
    lower, upper = task.bounds(theta)
    is_free = (theta > lower + 1e-9) & (theta < upper - 1e-9) & (np.diag(data) > 0)
    replicates = np.repeat(theta[None], blocks, axis=0)
    scale = np.sqrt(np.diag(data)[is_free])
    for number, (normal, gradient) in enumerate(zip(normals, gradients, strict=True)):
        remaining, regularised = (
            (matrix - normal)[np.ix_(is_free, is_free)] / np.outer(scale, scale)
            for matrix in (data, data + prior)
        )
        eigenvalue, direction = np.linalg.eigh(remaining)
        axes = direction[:, eigenvalue > MIN_EIGENVALUE * eigenvalue[-1]]
        step = np.linalg.solve(axes.T @ regularised @ axes, axes.T @ (gradient[is_free] / scale))
        replicates[number, is_free] += axes @ step / scale
    return Jackknife(
        theta=theta,
        replicates=np.clip(replicates, lower, upper),
        is_free=is_free,
        normal=data + prior,
        gradient=gradients,
    )


def summarise(refits: Jackknife, coordinates: Coordinates, scales: Scales) -> Uncertainty:
    """Return intervals of parameters, loading curve and loop width.

    Play weights on their bound 0 get one-sided upper limits.
    """
    reach_V = np.linspace(0.0, scales.voltage_V, POINTS)

    def loading(theta: Array) -> Array:
        model = to_si_units(operator_of(theta, coordinates), scales)
        return model.run(model.voltage_offset_V + reach_V, model.virgin_memory())[0]

    def width(theta: Array) -> Array:
        return np.array([loop_width_m(theta, coordinates, scales)])

    def values(theta: Array) -> Array:
        return np.array(list(parameters_of(theta, coordinates, scales).values()))

    operator = operator_of(refits.theta, coordinates)
    unit = abs(scales.displacement_m) / (envelope_stretch(operator) * scales.voltage_V)
    first = coordinates.slices["weight"].start
    return Uncertainty(
        blocks=refits.blocks,
        names=tuple(parameters_of(refits.theta, coordinates, scales)),
        values=values(refits.theta),
        covariance=refits.spread(values),
        upper_limit={
            f"play_weight_m_per_V[{i}]": refits.upper_limit(first + i) * unit
            for i in range(1, coordinates.shape.plays + 1)
            if refits.theta[first + i] <= 0.0
        },
        reach_V=reach_V,
        loading_m=loading(refits.theta),
        loading_half_m=refits.half_width(loading),
        loop_width_m=(
            loop_width_m(refits.theta, coordinates, scales),
            float(refits.half_width(width)[0]),
        ),
    )


def loop_width_m(theta: Array, coordinates: Coordinates, scales: Scales) -> float:
    """Return the opening of the full steady loop at the middle of the drive, m.

    2 sum_i w_i min(r_i, A - r_i)_+ mapped by Psi, A half the range of the drive
    """
    model = to_si_units(operator_of(theta, coordinates), scales)
    plays = model.plays
    half = float(
        (plays.weight * np.clip(scales.voltage_V - plays.threshold, 0.0, plays.threshold)).sum()
    )
    low_m, high_m = model.dead_zones.run(np.array([-half, half]))
    return float(high_m - low_m)


def certify(
    refits: Jackknife,
    coordinates: Coordinates,
    scales: Scales,
    residual_m: Array,
    slew_V_per_s: float,
    longest_lag_s: float,
) -> Certificate:
    """Return the bound of the model error for drives within the range of the data."""
    model = to_si_units(operator_of(refits.theta, coordinates), scales)
    reach_V = scales.voltage_V
    # theta + sum_c xi_c sqrt((G - 1)/G) (theta_(c) - mean), xi standard normal, within the bounds
    centred = refits.replicates - refits.replicates.mean(axis=0)
    blocks = refits.blocks
    xi = np.random.default_rng(SEED).standard_normal((DRAWS, blocks))
    xi *= np.sqrt((blocks - 1) / blocks)
    vectors = np.clip(refits.theta + xi @ centred, *coordinates.bounds(longest_lag_s))
    drawn_models = [to_si_units(operator_of(theta, coordinates), scales) for theta in vectors]
    terms = [distance_terms(model, alternative, reach_V) for alternative in drawn_models]
    plays_m, zones_m = np.quantile(np.array(terms), 0.95, axis=0)
    drives_V = adversarial_drives(reach_V, SEED)
    differences_m = [
        max_difference_m(model, alternative, drives_V, reach_V) for alternative in drawn_models
    ]
    return Certificate(
        plays_m=float(plays_m),
        dead_zones_m=float(zones_m),
        remainder_m=float(np.quantile(np.abs(residual_m), 0.999)),
        found_m=float(np.quantile(differences_m, 0.95)),
        reach_V=reach_V,
        slew_V_per_s=slew_V_per_s,
    )


def adversarial_drives(reach_V: float, seed: int) -> Array:
    """Return drives with decaying, growing and random reversals in sequence, (samples,) V.

    Each drive begins with a full swing, which erases the memory of the drive before.
    """
    rng = np.random.default_rng(seed)
    sign = (-1.0) ** np.arange(REVERSALS)
    sizes = [np.linspace(1.0, 0.02, REVERSALS), np.linspace(0.02, 1.0, REVERSALS)]
    sizes += [np.sort(rng.uniform(0.02, 1.0, REVERSALS))[::-1] for _ in range(DRIVES)]
    levels = [sign * size for size in sizes]
    levels += [rng.uniform(-1.0, 1.0, REVERSALS) for _ in range(DRIVES)]
    reversals = np.concatenate([np.concatenate([[1.0, -1.0], level]) for level in levels])
    steps = np.linspace(0.0, 1.0, STEPS, endpoint=False)
    ramps = reversals[:-1, None] + np.diff(reversals)[:, None] * steps
    return np.asarray(reach_V * ramps.ravel())


def max_difference_m(
    model: ModifiedPrandtlIshlinskii,
    alternative: ModifiedPrandtlIshlinskii,
    drives_V: Array,
    reach_V: float,
) -> float:
    """Return the largest difference of two models over many drives and their worst-case input.

    A common zero is removed, because it is fitted for every recording. The worst-case input of two
    sums of plays starts at the end of the range, so that no history matters; its mirror image is
    tried as well.
    """
    _, worst_V = worst_case(alternative.plays, model.plays, reach_V)
    voltage_V = model.voltage_offset_V + np.concatenate([drives_V, worst_V, -worst_V])
    first, second = (m.run(voltage_V, m.virgin_memory())[0] for m in (model, alternative))
    difference = second - first
    return float(np.ptp(difference) / 2)


def distance_terms(
    model: ModifiedPrandtlIshlinskii, alternative: ModifiedPrandtlIshlinskii, reach_V: float
) -> tuple[float, float]:
    """Return the play and the dead-zone term of the distance between two models, m.

    One operator has many equivalent scalings: the alternative is first rescaled so that both
    loading curves end at the same value.
    """
    end = np.array([reach_V])
    ratio = float(model.plays.loading_curve(end)[0] / alternative.plays.loading_curve(end)[0])
    alternative = alternative.rescaled(ratio)
    steepest = float(model.dead_zones.slope.max())
    reach = np.array([-reach_V, reach_V])
    widest_V = float(np.abs(alternative.envelope.run(reach)).max())
    bends_V = _sup_difference(model.envelope, alternative.envelope, reach_V)
    difference_m, _ = worst_case(alternative.plays, model.plays, widest_V)
    plays_m = steepest * (difference_m + float(np.abs(model.plays.weight).sum()) * bends_V)
    top_m = float(alternative.plays.loading_curve(np.array([widest_V]))[0])
    return plays_m, _sup_difference(model.dead_zones, alternative.dead_zones, top_m)


def _sup_difference(first: DeadZones, second: DeadZones, reach: float) -> float:
    """Return the largest difference of two piecewise-linear maps over [-reach, reach]."""
    knots = np.concatenate([first.threshold, second.threshold])
    grid = np.concatenate([[-reach, reach], knots[np.abs(knots) < reach]])
    return float(np.abs(first.run(grid) - second.run(grid)).max())
