"""Slips in the place of a delay, a lag, or what nothing else explains.

A slip in the fast half of a chirp looks like a delay of all of the chirp: nothing slow can tell.
So slips are tried once more against what was found instead. Each must leave no more of its track
than a delay of the track's own with lags and relaxations beside it could,

    rms_k(slips) <= A rms_k(nuisance class, all that looks like a delay),

and together they must leave less, block by block, than the cause that stands there.

Source: Vuong, Econometrica 57 (1989).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from piezoid.diagnosis.blocks import paired_z
from piezoid.diagnosis.effect import Fault
from piezoid.diagnosis.extended import SelectedEffect, extended
from piezoid.diagnosis.folds import Null
from piezoid.diagnosis.slip_placing import placed, tracks_without
from piezoid.diagnosis.slips import Slip, beside, late, places_of, strongest
from piezoid.diagnosis.tracks import Track
from piezoid.diagnosis.view import View, with_tracks
from piezoid.numerics.arrays import Array

ENOUGH = 1.1  # times what all that looks like a delay leaves of the track
TAKES = 0.3  # of the track's squared residual: what a slip must take to be tried
WHOLE = 0.4  # how far beta may be from one
ROUNDED = 12.0**-0.5  # samples: the spread of what is a whole number
ALONE = 0.75  # of the error: what slips must leave where nothing else speaks
ALONE_AGAIN = 0.97  # the same where a clock has slipped elsewhere
SURE = 3.0  # standard errors by which slips must be better than a cause
SURE_AGAIN = 1.2  # the same where a clock has slipped elsewhere, or where slips leave so much
LESS = 0.9  # less than the cause, of the error; then below SEPARABLE it is said
CHANCE = 5e-4  # of one block alone, a transient at its beginning say, much may come by chance
SEPARABLE = 1.96  # standard errors between two that are told apart


@dataclass(frozen=True, kw_only=True, eq=False)
class SlipAlternative:
    """Slips that stand better than what stood there.

    clean  the tracks with these put back in step
    view   the same with what was selected at work
    fault  what they are
    """

    clean: View
    view: View
    fault: Fault


def slips_in_place(
    clean: View, selected: Sequence[SelectedEffect], without: View
) -> SlipAlternative | None:
    """Return the slips that follow the tracks as well as all that looks like a delay would.

    without  the view with everything selected
    """
    null = beside(without)
    could = _rms_of_tracks(without, null)
    found: dict[int, Slip] = {}
    best = clean, without
    for slip in strongest(without, without.null):
        if slip.gain < TAKES:
            break
        there = _put_right(best, selected, slip)
        if there is not None and there[1].rms < best[1].rms:
            found[slip.track], best = there[2], there[:2]
    kept = {k: s for k, s in found.items() if _follows(best[1], k, could[k])}
    if not kept:
        return None
    if len(kept) < len(found):
        repaired = with_tracks(clean, tracks_without(clean, *kept.values()))
        best = repaired, extended(repaired, selected)
    return SlipAlternative(
        clean=best[0], view=best[1], fault=_fault(without, list(kept.values()), best[0])
    )


def slips_fit_better(
    instead: SlipAlternative, without: View, cause: View | None, known: Fault | None = None
) -> bool:
    """Tell whether slips explain more than a cause, or much where none speaks.

    cause  the view with the best cause at work
    known  what slipped elsewhere: where it was by as many samples, one clock is simpler than a
           clock and a delay of just so many
    """
    if cause is None:
        much = instead.view.rms < (ALONE_AGAIN if known else ALONE) * without.rms
        return much and instead.fault.p_value < CHANCE
    clear = _clear(instead, cause)
    least = SURE_AGAIN if known or instead.view.rms < LESS * cause.rms else SURE
    same = known is not None and abs(known.value) == abs(instead.fault.value)
    return instead.view.rms < cause.rms and (same or clear > least)


def fault_beside_cause(instead: SlipAlternative, name: str, cause: View) -> Fault:
    """Return the slips as a fault that says where a cause explains nearly as much.

    name   of the cause that stood there
    cause  the view with it at work
    """
    alike = (name,) if _clear(instead, cause) < SEPARABLE else ()
    return replace(instead.fault, alike=alike)


def _clear(instead: SlipAlternative, cause: View) -> float:
    """Return by how many standard errors blocks lose less with slips than with a cause."""
    there, here = _of_blocks(cause.null), _of_blocks(instead.view.null)
    both = sorted(there.keys() & here.keys())
    return paired_z(np.array([there[b] for b in both]), np.array([here[b] for b in both]))


def _put_right(
    before: tuple[View, View], selected: Sequence[SelectedEffect], slip: Slip
) -> tuple[View, View, Slip] | None:
    """Return the tracks with a slip put right, the view of it, the slip where it is."""
    clean, view = before

    def again(tracks: Sequence[Track]) -> View:
        return extended(with_tracks(clean, tracks), selected)

    there = placed(view, slip, again=again)
    if abs(slip.samples / there.samples - 1.0) > WHOLE:
        return None
    repaired = with_tracks(clean, tracks_without(clean, there))
    return repaired, extended(repaired, selected), there


def _follows(view: View, k: int, could: float) -> bool:
    return _rms_of_tracks(view, view.null)[k] < ENOUGH * could


def _rms_of_tracks(view: View, null: Null) -> list[float]:
    edges = view.nuisance.edges
    parts = [null.residual[a:b] for a, b in pairwise(edges)]
    return [float(np.sqrt(np.mean(part**2))) for part in parts]


def _of_blocks(null: Null) -> dict[int, float]:
    return {int(b): float(e) for b, e in zip(null.block[null.edges], null.energy, strict=True)}


def _fault(without: View, slips: Sequence[Slip], clean: View) -> Fault:
    first = max(slips, key=lambda slip: slip.gain)
    column = _column(without, first)
    spread = abs(first.samples) * float(np.sqrt(without.null.doubt(column[:, None])[0, 0]))
    return Fault(
        tracks=clean.tracks,
        value=first.samples,
        spread=float(np.hypot(spread, ROUNDED)),
        p_value=without.null.cross_validated(column[:, None]).p_value,
        where=places_of(slips, without.tracks),
    )


def _column(view: View, slip: Slip) -> Array:
    place = view.tracks[slip.track].place
    change = late(view.static[slip.track], place, int(slip.samples))
    return view.of_track(slip.track, np.where(place >= slip.instant, change, 0.0))
