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
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from piezoid.diagnosis.appearance import OVER_TIME
from piezoid.diagnosis.blocked_regression import Null
from piezoid.diagnosis.effect import Effect, Fault, FaultTest
from piezoid.diagnosis.effects.outliers import without_spikes
from piezoid.diagnosis.residual_view import View, with_tracks
from piezoid.diagnosis.sample_slips import FEWEST as FEWEST_ROWS
from piezoid.diagnosis.sample_slips import (
    OWN,
    Searched,
    Slip,
    beside,
    in_step,
    late,
    longest,
    placed,
    places_of,
    strongest,
    undone,
    width_of,
)
from piezoid.diagnosis.signals import with_displacement
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Recording

WHOLE = 0.4  # how far beta may be from one
GAIN = 0.33  # of the track's squared residual: what a slip must take
SURE = 6.0  # standard errors of the step among stretches of equal speed
LEAST_SHARE = 3e-4  # of half the stroke: what the slip must be worth in rms
WINDOWS = 36
EQUAL = 1.6  # speeds within this ratio are equal
FEWEST = 3  # stretches on either side
ONE_WAY = 0.08  # of the squared speed
DRAWN = 2000  # orders of the stretches
MOST = 8  # slips
CLEAR = 0.6  # of a track's squared residual: so much a slip takes that is clear by itself
KEPT = 0.6  # of what the tangent promised
LOOK = 0.05  # of a track's squared residual, to look closer


@dataclass(frozen=True, kw_only=True)
class SlipEvidence:
    """A slip with what speaks for it: the delay of stretches of equal speed before and behind it.

    A limit of the amplifier, a lag or hysteresis that knows rate delays fast stretches more than
    slow ones, whenever they come. A slip delays all that follows and nothing before.

    beta       estimate over length
    step       of the delay among stretches of equal speed, in samples, and its standard error
    p_value    of a step this clear where the stretches come in any other order
    worth      rms of what it changes, of half the stroke
    """

    slip: Slip
    beta: float
    step: float
    deviation: float
    p_value: float
    worth: float

    @property
    def is_significant(self) -> bool:
        """Tell whether this is evidence of a slip."""
        away = abs(self.step - self.slip.samples)
        return (
            self.worth > LEAST_SHARE
            and away < WHOLE * abs(self.slip.samples) + 2.0 * self.deviation
            and self.slip.gain > GAIN
            and abs(self.step) > SURE * self.deviation
            and abs(self.beta - 1.0) < WHOLE
        )


def hidden(view: View) -> float:
    """Return the rms of the largest slip that could be there unseen, of the stroke.

    A slip is evident if it takes the part g of a track's squared residual R^2; where nothing else
    stands for the part f of its own square,

        rms^2 < g R^2 / f,

    f for a slip in the middle of all places at which one is looked for.
    """
    null, worst = beside(view), LEAST_SHARE
    for k in range(len(view.tracks)):
        track = Searched.of(view, null, k)
        if len(track.place) < FEWEST_ROWS:
            continue
        first = track.instants()
        if len(first):
            share = max(float(np.median(track.own_share(1, first))), OWN)
            worst = max(worst, float(np.sqrt(GAIN / share * np.mean(track.residual**2))))
    return worst / 2.0


def evidence_of(view: View, null: Null, slip: Slip) -> SlipEvidence | None:
    """Compare the delay of stretches of equal speed before and behind a slip.

    None where no speed was met on both sides, or the stage moved one way only.
    """
    track = Searched.of(view, null, slip.track)
    n, samples = len(track.place), int(slip.samples)
    first = int(np.searchsorted(track.place, slip.instant))
    if not FEWEST < first < n - FEWEST:
        return None
    gain, beta = (float(v[0]) for v in track.score(samples, np.array([first])))
    change = late(track.static, track.place, samples)
    column = np.zeros(len(null.residual))
    column[track.rows] = np.where(np.arange(n) >= first, change, 0.0)
    left = (null.residual - beta * null.without(column))[track.rows]
    parts = _stretches(change, first)
    square = np.array([change[p] @ change[p] for p in parts]) + 1e-300
    behind = np.array([p.start >= first for p in parts])
    delay = samples * (np.array([change[p] @ left[p] for p in parts]) / square + beta * behind)
    speed = np.sqrt(np.array([np.sum(change[p] ** 4) for p in parts]) / square) + 1e-150
    equal = _equal(speed, behind)
    if _fewer(behind[equal]) < FEWEST or not _both_ways(change, first):
        return None
    step, deviation = _step(delay[equal], behind[equal], np.sqrt(square[equal]))
    return SlipEvidence(
        slip=replace(slip, gain=gain),
        beta=beta,
        step=step,
        deviation=deviation,
        p_value=_chance(delay[equal], np.sqrt(square[equal])),
        worth=float(np.sqrt(np.mean(change[first:] ** 2) * (n - first) / n)),
    )


def _both_ways(change: Array, first: int) -> bool:
    """Tell whether the stage moves to and fro on either side: one way only may be an offset."""
    parts = (change[:first], change[first:])
    forth = [
        float(np.sum(np.maximum(part, 0.0) ** 2) / max(part @ part, 1e-300)) for part in parts
    ]
    return all(ONE_WAY < share < 1.0 - ONE_WAY for share in forth)


def _fewer(behind: NDArray[np.bool_]) -> int:
    """Return how many stretches lie on the side that has fewer."""
    return int(min(behind.sum(), (~behind).sum()))


def _stretches(change: Array, first: int) -> list[slice]:
    """Cut a track's rows into stretches that tell as much as each other, none across a slip."""
    told = np.cumsum(change**2)
    edges = np.searchsorted(told, np.linspace(0.0, told[-1], WINDOWS + 1)[1:-1])
    whole = np.unique(np.concatenate([[0, first, len(change)], edges]))
    return [slice(int(a), int(b)) for a, b in pairwise(whole)]


def _equal(speed: Array, behind: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the stretches whose speed was met on the other side as well."""
    near = np.abs(np.log(speed[:, None] / speed[None, :])) < np.log(EQUAL)
    across = behind[:, None] != behind[None, :]
    return np.asarray(np.any(near & across, axis=1))


def _step(delay: Array, behind: NDArray[np.bool_], weight: Array) -> tuple[float, float]:
    """Return the difference of the weighted means of two groups, and its standard error."""
    means, squares = [], []
    for group in (behind, ~behind):
        w = weight[group] / weight[group].sum()
        means.append(float(w @ delay[group]))
        # each counts as often as its share of the weight
        count = 1.0 / float(w @ w)
        squares.append(float(w @ (delay[group] - means[-1]) ** 2) / max(count - 1.0, 0.5))
    return means[0] - means[1], float(np.sqrt(sum(squares))) + 1e-6


def _chance(delay: Array, weight: Array) -> float:
    """Return how often the stretches in any other order have as clear a step somewhere."""
    draw = np.random.default_rng(len(delay))
    orders = np.array([draw.permutation(len(delay)) for _ in range(DRAWN)])
    orders[0] = np.arange(len(delay))
    w = weight[orders]
    moved = np.cumsum(w * (delay[orders] - np.average(delay, weights=weight)), axis=1)[:, :-1]
    share = np.cumsum(w, axis=1)[:, :-1] / weight.sum()
    clear = np.max(moved**2 / np.maximum(share * (1.0 - share), 1e-12), axis=1)
    return float(np.mean(clear >= clear[0] * (1.0 - 1e-12)))


def _fault(view: View) -> Fault | None:
    # spikes are another fault; here they would only hide a small slip
    quiet = [without_spikes(t, s) for t, s in zip(view.tracks, view.static, strict=True)]
    calm = (
        view
        if all(a is b for a, b in zip(quiet, view.tracks, strict=True))
        else with_tracks(view, quiet)
    )
    found: list[SlipEvidence] = []
    while len(found) < MOST:
        judged = _next(calm)
        if judged is None:
            break
        better = undone(calm, judged.slip)
        if not _believed(calm, better, judged):
            break
        found.append(judged)
        calm = better
    if not found:
        return None
    tracks = list(view.tracks)
    for one in found:
        tracks[one.slip.track] = in_step(tracks[one.slip.track], one.slip)
    # what was placed too long or too short while others were in the way is put right later
    same = [one for one in found if _near(one.slip, found[0].slip, view)]
    last = same[-1]
    return Fault(
        tracks=tuple(tracks),
        value=sum(one.slip.samples for one in same),
        spread=float(np.hypot(last.deviation, last.step - last.slip.samples)),
        p_value=min(one.p_value for one in found),
        where=places_of([one.slip for one in found], view.tracks),
    )


def _believed(calm: View, better: View, judged: SlipEvidence) -> bool:
    """Tell whether less is left with a slip put right; one that is none makes the true one larger.

    Where other tracks slip as well, less may be left only beside all that looks like a delay: then
    as much must go as the tangent promised.
    """
    if better.rms < calm.rms:
        return True
    before, after = beside(calm), beside(better)
    track = slice(*calm.nuisance.edges[judged.slip.track : judged.slip.track + 2])
    promised = judged.slip.gain * float(np.sum(before.residual[track] ** 2))
    gone = float(np.sum(before.residual**2) - np.sum(after.residual**2))
    return judged.slip.gain > CLEAR and gone > KEPT * promised


def _near(one: Slip, other: Slip, view: View) -> bool:
    """Tell whether two slips are one, found in two goes."""
    width = width_of(len(view.tracks[other.track].drive))
    return one.track == other.track and abs(one.instant - other.instant) <= width


def _next(view: View) -> SlipEvidence | None:
    """Return the clearest slip that is left."""
    null = beside(view)
    for slip in strongest(view, null):
        if slip.gain < LOOK:
            break
        judged = evidence_of(view, null, placed(view, slip))
        if judged is not None and abs(judged.step - judged.slip.samples) > 2.0 * judged.deviation:
            # fitted in the midst of other slips: stretches of equal speed know the length better
            length = round(judged.step) or int(np.sign(slip.samples))
            if abs(length) > longest(len(view.tracks[slip.track].drive)):
                continue
            judged = evidence_of(
                view, null, placed(view, replace(slip, samples=length), fixed=True)
            )
        if judged is not None and judged.is_significant and _alone(view, judged):
            return judged
    return None


def _alone(view: View, judged: SlipEvidence) -> bool:
    """Tell whether a slip speaks beside what other axes may move as well."""
    if not any(track.others for track in view.tracks):
        return True
    there = evidence_of(view, beside(view, others=True), judged.slip)
    return there is not None and there.is_significant


def inject(recording: Recording, share: float) -> Recording:
    """Lose readings in the middle, as many as are worth the share."""
    moved_m = recording.displacement_m()
    step_m = float(np.sqrt(np.mean(np.diff(moved_m) ** 2)))
    rows = max(round(2.0 * share * float(np.ptp(moved_m)) / max(step_m, 1e-30)), 1)
    place = np.arange(len(moved_m))
    source = np.where(place > len(place) // 2, np.minimum(place + rows, len(place) - 1), place)
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
    fault=FaultTest(find=_fault, bound=hidden),
    detectable_share=1.2e-2,
    inject=inject,
)
