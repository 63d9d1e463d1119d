"""Fit the tunnelling junction: gap law from Z spectroscopies, plant from closed loops.

A gap that opens at v while the height is swept at s, away from the surface and back, has

    d(t) = z(t) + v t,    k_away = k (1 + v/s),    k_back = k (1 - v/s)

so that the mean of both is k for any drift, and half their difference is the drift. Drift also
shifts the backward sweep: at a height z that is h below the turning point,

    ln i_away - ln i_back = 2 k (v/s) h

The two estimates of the drift differ due to hysteresis, which does not change the mean if it
delays both directions equally, or due to slow motion of the gap, which does. A single direction
cannot separate drift from barrier: its interval covers the usual drifts of laboratories [95 %
within 100 pm/s].

Sweeps measure k relative to the recorded height, the loop relative to the declared extension per
volt. Their ratio does not depend on the barrier:

    k_loop / k_sweep = (true extension per volt) / (declared)    if the height of the sweep is true

so that a disagreement shows that one of the two calibrations is wrong, or that the spots differ.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.identification.quality import Confidence, Reason, lowest_grade
from piezoid.identification.tunnelling.approach import (
    ApproachCurve,
    Direction,
    read_z_spectroscopy,
)
from piezoid.identification.tunnelling.barrier_fit import (
    BarrierFit,
    GapLaw,
    barrier_reasons,
    fit_barrier,
)
from piezoid.identification.tunnelling.closed_loop import (
    LoopPlant,
    describe_loop_plant,
    identify_closed_loop,
)
from piezoid.identification.tunnelling.loop_files import is_loop, loops_of
from piezoid.identification.tunnelling.weighted_fit import CLEAR_OF_FLOOR
from piezoid.numerics.robust import NORMAL_95, student_quantile
from piezoid.operators.tunnelling import barrier_of_decay, decay_of_barrier
from piezoid.record_json import Interval
from piezoid.records.lab import Lab
from piezoid.records.recording import Quantity, Recording
from piezoid.records.table import RawTable

_DRIFT_m_per_s = 50e-12  # standard deviation: laboratories have 1 to 100 pm/s
_UNSTATED_s = 1.8  # duration of a sweep if not stated: 95 % limit for pairs of 0.1 to 5 s
_MAX_DRIFT = 0.25  # standard deviation relative to the travel of a valid sweep
# 95 %, relative to the drift: creep that began 30 s before changes by a tenth between two sweeps
# of 3 s each, and their mean by half of that.
_DRIFT_CHANGE = 0.05
_STRONG_DRIFT = 0.1  # of the speed of the sweep: above, second-order terms are several percent
# 95 %, relative to the difference of the two estimates of the drift. For 158 pairs of sweeps with
# hysteresis up to 3 % and 1/f motion up to 2 pm the intervals contain 91 % of the true values
# without this term, 96 % with a factor of 0.5, 97 % with 1; for 150 clipped pairs 91 % with 0.5.
_MISMATCH_SHARE = 0.75
_MIN_SPEED = 0.05  # smallest speed of the height minus that of the drift, relative


@dataclass(frozen=True, kw_only=True)
class DirectionShift:
    """Difference between backward and forward sweeps.

    reference_current_A  magnitude at which the heights are compared
    shift_m              height of that current, backward minus forward: hysteresis, creep, drift
    shift_interval_m     95 %
    decay_change         decay backward over forward, minus one
    decay_change_interval  95 %
    """

    reference_current_A: float
    shift_m: float
    shift_interval_m: Interval
    decay_change: float
    decay_change_interval: Interval

    @property
    def is_one_decay(self) -> bool:
        """Whether one decay is compatible with both directions."""
        low, high = self.decay_change_interval
        return low <= 0.0 <= high


def compare_directions(forward: BarrierFit, backward: BarrierFit) -> DirectionShift | None:
    """Compare both directions at a current that is above the noise in both.

        z(i) = ( ln I_0 - ln i ) / k,    shift = z_backward(i) - z_forward(i)

    The reference current is the geometric mean of the smaller peak and three times the larger
    floor, at which decay and height are nearly uncorrelated. Intervals follow from the block
    covariances by the delta method, for independent directions. None if no current is above three
    times the noise in both directions.
    """
    fits = (forward, backward)
    peak_A = min(fit.peak_A for fit in fits)
    floor_A = 3.0 * max(fit.floor_A for fit in fits)
    if peak_A <= floor_A:
        return None
    reference_A = math.sqrt(peak_A * floor_A)
    heights_m, deviations_m = [], []
    for fit in fits:
        height_m = math.log(fit.current_at_zero_height_A / reference_A) / fit.decay_per_m
        gradient = np.array([-height_m, 1.0]) / fit.decay_per_m
        heights_m.append(height_m)
        deviations_m.append(math.sqrt(float(gradient @ fit.covariance @ gradient)))
    shift_m = heights_m[1] - heights_m[0]
    spread_m = NORMAL_95 * math.hypot(*deviations_m)
    change = backward.decay_per_m / forward.decay_per_m - 1.0
    relative = [math.sqrt(fit.covariance[0, 0]) / fit.decay_per_m for fit in fits]
    spread = NORMAL_95 * math.hypot(*relative) * (1.0 + change)
    return DirectionShift(
        reference_current_A=reference_A,
        shift_m=shift_m,
        shift_interval_m=(shift_m - spread_m, shift_m + spread_m),
        decay_change=change,
        decay_change_interval=(change - spread, change + spread),
    )


@dataclass(frozen=True, kw_only=True)
class DecayEstimate:
    """Decay of one sweep, or of a pair of sweeps.

    decay_per_m     k
    below, above    relative distances of the ends of its 95 % interval; may be infinite
    drift           v/s, half the relative difference of both directions; None: single sweep
    due_to_drift    part of both distances that is due to unknown drift, relative
    """

    decay_per_m: float
    below: float
    above: float
    drift: float | None
    due_to_drift: tuple[float, float] = (0.0, 0.0)


def common_law(curves: Sequence[ApproachCurve], fits: Mapping[Direction, BarrierFit]) -> GapLaw:
    """Return the common law of all sweeps: decay corrected for drift, means of other values.

    curves  at least one, of one junction; two directions of one ``pair`` determine the drift
    fits    of each recorded direction, by ``fit_barrier``

    Every pair is one estimate, and so is every single sweep, whose variance includes an unknown
    drift.
    """
    pairs: dict[str, list[ApproachCurve]] = {}
    singles = []
    for curve in curves:
        partners = pairs.setdefault(curve.pair, []) if curve.pair else []
        if curve.pair and all(partner.direction is not curve.direction for partner in partners):
            partners.append(curve)
        else:
            singles.append([curve])
    estimates = [_estimate_decay(group) for group in (*pairs.values(), *singles)]
    decay, interval = _combine_decays(estimates)
    laws = tuple(fits.values())
    peak_A = min(fit.peak_A for fit in laws)
    # All directions reach that current; the mean of its heights is corrected for drift.
    height_m = np.mean(
        [math.log(law.current_at_zero_height_A / peak_A) / law.decay_per_m for law in laws]
    )
    log_current = math.log(peak_A) + decay * float(height_m)
    shares = [1.0 / max(law.offset_standard_A, 1e-30) ** 2 for law in laws]
    confidence, reasons = lowest_grade(_sweep_reasons(fits, estimates, decay, interval))
    return GapLaw(
        polarity=laws[0].polarity,
        decay_per_m=decay,
        decay_interval_per_m=interval,
        barrier_eV=barrier_of_decay(decay),
        barrier_interval_eV=(barrier_of_decay(interval[0]), barrier_of_decay(interval[1])),
        current_at_zero_height_A=math.exp(min(log_current, 700.0)),
        offset_A=float(np.average([law.offset_A for law in laws], weights=shares)),
        offset_standard_A=float(1.0 / np.sqrt(np.sum(shares))),
        floor_A=float(np.mean([law.floor_A for law in laws])),
        gap_jitter_m=float(np.mean([law.gap_jitter_m for law in laws])),
        sweep_decay_per_m=tuple(estimate.decay_per_m for estimate in estimates),
        confidence=confidence,
        reasons=reasons,
    )


def _estimate_decay(curves: Sequence[ApproachCurve]) -> DecayEstimate:
    """Estimate the decay from one sweep, or from a forward and a backward sweep of one pair."""
    fits = [fit_barrier([curve]) for curve in curves]
    decay = float(np.mean([fit.decay_per_m for fit in fits]))
    below = math.hypot(*(f.decay_per_m - f.decay_interval_per_m[0] for f in fits)) / len(fits)
    above = math.hypot(*(f.decay_interval_per_m[1] - f.decay_per_m for f in fits)) / len(fits)
    if len(fits) == 1:
        drift = None
        travel_m = float(np.ptp(curves[0].height_m))
        duration_s = _UNSTATED_s if curves[0].duration_s is None else curves[0].duration_s
        share = NORMAL_95 * min(_DRIFT_m_per_s * duration_s / travel_m, _MAX_DRIFT)
        drift_below, drift_above = share / (1.0 + share), share / max(1.0 - share, _MIN_SPEED)
    else:
        first, second = fits
        drift = 0.5 * (second.decay_per_m - first.decay_per_m) / decay
        # The difference of the drifts from the decays and from the shift. In the middle of the
        # range above the floor, estimates of decay and shift are independent.
        lowest_m = min(float(curve.height_m.min()) for curve in curves)
        turn_m = max(float(curve.height_m.max()) for curve in curves)
        ratio = first.peak_A / (CLEAR_OF_FLOOR * first.floor_A)
        middle_m = lowest_m + 0.5 * math.log(max(ratio, 1.0)) / first.decay_per_m
        below_turn_m = turn_m - min(middle_m, 0.5 * (lowest_m + turn_m))
        log_ratio = math.log(first.current_at_zero_height_A / second.current_at_zero_height_A)
        decay_difference = first.decay_per_m - second.decay_per_m
        shift = log_ratio - decay_difference * (turn_m - below_turn_m)
        mismatch = 0.5 * (decay_difference - shift / below_turn_m) / decay
        drift_below = drift_above = math.hypot(_DRIFT_CHANGE * drift, _MISMATCH_SHARE * mismatch)
    return DecayEstimate(
        decay_per_m=decay,
        below=math.hypot(below / decay, drift_below),
        above=math.hypot(above / decay, drift_above),
        drift=drift,
        due_to_drift=(drift_below, drift_above),
    )


def _combine_decays(estimates: Sequence[DecayEstimate]) -> tuple[float, Interval]:
    """Return the common decay and its 95 % interval, by a random-effects model of ln k.

    The variance between estimates has the quantile of Student's t for their number [DerSimonian &
    Laird 1986].
    """
    if len(estimates) == 1:
        decay, below, above = estimates[0].decay_per_m, estimates[0].below, estimates[0].above
        return decay, (decay * max(1.0 - below, 0.0), decay * (1.0 + above))
    logs = np.log([estimate.decay_per_m for estimate in estimates])
    within = np.array([(0.5 * (e.below + e.above) / NORMAL_95) ** 2 for e in estimates])
    is_bounded = np.isfinite(within)
    if not is_bounded.any():
        return math.exp(float(np.mean(logs))), (0.0, math.inf)
    logs, within = logs[is_bounded], np.maximum(within[is_bounded], 1e-16)
    weight = 1.0 / within
    between, quantile = 0.0, NORMAL_95
    if len(logs) > 1:
        excess = float(np.sum(weight * (logs - np.average(logs, weights=weight)) ** 2))
        spread = weight.sum() - np.sum(weight**2) / weight.sum()
        between = max((excess - len(logs) + 1) / spread, 0.0)
        quantile = float(student_quantile(0.975, len(logs) - 1))
    share = 1.0 / (within + between)
    share /= share.sum()
    mean = float(share @ logs)
    variance = NORMAL_95**2 * within + quantile**2 * between
    half = math.sqrt(float(np.sum(share**2 * variance)))
    if half >= 50.0:
        return math.exp(mean), (0.0, math.inf)
    return math.exp(mean), (math.exp(mean - half), math.exp(mean + half))


def _sweep_reasons(
    fits: Mapping[Direction, BarrierFit],
    estimates: Sequence[DecayEstimate],
    decay_per_m: float,
    interval_per_m: Interval,
) -> list[Reason]:
    """Return the criteria that each direction does not meet, and a reason for drift.

    Reasons common to all directions are listed once.
    """
    by_direction = {
        direction: barrier_reasons(fit.weighted, fit.curves, decay_per_m, interval_per_m)
        for direction, fit in fits.items()
    }
    shared = set.intersection(*(set(reasons) for reasons in by_direction.values()))
    labelled = [
        (grade, text if (grade, text) in shared else f"{direction.value}: {text}")
        for direction, reasons in by_direction.items()
        for grade, text in reasons
    ]
    reasons = list(dict.fromkeys(labelled))
    one_way = [estimate for estimate in estimates if estimate.drift is None]
    drift = max((abs(e.drift) for e in estimates if e.drift is not None), default=0.0)
    if one_way:
        below, above = one_way[0].due_to_drift
        text = (
            f"{len(one_way)} sweep(s) went one way only, which cannot separate drift of the "
            f"height from barrier: the interval contains a decay {100.0 * below:.2g} % smaller to "
            f"{100.0 * above:.2g} % larger for it; sweep in both directions"
        )
        reasons.append((Confidence.MEDIUM, text))
    elif drift > _STRONG_DRIFT:
        text = (
            f"the height drifted or crept by {100.0 * drift:.2g} % of its own motion; the mean of "
            "both directions is free of steady drift only: sweep faster"
        )
        reasons.append((Confidence.MEDIUM, text))
    return reasons


@dataclass(frozen=True, kw_only=True)
class JointBarrier:
    """Decay and barrier of sweeps and loop together.

    ratio           k of the loop over k of the sweeps, and its 95 % interval
    agree           whether that interval contains 1
    decay_per_m     weighted mean of both; None if they disagree
    decay_interval_per_m  95 % interval of the mean; if they disagree, the range of both intervals
    barrier_eV, barrier_interval_eV  of the decay
    """

    ratio: float
    ratio_interval: Interval
    agree: bool
    decay_per_m: float | None
    decay_interval_per_m: Interval
    barrier_eV: float | None
    barrier_interval_eV: Interval


def join_barriers(sweeps: tuple[float, Interval], loop: tuple[float, Interval]) -> JointBarrier:
    """Combine two decays with their 95 % intervals, in the logarithm, by inverse variance.

    sweeps, loop  decay and interval, 1/m; an unbounded interval carries no information

    If the decays differ by more than their standard deviations, the interval of the mean is
    widened by that ratio (Birge).
    """
    variances = [
        (math.log(high / low) / (2.0 * NORMAL_95)) ** 2
        if low > 0.0 and math.isfinite(high)
        else math.inf
        for _, (low, high) in (sweeps, loop)
    ]

    log_ratio = math.log(loop[0]) - math.log(sweeps[0])
    half = NORMAL_95 * math.sqrt(sum(variances))
    agree = abs(log_ratio) <= half
    decay = None
    interval = min(sweeps[1][0], loop[1][0]), max(sweeps[1][1], loop[1][1])
    if agree:
        weights = [1.0 / max(variance, 1e-30) for variance in variances]
        total = sum(weights)
        share = weights[1] / total if total > 0.0 else 0.5
        mean = math.log(sweeps[0]) + share * log_ratio
        excess = weights[0] * share * log_ratio**2 if total > 0.0 else 0.0
        spread = math.sqrt(max(excess, 1.0) / total) if total > 0.0 else math.inf
        decay, distance = math.exp(mean), NORMAL_95 * spread
        interval = math.exp(mean - distance), math.exp(mean + distance)
    return JointBarrier(
        ratio=math.exp(log_ratio),
        ratio_interval=(math.exp(log_ratio - half), math.exp(log_ratio + half)),
        agree=agree,
        decay_per_m=decay,
        decay_interval_per_m=interval,
        barrier_eV=None if decay is None else barrier_of_decay(decay),
        barrier_interval_eV=(barrier_of_decay(interval[0]), barrier_of_decay(interval[1])),
    )


@dataclass(frozen=True, kw_only=True)
class TunnellingModel:
    """Model of the tunnelling junction, from sweeps, closed loops, or both.

    gap_law            of all sweeps together, corrected for drift; None: no sweeps
    loop_plant         None: no closed loops
    forward, backward  of the sweeps of one direction, not corrected for drift; None unless there
                       are both directions
    shift              between both directions; None also if no current is above the noise in both
    joint              of sweeps and loops together; None unless there are both
    """

    gap_law: GapLaw | None
    loop_plant: LoopPlant | None
    forward: GapLaw | None = None
    backward: GapLaw | None = None
    shift: DirectionShift | None = None
    joint: JointBarrier | None = None


def fit_junction(
    sweeps: Sequence[RawTable], recordings: Sequence[Recording] = (), lab: Lab | None = None
) -> TunnellingModel | None:
    """Fit the gap law to sweeps over height and the plant to closed loops, of one tip.

    sweeps      tables over height; all sweeps of one direction share decay and offset, each has a
                zero of height
    recordings  over time; recordings with drive, current and reference are closed loops
    lab         declarations of the laboratory, required for closed loops

    Returns None if there are neither sweeps nor closed loops. Raises as ``read_z_spectroscopy``,
    ``fit_barrier``, ``loops_of`` and ``identify_closed_loop``.
    """
    model = gap_law = offset = None
    if sweeps:
        curves = curves_of(sweeps)
        fits = {
            direction: fit_barrier(same_direction)
            for direction in Direction
            if (same_direction := [curve for curve in curves if curve.direction is direction])
        }
        gap_law = common_law(curves, fits)
        model = TunnellingModel(gap_law=gap_law, loop_plant=None)
        if len(fits) == len(Direction):
            forward, backward = fits.values()
            shift = compare_directions(forward, backward)
            model = replace(model, forward=forward.law, backward=backward.law, shift=shift)
    if not any(is_loop(recording) for recording in recordings):
        return model
    if gap_law is not None:
        offset = (gap_law.offset_A, gap_law.offset_standard_A)
    rig, records = loops_of(recordings, lab or Lab())
    fits_of_loops = [identify_closed_loop(record, rig, offset_A=offset) for record in records]
    loop = describe_loop_plant(fits_of_loops, rig)
    if model is None or gap_law is None:
        return TunnellingModel(gap_law=None, loop_plant=loop)
    low_eV, high_eV = loop.barrier_interval_eV
    joint = join_barriers(
        (gap_law.decay_per_m, gap_law.decay_interval_per_m),
        (
            decay_of_barrier(loop.barrier_eV),
            (decay_of_barrier(low_eV), decay_of_barrier(high_eV)),
        ),
    )
    return replace(model, loop_plant=loop, joint=joint)


def curves_of(sweeps: Sequence[RawTable]) -> tuple[ApproachCurve, ...]:
    """Return all sweeps of all tables, in their order."""
    return tuple(curve for table in sweeps for curve in read_z_spectroscopy(table))


def remarks_on_currents(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Return a remark for each recording whose current over time could not be used."""
    return tuple(
        f"{recording.name}: its current over time was not used. The plant between drive and "
        "current needs the external dither beside them: name its column 'reference' in "
        "lab.toml, and declare the loop under [tunnelling]"
        for recording in recordings
        if any(channel.quantity is Quantity.CURRENT for channel in recording.channels)
        and not is_loop(recording)
    )
