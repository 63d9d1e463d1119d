"""Something else: what no effect of the catalogue stands for, with the coordinate it lives in.

The search for causes comes first. Where the remainder then lives in one coordinate, the curve
along it is taken off the readings and the search is repeated: a name that stood for it finds
nothing any more, and what it had hidden is seen. A cause in whose place a curve along one
coordinate leaves clearly less goes the same way, for a wrong name is worse than none. The second
search is believed where it ends with clearly less than the first one.

A reading may end before the motion does, told by what the rest of the readings foretells:

    y = min(x, L)   or   y = max(x, L)

A limit of the amplifier makes a plateau as well, but the stage leaves it at the drive at which it
came, and a sensor's at another one: the loop is open there. So the readings on the plateau are
left out, hysteresis is fitted to the others, and says where the stage was meanwhile.

Source: Tobin (1958) on readings that are censored.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from piezoid.diagnosis.coordinate_bases import Signals, along_displacement
from piezoid.diagnosis.coordinate_tests import (
    SHIFTS,
    CoordinateScore,
    Remainder,
    course,
    everywhere,
    of_grid,
)
from piezoid.diagnosis.null_distribution import chance_of, least_chance, score_of
from piezoid.diagnosis.refitted_view import SelectedEffect, extended
from piezoid.diagnosis.residual_view import View, with_tracks
from piezoid.diagnosis.segments import Track
from piezoid.diagnosis.selection import Outcome, search
from piezoid.numerics.arrays import Array
from piezoid.numerics.executor import Executor

WIDTH = 5.0  # times the noise: how far readings of one plateau differ from its middle
LEAST_ROWS = 20  # on it, of one recording
FAR = 8.0  # times the noise: how far beyond it the stage must have gone
MOVES = 20.0  # times the noise: how far the drive moves over it; at a turn it moves 2 * WIDTH
MOST = 0.4  # of the rows on the plateau
NAME = "something_else"
CONTROL = (
    "No model of a controller has it. What is in the reading alone the loop will follow, so find "
    "out first whether the stage moves."
)
MAINS, CLIPPED = "mains_interference", "amplifier_saturation"
OF_LINES = ("frequency", "line_phase")
ABOVE = 1.1  # times the noise: where less is left, a limit of the amplifier explains a plateau
SURE = 0.02  # p-value of one coordinate: the least but one of 99 shifts
UNUSUAL = 0.05  # probability that a healthy stage leaves as much in one coordinate
CLEARLY = 0.9  # of the error that a cause leaves: what a curve in its place must leave
BETTER = 0.97  # of the error: what the second search must leave


@dataclass(frozen=True, kw_only=True, eq=False)
class Ended:
    """Readings that end at a level.

    curve  (samples,) of every track: the reading less where the stage was
    level  at which it ends, in half strokes from 0 of the static response
    side   1 at the top, -1 at the bottom
    """

    curve: Signals
    level: float
    side: int


def ended(clean: View, others: Sequence[SelectedEffect]) -> Ended | None:
    """Return the end of the range that the readings show best, None where they show none.

    others  effects at work that are no limit of the amplifier
    """
    found = [one for side in (1, -1) if (one := _on_side(clean, others, side)) is not None]
    return max(found, key=_power, default=None)


def _power(found: Ended) -> float:
    return float(sum(np.sum(one**2) for one in found.curve))


def _on_side(clean: View, others: Sequence[SelectedEffect], side: int) -> Ended | None:
    noise = clean.noise
    plateaus = [_plateau(track, side, noise) for track in clean.tracks]
    on = [np.zeros(len(t.place), dtype=bool) if p is None else side * t.response[t.place] > p
          for t, p in zip(clean.tracks, plateaus, strict=True)]  # fmt: skip
    count, total = sum(int(one.sum()) for one in on), sum(len(one) for one in on)
    if not 0 < count < MOST * total:
        return None
    tracks = tuple(
        replace(track, place=track.place[~there], block=track.block[~there])
        for track, there in zip(clean.tracks, on, strict=True)
    )
    view = extended(with_tracks(clean, tracks), others)
    curve, levels = [], []
    for k, (track, plateau) in enumerate(zip(clean.tracks, plateaus, strict=True)):
        where = view.static[k] + _zero(view, k)
        if plateau is None:
            curve.append(np.zeros(len(where)))
            continue
        there = side * track.response > plateau
        level = float(np.median(track.response[there]))
        own = np.where(there, side * np.minimum(side * (level - where), 0.0), 0.0)
        state = float(np.abs(own).max()) > FAR * noise  # others turned there, and rested
        curve.append(own if state else np.zeros(len(own)))
        levels += [level - _zero(view, k)] if state else []
    if not levels:
        return None
    return Ended(curve=tuple(curve), level=float(np.median(levels)), side=side)


def _plateau(track: Track, side: int, noise: float) -> float | None:
    """Return from where on readings, times their side, are on a plateau, if there may be one.

    The readings go no farther, and the drive does: where it rests, the stage does as well.
    """
    readings = side * track.response
    top = float(np.quantile(readings, 1.0 - 20.0 / max(len(readings), 200)))
    near = readings > top - WIDTH * noise
    if int(np.sum(near[track.place])) < LEAST_ROWS:
        return None
    if np.ptp(readings[near]) > 2.0 * WIDTH * noise or np.ptp(track.drive[near]) < MOVES * noise:
        return None
    return float(np.median(readings[near])) - WIDTH * noise


def _zero(view: View, k: int) -> float:
    nuisance = view.nuisance
    return float(view.null.coefficients[nuisance.shared + nuisance.own * k])


@dataclass(frozen=True, kw_only=True, eq=False)
class Rest:
    """What no name of the catalogue stands for, in scaled units.

    rms         beyond the noise, before anything without a name is taken off
    share       of the power that the causes leave
    p_value     that a healthy stage leaves as much of it in one coordinate
    coordinate  that explains most of it
    gain        part of its power that this explains, on blocks left out
    """

    rms: float
    share: float
    p_value: float
    coordinate: str
    gain: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Discovered:
    """A remainder that lives in one coordinate.

    lives   the curve and what it explains
    curve   (samples,) of every track
    share   of the remainder's power above the noise
    left    (rows,)  the remainder
    view    of which it is the remainder
    chance  that a healthy stage leaves as much in one coordinate
    end     of the sensor's range, where that is what was discovered
    """

    lives: CoordinateScore
    curve: Signals
    share: float
    left: Array
    view: View
    chance: float
    end: Ended | None = None

    @property
    def rms(self) -> float:
        """Return the rms of what it explains on blocks left out."""
        return float(np.sqrt(self.lives.gain * np.mean(self.left**2)))

    @property
    def is_unheard_of(self) -> bool:
        """Whether no healthy stage leaves as much in one coordinate."""
        return self.end is None and self.chance <= least_chance()


@dataclass(frozen=True, kw_only=True, eq=False)
class SearchResult:
    """A search, with what it has no name for taken off before.

    raw          the view of the recordings as they came
    outcome      of the search, whose first view is without what was discovered
    unexplained  what no name stands for
    discovered   None where the remainder lives nowhere
    otherwise    the same without what was discovered
    """

    raw: View
    outcome: Outcome
    unexplained: Rest
    discovered: Discovered | None = None
    otherwise: "SearchResult | None" = None


def search_all(view: View, executor: Executor) -> SearchResult:
    """Search for effects, and for structure of the residual that no effect explains."""
    first = search(view, executor)
    return with_something_else(view, first, executor)


def without_names(view: View, outcome: Outcome) -> SearchResult:
    """Locate the residual without naming effects; used where the model class is rejected."""
    lives = everywhere(Remainder.of(outcome.final, ()))
    return SearchResult(raw=view, outcome=outcome, unexplained=rest_of(outcome, lives))


def with_something_else(view: View, first: Outcome, executor: Executor) -> SearchResult:
    """Test the residual of a search for structure that no known effect explains.

    view   of the recordings as they came
    first  the search on it
    """
    executor.report("locating the unexplained residual")
    remainder = Remainder.of(first.final, tangents_of(first, first.final))
    lives = everywhere(remainder)
    plain = SearchResult(raw=view, outcome=first, unexplained=rest_of(first, lives))
    best, least = plain, BETTER * first.final.rms
    for found in _sought(remainder, lives, first):
        executor.report("searching again without this structure")
        again = search(without(view, found), executor)
        if again.final.rms < least:
            least = again.final.rms
            best = replace(plain, outcome=again, discovered=found, otherwise=plain)
    return best


def _sought(
    remainder: Remainder, lives: Sequence[CoordinateScore], first: Outcome
) -> Iterator[Discovered]:
    """Yield what a remainder may be, what stands in the place of a wrong name before the rest."""
    end = _beyond_range(first)
    if end is not None:
        yield end
    curve = _instead(first) or _named(remainder, lives, first)
    if curve is not None:
        yield curve


def without(view: View, found: Discovered) -> View:
    """Return the view of readings less a curve.

    Beyond the end of the sensor's range nothing was measured, and those rows are left out.
    """
    tracks = []
    for track, one in zip(view.tracks, found.curve, strict=True):
        kept = ~_beyond(found, one)[track.place]
        place, block = track.place[kept], track.block[kept]
        tracks.append(replace(track, response=track.response - one, place=place, block=block))
    return with_tracks(view, tracks)


def with_it(view: View, found: Discovered) -> View:
    """Return the view with a curve, and its rows, put back."""
    tracks = []
    for track, one, raw in zip(view.tracks, found.curve, found.view.tracks, strict=True):
        again = raw.place[_beyond(found, one)[raw.place]]
        place = np.union1d(track.place, again)
        block = np.interp(place, raw.place, raw.block).astype(int)
        tracks.append(replace(track, response=track.response + one, place=place, block=block))
    return with_tracks(view, tracks)


def _beyond(found: Discovered, curve: Array) -> NDArray[np.bool_]:
    return (curve != 0.0) if found.end is not None else np.zeros(len(curve), dtype=bool)


def tangents_of(outcome: Outcome, view: View, but: str = "") -> list[Array]:
    """Return the tangents of effects that were not selected, at the rows of a view."""
    return [
        seen.trial.columns
        for name, seen in outcome.screened.items()
        if name != but and len(seen.trial.columns) == len(view.response)
    ]


def _named(
    remainder: Remainder, lives: Sequence[CoordinateScore], outcome: Outcome
) -> Discovered | None:
    """Return the coordinate that surely explains more than healthy stages leave, if one does."""
    hum = MAINS in {cause.effect.name for cause in outcome.causes}
    for one in lives:
        if hum and one.coordinate in OF_LINES and of_grid(one.basis.per_unit):
            continue  # a phase that wanders, or harmonics that die out, faster than allowed for
        if one.p_value <= SURE and _chance(remainder, one) <= UNUSUAL:
            return _discovered(remainder, one)
    return None


def _chance(remainder: Remainder, lives: CoordinateScore) -> float:
    """Return the probability that a healthy stage leaves as much in one coordinate."""
    return chance_of(score_of(lives.gain, remainder.null.rms, remainder.view.noise))


def _share(remainder: Remainder, gain: float) -> float:
    """Return the part of the power above the noise."""
    power = remainder.null.rms**2
    above = _above(power, remainder.view.noise**2, gain)
    return float(np.clip(gain * power / max(above, 1e-300), 0.0, 1.0))


def _above(power: float, noise: float, gain: float) -> float:
    """Return the power above the noise, as much of which a coordinate explains is none."""
    return max(power - min(noise, (1.0 - gain) * power), 0.0)


def _discovered(remainder: Remainder, lives: CoordinateScore) -> Discovered:
    """Return the curve once more, with what tangents would have taken of it."""
    whole = Remainder.of(remainder.view, ())
    if lives.coordinate == "time":
        again = course(whole, lives)
    else:
        again = whole.lives(lives.basis, lives.p_value)
    return Discovered(
        lives=again,
        curve=tuple(again.basis.made(k, again.coefficient) for k in range(len(again.basis.place))),
        share=_share(remainder, lives.gain),
        left=whole.left,
        view=whole.view,
        chance=_chance(remainder, lives),
    )


def _beyond_range(outcome: Outcome) -> Discovered | None:
    """Return an end of the sensor's range, where more is left than the noise."""
    if outcome.final.rms < ABOVE * outcome.final.noise:
        return None
    others = [
        cause.selected
        for cause in outcome.causes
        if cause.effect.name != CLIPPED and cause.effect.structural is None
    ]
    found = ended(outcome.clean, others)
    if found is None:
        return None
    view = extended(outcome.clean, others)
    curve = view.rows(found.curve)
    left = replace(view.null, response=view.response - curve).residual + curve
    gains = _gains(curve, left)
    lives = CoordinateScore(
        basis=along_displacement(view),
        gain=float(gains[0]),
        p_value=(1.0 + float(np.sum(gains[1:] >= gains[0]))) / len(gains),
        coefficient=np.zeros(0),
        followed=curve,
    )
    share = _share(Remainder(view=view, null=replace(view.null, response=left)), lives.gain)
    chance = chance_of(score_of(lives.gain, float(np.sqrt(np.mean(left**2))), view.noise))
    if lives.p_value > SURE or chance > UNUSUAL:
        return None
    return Discovered(
        lives=replace(lives, basis=replace(lives.basis, coordinate="reading")),
        curve=found.curve,
        share=share,
        left=left,
        view=view,
        chance=chance,
        end=found,
    )


def _gains(curve: Array, left: Array) -> Array:
    """Return which part of the power a curve explains, and explains of shifts of what is left."""
    shifts = np.linspace(0, len(left), SHIFTS + 1, endpoint=False).astype(int)
    power = float(np.sum(left**2))
    return np.array([float(np.sum((2.0 * np.roll(left, s) - curve) * curve)) for s in shifts]) / (
        max(power, 1e-300)
    )


def _instead(outcome: Outcome) -> Discovered | None:
    """Return a curve that leaves clearly less in the place of a cause than the cause does."""
    best, least = None, 1.0
    for cause in outcome.causes:
        if cause.effect.structural is not None or cause.selected.from_jumps:
            continue
        tangents = tangents_of(outcome, cause.without, cause.effect.name)
        remainder = Remainder.of(cause.without, tangents)
        found = _named(remainder, everywhere(remainder), outcome)
        if found is None:
            continue
        left = remainder.null.rms * sqrt(max(1.0 - found.lives.gain, 0.0)) / cause.cv.rms
        if left < min(CLEARLY, least):
            best, least = found, left
    return best


def rest_of(outcome: Outcome, lives: Sequence[CoordinateScore]) -> Rest:
    """Return how much is left, how often healthy stages leave as much, and where it lives."""
    final = outcome.final
    known = max((one.gain for one in lives if one.p_value <= SURE), default=0.0)
    above = _above(final.rms**2, final.noise**2, min(known, 1.0))
    return Rest(
        rms=sqrt(above),
        share=above / max(final.rms**2, 1e-300),
        p_value=chance_of(score_of(lives[0].gain, final.rms, final.noise)),
        coordinate=lives[0].coordinate,
        gain=float(np.clip(lives[0].gain, 0.0, 1.0)),
    )
