"""Least-squares fit of one gap law to several sweeps, with noise and tip jumps from the data.

    i_j = s ( A_c exp(-k (z_j - z_0)) + o ),   c the piece of point j

Pieces are sweeps, or parts of a sweep between tip jumps; they share decay and offset. For a given
decay, amplitudes and offset solve a linear weighted least-squares problem [Golub & Pereyra 1973],
so only the decay is searched for, over all plausible values: the fit needs no start value and
finds the global minimum. Weights and noise model are estimated in turn with the current.

At a tip jump the log current has a step at one height because the tip changed, not the gap. Jumps
are detected at currents above the floor, by the medians on either side of each point.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from piezoid.errors import ExcitationError
from piezoid.identification.tunnelling.approach import ApproachCurve
from piezoid.numerics.arrays import Array

MIN_DECAY_PER_M = 0.5e9  # 0.0024 eV: no junction
MAX_DECAY_PER_M = 60e9  # 34 eV: no junction either
_GRID = np.geomspace(MIN_DECAY_PER_M, MAX_DECAY_PER_M, 160)

_MIN_NOISE, _MAX_NOISE = 1e-6, 3.0  # relative; with more there is no signal

_SIDE = 5  # points on either side of a jump: a median of five tolerates two outliers
_MEDIAN_OF_SIDE = 0.536  # standard deviation of the median of five unit normals
_ALARM = 6.0  # robust standard deviations; the windows overlap, so their spread is uncertain
_MIN_JUMP_NEPERS = 0.05  # a smaller jump changes no decay by a percent
MAX_JUMPS = 3  # with more jumps the tip is unusable

OUTLIER = 3.0  # standard deviations; a normal residual passes it once in 370
CLEAR_OF_FLOOR = 3.0  # times the floor: above, the log of the current is used
_REPEATED = 0.9  # distinct currents over points: fewer are steps of a converter
_ROUNDS = 25
_TOLERANCE = 1e-7  # relative change of the decay


@dataclass(frozen=True, kw_only=True)
class TipJump:
    """One step of the log current along a sweep.

    sweep     index of the sweep
    height_m  mean of its two neighbouring points
    nepers    step of the log current with increasing height
    """

    sweep: int
    height_m: float
    nepers: float


@dataclass(frozen=True, kw_only=True, eq=False)
class WeightedFit:
    """Points of several sweeps and the fitted exponential with offset.

    height_m     (points,)  above ``lowest_m``, so that exponentials stay below one
    current_A    (points,)  times the polarity
    sweep        (points,)  index of the sweep
    piece        (points,)  index of the piece
    weight       (points,)  1 / variance, 1/A^2
    lowest_m     lowest height of all sweeps
    polarity     +1 or -1: the sign of the current, from the data
    floor_A      noise without current, converter steps included
    relative_noise  rho, noise over current; motion of the gap by sigma causes rho = k sigma
    quantisation_A  noise of the converter steps alone, the lower bound of the floor
    jumps        tip jumps, each of which separates two pieces
    decay_per_m  k
    amplitude_A  (pieces,)  >= 0, current at the lowest height
    offset_A     of the amplifier, times the polarity
    cost         weighted sum of squared residuals
    """

    height_m: Array
    current_A: Array
    sweep: NDArray[np.int64]
    piece: NDArray[np.int64]
    weight: Array
    lowest_m: float
    polarity: float
    floor_A: float
    relative_noise: float
    quantisation_A: float
    jumps: tuple[TipJump, ...] = ()
    decay_per_m: float = np.nan
    amplitude_A: Array = field(default_factory=lambda: np.zeros(0))
    offset_A: float = 0.0
    cost: float = np.inf

    def at_decay(self, decay_per_m: float) -> "WeightedFit":
        """Fit offset and non-negative amplitudes for a given decay."""
        decayed = np.exp(-decay_per_m * self.height_m)
        root = np.sqrt(self.weight)
        amplitude_A = np.zeros(int(self.piece.max()) + 1)
        pieces = np.arange(len(amplitude_A))
        while True:
            columns = [decayed * (self.piece == piece) for piece in pieces]
            design = np.column_stack([*columns, np.ones_like(decayed)])
            weighted, target = design * root[:, None], self.current_A * root
            solution = np.linalg.lstsq(weighted, target, rcond=None)[0]
            is_positive = solution[:-1] >= 0.0
            if is_positive.all():
                break
            pieces = pieces[is_positive]
        amplitude_A[pieces] = solution[:-1]
        return replace(
            self,
            decay_per_m=decay_per_m,
            amplitude_A=amplitude_A,
            offset_A=float(solution[-1]),
            cost=float(np.sum(self.weight * (self.current_A - design @ solution) ** 2)),
        )

    def at_best_decay(self) -> "WeightedFit":
        """Return the fit of least cost: the best of a grid of plausible decays, refined."""
        from scipy.optimize import minimize_scalar

        best = int(np.argmin([self.at_decay(decay).cost for decay in _GRID.tolist()]))
        refined = minimize_scalar(
            lambda decay: self.at_decay(float(decay)).cost,
            bounds=(float(_GRID[max(best - 1, 0)]), float(_GRID[min(best + 1, len(_GRID) - 1)])),
            method="bounded",
            options={"xatol": 1e-9 * _GRID[best]},
        )
        return self.at_decay(float(refined.x))

    def decay_interval(self, excess: float) -> tuple[float, float]:
        """Return the range of decays whose cost exceeds the minimum by no more than ``excess``.

        0 or infinity means that the data do not bound the decay on that side.
        """
        from scipy.optimize import brentq

        def cost_above_limit(decay: float) -> float:
            return self.at_decay(decay).cost - self.cost - excess

        interval = []
        for limit, unbounded in ((MIN_DECAY_PER_M, 0.0), (MAX_DECAY_PER_M, np.inf)):
            end, inside = unbounded, self.decay_per_m
            for outside in np.geomspace(self.decay_per_m, limit, 60)[1:].tolist():
                if cost_above_limit(outside) > 0.0:
                    end = float(brentq(cost_above_limit, inside, outside, rtol=1e-10))
                    break
                inside = outside
            interval.append(end)
        return interval[0], interval[1]

    @property
    def reading_variance(self) -> Array:
        """Variance of the readings, v(i) = floor^2 + (rho i)^2, (points,), A^2."""
        variance: Array = self.floor_A**2 + (self.relative_noise * self.mean_A) ** 2
        return variance

    @property
    def mean_A(self) -> Array:
        """Modelled current without offset, times the polarity, (points,)."""
        mean: Array = self.amplitude_A[self.piece] * np.exp(-self.decay_per_m * self.height_m)
        return mean

    @property
    def residual_A(self) -> Array:
        """Measured minus modelled current, times the polarity, (points,)."""
        residual: Array = self.current_A - self.offset_A - self.mean_A
        return residual

    @property
    def jacobian(self) -> Array:
        """Derivatives by k, ln A of each piece and the offset, (points, parameters)."""
        mean = self.mean_A
        by_piece = [mean * (self.piece == piece) for piece in range(len(self.amplitude_A))]
        return np.column_stack([-self.height_m * mean, *by_piece, np.ones_like(mean)])

    @property
    def is_clear(self) -> NDArray[np.bool_]:
        """Whether a point is above the floor and has a logarithm, (points,)."""
        above = self.mean_A > CLEAR_OF_FLOOR * self.floor_A
        return np.asarray(above & (self.current_A > self.offset_A))

    @property
    def log_residual(self) -> Array:
        """Log of measured over modelled current, (points,); 0 unless ``is_clear``."""
        ratio, is_clear = np.ones_like(self.mean_A), self.is_clear
        ratio[is_clear] = (self.current_A - self.offset_A)[is_clear] / self.mean_A[is_clear]
        return np.asarray(np.log(ratio))


def fit_sweeps(curves: Sequence[ApproachCurve]) -> WeightedFit:
    """Fit one decay to several sweeps, with noise, polarity and tip jumps from the data.

    curves  at least one, of one junction

    Raises ``ExcitationError`` for a current that increases with the height: the height is
    inverted.
    """
    sweep = np.repeat(np.arange(len(curves)), [c.points for c in curves])
    height_m = np.concatenate([c.height_m for c in curves])
    current_A = np.concatenate([c.current_A for c in curves])
    levels, quantisation_A = np.unique(current_A), 0.0
    if 1 < len(levels) < _REPEATED * len(current_A):
        quantisation_A = float(np.min(np.diff(levels))) / math.sqrt(12.0)
    floor_A = max(quantisation_A, 1e-30)
    for curve in curves:  # noise of the half with the smaller current, from neighbours in height
        by_height = curve.current_A[np.argsort(curve.height_m, kind="stable")]
        distance = np.abs(by_height - np.median(by_height))
        steps = np.diff(by_height[distance <= np.median(distance)])
        roughness_A = float(1.4826 * np.median(np.abs(steps)) / np.sqrt(2.0))
        floor_A = max(floor_A, roughness_A)
    positive = WeightedFit(
        height_m=height_m - height_m.min(),
        current_A=current_A,
        sweep=sweep,
        piece=sweep,
        weight=1.0 / (floor_A**2 + (0.05 * (current_A - np.median(current_A))) ** 2),
        lowest_m=float(height_m.min()),
        polarity=1.0,
        floor_A=floor_A,
        relative_noise=0.05,
        quantisation_A=quantisation_A,
    )
    signs = (positive, replace(positive, current_A=-current_A, polarity=-1.0))
    fit = min(
        (candidate.at_best_decay() for candidate in signs),
        key=lambda fit: (fit.cost, fit.polarity != curves[0].polarity),
    )
    mirrored_m = positive.height_m.max() - positive.height_m
    mirrored = [replace(candidate, height_m=mirrored_m).at_best_decay() for candidate in signs]
    if min(candidate.cost for candidate in mirrored) < 0.5 * fit.cost:
        raise ExcitationError(
            f"{curves[0].label}: the current grows with the height",
            needed="a height that increases when the tip retracts, so that the current falls",
            remedy="Pass the height with the opposite sign.",
        )

    fit = _settle(fit)
    for _ in range(MAX_JUMPS):
        jumps = [jump for n in range(len(curves)) if (jump := _find_jump(fit, n)) is not None]
        if not jumps:
            break
        largest = max(jumps, key=lambda jump: abs(jump.nepers))
        # The part of the sweep beyond the jump becomes another piece.
        is_beyond = fit.height_m + fit.lowest_m > largest.height_m
        split = 2 * fit.piece + ((fit.sweep == largest.sweep) & is_beyond)
        piece = np.unique(split, return_inverse=True)[1]
        fit = _settle(replace(fit, piece=piece, jumps=(*fit.jumps, largest)).at_best_decay())
    return fit


def _settle(fit: WeightedFit) -> WeightedFit:
    """Fit mean and noise in turn until the decay converges."""
    for _ in range(_ROUNDS):
        previous = fit.decay_per_m
        deviation = np.sqrt(fit.reading_variance)
        clipped_A = np.clip(fit.residual_A, -OUTLIER * deviation, OUTLIER * deviation)
        floor_A, relative = _estimate_noise(clipped_A, fit.mean_A, fit.quantisation_A)
        fit = replace(fit, floor_A=floor_A, relative_noise=relative)
        variance = fit.reading_variance
        whitened = np.abs(fit.residual_A) / np.sqrt(variance)
        weight = np.minimum(1.0, OUTLIER / np.maximum(whitened, 1e-300)) / variance
        fit = replace(fit, weight=weight).at_best_decay()
        if abs(fit.decay_per_m - previous) < _TOLERANCE * previous:
            break
    return fit


def _estimate_noise(
    residual_A: Array, mean_A: Array, quantisation_A: float
) -> tuple[float, float]:
    """Return the maximum-likelihood estimates of floor and relative noise.

        maximise  - sum ( ln v_j + r_j^2 / v_j )      over floor >= quantisation, rho >= 0

    r  residual_A  (points,)  measured minus mean, outliers clipped
    i  mean_A      (points,)

    The search uses logarithms, so that both remain positive. Pseudo-likelihood [Carroll & Ruppert
    1988]: given the mean, the noise maximises a normal likelihood; given the noise, the mean is
    refitted.
    """
    from scipy.optimize import minimize

    typical_A = max(float(np.sqrt(np.mean(residual_A**2))), quantisation_A, 1e-30)
    scale_A = max(float(np.max(np.abs(mean_A))), typical_A)
    min_log, max_log = math.log(_MIN_NOISE), math.log(_MAX_NOISE)
    lowest = math.log(max(quantisation_A, 1e-6 * typical_A))
    low, high = (lowest, min_log), (math.log(10.0 * typical_A) + 1e-9, max_log)

    def deviance(logs: Array) -> float:
        floor_A, relative = math.exp(float(logs[0])), math.exp(float(logs[1]))
        variance = floor_A**2 + (relative * mean_A) ** 2
        return float(np.sum(np.log(variance) + residual_A**2 / variance))

    dark_A = float(np.median(np.abs(residual_A[np.abs(mean_A) <= np.median(np.abs(mean_A))])))
    starts = (
        (
            math.log(max(dark_A, 1e-6 * typical_A)),
            math.log(max(typical_A / scale_A, _MIN_NOISE)),
        ),
        (math.log(typical_A), min_log / 2.0),
    )
    minima = [
        minimize(
            deviance,
            np.clip(start, low, high),
            method="Nelder-Mead",
            bounds=list(zip(low, high, strict=True)),
            options={"xatol": 1e-4, "fatol": 1e-6, "maxiter": 400},
        )
        for start in starts
    ]
    log_floor, log_relative = min(minima, key=lambda result: float(result.fun)).x.tolist()
    return math.exp(log_floor), math.exp(log_relative)


def _find_jump(fit: WeightedFit, sweep: int) -> TipJump | None:
    """Return the most significant step of one sweep, or None.

        t = (median after - median before) / its standard deviation from the noise model

    A jump also increases the fitted noise, so the noise model only gives the *variation* of the
    noise along the sweep; its scale is that of the same statistic at all other points, which also
    contain any smooth misfit.
    """
    rows = np.flatnonzero((fit.sweep == sweep) & fit.is_clear)
    if len(rows) < 4 * _SIDE:
        return None
    rows = rows[np.argsort(fit.height_m[rows], kind="stable")]
    deviation = np.sqrt(fit.reading_variance) / np.maximum(fit.mean_A, 1e-300)
    windows = np.lib.stride_tricks.sliding_window_view
    medians = np.median(windows(fit.log_residual[rows], _SIDE), axis=1)
    variances = np.mean(windows(deviation[rows], _SIDE) ** 2, axis=1)
    steps = medians[_SIDE:] - medians[:-_SIDE]
    noise = _MEDIAN_OF_SIDE * np.sqrt(variances[_SIDE:] + variances[:-_SIDE])
    relative = steps / np.maximum(noise, 1e-300)
    distance = np.abs(relative - np.median(relative))
    candidates = np.where(np.abs(steps) > _MIN_JUMP_NEPERS, distance, 0.0)
    step = int(np.argmax(candidates))
    if candidates[step] <= _ALARM * 1.4826 * float(np.median(distance)):
        return None
    neighbours = rows[step + _SIDE - 1 : step + _SIDE + 1]
    return TipJump(
        sweep=sweep,
        height_m=float(np.mean(fit.height_m[neighbours])) + fit.lowest_m,
        nepers=float(steps[step]),
    )
