"""Bounds of a hysteresis for a linear loop: the sector of its slopes and its largest error.

The slope of a true hysteresis behind the exact inverse of a model follows from

    Gamma_t o Gamma_m^-1 = Psi_t H_t kappa H_m^-1 Psi_m^-1,   kappa = gamma_t o gamma_m^-1

kappa is increasing, so H_t and H_m have the same turning points. A distance d from the last
turning point moves the plays with thresholds up to d/2. With slopes of kappa in [k_1, k_2], these
are the plays of H_m up to r, and the plays of H_t up to some r' in [k_1 r, k_2 r]. The slope is
then W_t(r') / W_m(r).

The fits that one recording allows differ in envelope, plays and dead zones, and these differences
compensate each other: the sum of the bounds of the parts is ten times the difference under any
drive. So the models are bounded together, over all histories. After an end of the range a history
is its nested turning points u_0, u_1, ..., and with v = gamma(u)

    h = h(u_0) + sum_i +- 2 phi(|v_i - v_(i-1)| / 2),   phi the loading curve  [Mayergoyz 1991]

The largest value of any s h_t - c h_m over all nested sequences on a grid of voltages follows by
dynamic programming, from wide intervals to narrow intervals. Several pairs (s, c) enclose the
outputs (h_t, h_m) that can occur together at each voltage in a polygon, over which

    |y_t - y_m| = |Psi_t(h_t) - Psi_m(h_m)|

is maximised. The error of the grid halves with its step, so it is about the increase by the last
halving; three times that increase is added. (Of 40 refits of the bundled stage, none exceeds the
bound on a grid four times as fine. With twice the increase one did, by 0.2 %.)
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.formatting import with_unit
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import DeadZones
from piezoid.operators.prandtl_ishlinskii import (
    ModifiedPrandtlIshlinskii,
    PrandtlIshlinskii,
    worst_case,
)
from piezoid.operators.preisach_plays import (
    PreisachPlays,
    farthest_apart_m,
    farthest_from_line_m,
    slope_ratios,
)

_DRAWS = 200
_STEPS = 96  # of the range, an even number
# relative differences of gauge between h_t and h_m that give the polygon its sides
_TILT = np.concatenate([-np.geomspace(0.02, 0.5, 5)[::-1], [0.0], np.geomspace(0.02, 0.5, 5)])
_POINTS = 200  # along h_m, where the polygon is searched
_EXTRAPOLATION = 3.0  # times the increase by the last halving of the grid

Interval = tuple[float, float]
Operator = ModifiedPrandtlIshlinskii | PreisachPlays


@dataclass(frozen=True, kw_only=True)
class HysteresisBounds:
    """Bounds of delta in y = a (u + delta[u]), u being the loop's command.

    form              ``affine`` or ``inverse``
    gain_m_per_V      a, the centre of the sector
    slope_min, slope_max   of d(u + delta)/du, relative to a; their mean is 1
    slope_beyond      largest slope of the displacement that the model class cannot represent,
                      relative to a
    error_m           sup |a delta| up to a constant, for |u| <= reach_V
    reach_V           largest command for which the bounds hold
    conditions        of the bounds, whole sentences
    """

    form: str
    gain_m_per_V: float
    slope_min: float
    slope_max: float
    error_m: float
    reach_V: float
    conditions: tuple[str, ...]
    slope_beyond: float = 0.0

    @property
    def increment_gain(self) -> float:
        """eps of |D delta| <= eps |D u|."""
        sector = (self.slope_max - self.slope_min) / (self.slope_max + self.slope_min)
        return sector + self.slope_beyond


def describe_command_range(low_V: float, high_V: float) -> str:
    """Return the condition that the command stays between two voltages."""
    low, high = (with_unit(round(end_V, 9), "V") for end_V in (low_V, high_V))
    return f"the command stays between {low} and {high}"


def affine_bounds(
    model: Operator,
    reach_V: float,
    *,
    remainder_m: float,
    remainder_m_per_V: float = 0.0,
) -> HysteresisBounds:
    """Bound the residual of a hysteresis model after an affine map.

        m <= D Gamma / D u <= M,   a = (M + m)/2,   eps = (M - m)/(M + m)
        |Gamma[u] - a u - b| <= int_0^V |s W(r) - c| dr + sup |c gamma(u) - a u|
                                + sup |Psi(h) - s h|,   V = sup |gamma(u)|

    s and a/c are the mid slopes of Psi and gamma. The increments of the play states per increment
    of the drive lie between 0 and 1 and do not grow with the threshold. So Abel summation bounds
    the slope of H, and the slopes of Psi and gamma multiply this bound. The integral is exact for
    plays [Brokate & Sprekels 1996]; ``preisach_bounds`` has the exact bound for plays behind
    functions.

    remainder_m        bound of the model's residual, for example the 99.9 % quantile of the
                       held-out residual
    remainder_m_per_V  largest slope of that residual
    """
    centre_V = model.voltage_offset_V
    lowest, greatest = model.slope_sector_m_per_V
    gain = 0.5 * (greatest + lowest)
    if isinstance(model, PreisachPlays):
        error_m = farthest_from_line_m(model, gain, reach_V)
    else:
        zone_slope, envelope_slope = (
            0.5 * float(zones.slope.min() + zones.slope.max())
            for zones in (model.dead_zones, model.envelope)
        )
        weight = zone_slope * model.plays.weight
        scaled = PrandtlIshlinskii(threshold=model.plays.threshold, weight=weight)
        line_weight = np.array([gain / envelope_slope])
        line = PrandtlIshlinskii(threshold=np.zeros(1), weight=line_weight)
        reach = _envelope_reach_V(model, reach_V)
        largest_m = float(np.abs(model.plays.loading_curve(np.array([reach]))[0]))
        zones_m = static_difference(model.dead_zones, zone_slope, largest_m)
        envelope_m = (
            gain / envelope_slope * static_difference(model.envelope, envelope_slope, reach_V)
        )
        plays_m, _ = worst_case(scaled, line, reach)
        error_m = plays_m + envelope_m + zones_m
    return HysteresisBounds(
        form="affine",
        gain_m_per_V=gain,
        slope_min=lowest / gain,
        slope_max=greatest / gain,
        slope_beyond=remainder_m_per_V / gain,
        error_m=error_m + remainder_m,
        reach_V=reach_V,
        conditions=(
            describe_command_range(centre_V - reach_V, centre_V + reach_V),
            "the stage started de-poled, or has passed an extreme larger than the scan",
            f"the error of the hysteresis model is at most {with_unit(remainder_m, 'm')}",
        ),
    )


def inverse_bounds(
    model: Operator,
    replicates: Sequence[Operator],
    reach_V: float,
    *,
    gain_m_per_V: float,
    remainder_m: float,
    remainder_m_per_V: float = 0.0,
    confidence: float = 0.95,
) -> HysteresisBounds:
    """Bound the residual after exact inversion of a model, from models refitted to resampled data.

        |Gamma_t[u] - Gamma_m[u]| <= sup over all histories, see ``_bound_difference``, + rho_max
        m = min D(Gamma_t o Gamma_m^-1),   M = max D(Gamma_t o Gamma_m^-1)

    The compensation error is the model error at the inverse's output. Each replicate takes the
    place of the true hysteresis; the bounds are quantiles over the replicates. All models are in
    the gauge of unit central dead zone. Plays behind functions have no gauge, and both suprema are
    exact, see ``preisach_bounds``.

    gain_m_per_V       a of the linear design, the unit of the command
    remainder_m        rho_max: bound of the displacement that no model of this class explains
    remainder_m_per_V  largest slope of that displacement
    """
    if isinstance(model, PreisachPlays):
        functions = [replicate for replicate in replicates if isinstance(replicate, PreisachPlays)]
        errors_m = farthest_apart_m(model, functions, reach_V)
        sectors = slope_ratios(model, functions, reach_V)
    else:
        reference = model.regauged()
        truths = [r.regauged() for r in replicates if isinstance(r, ModifiedPrandtlIshlinskii)]
        coarse_m, *_ = _bound_difference(reference, truths, reach_V, _STEPS // 2)
        fine_m, *grid = _bound_difference(reference, truths, reach_V)
        errors_m = fine_m + _EXTRAPOLATION * (fine_m - coarse_m)
        voltage_V, min_m, max_m = grid
        sectors = np.array(
            [
                _ratio_sector(reference, truth, reach_V, (voltage_V, min_m, max_m), error_m)
                for truth, error_m in zip(truths, errors_m.tolist(), strict=True)
            ]
        )
    low = float(np.quantile(sectors[:, 0], 1.0 - confidence))
    high = float(np.quantile(sectors[:, 1], confidence))
    centre, centre_V = 0.5 * (low + high), model.voltage_offset_V
    return HysteresisBounds(
        form="inverse",
        gain_m_per_V=gain_m_per_V * centre,
        slope_min=low / centre,
        slope_max=high / centre,
        slope_beyond=remainder_m_per_V / (gain_m_per_V * centre),
        error_m=float(np.quantile(errors_m, confidence)) + remainder_m,
        reach_V=reach_V,
        conditions=(
            describe_command_range(centre_V - reach_V, centre_V + reach_V),
            "the true hysteresis differs from the model by no more than "
            f"{100.0 * confidence:g} % of {len(replicates)} refits to parts of the data do",
            "the displacement that plays and dead zones cannot represent stays below "
            f"{with_unit(remainder_m, 'm')}",
        ),
    )


def _bound_difference(
    model: ModifiedPrandtlIshlinskii,
    truths: Sequence[ModifiedPrandtlIshlinskii],
    reach_V: float,
    steps: int = _STEPS,
) -> tuple[Array, Array, Array, Array]:
    """Bound |Gamma_t[u] - Gamma_m[u]| for |u| <= reach on a grid, all in one gauge.

    Every history begins at an end of the range; a de-poled stage is the limit of decreasing
    turning points.

    returned  (truths,) the largest difference on the grid, m; and (steps + 1,) each, the voltages
              of the grid and the smallest and largest H of the model there
    """
    voltage_V = np.linspace(-reach_V, reach_V, steps + 1)
    model_branches, low_m, high_m = _branches(model, voltage_V)
    truth_branches = [_branches(truth, voltage_V) for truth in truths]
    truth_rises = np.array([rises for rises, _, _ in truth_branches])
    slope = 1.0 + _TILT
    truth_factor = np.concatenate([np.ones_like(slope), -np.ones_like(slope), np.zeros(2)])
    model_factor = np.concatenate([-slope, slope, [1.0, -1.0]])

    def combined(truth_m: Array, model_m: Array) -> Array:
        return np.asarray(
            truth_m[:, None, :] * truth_factor[:, None] + model_factor[:, None] * model_m
        )

    # the largest value over the histories that end at a voltage, rising and falling
    rising = np.full((len(truths), len(truth_factor), steps + 1), -np.inf)
    falling = rising.copy()
    lows_m, highs_m = (np.array([[row[k]] for row in truth_branches]) for k in (1, 2))
    falling[:, :, :1] = combined(lows_m, np.array([low_m]))
    rising[:, :, -1:] = combined(highs_m, np.array([high_m]))
    for width in range(steps, 0, -1):
        below, above = slice(0, steps + 1 - width), slice(width, steps + 1)
        branch = combined(truth_rises[:, width, below], model_branches[width, below])
        up, down = falling[:, :, below] + branch, rising[:, :, above] - branch
        np.maximum(falling[:, :, below], down, out=falling[:, :, below])
        np.maximum(rising[:, :, above], up, out=rising[:, :, above])
    largest = np.maximum(rising, falling)
    sides, min_m, max_m = len(slope), -largest[0, -1], largest[0, -2]
    # the largest |Psi_t(h_t) - Psi_m(h_m)| over the polygons
    share = np.linspace(0.0, 1.0, _POINTS)
    h_m = np.multiply.outer(min_m, 1.0 - share) + np.multiply.outer(max_m, share)

    def run_zones(operator: ModifiedPrandtlIshlinskii, h: Array) -> Array:
        return operator.dead_zones.run(h.ravel()).reshape(h.shape)

    y_m, tilted_m = run_zones(model, h_m), slope[:, None, None] * h_m
    errors_m = []
    for k, truth in enumerate(truths):
        highest_m = (largest[k, :sides][:, :, None] + tilted_m).min(axis=0)
        lowest_m = (tilted_m - largest[k, sides : 2 * sides][:, :, None]).max(axis=0)
        above_m, below_m = run_zones(truth, highest_m) - y_m, y_m - run_zones(truth, lowest_m)
        errors_m.append(max(float(above_m.max()), float(below_m.max())))
    return np.array(errors_m), voltage_V, min_m, max_m


def _branches(operator: ModifiedPrandtlIshlinskii, voltage_V: Array) -> tuple[Array, float, float]:
    """Return the rise of H from voltage i to i + width, and H at both ends of the range, m.

    returned  (voltages, voltages), element (width, i); and two numbers
    """
    v, curve = operator.envelope.run(voltage_V), operator.plays.loading_curve
    rise = np.zeros((len(v), len(v)))
    high, low = np.tril_indices(len(v), -1)
    rise[high - low, low] = 2.0 * curve(0.5 * (v[high] - v[low]))
    return rise, -float(curve(np.array([-v[0]]))[0]), float(curve(np.array([v[-1]]))[0])


def _ratio_sector(
    model: ModifiedPrandtlIshlinskii,
    truth: ModifiedPrandtlIshlinskii,
    reach_V: float,
    grid: tuple[Array, Array, Array],
    error_m: float,
) -> Interval:
    """Return the smallest and largest increment gain of Gamma_t o Gamma_m^-1 for |u| <= reach.

    grid     voltages, and the range of H of the model at each
    error_m  largest difference of the outputs
    """
    # The slopes of kappa between adjacent voltages; knots of the envelopes subdivide the interval.
    voltage_V, min_m, max_m = grid
    knots = np.union1d(model.envelope.threshold, truth.envelope.threshold)
    knots = knots[(knots > voltage_V[0]) & (knots < voltage_V[-1])]
    edges = np.union1d(voltage_V, knots)
    middle = 0.5 * (edges[1:] + edges[:-1])
    ratio = truth.envelope.run_with_slope(middle)[1] / model.envelope.run_with_slope(middle)[1]
    first = np.searchsorted(edges, voltage_V[:-1])
    min_kappa = np.minimum.reduceat(ratio, first)
    max_kappa = np.maximum.reduceat(ratio, first)
    # Psi_t' / Psi_m' for the outputs between adjacent voltages; they differ by at most error_m
    zones, true_zones = model.dead_zones, truth.dead_zones
    low_m, high_m = zones.run(min_m[:-1]), zones.run(max_m[1:])
    model_edges, truth_edges = (
        np.concatenate([[-np.inf], z.run(z.threshold), [np.inf]]) for z in (zones, true_zones)
    )
    start_m = np.maximum(model_edges[:-1], low_m[:, None])  # (intervals, pieces of the model)
    stop_m = np.minimum(model_edges[1:], high_m[:, None])
    is_reachable = (start_m <= stop_m)[:, :, None] & (
        (truth_edges[:-1] <= stop_m[:, :, None] + error_m)
        & (truth_edges[1:] >= start_m[:, :, None] - error_m)
    )
    ratio = true_zones.slope / zones.slope[:, None]
    min_zones = np.where(is_reachable, ratio, np.inf).min(axis=(1, 2))
    max_zones = np.where(is_reachable, ratio, -np.inf).max(axis=(1, 2))
    # W_t(r') / W_m(r) over r <= reach and low r <= r' <= high r
    reach, low, high = _envelope_reach_V(model, reach_V), min_kappa.min(), max_kappa.max()
    play_edges = np.append(truth.plays.threshold, np.inf)
    starts = model.plays.threshold[model.plays.threshold < reach]
    stops = np.append(starts[1:], reach)
    ratios: list[float] = []
    for start, stop, slope in zip(starts, stops, model.plays.slope, strict=False):
        is_reachable = (play_edges[:-1] < high * stop) & (play_edges[1:] > low * start)
        truth_slope = truth.plays.slope[is_reachable]
        ratios += [float(truth_slope.min() / slope), float(truth_slope.max() / slope)]
    lowest = min(ratios) * float((min_kappa * min_zones).min())
    return lowest, max(ratios) * float((max_kappa * max_zones).max())


def _envelope_reach_V(model: ModifiedPrandtlIshlinskii, reach_V: float) -> float:
    return float(np.abs(model.envelope.run(np.array([-reach_V, reach_V]))).max())


def static_difference(zones: DeadZones, slope: float, reach: float) -> float:
    """Return sup over |h| <= reach of |Psi(h) - slope h|, which lies at a knot or an end."""
    knots = zones.threshold
    h: Array = np.concatenate([[-reach], knots[np.abs(knots) < reach], [reach]])
    return float(np.abs(zones.run(h) - slope * h).max())


def draw_replicates(
    axis: AxisModel, rng: np.random.Generator, *, draws: int = _DRAWS
) -> tuple[Operator, ...]:
    """Draw operators from the normal distribution of the fit; drop draws without an inverse.

    draws  number of draws, before those without an inverse are dropped: the true hysteresis is
           assumed to have one

    Parameters on a bound have no variance and keep their value.
    """
    if axis.minor_loops is not None:
        return axis.minor_loops.draw(rng, draws)
    uncertainty = axis.uncertainty
    values, vectors = np.linalg.eigh(uncertainty.covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    thetas = uncertainty.values + rng.standard_normal((draws, len(values))) @ root.T
    model = axis.hysteresis
    plays, zones, envelope = model.plays, model.dead_zones, model.envelope
    fitted = {
        "play_threshold_V": plays.threshold,
        "play_weight_m_per_V": plays.weight,
        "dead_zone_threshold_m": zones.threshold,
        "dead_zone_weight": zones.weight,
        "envelope_weight": envelope.weight,
    }
    operators = []
    for theta in thetas:
        parameters = dict(zip(uncertainty.names, theta, strict=True))
        play_V, play_weight, zone_m, zone_weight, envelope_weight = (
            np.array([parameters.get(f"{name}[{i}]", v) for i, v in enumerate(values.tolist())])
            for name, values in fitted.items()
        )
        play_V[0], zone_m[zones.zero] = 0.0, 0.0
        if not ((np.diff(play_V) > 0).all() and (np.diff(zone_m) > 0).all()):
            continue
        operator = replace(
            model,
            plays=PrandtlIshlinskii(threshold=play_V, weight=play_weight),
            dead_zones=DeadZones(threshold=zone_m, weight=zone_weight),
            envelope=DeadZones(threshold=envelope.threshold, weight=envelope_weight),
        )
        if operator.is_invertible:
            operators.append(operator)
    return tuple(operators)
