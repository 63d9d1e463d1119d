"""Where a slip is and how long, to the sample; and its readings put back in step."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from piezoid.diagnosis.slips import INSTANTS, Slip, late, longest
from piezoid.diagnosis.tracks import Track
from piezoid.diagnosis.view import View, with_tracks
from piezoid.numerics.arrays import Array

ROUNDS = 4  # of placing one and fitting the static response again


def width_of(samples: int) -> int:
    """Return how far from where it was found the instant of a slip may be."""
    return int(2.5 * samples / INSTANTS) + 2


Fitted = Callable[[Sequence[Track]], View]


def placed(view: View, slip: Slip, *, again: Fitted | None = None, fixed: bool = False) -> Slip:
    """Return the slip at the sample and of the whole length that fit best, all samples compared.

    again  fits tracks put right as the view was fitted, where effects are at work in it
    fixed  the length is known, the instant is not

    The static response is fitted again with the slip undone; what tracks have of their own (zero,
    memory) is carried from rows to all samples.
    """
    k, samples = slip.track, round(slip.samples) or int(np.sign(slip.samples))
    slip = replace(slip, samples=samples)
    width = width_of(len(view.tracks[k].drive))
    for _ in range(ROUNDS):
        there = again(tracks_without(view, slip)) if again else undone(view, slip)
        track, static = there.tracks[k], there.static[k]
        here = there.null.residual[slice(*there.nuisance.edges[k : k + 2])]
        own = track.response[track.place] - here - static[track.place]
        place = np.arange(len(static))
        measured = view.tracks[k].response - np.interp(place, track.place, own)
        better = _best(measured, static, slip, width, 0 if fixed else max(2, abs(samples) // 6))
        if better == slip:
            break
        slip = better
    return slip


def _best(measured: Array, static: Array, slip: Slip, width: int, reach: int) -> Slip:
    """Return the neighbour in place, and in length up to a reach, that leaves least squares."""
    n, samples = len(static), int(slip.samples)
    shortest, farthest = max(samples - reach, -longest(n)), min(samples + reach, longest(n))
    place = np.arange(n)
    first, last = max(slip.instant - width, 2), min(slip.instant + width, n - 2)
    before = np.concatenate([[0.0], np.cumsum((measured - static) ** 2)])
    best = (np.inf, slip)
    for length in range(shortest, farthest + 1):
        if length == 0:
            continue
        missed = measured - static - late(static, place, length)
        total = before[first:last] + np.cumsum((missed**2)[::-1])[::-1][first:last]
        j = int(np.argmin(total))
        if total[j] < best[0]:
            best = (float(total[j]), replace(slip, instant=first + j, samples=length))
    return best[1]


def undone(view: View, slip: Slip) -> View:
    """Return the view of tracks in which a slip is put back in step."""
    return with_tracks(view, tracks_without(view, slip))


def tracks_without(view: View, *slips: Slip) -> list[Track]:
    """Return the tracks with slips put back in step."""
    tracks = list(view.tracks)
    for slip in slips:
        tracks[slip.track] = in_step(tracks[slip.track], slip)
    return tracks


def in_step(track: Track, slip: Slip) -> Track:
    """Put the readings behind an instant back in step; rows that have no reading are left out."""
    samples, count = int(slip.samples), len(track.response)
    place = np.arange(count)
    source = np.where(place >= slip.instant, np.clip(place + samples, 0, count - 1), place)
    reach = 2 + max(-samples, 0)
    lost = (track.place > slip.instant - 3) & (track.place < slip.instant + reach)
    kept = ~lost & (track.place + max(samples, 0) < count)
    return replace(
        track,
        response=track.response[source],
        place=track.place[kept],
        block=track.block[kept],
    )
