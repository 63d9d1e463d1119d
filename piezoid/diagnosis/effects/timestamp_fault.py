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

from piezoid.diagnosis.appearance import OVER_TIME
from piezoid.diagnosis.effect import Effect, Fault
from piezoid.diagnosis.effects.outliers import without_spikes
from piezoid.diagnosis.signals import with_displacement
from piezoid.diagnosis.slip_evidence import SlipEvidence, evidence_of, hidden
from piezoid.diagnosis.slips import (
    Slip,
    beside,
    in_step,
    longest,
    placed,
    places_of,
    strongest,
    undone,
    width_of,
)
from piezoid.diagnosis.view import View, with_tracks
from piezoid.records.recording import Recording

MOST = 8  # slips
CLEAR = 0.6  # of a track's squared residual: so much a slip takes that is clear by itself
KEPT = 0.6  # of what the tangent promised
LOOK = 0.05  # of a track's squared residual, to look closer


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
    fault=_fault,
    bound=hidden,
    detectable_share=1.2e-2,
    inject=inject,
)
