"""Slips in the place of a delay or a lag, where the clock has slipped elsewhere.

A slip in the fast half of a chirp looks like a delay of all of the chirp: nothing slow can tell.
Where a clock is known to slip, slips by as many samples are a simpler tale than a delay beside
them. Each must leave no more of its track than a delay of the track's own with lags and
relaxations beside it could,

    rms_k(slips) <= A rms_k(nuisance class, all that looks like a delay),

and together they must leave less than the filter that stands there.
"""

from collections.abc import Sequence
from functools import partial
from itertools import pairwise

import numpy as np

from piezoid.diagnosis.effect import Fault
from piezoid.diagnosis.extended import SelectedEffect, extended
from piezoid.diagnosis.folds import Null
from piezoid.diagnosis.slips import Slip, beside, late, placed, places_of, strongest, undone
from piezoid.diagnosis.tracks import Track
from piezoid.diagnosis.view import View, with_tracks

ENOUGH = 1.1  # times what all that looks like a delay leaves of the track
TAKES = 0.3  # of the track's squared residual: what a slip must take to be tried
ROUNDED = 12.0**-0.5  # samples: the spread of what is a whole number


def slips_in_place(
    clean: View, others: Sequence[SelectedEffect], cause: View, known: Fault
) -> tuple[View, Fault] | None:
    """Return tracks put back in step and the slips as a fault; None where the filter stands.

    others  what was selected but the filter
    cause   the view with the filter at work
    known   what slipped elsewhere
    """
    without = extended(clean, others)
    could = _rms_of_tracks(without, beside(without))
    there = clean
    found: list[Slip] = []
    for slip in strongest(without, without.null):
        if slip.gain < TAKES:
            break
        view = extended(there, others)
        one = placed(view, slip, again=partial(_again, there, others))
        better = undone(there, one)
        after = extended(better, others)
        follows = _rms_of_tracks(after, after.null)[slip.track] < ENOUGH * could[slip.track]
        if follows and after.rms < view.rms:
            there, found = better, [*found, one]
    if not found or extended(there, others).rms >= cause.rms:
        return None
    first = max(found, key=lambda slip: slip.gain)
    if abs(first.samples) != abs(known.value):
        return None
    return there, _fault(without, found, first, there)


def _again(clean: View, others: Sequence[SelectedEffect], tracks: Sequence[Track]) -> View:
    return extended(with_tracks(clean, tracks), others)


def _rms_of_tracks(view: View, null: Null) -> list[float]:
    parts = [null.residual[a:b] for a, b in pairwise(view.nuisance.edges)]
    return [float(np.sqrt(np.mean(part**2))) for part in parts]


def _fault(without: View, slips: Sequence[Slip], first: Slip, there: View) -> Fault:
    place = without.tracks[first.track].place
    change = late(without.static[first.track], place, int(first.samples))
    column = without.of_track(first.track, np.where(place >= first.instant, change, 0.0))[:, None]
    spread = abs(first.samples) * float(np.sqrt(without.null.doubt(column)[0, 0]))
    return Fault(
        tracks=there.tracks,
        value=first.samples,
        spread=float(np.hypot(spread, ROUNDED)),
        p_value=without.null.cross_validated(column).p_value,
        where=places_of(slips, without.tracks),
    )
