"""What speaks for a slip: the delay of stretches of equal speed before and behind it.

A limit of the amplifier, a lag or hysteresis that knows rate delays fast stretches more than slow
ones, whenever they come. A slip delays all that follows and nothing before.
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from piezoid.diagnosis.folds import Null
from piezoid.diagnosis.slips import FEWEST as FEWEST_ROWS
from piezoid.diagnosis.slips import OWN, Searched, Slip, beside, late
from piezoid.diagnosis.view import View
from piezoid.numerics.arrays import Array

WHOLE = 0.4  # how far beta may be from one
GAIN = 0.33  # of the track's squared residual: what a slip must take
SURE = 6.0  # standard errors of the step among stretches of equal speed
LEAST_SHARE = 3e-4  # of half the stroke: what the slip must be worth in rms
WINDOWS = 36
EQUAL = 1.6  # speeds within this ratio are equal
FEWEST = 3  # stretches on either side
ONE_WAY = 0.08  # of the squared speed
DRAWN = 2000  # orders of the stretches


@dataclass(frozen=True, kw_only=True)
class SlipEvidence:
    """A slip with what speaks for it.

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
