"""How steep a true hysteresis can be behind the exact inverse of a model.

    Gamma_t o Gamma_m^-1 = Psi_t H_t kappa H_m^-1 Psi_m^-1,   kappa = gamma_t o gamma_m^-1

kappa is increasing, so H_t sees the turning points H_m sees. A stretch that has come d beyond its
last turning point moves the plays up to d/2: with slopes of kappa in [k_1, k_2], those of H_m up
to r and those of H_t up to some r' in [k_1 r, k_2 r]. Its slope is W_t(r') / W_m(r) then.
"""

import numpy as np

from piezoid.design.joint_error import JointError
from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import DeadZones
from piezoid.operators.modified_prandtl_ishlinskii import ModifiedPrandtlIshlinskii

Interval = tuple[float, float]


def ratio_sector(
    model: ModifiedPrandtlIshlinskii,
    truth: ModifiedPrandtlIshlinskii,
    reach_V: float,
    apart: JointError,
    error_m: float,
) -> Interval:
    """Return least and greatest increment gain of Gamma_t o Gamma_m^-1 for |u| <= reach.

    apart    of the model: its grid of voltages and what it can put out at each
    error_m  how far the outputs of both can be apart
    """
    bend = _bends(model, truth, apart.voltage_V)
    static = _static_ratios(model.dead_zones, truth.dead_zones, apart, error_m)
    plays = _ratios(
        _pieces_of_plays(model, envelope_reach_V(model, reach_V)),
        _pieces_of_plays(truth, np.inf),
        stretch=(float(bend[0].min()), float(bend[1].max())),
    )
    low, high = float((bend[0] * static[0]).min()), float((bend[1] * static[1]).max())
    return plays[0] * low, plays[1] * high


def envelope_reach_V(model: ModifiedPrandtlIshlinskii, reach_V: float) -> float:
    """Return the largest |gamma(u)| for |u| <= reach."""
    return float(np.abs(model.envelope.run(np.array([-reach_V, reach_V]))).max())


def output_reach_m(model: ModifiedPrandtlIshlinskii, reach_V: float) -> float:
    """Return the largest |H[gamma(u)]| for |u| <= reach: the loading curve there."""
    end_V = np.array([envelope_reach_V(model, reach_V)])
    return float(np.abs(model.plays.loading_curve(end_V)[0]))


def static_difference(zones: DeadZones, slope: float, reach: float) -> float:
    """Return sup over |h| <= reach of |Psi(h) - slope h|; it is met at a knot."""
    knots = zones.threshold
    h: Array = np.concatenate([[-reach], knots[np.abs(knots) < reach], [reach]])
    return float(np.abs(zones.run(h) - slope * h).max())


def _bends(
    model: ModifiedPrandtlIshlinskii, truth: ModifiedPrandtlIshlinskii, voltage_V: Array
) -> tuple[Array, Array]:
    """Return the least and the greatest slope of kappa between each two voltages."""
    knots = np.union1d(model.envelope.threshold, truth.envelope.threshold)
    knots = knots[(knots > voltage_V[0]) & (knots < voltage_V[-1])]
    edges = np.union1d(voltage_V, knots)
    middle = 0.5 * (edges[1:] + edges[:-1])
    ratio = truth.envelope.run_with_slope(middle)[1] / model.envelope.run_with_slope(middle)[1]
    first = np.searchsorted(edges, voltage_V[:-1])
    return np.minimum.reduceat(ratio, first), np.maximum.reduceat(ratio, first)


def _static_ratios(
    zones: DeadZones, truth: DeadZones, apart: JointError, error_m: float
) -> tuple[Array, Array]:
    """Return the extremes of Psi_t' / Psi_m' at outputs together, between each two voltages."""
    low_m, high_m = zones.run(apart.least_m[:-1]), zones.run(apart.most_m[1:])
    own, other = (
        np.concatenate([[-np.inf], z.run(z.threshold), [np.inf]]) for z in (zones, truth)
    )
    first = np.maximum(own[:-1], low_m[:, None])  # (cells, pieces of the model)
    last = np.minimum(own[1:], high_m[:, None])
    met = (first <= last)[:, :, None] & (
        (other[:-1] <= last[:, :, None] + error_m) & (other[1:] >= first[:, :, None] - error_m)
    )
    ratio = truth.slope / zones.slope[:, None]
    least = np.where(met, ratio, np.inf).min(axis=(1, 2))
    return least, np.where(met, ratio, -np.inf).max(axis=(1, 2))


_Pieces = tuple[Array, Array]
"""Edges (pieces + 1,) and the slope between each two."""


def _pieces_of_plays(model: ModifiedPrandtlIshlinskii, reach_V: float) -> _Pieces:
    inside = model.plays.threshold < reach_V
    edges = np.concatenate([model.plays.threshold[inside], [reach_V]])
    return edges, model.plays.slope[inside]


def _ratios(model: _Pieces, truth: _Pieces, *, stretch: Interval) -> Interval:
    """Return the extremes of truth's slope over the model's where both may be together.

    stretch  factors between the model's place and the truth's
    """
    low, high = np.inf, 0.0
    edges, slopes = truth
    for start, end, slope in zip(model[0][:-1], model[0][1:], model[1], strict=True):
        met = (edges[:-1] < stretch[1] * end) & (edges[1:] > stretch[0] * start)
        low = min(low, float(slopes[met].min() / slope))
        high = max(high, float(slopes[met].max() / slope))
    return low, high
