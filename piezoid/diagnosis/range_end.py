"""A reading that ends before the motion does: told by what the rest of the readings foretells.

    y = min(x, L)   or   y = max(x, L)

A limit of the amplifier makes a plateau as well, but the stage leaves it at the drive at which it
came, and a sensor's at another one: the loop is open there. So the readings on the plateau are
left out, hysteresis is fitted to the others, and says where the stage was meanwhile.

Source: Tobin (1958) on readings that are censored.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.diagnosis.coordinates import Signals
from piezoid.diagnosis.extended import SelectedEffect, extended
from piezoid.diagnosis.tracks import Track
from piezoid.diagnosis.view import View, with_tracks

WIDTH = 5.0  # times the noise: how far readings of one plateau differ from its middle
LEAST_ROWS = 20  # on it, of one recording
FAR = 8.0  # times the noise: how far beyond it the stage must have gone
MOVES = 20.0  # times the noise: how far the drive moves over it; at a turn it moves 2 * WIDTH
MOST = 0.4  # of the rows on the plateau


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
