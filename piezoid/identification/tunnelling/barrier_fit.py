"""Fit decay and apparent barrier, with interval and confidence, to sweeps of one direction.

Neighbouring points of a sweep share drift, creep and vibration; an interval for independent points
is far too narrow. Blocks of neighbours with equal shares of the information on the decay are left
out in turn, so that the interval also covers small errors of the model (jackknife form of the
clustered sandwich; Bell & McCaffrey 2002).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from piezoid.identification.quality import Confidence, Reason, lowest_grade
from piezoid.identification.tunnelling.approach import ApproachCurve
from piezoid.identification.tunnelling.weighted_fit import (
    CLEAR_OF_FLOOR,
    OUTLIER,
    WeightedFit,
    fit_sweeps,
)
from piezoid.numerics.arrays import Array, freeze
from piezoid.numerics.robust import student_quantile
from piezoid.operators.tunnelling import barrier_of_decay
from piezoid.record_json import Interval

# Few enough for nearly independent blocks: with 1/f motion of the gap of 2 pm, intervals of ten
# blocks contain 83 % of 60 true values, those of five blocks 98 % and are a third wider.
BLOCKS = 8
MIN_POINTS = 20  # above the noise, to compare the slopes of both halves of a sweep
TINY = 1e-300


@dataclass(frozen=True, kw_only=True)
class GapLaw:
    """Current over height: i = polarity I_0 exp(-k z) + offset, z increasing to retract the tip.

    polarity                  +1 or -1
    decay_per_m               k, and its 95 % interval; an upper end may be infinite
    barrier_eV                (k / 10.246 nm^-1)^2, apparent, and its 95 % interval
    current_at_zero_height_A  I_0 > 0, geometric mean over the sweeps, before any tip jump
    offset_A                  of the amplifier, with its sign, and its standard deviation
    floor_A                   rms noise without current
    gap_jitter_m              relative noise / k: motion of the gap that causes the relative noise
    sweep_decay_per_m         k of each sweep; in a common law of each pair of sweeps
    confidence, reasons       rating, and the criteria that are not met
    """

    polarity: float
    decay_per_m: float
    decay_interval_per_m: Interval
    barrier_eV: float
    barrier_interval_eV: Interval
    current_at_zero_height_A: float
    offset_A: float
    floor_A: float
    gap_jitter_m: float
    sweep_decay_per_m: tuple[float, ...]
    confidence: Confidence
    reasons: tuple[str, ...]
    offset_standard_A: float = 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class BarrierFit(GapLaw):
    """The gap law of sweeps of one direction, with the fit from which it follows.

    curves      the sweeps
    covariance  (2, 2) of k and ln I_0, correlated residuals allowed for
    weighted    points and least-squares fit
    """

    curves: tuple[ApproachCurve, ...]
    covariance: Array
    weighted: WeightedFit

    def __post_init__(self) -> None:
        freeze(self, "covariance", ndim=2)

    @property
    def law(self) -> GapLaw:
        """The gap law alone, as stored in a model."""
        return GapLaw(**{field.name: getattr(self, field.name) for field in fields(GapLaw)})

    @property
    def peak_A(self) -> float:
        """Largest modelled current."""
        return float(self.weighted.mean_A.max())


def fit_barrier(curves: Sequence[ApproachCurve]) -> BarrierFit:
    """Fit the decay of the current over the height, and the apparent barrier.

        i = s ( A_c exp(-k z) + o ),  var i = floor^2 + (rho i)^2
        phi = (k / 10.246 nm^-1)^2 eV

    curves  sweeps of one direction at one spot; they share k and o, each has an amplitude A

    All points are fitted, and no logarithm of noise is taken. The interval contains the decays
    whose weighted cost lies within t^2 of the minimum, widened by the ratio of the block
    covariance to that of independent points, to cover correlated residuals and misfit. It takes
    the recorded height as exact. A weak or unstable sweep has a wide interval and a low confidence
    with reasons.
    """
    fit = fit_sweeps(curves)
    sweeps, decay = len(curves), fit.decay_per_m
    root = np.sqrt(fit.weight)
    jacobian, residual = fit.jacobian * root[:, None], fit.residual_A * root
    decay_covariance, blocks = _block_covariance(jacobian, residual, fit.height_m, 0)
    offset = len(decay_covariance) - 1
    offset_covariance, _ = _block_covariance(jacobian, residual, fit.height_m, offset)
    # ln I_0 = mean over sweeps of ln A + k z_0, with z_0 the lowest height.
    rows_of_sweep = [np.flatnonzero(fit.sweep == sweep) for sweep in range(sweeps)]
    pieces = [int(fit.piece[rows[np.argmin(fit.height_m[rows])]]) for rows in rows_of_sweep]
    gradient = np.zeros((2, len(decay_covariance)))
    gradient[:, 0] = (1.0, fit.lowest_m)
    for piece in pieces:
        gradient[1, 1 + piece] += 1.0 / sweeps
    covariance = gradient @ decay_covariance @ gradient.T
    # The decay of each sweep, with the weights of the common fit.
    decays = [decay]
    if sweeps > 1:
        decays = [
            replace(
                fit,
                height_m=fit.height_m[rows],
                current_A=fit.current_A[rows],
                piece=np.unique(fit.piece[rows], return_inverse=True)[1],
                weight=fit.weight[rows],
            )
            .at_best_decay()
            .decay_per_m
            for rows in rows_of_sweep
        ]
    independent = 1.0 / max(float(_information(jacobian, 0).sum()), TINY)
    between = float(np.var(decays, ddof=1)) / sweeps if sweeps > 2 else 0.0
    inflation = max(float(covariance[0, 0]) / independent, between / independent, 1.0)
    quantile = float(student_quantile(0.975, max(blocks - 1, 1)))
    interval = fit.decay_interval(quantile**2 * inflation)
    confidence, reasons = lowest_grade(barrier_reasons(fit, curves, decay, interval))
    log_current = float(np.mean(np.log(np.maximum(fit.amplitude_A[pieces], TINY))))
    return BarrierFit(
        curves=tuple(curves),
        polarity=fit.polarity,
        decay_per_m=decay,
        decay_interval_per_m=interval,
        barrier_eV=barrier_of_decay(decay),
        barrier_interval_eV=(barrier_of_decay(interval[0]), barrier_of_decay(interval[1])),
        current_at_zero_height_A=math.exp(min(log_current + decay * fit.lowest_m, 700.0)),
        covariance=covariance,
        offset_A=fit.polarity * fit.offset_A,
        offset_standard_A=math.sqrt(max(float(offset_covariance[-1, -1]), 0.0)),
        floor_A=fit.floor_A,
        gap_jitter_m=fit.relative_noise / decay,
        sweep_decay_per_m=tuple(decays),
        weighted=fit,
        confidence=confidence,
        reasons=reasons,
    )


def slope_change(fit: WeightedFit) -> float:
    """Return the decay of the weak half of the sweeps over that of the strong half, minus one."""
    height_m, is_clear = fit.height_m, fit.is_clear
    if is_clear.sum() < MIN_POINTS:
        return 0.0
    middle_m = 0.5 * (height_m[is_clear].min() + height_m[is_clear].max())
    halves = [is_clear & (height_m <= middle_m), is_clear & (height_m > middle_m)]
    if min(half.sum() for half in halves) < 5:
        return 0.0
    root, residual = np.sqrt(fit.weight) * fit.mean_A, fit.log_residual
    near_decay, far_decay = (
        fit.decay_per_m - np.polyfit(height_m[half], residual[half], 1, w=root[half])[0]
        for half in halves
    )
    return float(far_decay / near_decay - 1.0)


def barrier_reasons(
    fit: WeightedFit,
    curves: Sequence[ApproachCurve],
    decay_per_m: float,
    interval_per_m: Interval,
) -> tuple[Reason, ...]:
    """Return the criteria that a barrier does not meet, in the order of the rules.

    decay_per_m, interval_per_m  k and its 95 % interval, of these sweeps or of all sweeps of a tip
    """
    rows, points = sum(curve.rows for curve in curves), sum(curve.points for curve in curves)
    saturated = sum(curve.saturated for curve in curves)
    peak_A, ends_above_floor = float(fit.mean_A.max()), not fit.mean_A.min() < fit.floor_A
    largest_jump = max((jump.nepers for jump in fit.jumps), key=abs, default=0.0)
    bend_share = slope_change(fit)
    outliers = float(np.mean(np.abs(fit.residual_A) > OUTLIER * np.sqrt(fit.reading_variance)))
    missing = f"{rows - points - saturated} of {rows} rows contain no number"
    decades = math.log10(max(peak_A, 1e-30) / (CLEAR_OF_FLOOR * fit.floor_A))
    barrier_eV = barrier_of_decay(decay_per_m)
    low_eV, high_eV = (barrier_of_decay(end) for end in interval_per_m)
    clipped = f"{saturated} of {rows} rows lie at the amplifier's limit"
    span = (
        f"the current spans {decades:.2g} decades above three times its noise: {peak_A:.3g} A "
        f"at most, noise {fit.floor_A:.3g} A"
    )
    width = f"the 95 % interval runs from {low_eV:.3g} to {high_eV:.3g} eV"
    unstable = (
        f"the current fluctuates by {100 * fit.relative_noise:.2g} % of itself: unstable tip"
    )
    jumps = f"{len(fit.jumps)} tip jump(s), the largest of {largest_jump:.2g} nepers"
    floor = f"the sweep ends above the noise of {fit.floor_A:.3g} A: the offset is extrapolated"
    bend = (
        f"the decay of the weaker half differs by {100 * bend_share:.2g} % from that of the "
        "stronger: creep of the height, or not one exponential"
    )
    implausible = (
        f"a barrier of {barrier_eV:.3g} eV lies outside 0.05 to 7 eV: is the height in metres, "
        "and is its calibration right?"
    )
    rules = (  # quantity; above it medium, above it low confidence; sentence
        (saturated / rows, 0.0, 0.5, clipped),
        (1.0 - (points + saturated) / rows, 0.1, 0.5, missing),
        (-points, -40, -20, f"only {points} points"),
        (-decades, -2.5, -1.5, span),
        ((high_eV - low_eV) / barrier_eV, 0.2, 0.5, width),
        (fit.relative_noise, 0.1, 0.3, unstable),
        (len(fit.jumps), 0, 1, jumps),
        (abs(largest_jump), 0.3, 1.0, f"a tip jump of {largest_jump:.2g} nepers"),
        (float(ends_above_floor), 0.5, np.inf, floor),
        (abs(bend_share), 0.1, 0.3, bend),
        (outliers, 0.05, 0.2, f"{100 * outliers:.2g} % of the points are outliers"),
        (max(barrier_eV / 7.0, 0.05 / barrier_eV), 1.0, 2.0, implausible),
    )
    return tuple(
        (Confidence.MEDIUM if quantity <= low else Confidence.LOW, text)
        for quantity, medium, low, text in rules
        if not quantity <= medium
    )


def _information(jacobian: Array, column: int) -> Array:
    """Return the information of each point on one parameter, with the other parameters unknown.

    jacobian  (points, parameters)  whitened
    returned  (points,)             their sum is 1 / variance
    """
    remaining, target = np.delete(jacobian, column, axis=1), jacobian[:, column]
    explained = remaining @ np.linalg.lstsq(remaining, target, rcond=None)[0]
    return np.asarray((target - explained) ** 2)


def _block_covariance(
    jacobian: Array, residual: Array, height_m: Array, column: int
) -> tuple[Array, int]:
    """Return the jackknife covariance of the parameters, and the number of blocks.

        C = (G - 1)/G sum_g delta_g delta_g',   delta_g = -(H - H_g)^-1 J_g' r_g,   H = J' J

    jacobian, residual  (points, parameters), (points,)  whitened
    height_m            (points,)  blocks are ranges of height; points of several sweeps at one
                        height are in the same block
    column              index of the parameter on which all blocks have equal information

    The pseudo-inverse handles parameters that only one block determines (an amplitude inside it).
    """
    heights, row = np.unique(height_m, return_inverse=True)
    by_height = np.bincount(row, weights=_information(jacobian, column), minlength=len(heights))
    share = (np.cumsum(by_height) - 0.5 * by_height) / max(float(by_height.sum()), TINY)
    block = np.unique(np.minimum((share * BLOCKS).astype(int), BLOCKS - 1), return_inverse=True)[1]
    block = block[row]
    scale = 1.0 / np.sqrt(np.maximum((jacobian**2).sum(axis=0), TINY))
    scaled = jacobian * scale
    information = scaled.T @ scaled
    count = int(block.max()) + 1
    covariance = np.zeros_like(information)
    for g in range(count):
        part, error = scaled[block == g], residual[block == g]
        change = np.linalg.pinv(information - part.T @ part, rcond=1e-10) @ (part.T @ error)
        covariance += np.outer(change, change)
    return np.asarray(covariance * (count - 1) / count * np.outer(scale, scale)), count
