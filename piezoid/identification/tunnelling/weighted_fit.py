"""Least squares fit of one gap law to several sweeps, with noise and tip jumps from the data.

    i_j = s ( A_c exp(-k (z_j - z_0)) + o ),   c the piece that point j belongs to

Pieces are sweeps, and the parts of a sweep between tip jumps; they share decay and offset. For a
given decay the amplitudes and the offset solve a linear weighted least squares problem [Golub &
Pereyra 1973], so only the decay is searched, over all plausible values: the fit needs no start
value and has no local minimum. Weights and noise model are estimated in turn with the current.

At a tip jump the log current steps at one height because the tip changed, not the gap. Jumps are
sought where the current is clear of the floor, by the medians on either side of each point.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezoid.errors import ExcitationError
from piezoid.identification.tunnelling.approach import ApproachCurve
from piezoid.identification.tunnelling.current_noise import (
    CurrentChain,
    CurrentNoise,
    estimate_noise,
)
from piezoid.numerics.arrays import Array

IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

MIN_DECAY_PER_M = 0.5e9  # 0.0024 eV: no junction
MAX_DECAY_PER_M = 60e9  # 34 eV: no junction either
_GRID = np.geomspace(MIN_DECAY_PER_M, MAX_DECAY_PER_M, 160)

_SIDE = 5  # points on either side of a jump: a median of five survives two outliers
_MEDIAN_OF_SIDE = 0.536  # standard deviation of the median of five unit normals
_ALARM = 6.0  # robust standard deviations; the windows overlap, so their spread is uncertain
_SMALLEST_NEPERS = 0.05  # a jump below this moves no decay by a percent
MAX_JUMPS = 3  # with more of them there is no tip to speak of

OUTLIER = 3.0  # standard deviations; a normal residual passes it once in 370
CLEAR_OF_FLOOR = 3.0  # times the floor: where a log of the current means something
_REPEATED = 0.9  # fewer distinct currents than this share of the points: they are steps
_ROUNDS = 25
_SETTLED = 1e-7  # relative change of the decay


@dataclass(frozen=True, kw_only=True, eq=False)
class Points:
    """The points of one fit, all sweeps together, the current positive.

    height_m   (points,)  above the lowest height of all, so that exponentials stay below one
    current_A  (points,)  times the polarity
    piece      (points,)  from 0: which amplitude applies
    weight     (points,)  1 / variance, 1/A^2
    """

    height_m: Array
    current_A: Array
    piece: IntArray
    weight: Array

    @property
    def pieces(self) -> int:
        """Number of amplitudes."""
        return int(self.piece.max()) + 1


@dataclass(frozen=True, kw_only=True, eq=False)
class Exponential:
    """The exponential with offset fitted to points.

    decay_per_m  k
    amplitude_A  (pieces,)  current at the lowest height; zero where the data want it negative
    offset_A     of the amplifier, times the polarity
    cost         weighted sum of squared residuals
    """

    decay_per_m: float
    amplitude_A: Array
    offset_A: float
    cost: float

    def mean(self, points: Points) -> Array:
        """Return the modelled current without the offset, (points,) A."""
        mean: Array = self.amplitude_A[points.piece] * np.exp(-self.decay_per_m * points.height_m)
        return mean

    def jacobian(self, points: Points) -> Array:
        """Return d i / d (k, ln A of each piece, o), (points, pieces + 2)."""
        mean = self.mean(points)
        of_pieces = [mean * (points.piece == piece) for piece in range(points.pieces)]
        return np.column_stack([-points.height_m * mean, *of_pieces, np.ones_like(mean)])


def solve_at(points: Points, decay_per_m: float) -> Exponential:
    """Return the best amplitudes, none of them negative, and the offset for a given decay."""
    decayed = np.exp(-decay_per_m * points.height_m)
    root = np.sqrt(points.weight)
    is_used = np.ones(points.pieces, dtype=bool)
    while True:
        columns = [decayed * (points.piece == piece) for piece in np.flatnonzero(is_used)]
        design = np.column_stack([*columns, np.ones_like(decayed)])
        solution = np.linalg.lstsq(design * root[:, None], points.current_A * root, rcond=None)[0]
        if (solution[:-1] >= 0.0).all():
            break
        is_used[np.flatnonzero(is_used)[solution[:-1] < 0.0]] = False
    amplitude_A = np.zeros(points.pieces)
    amplitude_A[is_used] = solution[:-1]
    return Exponential(
        decay_per_m=decay_per_m,
        amplitude_A=amplitude_A,
        offset_A=float(solution[-1]),
        cost=float(np.sum(points.weight * (points.current_A - design @ solution) ** 2)),
    )


def fit_exponential(points: Points) -> Exponential:
    """Return the decay, amplitudes and offset of least weighted residual.

    The decay is searched on a grid over all plausible values, then refined between neighbours.
    """
    from scipy.optimize import minimize_scalar

    best = int(np.argmin([solve_at(points, float(decay)).cost for decay in _GRID]))
    refined = minimize_scalar(
        lambda decay: solve_at(points, float(decay)).cost,
        bounds=(float(_GRID[max(best - 1, 0)]), float(_GRID[min(best + 1, len(_GRID) - 1)])),
        method="bounded",
        options={"xatol": 1e-9 * _GRID[best]},
    )
    return solve_at(points, float(refined.x))


def profile_interval(points: Points, fit: Exponential, excess: float) -> tuple[float, float]:
    """Return the range of decays whose cost exceeds the minimum by no more than ``excess``.

        { k : cost(k) - cost(k^) <= excess }

    A bound of 0 or infinity means that the data exclude no decay on that side.
    """
    from scipy.optimize import brentq

    def above(decay: float) -> float:
        return solve_at(points, decay).cost - fit.cost - excess

    def crossing(limit: float) -> float | None:
        inside = fit.decay_per_m
        for outside in np.geomspace(fit.decay_per_m, limit, 60)[1:].tolist():
            if above(outside) > 0.0:
                return float(brentq(above, inside, outside, rtol=1e-10))
            inside = outside
        return None

    low, high = crossing(MIN_DECAY_PER_M), crossing(MAX_DECAY_PER_M)
    return (0.0 if low is None else low, np.inf if high is None else high)


@dataclass(frozen=True, kw_only=True)
class TipJump:
    """One step of the log current along a sweep.

    sweep     which of the fitted sweeps, from 0
    height_m  between the two points it lies between
    nepers    upwards in height positive
    """

    sweep: int
    height_m: float
    nepers: float


@dataclass(frozen=True, kw_only=True, eq=False)
class WeightedFit:
    """Several sweeps with one decay, their noise and their tip jumps.

    sweep_of_point  (points,)  which sweep each point came from
    lowest_m        height that the points' heights count from
    polarity        +1 or -1: the sign of the current, from the data
    """

    points: Points
    sweep_of_point: IntArray
    lowest_m: float
    polarity: float
    fit: Exponential
    noise: CurrentNoise
    jumps: tuple[TipJump, ...]

    @property
    def mean_A(self) -> Array:
        """The modelled current without offset, times the polarity."""
        return self.fit.mean(self.points)

    @property
    def residual_A(self) -> Array:
        """Measured minus modelled current, times the polarity."""
        residual: Array = self.points.current_A - self.fit.offset_A - self.mean_A
        return residual

    @property
    def is_clear(self) -> BoolArray:
        """Whether a point is clear of the floor and has a logarithm, (points,)."""
        above = self.mean_A > CLEAR_OF_FLOOR * self.noise.floor_A
        return np.asarray(above & (self.points.current_A > self.fit.offset_A))

    @property
    def log_residual(self) -> Array:
        """Log of measured over modelled current, (points,); zero where not clear of the floor."""
        ratio, clear = np.ones_like(self.mean_A), self.is_clear
        ratio[clear] = (self.points.current_A - self.fit.offset_A)[clear] / self.mean_A[clear]
        return np.asarray(np.log(ratio))

    def first_piece(self, sweep: int) -> int:
        """Return the piece that holds the lowest height of a sweep."""
        rows = np.flatnonzero(self.sweep_of_point == sweep)
        return int(self.points.piece[rows[np.argmin(self.points.height_m[rows])]])


def fit_sweeps(curves: Sequence[ApproachCurve], chain: CurrentChain) -> WeightedFit:
    """Fit one decay to several sweeps, with noise, polarity and tip jumps from the data.

    curves  at least one, of one junction
    chain   declared properties of the current amplifier

    Raises ``ExcitationError`` for a current that grows with the height: the height has the
    opposite sign.
    """
    state = _settle(_start(curves, chain))
    for _ in range(MAX_JUMPS):
        jumps = [jump for n in range(len(curves)) if (jump := _find_jump(state, n)) is not None]
        if not jumps:
            break
        largest = max(jumps, key=lambda jump: abs(jump.nepers))
        # The part of the sweep beyond the jump gets an amplitude of its own.
        beyond = state.points.height_m + state.lowest_m > largest.height_m
        split = 2 * state.points.piece + ((state.sweep_of_point == largest.sweep) & beyond)
        points = replace(state.points, piece=np.unique(split, return_inverse=True)[1])
        fit = fit_exponential(points)
        state = _settle(replace(state, points=points, jumps=(*state.jumps, largest), fit=fit))
    return state


def _start(curves: Sequence[ApproachCurve], chain: CurrentChain) -> WeightedFit:
    sweep = np.repeat(np.arange(len(curves)), [c.points for c in curves])
    height_m = np.concatenate([c.height_m for c in curves])
    current_A = np.concatenate([c.current_A for c in curves])
    levels = np.unique(current_A)
    if chain.adc_step_A is None and 1 < len(levels) < _REPEATED * len(current_A):
        chain = replace(chain, adc_step_A=float(np.min(np.diff(levels))))
    floor_A = max(max(map(_roughness_A, curves)), chain.declared_floor_A, 1e-30)
    noise = CurrentNoise(floor_A=floor_A, relative=0.05, chain=chain)
    weight = 1.0 / noise.variance(current_A - np.median(current_A))
    candidates = {
        polarity: Points(
            height_m=height_m - height_m.min(),
            current_A=polarity * current_A,
            piece=sweep,
            weight=weight,
        )
        for polarity in (1.0, -1.0)
    }
    fits = {polarity: fit_exponential(points) for polarity, points in candidates.items()}
    polarity = min(fits, key=lambda sign: (fits[sign].cost, sign != curves[0].polarity))
    mirrored = [
        replace(points, height_m=points.height_m.max() - points.height_m)
        for points in candidates.values()
    ]
    if min(fit_exponential(points).cost for points in mirrored) < 0.5 * fits[polarity].cost:
        raise ExcitationError(
            f"{curves[0].label}: the current grows with the height",
            needed="a height that grows when the tip retracts, so that the current falls",
            remedy="Pass the height with the opposite sign.",
        )
    return WeightedFit(
        points=candidates[polarity],
        sweep_of_point=sweep,
        lowest_m=float(height_m.min()),
        polarity=polarity,
        fit=fits[polarity],
        noise=noise,
        jumps=(),
    )


def _roughness_A(curve: ApproachCurve) -> float:
    """Noise of the weaker half of a sweep, from neighbours in height."""
    by_height = curve.current_A[np.argsort(curve.height_m, kind="stable")]
    distance = np.abs(by_height - np.median(by_height))
    weak = by_height[distance <= np.median(distance)]
    return float(1.4826 * np.median(np.abs(np.diff(weak))) / np.sqrt(2.0))


def _settle(state: WeightedFit) -> WeightedFit:
    """Alternate mean and noise until the decay stands still."""
    for _ in range(_ROUNDS):
        previous = state.fit.decay_per_m
        deviation = np.sqrt(state.noise.variance(state.mean_A))
        clipped_A = np.clip(state.residual_A, -OUTLIER * deviation, OUTLIER * deviation)
        noise = estimate_noise(clipped_A, state.mean_A, state.noise.chain)
        variance = noise.variance(state.mean_A)
        whitened = np.abs(state.residual_A) / np.sqrt(variance)
        weight = np.minimum(1.0, OUTLIER / np.maximum(whitened, 1e-300)) / variance
        points = replace(state.points, weight=weight)
        state = replace(state, points=points, noise=noise, fit=fit_exponential(points))
        if abs(state.fit.decay_per_m - previous) < _SETTLED * previous:
            break
    return state


def _find_jump(state: WeightedFit, sweep: int) -> TipJump | None:
    """Return the most conspicuous step of one sweep, or None.

        t = (median after - median before) / its standard deviation from the noise model

    A jump also inflates the fitted noise, so the noise model only says how the noise *varies*
    along the sweep; its scale comes from the same statistic at all other points, which a smooth
    misfit moves alike.
    """
    rows = np.flatnonzero((state.sweep_of_point == sweep) & state.is_clear)
    if len(rows) < 4 * _SIDE:
        return None
    rows = rows[np.argsort(state.points.height_m[rows], kind="stable")]
    deviation = np.sqrt(state.noise.variance(state.mean_A)) / np.maximum(state.mean_A, 1e-300)
    windows = np.lib.stride_tricks.sliding_window_view
    medians = np.median(windows(state.log_residual[rows], _SIDE), axis=1)
    variances = np.mean(windows(deviation[rows], _SIDE) ** 2, axis=1)
    steps = medians[_SIDE:] - medians[:-_SIDE]
    noise = _MEDIAN_OF_SIDE * np.sqrt(variances[_SIDE:] + variances[:-_SIDE])
    relative = steps / np.maximum(noise, 1e-300)
    distance = np.abs(relative - np.median(relative))
    candidates = np.where(np.abs(steps) > _SMALLEST_NEPERS, distance, 0.0)
    step = int(np.argmax(candidates))
    if candidates[step] <= _ALARM * 1.4826 * float(np.median(distance)):
        return None
    neighbours = rows[step + _SIDE - 1 : step + _SIDE + 1]
    return TipJump(
        sweep=sweep,
        height_m=float(np.mean(state.points.height_m[neighbours])) + state.lowest_m,
        nepers=float(steps[step]),
    )
