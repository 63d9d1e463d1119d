"""Fit the gap law to several sweeps: current and noise in turn, with tip jumps as steps.

At a tip jump the log current steps at one height because the tip changed, not the gap. Jumps are
sought where the current is clear of the floor, by the medians on either side of each point,
against the spread of the same statistic at all other points: a smooth misfit moves all alike.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.errors import ExcitationError
from piezoid.identification.tunnelling.approach import ApproachCurve
from piezoid.identification.tunnelling.current_noise import (
    CurrentChain,
    CurrentNoise,
    estimate_noise,
)
from piezoid.identification.tunnelling.exponential_fit import (
    Exponential,
    Points,
    fit_exponential,
)
from piezoid.numerics.arrays import Array

_SIDE = 5  # points on either side: a median of five survives two outliers
_MEDIAN_OF_SIDE = 0.536  # standard deviation of the median of five unit normals
_ALARM = 6.0  # robust standard deviations; the windows overlap, so their spread is uncertain
_SMALLEST_NEPERS = 0.05  # a jump below this moves no decay by a percent

OUTLIER = 3.0  # standard deviations; a normal residual passes it once in 370
CLEAR_OF_FLOOR = 3.0  # times the floor: where a log of the current means something
MOST_JUMPS = 3  # with more of them there is no tip to speak of
_REPEATED = 0.9  # fewer distinct currents than this share of the points: they are steps
_ROUNDS = 25
_SETTLED = 1e-7  # relative change of the decay


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


def find_jump(log_residual: Array, log_deviation: Array) -> tuple[int, float] | None:
    """Return the place and size of the most conspicuous step of one sweep, or None.

        t = (median after - median before) / its standard deviation from the noise model

    log_residual   (points,)  nepers, in order of height
    log_deviation  (points,)  standard deviation of each: noise over current
    returned       index of the first point after the step, and its size in nepers

    A jump also inflates the fitted noise, so the noise model only says how the noise *varies*
    along the sweep; its scale comes from the same statistic at all other places.
    """
    if len(log_residual) < 4 * _SIDE:
        return None
    medians = np.median(_windows(log_residual), axis=1)
    steps = medians[_SIDE:] - medians[:-_SIDE]
    variances = np.mean(_windows(log_deviation) ** 2, axis=1)
    noise = _MEDIAN_OF_SIDE * np.sqrt(variances[_SIDE:] + variances[:-_SIDE])
    relative = steps / np.maximum(noise, 1e-300)
    apart = np.abs(relative - np.median(relative))
    large = np.where(np.abs(steps) > _SMALLEST_NEPERS, apart, 0.0)
    place = int(np.argmax(large))
    if large[place] <= _ALARM * 1.4826 * float(np.median(apart)):
        return None
    return place + _SIDE, float(steps[place])


def _windows(values: Array) -> Array:
    windows: Array = np.lib.stride_tricks.sliding_window_view(values, _SIDE)
    return windows


@dataclass(frozen=True, kw_only=True, eq=False)
class WeightedFit:
    """Several sweeps with one decay, their noise and their tip jumps.

    sweep_of_point  (points,)  whole numbers: which sweep each point came from
    lowest_m        height that the points' heights count from
    polarity        +1 or -1: the sign of the current, from the data
    """

    points: Points
    sweep_of_point: Array
    lowest_m: float
    polarity: float
    fit: Exponential
    noise: CurrentNoise
    jumps: tuple[TipJump, ...]

    @property
    def mean_A(self) -> Array:
        """The modelled current without offset, upright."""
        return self.fit.mean(self.points)

    @property
    def residual_A(self) -> Array:
        """Measured minus modelled current, upright."""
        residual: Array = self.points.current_A - self.fit.offset_A - self.mean_A
        return residual

    @property
    def clear(self) -> Array:
        """Which points stand clear of the floor and have a logarithm, (points,) 0 or 1."""
        above = self.mean_A > CLEAR_OF_FLOOR * self.noise.floor_A
        clear: Array = (above & (self.points.current_A > self.fit.offset_A)).astype(np.float64)
        return clear

    @property
    def log_residual(self) -> Array:
        """Log of the measured over the modelled current; zero where not clear of the floor."""
        ratio = np.ones_like(self.mean_A)
        seen = self.clear > 0.0
        excess_A = self.points.current_A - self.fit.offset_A
        ratio[seen] = excess_A[seen] / self.mean_A[seen]
        logs: Array = np.log(ratio)
        return logs

    def first_piece(self, sweep: int) -> int:
        """Return the piece that holds the lowest height of a sweep."""
        mine = np.flatnonzero(self.sweep_of_point == sweep)
        return int(self.points.piece[mine[np.argmin(self.points.height_m[mine])]])


def fit_sweeps(curves: Sequence[ApproachCurve], chain: CurrentChain) -> WeightedFit:
    """Fit one decay to several sweeps, with noise, polarity and tip jumps from the data.

    curves  at least one, of one junction
    chain   what is declared of the current amplifier

    Refused: a current that grows with the height, which is a column of the other sign.
    """
    state = _settle(_start(curves, chain))
    for _ in range(MOST_JUMPS):
        jump = _next_jump(state, len(curves))
        if jump is None:
            break
        state = _settle(_with_jump(state, jump))
    return state


def _start(curves: Sequence[ApproachCurve], chain: CurrentChain) -> WeightedFit:
    sweep = np.concatenate([np.full(c.points, float(n)) for n, c in enumerate(curves)])
    height_m = np.concatenate([c.height_m for c in curves])
    current_A = np.concatenate([c.current_A for c in curves])
    chain = _with_grain(chain, current_A)
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
    _refuse_mirrored(candidates, fits[polarity].cost, curves[0].label)
    return WeightedFit(
        points=candidates[polarity],
        sweep_of_point=sweep,
        lowest_m=float(height_m.min()),
        polarity=polarity,
        fit=fits[polarity],
        noise=noise,
        jumps=(),
    )


def _with_grain(chain: CurrentChain, current_A: Array) -> CurrentChain:
    """Take an undeclared converter step from the data where currents repeat exactly."""
    levels = np.unique(current_A)
    if chain.adc_step_A is not None or not 1 < len(levels) < _REPEATED * len(current_A):
        return chain
    return replace(chain, adc_step_A=float(np.min(np.diff(levels))))


def _roughness_A(curve: ApproachCurve) -> float:
    """Noise of the weaker half of a sweep, from neighbours in height."""
    by_height = curve.current_A[np.argsort(curve.height_m, kind="stable")]
    distance = np.abs(by_height - np.median(by_height))
    weak = by_height[distance <= np.median(distance)]
    return float(1.4826 * np.median(np.abs(np.diff(weak))) / np.sqrt(2.0))


def _refuse_mirrored(candidates: dict[float, Points], cost: float, label: str) -> None:
    mirrored = min(fit_exponential(points.mirrored()).cost for points in candidates.values())
    if mirrored < 0.5 * cost:
        raise ExcitationError(
            f"{label}: the current grows with the height",
            needed="a height that grows when the tip retracts, so that the current falls",
            remedy="Pass the height with the opposite sign.",
            cost=cost,
            mirrored_cost=mirrored,
        )


def _settle(start: WeightedFit) -> WeightedFit:
    """Alternate mean and noise until the decay stands still."""
    state = start
    for _ in range(_ROUNDS):
        before = state.fit.decay_per_m
        deviation = np.sqrt(state.noise.variance(state.mean_A))
        pulled_A = np.clip(state.residual_A, -OUTLIER * deviation, OUTLIER * deviation)
        noise = estimate_noise(pulled_A, state.mean_A, state.noise.chain)
        variance = noise.variance(state.mean_A)
        whitened = np.abs(state.residual_A) / np.sqrt(variance)
        weight = np.minimum(1.0, OUTLIER / np.maximum(whitened, 1e-300)) / variance
        points = replace(state.points, weight=weight)
        state = replace(state, points=points, noise=noise, fit=fit_exponential(points))
        if abs(state.fit.decay_per_m - before) < _SETTLED * before:
            break
    return state


def _next_jump(state: WeightedFit, sweeps: int) -> TipJump | None:
    """The largest step that any sweep still shows beside the fit, or None."""
    found = [jump for n in range(sweeps) if (jump := _jump_of_sweep(state, n)) is not None]
    return max(found, key=lambda jump: abs(jump.nepers), default=None)


def _jump_of_sweep(state: WeightedFit, sweep: int) -> TipJump | None:
    mine = np.flatnonzero((state.sweep_of_point == sweep) & (state.clear > 0.0))
    mine = mine[np.argsort(state.points.height_m[mine], kind="stable")]
    deviation = np.sqrt(state.noise.variance(state.mean_A)) / np.maximum(state.mean_A, 1e-300)
    found = find_jump(state.log_residual[mine], deviation[mine])
    if found is None:
        return None
    place, nepers = found
    middle_m = float(np.mean(state.points.height_m[mine[place - 1 : place + 1]]))
    return TipJump(sweep=sweep, height_m=middle_m + state.lowest_m, nepers=nepers)


def _with_jump(state: WeightedFit, jump: TipJump) -> WeightedFit:
    """Give the part of a sweep beyond a jump an amplitude of its own, and refit."""
    jumps = (*state.jumps, jump)
    beyond = state.points.height_m + state.lowest_m > jump.height_m
    split = 2.0 * state.points.piece + ((state.sweep_of_point == jump.sweep) & beyond)
    piece = np.unique(split, return_inverse=True)[1].astype(np.float64)
    points = replace(state.points, piece=piece)
    return replace(state, points=points, jumps=jumps, fit=fit_exponential(points))
