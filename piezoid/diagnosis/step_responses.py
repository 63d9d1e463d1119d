"""Step responses: resonances after jumps of the drive, at all samples.

A mode that a jump has struck rings for some milliseconds: a few of thousands of rows, all in one
block, of which no mean over blocks is ever sure. So what follows jumps is looked at by itself,
with blocks of its own, beside static responses that are known from all the rest.

Source: Ewins, Modal Testing, 2nd ed. (2000), on free decays.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from piezoid.diagnosis.candidate import evaluate
from piezoid.diagnosis.drive_history import History
from piezoid.diagnosis.effect import Effect, Parameters, Trial
from piezoid.diagnosis.effects import every_effect
from piezoid.diagnosis.nuisance import NuisanceClass
from piezoid.diagnosis.refinement import initial_guess, refine
from piezoid.diagnosis.refitted_view import SelectedEffect
from piezoid.diagnosis.residual_view import View, with_tracks
from piezoid.diagnosis.score_test import score_test
from piezoid.diagnosis.segments import BLOCKS, Track
from piezoid.identification.extensions.linear_mode import LinearMode
from piezoid.identification.step_rows import rows_after_steps
from piezoid.numerics.arrays import Array
from piezoid.numerics.executor import Once

STRETCH = 300  # samples behind a jump
FEWEST = 100  # of them
WITHIN = 3  # samples for all of a jump
SETTLED = 6  # samples until amplifier and converter have followed
JUMP = 0.1  # of half the range
CALM = 0.05  # of a jump: largest motion of the drive after it in the same time
DEGREE = 4  # of trends
Stretch = tuple[int, int]


@dataclass(frozen=True, kw_only=True, eq=False)
class Trend(NuisanceClass):
    """Replace the hysteresis by smooth trends when its parameters are already known.

    sum_n p_n P_n(2 sqrt(t / T) - 1),  P_n Legendre's polynomials: creep begins steeply
    """

    @Once
    def shared(self) -> int:
        """Number of columns shared by all tracks: none."""
        return 0

    @Once
    def columns(self) -> Array:
        """Return separate polynomial trends for each stretch of rows, (rows, columns)."""
        rows = np.concatenate([track.rows for track in self.tracks])
        stops = [*(np.flatnonzero(np.diff(rows) != 1) + 1).tolist(), len(rows)]
        columns = np.zeros((len(rows), len(stops) * (DEGREE + 1)), order="F")
        for k, (first, stop) in enumerate(pairwise([0, *stops])):
            position = 2.0 * np.sqrt(np.arange(stop - first) / (stop - first)) - 1.0
            columns_of_segment = slice(k * (DEGREE + 1), (k + 1) * (DEGREE + 1))
            columns[first:stop, columns_of_segment] = np.polynomial.legendre.legvander(
                position, DEGREE
            )
        return columns


def modes_behind_jumps(view: View) -> tuple[SelectedEffect, ...]:
    """Return the resonances that are significant in step responses."""
    scope = behind_jumps(view)
    if scope is None:
        return ()
    modes = [
        _struck(in_any_phase(effect), scope) for effect in every_effect() if effect.may_be_absorbed
    ]
    return tuple(mode for mode in modes if mode is not None)


def in_any_phase(effect: Effect) -> Effect:
    """Return the effect with its columns and the same columns delayed by one sample.

    A jump lies between two samples, so its response is delayed by a fraction of a sample: a
    weighted sum of the two.
    """
    assert effect.trials is not None
    assert effect.columns is not None
    trials, columns = effect.trials, effect.columns

    def two_phases(view: View, parameters: Parameters) -> Array:
        return np.hstack([columns(view, parameters), columns(_earlier(view), parameters)])

    def either(view: View) -> list[Trial]:
        return [
            replace(
                trial,
                columns=two_phases(view, trial.parameters),
                coefficient_range=(-np.inf, np.inf),
            )
            for trial in trials(view)
        ]

    return replace(effect, trials=either, columns=two_phases)


def _earlier(view: View) -> View:
    tracks = [replace(track, rows=np.maximum(track.rows - 1, 0)) for track in view.tracks]
    return replace(with_tracks(view, tracks), guess=view.static)


def behind_jumps(view: View) -> View | None:
    """Return the view of the step responses with fixed static responses; None without jumps."""
    by_track = {k: _stretches(track.drive) for k, track in enumerate(view.tracks)}
    tracks_with_jumps = [k for k, stretches in by_track.items() if stretches]
    if not tracks_with_jumps:
        return None
    tracks = [_only(view.tracks[k], by_track[k]) for k in tracks_with_jumps]
    reversals = [view.nuisance.reversals[k] for k in tracks_with_jumps]
    histories = [History(track=t, reversals=p) for t, p in zip(tracks, reversals, strict=True)]
    trend = Trend(histories=tuple(histories))
    static = tuple(view.static[k] for k in tracks_with_jumps)
    return replace(with_tracks(replace(view, nuisance=trend), tracks), guess=static)


def without_unresolved_ringing(view: View, selected: Sequence[SelectedEffect]) -> View:
    """Return the view without rows behind steps where a mode rings that no sample resolves."""
    numbers = [effect.parameters for effect in selected if effect.effect.may_be_absorbed]
    modes = [LinearMode(frequency_Hz=p["frequency_Hz"], quality=p["quality"]) for p in numbers]
    tracks = [_resolved(track, modes) for track in view.tracks]
    if all(len(new.rows) == len(old.rows) for new, old in zip(tracks, view.tracks, strict=True)):
        return view
    return with_tracks(view, tracks)


def _resolved(track: Track, modes: Sequence[LinearMode]) -> Track:
    kept = ~np.isin(track.rows, rows_after_steps(track.command, track.rate_Hz, modes))
    if kept.all() or not kept.any():
        return track
    block = np.unique(track.block[kept], return_inverse=True)[1]
    return replace(track, rows=track.rows[kept], block=block)


def _stretches(drive: Array) -> list[Stretch]:
    """Return the stretches (first sample, end) after jumps that are followed by a calm drive."""
    change = np.abs(drive[WITHIN:] - drive[:-WITHIN])
    fast = np.concatenate([[False], change >= JUMP, [False]])
    starts, stops = (np.flatnonzero(np.diff(fast.astype(int)) == sign) for sign in (1, -1))
    following = np.append(starts[1:], len(change))[: len(starts)]
    stretches = []
    for begin, end, next_one in zip(
        *(a.tolist() for a in (starts, stops, following)), strict=True
    ):
        first = end + SETTLED
        stop = min(first + STRETCH, next_one)
        if end - begin > 2 * WITHIN or stop - first < FEWEST:
            continue
        if change[end:stop].max() < CALM * change[begin:end].max():
            stretches.append((first, stop))
    return stretches


def _only(track: Track, stretches: Sequence[Stretch]) -> Track:
    rows = [np.arange(first, last) for first, last in stretches]
    block = [(p - p[0]) * BLOCKS // STRETCH for p in rows]
    return replace(track, rows=np.concatenate(rows), block=np.concatenate(block))


def _struck(effect: Effect, scope: View) -> SelectedEffect | None:
    test = None if effect.untestable(scope) else score_test(effect, scope)
    if test is None or not test.physical:
        return None
    guess = initial_guess(effect, test.trial, float(test.cv.coefficient[0]))
    refined, view = refine(guess, scope, [])
    candidate = evaluate(refined, view, scope, test=test)
    return replace(refined, from_jumps=True) if candidate.is_significant else None
