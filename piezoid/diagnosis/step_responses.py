"""Jumps: what follows a jump of the drive, seen at every sample.

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
from piezoid.numerics.arrays import Array
from piezoid.numerics.executor import Once

STRETCH = 300  # samples behind a jump
FEWEST = 100  # of them
WITHIN = 3  # samples for all of a jump
SETTLED = 6  # samples until amplifier and converter have followed
JUMP = 0.1  # of half the range
CALM = 0.05  # of a jump: what the drive may move as fast behind it
DEGREE = 4  # of trends
Stretch = tuple[int, int]


@dataclass(frozen=True, kw_only=True, eq=False)
class Trend(NuisanceClass):
    """Smooth trends of stretches in the place of hysteresis, which is known from elsewhere.

    sum_n p_n P_n(2 sqrt(t / T) - 1),  P_n Legendre's polynomials: creep begins steeply
    """

    @Once
    def shared(self) -> int:
        """Return how many columns all tracks share: none."""
        return 0

    @Once
    def columns(self) -> Array:
        """Return trends of their own for all stretches, at all rows."""
        place = np.concatenate([track.place for track in self.tracks])
        ends = [*(np.flatnonzero(np.diff(place) != 1) + 1).tolist(), len(place)]
        columns = np.zeros((len(place), len(ends) * (DEGREE + 1)), order="F")
        for k, (first, last) in enumerate(pairwise([0, *ends])):
            way = 2.0 * np.sqrt(np.arange(last - first) / (last - first)) - 1.0
            own = slice(k * (DEGREE + 1), (k + 1) * (DEGREE + 1))
            columns[first:last, own] = np.polynomial.legendre.legvander(way, DEGREE)
        return columns


def modes_behind_jumps(view: View) -> tuple[SelectedEffect, ...]:
    """Return the modes that jumps of the drive have struck beyond doubt."""
    scope = behind_jumps(view)
    if scope is None:
        return ()
    found = [
        _struck(in_any_phase(effect), scope) for effect in every_effect() if effect.may_be_absorbed
    ]
    return tuple(one for one in found if one is not None)


def in_any_phase(effect: Effect) -> Effect:
    """Return the effect with its columns as they are and a sample later.

    A jump lies between two samples, and may reach the stage by any part of one later: what is
    added then is a sum of the two.
    """
    assert effect.trials is not None
    assert effect.columns is not None
    trials, columns = effect.trials, effect.columns

    def both(view: View, parameters: Parameters) -> Array:
        return np.hstack([columns(view, parameters), columns(_earlier(view), parameters)])

    def either(view: View) -> list[Trial]:
        return [
            replace(
                trial, columns=both(view, trial.parameters), coefficient_range=(-np.inf, np.inf)
            )
            for trial in trials(view)
        ]

    return replace(effect, trials=either, columns=both)


def _earlier(view: View) -> View:
    tracks = [replace(track, place=np.maximum(track.place - 1, 0)) for track in view.tracks]
    return replace(with_tracks(view, tracks), guess=view.static)


def behind_jumps(view: View) -> View | None:
    """Return what follows jumps with static responses as they are, None where nothing jumps."""
    there = {k: _stretches(track.drive) for k, track in enumerate(view.tracks)}
    kept = [k for k, stretches in there.items() if stretches]
    if not kept:
        return None
    tracks = [_only(view.tracks[k], there[k]) for k in kept]
    reversals = [view.nuisance.reversals[k] for k in kept]
    histories = [History(track=t, reversals=p) for t, p in zip(tracks, reversals, strict=True)]
    trend = Trend(histories=tuple(histories))
    known = tuple(view.static[k] for k in kept)
    return replace(with_tracks(replace(view, nuisance=trend), tracks), guess=known)


def _stretches(drive: Array) -> list[Stretch]:
    """Return first and last sample of what follows each jump behind which the drive is calm."""
    way = np.abs(drive[WITHIN:] - drive[:-WITHIN])
    fast = np.concatenate([[False], way >= JUMP, [False]])
    begins, ends = (np.flatnonzero(np.diff(fast.astype(int)) == sign) for sign in (1, -1))
    following = np.append(begins[1:], len(way))[: len(begins)]
    found = []
    for begin, end, next_one in zip(*(a.tolist() for a in (begins, ends, following)), strict=True):
        first = end + SETTLED
        last = min(first + STRETCH, next_one)
        if end - begin > 2 * WITHIN or last - first < FEWEST:
            continue
        if way[end:last].max() < CALM * way[begin:end].max():
            found.append((first, last))
    return found


def _only(track: Track, stretches: Sequence[Stretch]) -> Track:
    place = [np.arange(first, last) for first, last in stretches]
    block = [(p - p[0]) * BLOCKS // STRETCH for p in place]
    return replace(track, place=np.concatenate(place), block=np.concatenate(block))


def _struck(effect: Effect, scope: View) -> SelectedEffect | None:
    seen = None if effect.untestable(scope) else score_test(effect, scope)
    if seen is None or not seen.physical:
        return None
    one = initial_guess(effect, seen.trial, float(seen.cv.coefficient[0]))
    better, view = refine(one, scope, [])
    found = evaluate(better, view, scope, test=seen)
    return replace(better, from_jumps=True) if found.is_significant else None
