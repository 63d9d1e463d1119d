"""BarrierFit: the decay and apparent barrier of a junction, with interval and confidence.

Covariance of an estimate whose residuals are correlated: leave out one block at a time.

Neighbouring points of a sweep share drift, creep and vibration; an interval that counts them as
independent is far too narrow. Blocks of neighbours, each holding an equal share of what is known
about the decay, are left out in turn, which also charges the estimate for a model that does not
quite fit (jackknife form of the clustered sandwich; Bell & McCaffrey 2002).

One barrier from sweeps and closed loop, where the two agree; where they do not, the reason.

Both measure k, a sweep over the height it was given, the loop over the extension per volt it was
given. Their ratio is free of the barrier:

    k_loop / k_sweep = (true extension per volt) / (declared one)    if the sweep's height is true

so that a disagreement says that one of the two calibrations, or the spot, is another.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from piezoid.identification.tunnelling.approach import ApproachCurve
from piezoid.identification.tunnelling.confidence import (
    Confidence,
    Reason,
    SweepEvidence,
    judge,
)
from piezoid.identification.tunnelling.current_noise import CurrentChain, CurrentNoise
from piezoid.identification.tunnelling.exponential_fit import fit_exponential, profile_interval
from piezoid.identification.tunnelling.weighted_fit import (
    CLEAR_OF_FLOOR,
    OUTLIER,
    TipJump,
    WeightedFit,
    fit_sweeps,
)
from piezoid.numerics.arrays import Array, freeze
from piezoid.numerics.robust import student_quantile
from piezoid.operators.tunnelling import barrier_of_decay
from piezoid.record_json import Interval

_NORMAL_95 = 1.959963984540054

# Few enough that neighbours in different blocks are nearly independent: under a gap with 1/f
# unrest of 2 pm, ten blocks held 83 % of 60 truths, five 98 %, a third wider.
_BLOCKS = 8
NORMAL_95 = 1.959963984540054


@dataclass(frozen=True, kw_only=True)
class JointBarrier:
    """What sweeps and loop say together.

    ratio           k of the loop over k of the sweeps, and its 95 % interval
    agree           whether that interval holds 1
    decay_per_m     weighted mean of both; None where they disagree
    decay_interval_per_m  95 % of it; where they disagree, from the lower end of the lower to the
                    upper end of the higher
    barrier_eV, barrier_interval_eV  of the decay
    """

    ratio: float
    ratio_interval: Interval
    agree: bool
    decay_per_m: float | None
    decay_interval_per_m: Interval
    barrier_eV: float | None
    barrier_interval_eV: Interval


def join_barriers(
    sweeps: Sequence[tuple[float, Interval]], loop: tuple[float, Interval]
) -> JointBarrier:
    """Combine decays with their 95 % intervals, in the logarithm, by inverse variance.

    sweeps  (decay, interval), 1/m, of all sweeps together or of parts that tell nothing of drift
    loop    (decay, interval), 1/m

    Parts that differ by more than their intervals allow widen the mean by that much
    (Birge's ratio). An interval without an end counts as no information.
    """
    sweep, sweep_variance = _mean([_log(*pair) for pair in sweeps])
    loop_log, loop_variance = _log(*loop)
    half = _NORMAL_95 * math.sqrt(sweep_variance + loop_variance)
    between = loop_log - sweep
    agree = abs(between) <= half
    joint = _mean([(sweep, sweep_variance), (loop_log, loop_variance)]) if agree else None
    decay = None if joint is None else math.exp(joint[0])
    ends = [*(interval for _, interval in sweeps), loop[1]]
    interval = min(low for low, _ in ends), max(high for _, high in ends)
    if joint is not None:
        interval = _ends(joint[0], _NORMAL_95 * math.sqrt(joint[1]))
    return JointBarrier(
        ratio=math.exp(between),
        ratio_interval=_ends(between, half),
        agree=agree,
        decay_per_m=decay,
        decay_interval_per_m=interval,
        barrier_eV=None if decay is None else barrier_of_decay(decay),
        barrier_interval_eV=(barrier_of_decay(interval[0]), barrier_of_decay(interval[1])),
    )


def _log(decay: float, interval: Interval) -> tuple[float, float]:
    low, high = interval
    if not (low > 0.0 and math.isfinite(high)):
        return math.log(decay), math.inf
    return math.log(decay), (math.log(high / low) / (2.0 * _NORMAL_95)) ** 2


def _mean(parts: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Mean and variance, widened where the parts scatter more than their variances say."""
    weights = [1.0 / max(variance, 1e-30) for _, variance in parts]
    total = sum(weights)
    if not total > 0.0:
        return sum(value for value, _ in parts) / len(parts), math.inf
    mean = sum(w * value for w, (value, _) in zip(weights, parts, strict=True)) / total
    known = [(w, value) for w, (value, _) in zip(weights, parts, strict=True) if w > 0.0]
    excess = sum(w * (value - mean) ** 2 for w, value in known) / max(len(known) - 1, 1)
    return mean, max(excess, 1.0) / total


def _ends(center: float, half: float) -> Interval:
    if not math.isfinite(half):
        return 0.0, math.inf
    return math.exp(center - half), math.exp(center + half)


@dataclass(frozen=True, kw_only=True, eq=False)
class BarrierFit:
    """The gap law fitted to one or more sweeps: i = polarity (I_0 exp(-k z)) + offset.

    labels                    of the sweeps
    polarity                  +1 or -1
    decay_per_m               k
    decay_interval_per_m      95 %; 0 or infinity where the data exclude nothing
    barrier_eV                (k / 10.246 nm^-1)^2
    barrier_interval_eV       the same map of the interval's ends
    current_at_zero_height_A  I_0 > 0, geometric mean over the sweeps, before any tip jump
    covariance                (2, 2) of k and ln I_0, correlated residuals allowed for
    offset_A                  of the amplifier, with its sign
    offset_standard_A         its standard deviation
    noise                     floor and relative noise, estimated
    gap_jitter_m              relative noise / k: what a jittering gap would amount to
    sweep_decay_per_m         k of each sweep alone
    jumps                     tip jumps found and allowed for
    evidence                  what the confidence was judged from
    confidence, reasons       the grade, and every rule broken
    """

    labels: tuple[str, ...]
    polarity: float
    decay_per_m: float
    decay_interval_per_m: tuple[float, float]
    barrier_eV: float
    barrier_interval_eV: tuple[float, float]
    current_at_zero_height_A: float
    covariance: Array
    offset_A: float
    offset_standard_A: float
    noise: CurrentNoise
    gap_jitter_m: float
    sweep_decay_per_m: tuple[float, ...]
    jumps: tuple[TipJump, ...]
    evidence: SweepEvidence
    confidence: Confidence
    reasons: tuple[Reason, ...]

    def __post_init__(self) -> None:
        freeze(self, "covariance", ndim=2)


def fit_barrier(
    curves: Sequence[ApproachCurve],
    *,
    chain: CurrentChain | None = None,
    height_relative_uncertainty: float = 0.0,
) -> BarrierFit:
    """Fit the decay of the current over the height, and the apparent barrier.

        i = s ( A_c exp(-k z) + o ),  var i = floor^2 + 2 e |i| B + (rho i)^2
        phi = (k / 10.246 nm^-1)^2 eV

    curves  sweeps of one direction over one spot; they share k and o, each has its own A
    chain   what is declared of the current amplifier; default: nothing, all noise from the data
    height_relative_uncertainty  standard uncertainty of the height's calibration; default 0, the
            interval then speaks of the height as recorded

    Nothing is selected and no logarithm of noise is taken. The interval holds the decays whose
    weighted cost lies within t^2 of the least, widened by the ratio of the block covariance to
    the plain one, so that correlated residuals and misfit count. A weak or unstable sweep has a
    wide interval, low confidence and reasons; it is not refused.
    """
    state = fit_sweeps(curves, chain or CurrentChain())
    alone = _decays_alone(state, len(curves))
    covariance, standard_offset_A, blocks = _covariance(state, len(curves))
    interval = _decay_interval(state, covariance, alone, blocks)
    interval = _with_calibration(state.fit.decay_per_m, interval, height_relative_uncertainty)
    evidence = _evidence(state, curves, interval)
    confidence, reasons = judge(evidence)
    decay = state.fit.decay_per_m
    log_current = _log_current_at_zero(state, len(curves))
    return BarrierFit(
        labels=tuple(curve.label for curve in curves),
        polarity=state.polarity,
        decay_per_m=decay,
        decay_interval_per_m=interval,
        barrier_eV=barrier_of_decay(decay),
        barrier_interval_eV=(barrier_of_decay(interval[0]), barrier_of_decay(interval[1])),
        current_at_zero_height_A=math.exp(min(log_current, 700.0)),
        covariance=covariance,
        offset_A=state.polarity * state.fit.offset_A,
        offset_standard_A=standard_offset_A,
        noise=state.noise,
        gap_jitter_m=state.noise.relative / decay,
        sweep_decay_per_m=alone,
        jumps=state.jumps,
        evidence=evidence,
        confidence=confidence,
        reasons=reasons,
    )


def _log_current_at_zero(state: WeightedFit, sweeps: int) -> float:
    amplitude_A = [state.fit.amplitude_A[state.first_piece(n)] for n in range(sweeps)]
    logs = np.log(np.maximum(amplitude_A, 1e-300))
    return float(np.mean(logs)) + state.fit.decay_per_m * state.lowest_m


def _decays_alone(state: WeightedFit, sweeps: int) -> tuple[float, ...]:
    if sweeps == 1:
        return (state.fit.decay_per_m,)
    decays = []
    for sweep in range(sweeps):
        mine = state.sweep_of_point == sweep
        part = type(state.points)(
            height_m=state.points.height_m[mine],
            current_A=state.points.current_A[mine],
            piece=np.unique(state.points.piece[mine], return_inverse=True)[1].astype(float),
            weight=state.points.weight[mine],
        )
        decays.append(fit_exponential(part).decay_per_m)
    return tuple(decays)


def _whitened(state: WeightedFit) -> tuple[Array, Array]:
    root = np.sqrt(state.points.weight)
    return state.fit.jacobian(state.points) * root[:, None], state.residual_A * root


def _jackknife(state: WeightedFit, column: int) -> tuple[Array, int]:
    """Block covariance by blocks that share what is known of one parameter; their number."""
    jacobian, residual = _whitened(state)
    score = partial_score(jacobian, column)
    block = equal_information_blocks(state.points.height_m, score, count=_BLOCKS)
    return leave_one_block_out(jacobian, residual, block), int(block.max()) + 1


def _covariance(state: WeightedFit, sweeps: int) -> tuple[Array, float, int]:
    """Block covariance of (k, ln I_0), standard deviation of the offset, number of blocks."""
    full, blocks = _jackknife(state, 0)
    # ln I_0 = mean over sweeps of ln A + k z_0, with z_0 the lowest height.
    to_pair = np.zeros((2, full.shape[0]))
    to_pair[:, 0] = (1.0, state.lowest_m)
    for sweep in range(sweeps):
        to_pair[1, 1 + state.first_piece(sweep)] += 1.0 / sweeps
    of_offset = _jackknife(state, full.shape[0] - 1)[0][-1, -1]
    return to_pair @ full @ to_pair.T, math.sqrt(max(float(of_offset), 0.0)), blocks


def _decay_interval(
    state: WeightedFit, covariance: Array, alone: tuple[float, ...], blocks: int
) -> tuple[float, float]:

    jacobian, _ = _whitened(state)
    plain = 1.0 / max(float(partial_score(jacobian, 0).sum()), 1e-300)
    between = float(np.var(alone, ddof=1)) / len(alone) if len(alone) > 2 else 0.0
    inflation = max(float(covariance[0, 0]) / plain, between / plain, 1.0)
    quantile = float(student_quantile(0.975, max(blocks - 1, 1)))
    return profile_interval(state.points, state.fit, quantile**2 * inflation)


def _with_calibration(
    decay: float, interval: tuple[float, float], relative: float
) -> tuple[float, float]:
    scale = NORMAL_95 * relative * decay
    low = decay - math.hypot(decay - interval[0], scale)
    return max(low, 0.0), decay + math.hypot(interval[1] - decay, scale)


def _evidence(
    state: WeightedFit, curves: Sequence[ApproachCurve], interval: tuple[float, float]
) -> SweepEvidence:
    mean_A, floor_A = state.mean_A, state.noise.floor_A
    peak_A = float(mean_A.max())
    deviation = np.sqrt(state.noise.variance(mean_A))
    return SweepEvidence(
        points=sum(curve.points for curve in curves),
        rows=sum(curve.rows for curve in curves),
        saturated=sum(curve.saturated for curve in curves),
        peak_A=peak_A,
        floor_A=floor_A,
        decades=math.log10(max(peak_A, 1e-30) / (CLEAR_OF_FLOOR * floor_A)),
        relative_noise=state.noise.relative,
        jumps=len(state.jumps),
        largest_jump=max((jump.nepers for jump in state.jumps), key=abs, default=0.0),
        barrier_eV=barrier_of_decay(state.fit.decay_per_m),
        barrier_low_eV=barrier_of_decay(interval[0]),
        barrier_high_eV=barrier_of_decay(interval[1]),
        reaches_floor=bool(mean_A.min() < floor_A),
        slope_change=_slope_change(state),
        outliers=float(np.mean(np.abs(state.residual_A) > OUTLIER * deviation)),
    )


def _slope_change(state: WeightedFit) -> float:
    """Relative difference of the decay of the far half to that of the near half."""
    clear = state.clear > 0.0
    if clear.sum() < 20:
        return 0.0
    height_m = state.points.height_m
    middle = 0.5 * (height_m[clear].min() + height_m[clear].max())
    root = np.sqrt(state.points.weight) * state.mean_A
    slopes = []
    for half in (clear & (height_m <= middle), clear & (height_m > middle)):
        if half.sum() < 5:
            return 0.0
        slopes.append(np.polyfit(height_m[half], state.log_residual[half], 1, w=root[half])[0])
    near, far = (state.fit.decay_per_m - slope for slope in slopes)
    return float(far / near - 1.0)


def equal_information_blocks(height_m: Array, score: Array, *, count: int) -> Array:
    """Return the block of each point, (points,) whole numbers, neighbours in height together.

    height_m  (points,)  m; points of several sweeps at one height share a block
    score     (points,)  what each point knows about the parameter of interest, >= 0
    count     blocks at most; fewer when single heights hold more than a share
    """
    heights, place = np.unique(height_m, return_inverse=True)
    known = np.bincount(place, weights=score, minlength=len(heights))
    share = (np.cumsum(known) - 0.5 * known) / max(float(known.sum()), 1e-300)
    raw = np.minimum((share * count).astype(int), count - 1)
    block: Array = np.unique(raw, return_inverse=True)[1][place].astype(np.float64)
    return block


def leave_one_block_out(jacobian: Array, residual: Array, block: Array) -> Array:
    """Return the jackknife covariance of a least squares estimate, (parameters, parameters).

        C = (G - 1)/G sum_g delta_g delta_g',   delta_g = -(H - H_g)^-1 J_g' r_g,   H = J' J

    J  jacobian  (points, parameters)  whitened: divided by each point's standard deviation
    r  residual  (points,)             whitened
    g  block     (points,)             whole numbers from 0

    What only one block knows (an amplitude inside it) is left to the pseudo-inverse.
    """
    information = jacobian.T @ jacobian
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    scaled = jacobian * scale
    whole = scaled.T @ scaled
    count = int(block.max()) + 1
    covariance = np.zeros_like(whole)
    for g in range(count):
        part = scaled[block == g]
        delta = np.linalg.pinv(whole - part.T @ part, rcond=1e-10) @ (
            part.T @ residual[block == g]
        )
        covariance += np.outer(delta, delta)
    unscaled: Array = covariance * (count - 1) / max(count, 1) * np.outer(scale, scale)
    return unscaled


def partial_score(jacobian: Array, column: int) -> Array:
    """Return each point's share in the information about one parameter, the others unknown.

    jacobian  (points, parameters)  whitened
    returned  (points,)             squared, so that the sum is 1 / variance
    """
    others = np.delete(jacobian, column, axis=1)
    wanted = jacobian[:, column]
    explained = others @ np.linalg.lstsq(others, wanted, rcond=None)[0]
    share: Array = (wanted - explained) ** 2
    return share
