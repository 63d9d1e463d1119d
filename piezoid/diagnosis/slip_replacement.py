"""Replace a selected filter by sample slips where these explain more.

A slip in the fast half of a chirp resembles a delay of the whole chirp: slow motion shows neither.
Where a clock is known to slip, slips by as many samples elsewhere are a simpler explanation than a
delay beside them. Each slip must leave an error of its track near that of everything that
resembles a delay, with separate coefficients,

    rms_k(slips) <= MAX_EXCESS rms_k(nuisance class, all that resembles a delay),

and together they must leave a smaller error than the filter.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np

from piezoid.diagnosis.blocked_regression import Null
from piezoid.diagnosis.effect import Fault
from piezoid.diagnosis.refitted_view import SelectedEffect, with_effects
from piezoid.diagnosis.residual_view import View, with_tracks
from piezoid.diagnosis.sample_slips import (
    Slip,
    delay_change,
    delay_like_null,
    refine_slip,
    slip_places,
    strongest_slips,
    undo_slip,
)
from piezoid.diagnosis.segments import Track

MAX_EXCESS = 1.1  # times the error of everything that resembles a delay, in the track
MIN_GAIN = 0.3  # of the track's squared residual, for a slip that is tried
ROUNDING = 12.0**-0.5  # samples: standard deviation of an integer


def replace_filter_by_slips(
    clean: View, others: Sequence[SelectedEffect], with_filter: View, fault: Fault
) -> tuple[View, Fault] | None:
    """Return the view with slips undone and these as a fault; None if the filter explains more.

    others       selected effects without the filter
    with_filter  the view with the filter in the model
    fault        slips that were found before
    """
    without = with_effects(clean, others)
    smallest_rms = _rms_of_tracks(without, delay_like_null(without))
    repaired = clean
    slips: list[Slip] = []
    for candidate in strongest_slips(without, without.null):
        if candidate.gain < MIN_GAIN:
            break
        view = with_effects(repaired, others)
        slip = refine_slip(view, candidate, refit=partial(_refit, repaired, others))
        trial = undo_slip(repaired, slip)
        after = with_effects(trial, others)
        limit = MAX_EXCESS * smallest_rms[slip.track]
        if _rms_of_tracks(after, after.null)[slip.track] < limit and after.rms < view.rms:
            repaired, slips = trial, [*slips, slip]
    if not slips or with_effects(repaired, others).rms >= with_filter.rms:
        return None
    strongest = max(slips, key=lambda slip: slip.gain)
    if abs(strongest.samples) != abs(fault.value):
        return None
    return repaired, _as_fault(without, repaired, slips, strongest)


def _as_fault(without: View, repaired: View, slips: Sequence[Slip], strongest: Slip) -> Fault:
    place, samples = without.tracks[strongest.track].place, int(strongest.samples)
    change = delay_change(without.static[strongest.track], place, samples)
    after = np.where(place >= strongest.instant, change, 0.0)
    column = without.of_track(strongest.track, after)[:, None]
    std = abs(samples) * float(np.sqrt(without.null.clustered_covariance(column)[0, 0]))
    return Fault(
        tracks=repaired.tracks,
        value=strongest.samples,
        spread=float(np.hypot(std, ROUNDING)),
        p_value=without.null.cross_validated(column).p_value,
        where=slip_places(slips, without.tracks),
    )


def _refit(clean: View, others: Sequence[SelectedEffect], tracks: Sequence[Track]) -> View:
    return with_effects(with_tracks(clean, tracks), others)


def _rms_of_tracks(view: View, null: Null) -> list[float]:
    return [
        float(np.sqrt(np.mean(null.residual[view.track_rows(k)] ** 2)))
        for k in range(len(view.tracks))
    ]
