"""Boundedness certificate: largest error of the model for any drive in its range.

    |Gamma_t[u] - Gamma_m[u]| <= Lip(Psi_m) (int |W_t - W_m| dr + Lip(H_m) sup |gamma_t - gamma_m|)
                                 + sup |Psi_t - Psi_m| + rho

The first terms are 95 % quantiles over models drawn from the fit's own uncertainty; rho is
the 99.9 % quantile of the held-out residual. Every term is finite, so the error of the model, and
with it that of the compensation by its inverse, is bounded for all bounded drives.
"""

import numpy as np

from piezoid.identification.hysteresis.coordinates import Coordinates, operator_of
from piezoid.identification.hysteresis.jackknife import Jackknife
from piezoid.identification.hysteresis.physical import physical
from piezoid.identification.hysteresis.pieces import Scales
from piezoid.identification.quality import Certificate
from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import DeadZones
from piezoid.operators.modified_prandtl_ishlinskii import ModifiedPrandtlIshlinskii
from piezoid.operators.worst_case import worst_case

DRAWS = 200
DRIVES = 12  # of each arbitrary kind
TURNS = 24
STEPS = 6  # samples from one turning point to the next
SEED = 1


def drawn_vectors(jack: Jackknife, bounds: tuple[Array, Array], draws: int, seed: int) -> Array:
    """Draw vectors from the fit's uncertainty, (draws, total), kept inside the bounds.

    theta + sum_c xi_c sqrt((G - 1)/G) (theta_(c) - mean), xi standard normal
    """
    rng = np.random.default_rng(seed)
    centred = jack.replicates - jack.replicates.mean(axis=0)
    blocks = jack.blocks
    xi = rng.standard_normal((draws, blocks)) * np.sqrt((blocks - 1) / blocks)
    return np.asarray(np.clip(jack.theta + xi @ centred, *bounds))


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
    vectors = drawn_vectors(jack, coordinates.bounds(longest_lag_s), DRAWS, SEED)
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
