"""Timestamp fault: the reader of the sensor loses step with the drive.

What you see
    From one instant on the displacement comes early or late by a fixed number of samples.
Why it happens
    A buffer overran and readings are gone, or the reader stalled and repeated its last value.
How it is detected
    A delay that begins at one instant takes a good part of a recording's error, beside a constant
    delay, lags, creep and all that grows with speed; and among stretches of equal speed it is one
    number before the instant and another behind it.
What the extension adds
    Nothing: the readings are put back in step and the rows in between are left out.
Source
    what acquisition programs do when the disk is busy
"""

from dataclasses import replace

import numpy as np

from piezoid.diagnosis.effect import Effect, Fault
from piezoid.diagnosis.effects.outliers import without_spikes
from piezoid.diagnosis.signals import with_displacement
from piezoid.diagnosis.slip_evidence import Judged, hidden, judged_of
from piezoid.diagnosis.slips import INSTANTS, Slip, beside, late, strongest
from piezoid.diagnosis.tracks import Track
from piezoid.diagnosis.view import View, with_tracks
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Recording

MOST = 8  # slips
ROUNDS = 4  # of placing one and fitting the static response again
LOOK = 0.05  # of a track's squared residual, to look closer


def _fault(view: View) -> Fault | None:
    # spikes are another fault; here they would only hide a small slip
    quiet = [without_spikes(t, s) for t, s in zip(view.tracks, view.static, strict=True)]
    calm = (
        view
        if all(a is b for a, b in zip(quiet, view.tracks, strict=True))
        else with_tracks(view, quiet)
    )
    found: list[Judged] = []
    while len(found) < MOST:
        judged = _next(calm, bool(found))
        if judged is None:
            break
        better = _repaired(calm, judged.slip)
        # one that is none takes its share of the tangent's error, and makes the true one larger
        if better.rms >= calm.rms:
            break
        found.append(judged)
        calm = better
    if not found:
        return None
    tracks = list(view.tracks)
    for one in found:
        tracks[one.slip.track] = _in_step(tracks[one.slip.track], one.slip)
    # what was placed too long or too short while others were in the way is put right later
    same = [one for one in found if _near(one.slip, found[0].slip, view)]
    last = same[-1]
    return Fault(
        tracks=tuple(tracks),
        value=sum(one.slip.samples for one in same),
        spread=float(np.hypot(last.deviation, last.step - last.slip.samples)),
        p_value=min(one.p_value for one in found),
    )


def _near(one: Slip, other: Slip, view: View) -> bool:
    """Tell whether two slips are one, found in two goes."""
    width = _width(len(view.tracks[other.track].drive))
    return one.track == other.track and abs(one.instant - other.instant) <= width


def _width(samples: int) -> int:
    """Return how far from where it was found the instant of a slip may be."""
    return int(2.5 * samples / INSTANTS) + 2


def _next(view: View, again: bool) -> Judged | None:
    """Return the clearest slip that is left."""
    null = beside(view)
    for slip in strongest(view, null):
        if slip.gain < LOOK:
            break
        judged = judged_of(view, null, _placed(view, slip))
        if judged is not None and abs(judged.step - judged.slip.samples) > 2.0 * judged.deviation:
            # fitted in the midst of other slips: stretches of equal speed know the length better
            length = round(judged.step) or int(np.sign(slip.samples))
            judged = judged_of(
                view, null, _placed(view, replace(slip, samples=length), fixed=True)
            )
        if judged is not None and judged.speaks(again=again):
            return judged
    return None


def _placed(view: View, slip: Slip, *, fixed: bool = False) -> Slip:
    """Return the slip at the sample and of the whole length that fit best, all samples compared.

    fixed  the length is known, the instant is not

    The static response is fitted again with the slip undone; what tracks have of their own (zero,
    memory) is carried from rows to all samples.
    """
    k, samples = slip.track, round(slip.samples) or int(np.sign(slip.samples))
    slip = replace(slip, samples=samples)
    width = _width(len(view.tracks[k].drive))
    for _ in range(ROUNDS):
        again = _repaired(view, slip)
        track, static = again.tracks[k], again.static[k]
        here = again.null.residual[slice(*again.envelope.edges[k : k + 2])]
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
    place = np.arange(n)
    first, last = max(slip.instant - width, 2), min(slip.instant + width, n - 2)
    before = np.concatenate([[0.0], np.cumsum((measured - static) ** 2)])
    best = (np.inf, slip)
    for length in range(samples - reach, samples + reach + 1):
        if length == 0:
            continue
        missed = measured - static - late(static, place, length)
        total = before[first:last] + np.cumsum((missed**2)[::-1])[::-1][first:last]
        j = int(np.argmin(total))
        if total[j] < best[0]:
            best = (float(total[j]), replace(slip, instant=first + j, samples=length))
    return best[1]


def _repaired(view: View, slip: Slip) -> View:
    tracks = list(view.tracks)
    tracks[slip.track] = _in_step(tracks[slip.track], slip)
    return with_tracks(view, tracks)


def _in_step(track: Track, slip: Slip) -> Track:
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
    rivals=("delay",),
    fault=_fault,
    bound=hidden,
    shows_at=1.2e-2,
    inject=inject,
)
