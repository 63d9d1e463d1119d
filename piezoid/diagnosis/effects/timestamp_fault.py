"""Timestamp fault: displacement and drive get out of step.

What you see
    From one instant on the displacement comes early or late by a fixed number of samples.
Why it happens
    A buffer overran and readings are gone, or the reader stalled and repeated its last value.
How it is detected
    A delay that begins at one instant explains a large part of the error of a recording, beside
    a constant delay, lags, creep and everything that grows with speed. At equal speed it has one
    value before the instant and another after it.
What the extension adds
    Nothing: the readings are shifted back into step and the rows in between are left out.
Source
    what acquisition programs do when the disk is busy
"""

from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from piezoid.diagnosis.blocked_regression import Null
from piezoid.diagnosis.effect import OVER_TIME, Effect, Fault, FaultTest
from piezoid.diagnosis.effects.outliers import spikes, without_spikes
from piezoid.diagnosis.residual_view import View, with_tracks
from piezoid.diagnosis.sample_slips import (
    MIN_ORTHOGONAL,
    Refit,
    Slip,
    SlipScan,
    delay_change,
    delay_like_null,
    instant_error,
    max_slip,
    refine_slip,
    slip_locations,
    strongest_slips,
    without_slips,
)
from piezoid.diagnosis.signals import other_axis_columns, with_displacement
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Recording

MAX_BETA_ERROR = 0.4  # largest deviation of beta from 1, and of the step relative to the length
MIN_GAIN = 0.33  # of the track's squared residual
MIN_STEP_Z = 6.0  # standard errors of the step among windows of equal speed
MIN_RMS = 3e-4  # of half the stroke
WINDOWS = 36
EQUAL_SPEED = 1.6  # speeds within this ratio count as equal
MIN_WINDOWS = 3  # on either side
MIN_REVERSE_MOTION = 0.08  # of the squared speed
PERMUTATIONS = 2000
MAX_SLIPS = 8
EVIDENT_GAIN = 0.6  # share of the squared residual of a track, evident despite other slips
MIN_CONFIRMED = 0.6  # of the gain of the tangent, by the refitted slip
# Error of all recordings after undoing a slip of the length of other slips, over that before: 0.26
# in the chirp of a Coleman-Hodgdon stage.
MAX_ERROR = 0.9
# Error with the length of least error over that with the length that windows of equal speed show,
# below which the first counts: 0.91 for 9 lost samples on a Dahl stage, where the windows showed
# 8; 1.00 for 4 repeated ones on a Duhem stage, where the error showed 3 because of slips in
# another recording. On 36 fresh recordings of six laws 22 of 26 lengths were right with 0.97 and
# with 0.99, and 8 of 24 by the windows alone.
CLEARLY_BETTER = 0.97
ROUNDING = 12.0**-0.5  # samples: standard deviation of an integer
MIN_TRIAL_GAIN = 0.05  # of a track's squared residual, for a slip that is refined


@dataclass(frozen=True, kw_only=True)
class SlipEvidence:
    """Evidence of a slip: the delay of windows of equal speed before and after it.

    A limit of the amplifier, a lag or rate-dependent hysteresis delays fast windows more than slow
    windows, before and after the instant. A slip delays all windows after it and none before.

    beta     estimated length over length
    step     step of the delay among windows of equal speed, in samples
    std      standard error of this step
    p_value  of such a step if the windows are in random order
    rms      of the change by the slip, of half the stroke
    """

    slip: Slip
    beta: float
    step: float
    std: float
    p_value: float
    rms: float

    @property
    def is_significant(self) -> bool:
        """Whether the step is significant, and agrees with the length of a slip of some size."""
        deviation = abs(self.step - self.slip.samples)
        return (
            self.rms > MIN_RMS
            and deviation < MAX_BETA_ERROR * abs(self.slip.samples) + 2.0 * self.std
            and self.slip.gain > MIN_GAIN
            and abs(self.step) > MIN_STEP_Z * self.std
            and abs(self.beta - 1.0) < MAX_BETA_ERROR
        )


def largest_undetected(view: View) -> float:
    """Return the rms of the largest slip that could be present undetected, of the stroke.

    A slip is evident if it explains the share g of a track's squared residual R^2. If a share f of
    its square is orthogonal to the null,

        rms^2 < g R^2 / f.

    f is the median over all trial instants.
    """
    null, largest = delay_like_null(view), MIN_RMS
    for k in range(len(view.tracks)):
        scan = SlipScan.of(view, null, k)
        first = scan.instants()
        if len(first):
            square, orthogonal = scan.squares(1, first)
            share = max(float(np.median(orthogonal / (square + 1e-300))), MIN_ORTHOGONAL)
            power = MIN_GAIN / share * np.mean(scan.residual**2)
            largest = max(largest, float(np.sqrt(power)))
    return largest / 2.0


def slip_evidence(view: View, null: Null, slip: Slip) -> SlipEvidence | None:
    """Compare the delay of windows of equal speed before and after a slip.

    The windows are of equal motion and do not cross the slip. Returns None if no speed occurs on
    both sides, or the stage moves one way only.
    """
    scan = SlipScan.of(view, null, slip.track)
    n, samples = len(scan.samples), int(slip.samples)
    first = int(np.searchsorted(scan.samples, slip.instant))
    if not MIN_WINDOWS < first < n - MIN_WINDOWS:
        return None
    gain, beta = (float(values[0]) for values in scan.score(samples, np.array([first])))
    change = delay_change(scan.static, scan.samples, samples)
    column = np.zeros(len(null.residual))
    column[scan.rows] = np.where(np.arange(n) >= first, change, 0.0)
    residual = (null.residual - beta * null.project_out(column))[scan.rows]
    motion = np.cumsum(change**2)
    edges = np.searchsorted(motion, np.linspace(0.0, motion[-1], WINDOWS + 1)[1:-1])
    edges = np.unique(np.concatenate([[0, first, len(change)], edges]))
    windows = [slice(int(a), int(b)) for a, b in pairwise(edges)]
    square = np.array([change[w] @ change[w] for w in windows]) + 1e-300
    is_after = np.array([w.start >= first for w in windows])
    product = np.array([change[w] @ residual[w] for w in windows])
    delay = samples * (product / square + beta * is_after)
    speed = np.sqrt(np.array([np.sum(change[w] ** 4) for w in windows]) / square) + 1e-150
    is_equal = np.abs(np.log(speed[:, None] / speed[None, :])) < np.log(EQUAL_SPEED)
    is_common = np.any(is_equal & (is_after[:, None] != is_after[None, :]), axis=1)
    sides = is_after[is_common]
    # if the stage moves one way only, a slip may be an offset
    moves_both_ways = all(
        MIN_REVERSE_MOTION
        < np.sum(np.maximum(side, 0.0) ** 2) / max(side @ side, 1e-300)
        < 1.0 - MIN_REVERSE_MOTION
        for side in (change[:first], change[first:])
    )
    if min(sides.sum(), (~sides).sum()) < MIN_WINDOWS or not moves_both_ways:
        return None
    weight = np.sqrt(square[is_common])
    step, std = _step(delay[is_common], sides, weight)
    return SlipEvidence(
        slip=replace(slip, gain=gain),
        beta=beta,
        step=step,
        std=std,
        p_value=_permutation_p_value(delay[is_common], weight),
        rms=float(np.sqrt(np.mean(change[first:] ** 2) * (n - first) / n)),
    )


def _step(delay: Array, is_after: NDArray[np.bool_], weight: Array) -> tuple[float, float]:
    """Return the difference of the weighted means of two groups, and its standard error."""
    means, variances = [], []
    for group in (is_after, ~is_after):
        w = weight[group] / weight[group].sum()
        means.append(float(w @ delay[group]))
        effective_count = 1.0 / float(w @ w)
        variance = float(w @ (delay[group] - means[-1]) ** 2)
        variances.append(variance / max(effective_count - 1.0, 0.5))
    return means[0] - means[1], float(np.sqrt(sum(variances))) + 1e-6


def _permutation_p_value(delay: Array, weight: Array) -> float:
    """Return the share of random orders of the windows with as significant a step anywhere."""
    rng = np.random.default_rng(len(delay))
    orders = np.array([rng.permutation(len(delay)) for _ in range(PERMUTATIONS)])
    orders[0] = np.arange(len(delay))
    w = weight[orders]
    deviation = delay[orders] - np.average(delay, weights=weight)
    total = np.cumsum(w * deviation, axis=1)[:, :-1]
    share = np.cumsum(w, axis=1)[:, :-1] / weight.sum()
    largest = np.max(total**2 / np.maximum(share * (1.0 - share), 1e-12), axis=1)
    return float(np.mean(largest >= largest[0] * (1.0 - 1e-12)))


def find_slips(view: View, refit: Refit | None = None) -> Fault | None:
    """Find slips one after the other, each with all earlier slips undone.

    refit  refits repaired tracks with the effects of the view; None: the view has no effects
    """
    refit = refit or partial(with_tracks, view)
    pairs = zip(view.tracks, view.static, strict=True)
    # spikes would hide a small slip
    tracks = [without_spikes(track, spikes(track, static)[0]) for track, static in pairs]
    is_clean = all(new is old for new, old in zip(tracks, view.tracks, strict=True))
    repaired = view if is_clean else refit(tracks)
    detected: list[SlipEvidence] = []
    while len(detected) < MAX_SLIPS:
        evidence = _next_slip(repaired, refit)
        if evidence is None:
            break
        trial = refit(without_slips(repaired.tracks, evidence.slip))
        if not _is_confirmed(repaired, trial, evidence):
            break
        detected.append(evidence)
        repaired = trial
    if not detected:
        return None
    slips = []
    for evidence in detected:
        further_slips = [further.slip for further in detected if further is not evidence]
        slip = evidence.slip
        if all(further.track != slip.track for further in further_slips):
            # refine the only slip of a track, all others undone, if that clearly reduces the error
            beside = refit(without_slips(view.tracks, *further_slips))
            refined = refine_slip(beside, slip, refit=refit)
            rms, refined_rms = (
                refit(without_slips(beside.tracks, undone)).rms for undone in (slip, refined)
            )
            slip = refined if refined_rms < CLEARLY_BETTER * rms else slip
        slips.append(replace(evidence, slip=slip))
    # a second slip at the instant of the first one corrects its length
    first = slips[0].slip
    width = instant_error(len(view.tracks[first.track].drive))
    at_first = [
        evidence
        for evidence in slips
        if evidence.slip.track == first.track
        and abs(evidence.slip.instant - first.instant) <= width
    ]
    last = at_first[-1]
    return Fault(
        tracks=tuple(without_slips(view.tracks, *(evidence.slip for evidence in slips))),
        value=sum(evidence.slip.samples for evidence in at_first),
        spread=float(np.hypot(last.std, last.step - last.slip.samples)),
        p_value=min(evidence.p_value for evidence in slips),
        locations=slip_locations([evidence.slip for evidence in slips], view.tracks),
    )


def find_equal_slips(view: View, refit: Refit, samples: int) -> Fault | None:
    """Find slips of the length of other slips by the error alone, at most one in each track.

    A chirp has no equal speeds before and after a slip, so that ``find_slips`` finds none. The
    p-value is that of the likelihood ratio of n independent blocks, z^2 = 2 n ln(rms / rms').

    refit    refits repaired tracks with the effects of the view
    samples  length of the slips
    """
    repaired = view
    slips: list[Slip] = []
    for k in range(len(view.tracks)):
        scan = SlipScan.of(repaired, repaired.null, k)
        first = scan.instants()
        if not len(first):
            continue
        gain, beta = scan.score(samples, first)
        row = int(np.argmax(np.where(beta > 0.0, gain, 0.0)))
        instant = int(scan.samples[first[row]])
        slip = Slip(track=k, instant=instant, samples=samples, gain=float(gain[row]))
        slip = refine_slip(repaired, slip, refit=refit, has_length=True)
        trial = refit(without_slips(repaired.tracks, slip))
        if trial.rms < MAX_ERROR * repaired.rms:
            repaired, slips = trial, [*slips, slip]
    if not slips:
        return None
    blocks = len(view.null.edges)
    return Fault(
        tracks=repaired.tracks,
        value=samples,
        spread=ROUNDING,
        p_value=2.0 * float(ndtr(-np.sqrt(2.0 * blocks * np.log(view.rms / repaired.rms)))),
        locations=slip_locations(slips, view.tracks),
    )


def _next_slip(view: View, refit: Refit) -> SlipEvidence | None:
    """Return the strongest slip that is significant, also beside other axes, or None."""
    null, has_other_axes = delay_like_null(view), any(t.other_drives for t in view.tracks)
    for slip in strongest_slips(view, null):
        if slip.gain < MIN_TRIAL_GAIN:
            break
        evidence = slip_evidence(view, null, refine_slip(view, slip, refit=refit))
        if evidence is not None and abs(evidence.step - evidence.slip.samples) > 2 * evidence.std:
            # with other slips present, the step of windows of equal speed is more accurate
            length = round(evidence.step) or int(np.sign(slip.samples))
            if abs(length) > max_slip(len(view.tracks[slip.track].drive)):
                continue
            resized = refine_slip(
                view, replace(slip, samples=length), refit=refit, has_length=True
            )
            evidence = slip_evidence(view, null, resized)
        if evidence is None or not evidence.is_significant:
            continue
        if not has_other_axes:
            return evidence
        wider_null = delay_like_null(view, other_axis_columns(view))
        beside_other_axes = slip_evidence(view, wider_null, evidence.slip)
        if beside_other_axes is not None and beside_other_axes.is_significant:
            return evidence
    return None


def _is_confirmed(original: View, undone: View, evidence: SlipEvidence) -> bool:
    """Tell whether undoing a slip reduces the error; undoing a wrong slip would hide the true one.

    With slips in other tracks the total error may not fall. Then an evident slip must explain most
    of its expected gain beside delay-like columns.
    """
    if undone.rms < original.rms:
        return True
    null, undone_null = delay_like_null(original), delay_like_null(undone)
    rows = original.track_rows(evidence.slip.track)
    expected = evidence.slip.gain * float(np.sum(null.residual[rows] ** 2))
    explained = float(np.sum(null.residual**2) - np.sum(undone_null.residual**2))
    return evidence.slip.gain > EVIDENT_GAIN and explained > MIN_CONFIRMED * expected


def inject(recording: Recording, share: float) -> Recording:
    """Drop as many samples in the middle as change the reading by the share."""
    moved_m = recording.displacement_m()
    step_m = float(np.sqrt(np.mean(np.diff(moved_m) ** 2)))
    rows = max(round(2.0 * share * float(np.ptp(moved_m)) / max(step_m, 1e-30)), 1)
    samples = np.arange(len(moved_m))
    source = np.where(
        samples > len(samples) // 2, np.minimum(samples + rows, len(samples) - 1), samples
    )
    return with_displacement(recording, moved_m[source])


EFFECT = Effect(
    name="timestamp_fault",
    explanation=__doc__ or "",
    unit="samples",
    experiment="Record a steady sine for as long, with the acquisition's own sample counter in a "
    "column, and nothing else running on the computer.",
    control="The clock of the recording is not that of the stage: nothing fast can be designed "
    "from it. Record again.",
    shows=OVER_TIME,
    tangent="its remedy is the acquisition's own counter in a column",
    confounded=("delay",),
    fault=FaultTest(find=find_slips, bound=largest_undetected),
    detectable_share=1.2e-2,
    inject=inject,
)
