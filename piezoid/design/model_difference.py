"""Bound the difference of two models of one hysteresis over all histories of the drive.

The fits that one recording allows differ in envelope, plays and dead zones at once, and what one
part has too much another has too little: bounds of the parts, added up, are ten times what any
drive shows. So both models are bounded together, over all histories. Behind an end of the range a
history is its nested turning points u_0, u_1, ..., and with v = gamma(u)

    h = h(u_0) + sum_i +- 2 phi(|v_i - v_(i-1)| / 2),   phi the loading curve  [Mayergoyz 1991]

The largest value of any s h_t - c h_m over all nested sequences on a grid of voltages follows by
dynamic programming, from wide intervals to narrow ones. Several pairs (s, c) enclose the outputs
(h_t, h_m) that can occur together at each voltage in a polygon, and over it

    |y_t - y_m| = |Psi_t(h_t) - Psi_m(h_m)|

is searched. What lies between the voltages of the grid halves as its step does: it is about what
the last halving added: three times that is put on top. (Of 40 refits of the bundled stage none is
wider on a grid four times as fine; with twice that one was, by 0.2 %.)
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import DeadZones
from piezoid.operators.modified_prandtl_ishlinskii import ModifiedPrandtlIshlinskii
from piezoid.operators.prandtl_ishlinskii import PrandtlIshlinskii

STEPS = 96  # of the range, an even number
# relative differences of gauge between h_t and h_m that give the polygon its sides
_TILT = np.concatenate([-np.geomspace(0.02, 0.5, 5)[::-1], [0.0], np.geomspace(0.02, 0.5, 5)])
_POINTS = 200  # along h_m, where the polygon is searched
_BEYOND = 3.0  # times what the last halving of the grid added


@dataclass(frozen=True, kw_only=True, eq=False)
class JointError:
    """How far truths can be from a model at any history.

    error_m     (truths,)  sup |y_t - y_m|
    voltage_V   (steps + 1,)  the grid
    least_m, most_m  (steps + 1,)  what H of the model can be at its voltages
    """

    error_m: Array
    voltage_V: Array
    least_m: Array
    most_m: Array


def joint_error(
    model: ModifiedPrandtlIshlinskii, truths: Sequence[ModifiedPrandtlIshlinskii], reach_V: float
) -> JointError:
    """Bound |Gamma_t[u] - Gamma_m[u]| for |u| <= reach, all in one gauge.

    Every history begins at an end of the range; a de-poled stage is one whose turning points
    closed in.
    """
    coarse = _errors(model, truths, _reached(model, truths, reach_V, STEPS // 2))
    reached = _reached(model, truths, reach_V, STEPS)
    fine = _errors(model, truths, reached)
    return JointError(
        error_m=fine + _BEYOND * (fine - coarse),
        voltage_V=reached.voltage_V,
        least_m=reached.least_m,
        most_m=reached.most_m,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Reached:
    """Outputs that can occur together at the voltages of a grid.

    above_m  (truths, tilts, voltages)  sup of h_t - (1 + tilt) h_m
    below_m  the same of its negative
    """

    voltage_V: Array
    above_m: Array
    below_m: Array
    least_m: Array
    most_m: Array


def _reached(
    model: ModifiedPrandtlIshlinskii,
    truths: Sequence[ModifiedPrandtlIshlinskii],
    reach_V: float,
    steps: int,
) -> _Reached:
    voltage_V = np.linspace(-reach_V, reach_V, steps + 1)
    model_branches, low_m, high_m = _branches(model, voltage_V)
    truth_branches = [_branches(truth, voltage_V) for truth in truths]
    truth_rises = np.array([rises for rises, _, _ in truth_branches])
    tilted, none = 1.0 + _TILT, np.zeros(2)
    of_truth = np.concatenate([np.ones_like(tilted), -np.ones_like(tilted), none])
    of_model = np.concatenate([-tilted, tilted, [1.0, -1.0]])

    def combined(truth_m: Array, model_m: Array) -> Array:
        return np.asarray(truth_m[:, None, :] * of_truth[:, None] + of_model[:, None] * model_m)

    # the best of all histories so far that came to a voltage by rising, and by falling
    rising = np.full((len(truths), len(of_truth), steps + 1), -np.inf)
    falling = rising.copy()
    falling[:, :, :1] = combined(
        np.array([[low] for _, low, _ in truth_branches]), np.array([low_m])
    )
    rising[:, :, -1:] = combined(
        np.array([[high] for _, _, high in truth_branches]), np.array([high_m])
    )
    for width in range(steps, 0, -1):
        below, above = slice(0, steps + 1 - width), slice(width, steps + 1)
        branch = combined(truth_rises[:, width, below], model_branches[width, below])
        up, down = falling[:, :, below] + branch, rising[:, :, above] - branch
        np.maximum(falling[:, :, below], down, out=falling[:, :, below])
        np.maximum(rising[:, :, above], up, out=rising[:, :, above])
    largest = np.maximum(rising, falling)
    sides = len(tilted)
    return _Reached(
        voltage_V=voltage_V,
        above_m=largest[:, :sides],
        below_m=largest[:, sides : 2 * sides],
        least_m=-largest[0, -1],
        most_m=largest[0, -2],
    )


def _branches(operator: ModifiedPrandtlIshlinskii, voltage_V: Array) -> tuple[Array, float, float]:
    """Return what H adds on the way up from voltage i to i + width, and its ends of the range.

    returned  (width, i) in a square of (voltages, voltages), m; and two numbers in m
    """
    v = operator.envelope.run(voltage_V)
    added = np.zeros((len(v), len(v)))
    high, low = np.tril_indices(len(v), -1)
    added[high - low, low] = 2.0 * operator.plays.loading_curve(0.5 * (v[high] - v[low]))
    return added, -_first_rise(operator.plays, -v[0]), _first_rise(operator.plays, v[-1])


def _first_rise(plays: PrandtlIshlinskii, end: float) -> float:
    return float(plays.loading_curve(np.array([end]))[0])


def _errors(
    model: ModifiedPrandtlIshlinskii,
    truths: Sequence[ModifiedPrandtlIshlinskii],
    reached: _Reached,
) -> Array:
    """Return the largest |Psi_t(h_t) - Psi_m(h_m)| over the polygons, (truths,)."""
    share = np.linspace(0.0, 1.0, _POINTS)
    h_m = np.multiply.outer(reached.least_m, 1.0 - share) + np.multiply.outer(
        reached.most_m, share
    )
    y_m, slope = _through(model.dead_zones, h_m), (1.0 + _TILT)[:, None, None]
    errors_m = []
    for k, truth in enumerate(truths):
        most_m = (reached.above_m[k][:, :, None] + slope * h_m).min(axis=0)
        least_m = (slope * h_m - reached.below_m[k][:, :, None]).max(axis=0)
        above = _through(truth.dead_zones, most_m) - y_m
        below = y_m - _through(truth.dead_zones, least_m)
        errors_m.append(max(float(above.max()), float(below.max())))
    return np.array(errors_m)


def _through(zones: DeadZones, h: Array) -> Array:
    return zones.run(h.ravel()).reshape(h.shape)
