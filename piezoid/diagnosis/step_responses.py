"""Step responses: resonances after jumps of the drive, at all samples.

A mode rings for some milliseconds after a jump. These are a few of thousands of rows, all in one
block, so that no mean over blocks is significant. Step responses therefore have a view of their
own, with all samples and separate blocks, beside the static response of the whole view.

Source: Ewins, Modal Testing, 2nd ed. (2000), on free decays.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from piezoid.diagnosis.nuisance import History, NuisanceClass
from piezoid.diagnosis.refinement import SelectedEffect
from piezoid.diagnosis.residual_view import View, with_tracks
from piezoid.diagnosis.segments import BLOCKS
from piezoid.identification.extensions.linear_mode import LinearMode, rows_after_steps
from piezoid.numerics.arrays import Array
from piezoid.numerics.executor import Once

MAX_SAMPLES = 300  # of a step response
MIN_SAMPLES = 100
JUMP_SAMPLES = 3  # longest duration of a jump
SETTLING_SAMPLES = 6  # until amplifier and converter have settled
MIN_JUMP = 0.1  # of half the range
MAX_MOTION = 0.05  # of the jump: largest motion of the drive after it in the same time
DEGREE = 4  # of trends
Span = tuple[int, int]  # first sample, end


@dataclass(frozen=True, kw_only=True, eq=False)
class Trend(NuisanceClass):
    """Nuisance class of step responses: a smooth trend for each, beside a fixed static response.

        sum_n p_n P_n(2 sqrt(t / T) - 1)

    P_n Legendre polynomials; the square root represents the steep beginning of creep.
    """

    @Once
    def shared(self) -> int:
        """Number of columns shared by all tracks: none."""
        return 0

    @Once
    def columns(self) -> Array:
        """Return separate polynomial trends for each span of rows, (rows, columns)."""
        rows = np.concatenate([track.rows for track in self.tracks])
        stops = [*(np.flatnonzero(np.diff(rows) != 1) + 1).tolist(), len(rows)]
        columns = np.zeros((len(rows), len(stops) * (DEGREE + 1)), order="F")
        for k, (first, stop) in enumerate(pairwise([0, *stops])):
            position = 2.0 * np.sqrt(np.arange(stop - first) / (stop - first)) - 1.0
            polynomials = np.polynomial.legendre.legvander(position, DEGREE)
            columns[first:stop, k * (DEGREE + 1) : (k + 1) * (DEGREE + 1)] = polynomials
        return columns


def step_response_view(view: View) -> View | None:
    """Return the view of the step responses with fixed static responses; None without jumps.

    All samples of the spans after jumps are rows, and each span has its own blocks.
    """
    histories, static = [], []
    for k, track in enumerate(view.tracks):
        spans = [np.arange(first, stop) for first, stop in _spans_after_jumps(track.drive)]
        if not spans:
            continue
        blocks = [(span - span[0]) * BLOCKS // MAX_SAMPLES for span in spans]
        responses = replace(track, rows=np.concatenate(spans), block=np.concatenate(blocks))
        histories.append(History(track=responses, reversals=view.nuisance.reversals[k]))
        static.append(view.static[k])
    if not histories:
        return None
    trends = replace(view, nuisance=Trend(histories=tuple(histories)))
    with_trends = with_tracks(trends, [history.track for history in histories])
    return replace(with_trends, static_override=tuple(static))


def without_unresolved_ringing(view: View, selected: Sequence[SelectedEffect]) -> View:
    """Return the view without rows after steps at which the samples do not resolve the ringing."""
    parameters = [effect.parameters for effect in selected if effect.effect.may_be_absorbed]
    modes = [LinearMode(frequency_Hz=p["frequency_Hz"], quality=p["quality"]) for p in parameters]
    tracks = []
    for track in view.tracks:
        unresolved = rows_after_steps(track.command, track.rate_Hz, modes)
        is_resolved = ~np.isin(track.rows, unresolved)
        if is_resolved.any() and not is_resolved.all():
            block = np.unique(track.block[is_resolved], return_inverse=True)[1]
            tracks.append(replace(track, rows=track.rows[is_resolved], block=block))
        else:
            tracks.append(track)
    if all(new is old for new, old in zip(tracks, view.tracks, strict=True)):
        return view
    return with_tracks(view, tracks)


def _spans_after_jumps(drive: Array) -> list[Span]:
    """Return the spans of samples after jumps in which the drive hardly moves."""
    change = np.abs(drive[JUMP_SAMPLES:] - drive[:-JUMP_SAMPLES])
    is_jump = np.concatenate([[False], change >= MIN_JUMP, [False]])
    starts, stops = (np.flatnonzero(np.diff(is_jump.astype(int)) == sign) for sign in (1, -1))
    next_starts = np.append(starts[1:], len(change))[: len(starts)]
    spans = []
    for jump, end, next_jump in zip(
        starts.tolist(), stops.tolist(), next_starts.tolist(), strict=True
    ):
        first = end + SETTLING_SAMPLES
        stop = min(first + MAX_SAMPLES, next_jump)
        if end - jump > 2 * JUMP_SAMPLES or stop - first < MIN_SAMPLES:
            continue
        if change[end:stop].max() < MAX_MOTION * change[jump:end].max():
            spans.append((first, stop))
    return spans
