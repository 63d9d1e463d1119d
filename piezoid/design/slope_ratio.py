"""How steep a true hysteresis can be behind the exact inverse of a model, and how far both differ.

    Gamma_t o Gamma_m^-1 = Psi_t H_t kappa H_m^-1 Psi_m^-1,   kappa = gamma_t o gamma_m^-1

kappa is increasing, so H_t sees the turning points H_m sees. A stretch that has come d beyond its
last turning point moves the plays up to d/2: with slopes of kappa in [k_1, k_2], those of H_m up
to r and those of H_t up to some r' in [k_1 r, k_2 r]. Its slope is W_t(r') / W_m(r) then.
"""

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import DeadZones
from piezoid.operators.modified_prandtl_ishlinskii import ModifiedPrandtlIshlinskii
from piezoid.operators.worst_case import worst_case

Interval = tuple[float, float]


def model_error_m(
    model: ModifiedPrandtlIshlinskii, truth: ModifiedPrandtlIshlinskii, reach_V: float
) -> float:
    """Return a bound of |Gamma_t[u] - Gamma_m[u]| for |u| <= reach, both in one gauge.

    Lip(Psi_m) sup |H_t gamma_t - H_m gamma_m| + sup |Psi_t - Psi_m|
    """
    static = static_difference(
        truth.dead_zones, model.dead_zones, 0.0, output_reach_m(truth, reach_V)
    )
    return float(model.dead_zones.slope.max()) * _memory_error_m(model, truth, reach_V) + static


def ratio_sector(
    model: ModifiedPrandtlIshlinskii, truth: ModifiedPrandtlIshlinskii, reach_V: float
) -> Interval:
    """Return least and greatest increment gain of Gamma_t o Gamma_m^-1 for |u| <= reach."""
    bend = _bend(model, truth, reach_V)
    plays = _ratios(
        _pieces_of_plays(model, envelope_reach_V(model, reach_V)),
        _pieces_of_plays(truth, np.inf),
        stretch=bend,
    )
    static = _ratios(
        _pieces_of_zones(model.dead_zones, output_reach_m(model, reach_V)),
        _pieces_of_zones(truth.dead_zones, np.inf),
        slack=_memory_error_m(model, truth, reach_V),
    )
    low, high = (bend[k] * plays[k] * static[k] for k in (0, 1))
    return low, high


def envelope_reach_V(model: ModifiedPrandtlIshlinskii, reach_V: float) -> float:
    """Return the largest |gamma(u)| for |u| <= reach."""
    return float(np.abs(model.envelope.run(np.array([-reach_V, reach_V]))).max())


def output_reach_m(model: ModifiedPrandtlIshlinskii, reach_V: float) -> float:
    """Return the largest |H[gamma(u)]| for |u| <= reach: the loading curve there."""
    end_V = np.array([envelope_reach_V(model, reach_V)])
    return float(np.abs(model.plays.loading_curve(end_V)[0]))


def static_difference(
    zones: DeadZones, other: DeadZones | None, slope: float, reach: float
) -> float:
    """Return sup over |h| <= reach of |Psi(h) - other(h) - slope h|; it is met at a knot."""
    knots = zones.threshold if other is None else np.union1d(zones.threshold, other.threshold)
    h: Array = np.concatenate([[-reach], knots[np.abs(knots) < reach], [reach]])
    difference = zones.run(h) - slope * h - (0.0 if other is None else other.run(h))
    return float(np.abs(difference).max())


def _memory_error_m(
    model: ModifiedPrandtlIshlinskii, truth: ModifiedPrandtlIshlinskii, reach_V: float
) -> float:
    """Bound |H_t[gamma_t(u)] - H_m[gamma_m(u)]|: the operators' distance, and the envelopes'."""
    widest_V = envelope_reach_V(truth, reach_V)
    bends_V = static_difference(truth.envelope, model.envelope, 0.0, reach_V)
    plays_m = worst_case(truth.plays, model.plays, widest_V).bound
    return plays_m + float(np.abs(model.plays.weight).sum()) * bends_V


def _bend(
    model: ModifiedPrandtlIshlinskii, truth: ModifiedPrandtlIshlinskii, reach_V: float
) -> Interval:
    """Return least and greatest slope of kappa: both envelopes have one argument."""
    knots = np.union1d(model.envelope.threshold, truth.envelope.threshold)
    edges = np.concatenate([[-reach_V], knots[np.abs(knots) < reach_V], [reach_V]])
    middle = 0.5 * (edges[1:] + edges[:-1])
    ratio = truth.envelope.run_with_slope(middle)[1] / model.envelope.run_with_slope(middle)[1]
    return float(ratio.min()), float(ratio.max())


_Pieces = tuple[Array, Array]
"""Edges (pieces + 1,) and the slope between each two."""


def _pieces_of_plays(model: ModifiedPrandtlIshlinskii, reach_V: float) -> _Pieces:
    inside = model.plays.threshold < reach_V
    edges = np.concatenate([model.plays.threshold[inside], [reach_V]])
    return edges, model.plays.slope[inside]


def _pieces_of_zones(zones: DeadZones, reach_m: float) -> _Pieces:
    knots = zones.threshold[np.abs(zones.threshold) < reach_m]
    first = int(np.searchsorted(zones.threshold, -reach_m, side="right"))
    slopes = zones.slope[first : first + len(knots) + 1]
    return np.concatenate([[-reach_m], knots, [reach_m]]), slopes


def _ratios(
    model: _Pieces, truth: _Pieces, *, stretch: Interval = (1.0, 1.0), slack: float = 0.0
) -> Interval:
    """Return the extremes of truth's slope over the model's where both may be together.

    stretch  factors between the model's place and the truth's
    slack    how far apart the places may be besides
    """
    low, high = np.inf, 0.0
    edges, slopes = truth
    for start, end, slope in zip(model[0][:-1], model[0][1:], model[1], strict=True):
        met = (edges[:-1] < stretch[1] * end + slack) & (edges[1:] > stretch[0] * start - slack)
        low = min(low, float(slopes[met].min() / slope))
        high = max(high, float(slopes[met].max() / slope))
    return low, high
