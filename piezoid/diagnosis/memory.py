"""Memory: what each track remembers from before its first sample.

The envelope is fitted where that is forgotten: to rows before which the drive has covered its
whole range since the track began. Pasts are then compared by how such an envelope follows a track
from its first sample on, each by itself and one for all, as one person cycles every time alike.
What else is wrong must not pass for memory: other pasts must be better for all tracks together
once everything is refitted.

Source: Krejci (1996) on forgetting; Mayergoyz (1991) on wiping out.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from piezoid.diagnosis.bouc_wen import Knee, bent_states
from piezoid.diagnosis.folds import Null
from piezoid.diagnosis.friction import REACH, rubbed, rubbing
from piezoid.diagnosis.pasts import Turns, habits, past, pasts
from piezoid.diagnosis.shape import SHARED, THRESHOLD, knee_columns, shape
from piezoid.diagnosis.view import View, cycled, with_free_memory, with_habit, with_pasts
from piezoid.numerics.arrays import Array
from piezoid.numerics.hands import ALONE, Hands
from piezoid.operators.play import play_columns

COVERED = 0.97  # of the whole range: then all is forgotten
FEWEST = 4  # rows for a column, or all rows are taken
CLEARLY = 0.9  # of the misfit of a cycled past: what another past must leave to be believed
NEARLY = 0.025  # of what fitted pasts take off, in power: so little may one habit leave,
AS_GOOD = 1.06  # and of what they leave, in power, where the class follows the rest,
POOR = 2.0  # which it does not from so many times the noise on
OTHER_PASTS = 0.92  # of the error: what other pasts of the tracks must leave to be taken
POINTS = 500  # of a track that are compared
PARTS = (0.15, 0.05, 0.015)  # of half the range, by which turns are moved
FARTHEST = 1.2


def with_best_habit(view: View, hands: Hands = ALONE) -> View:
    """Return the view before whose drives a laboratory did what leaves least, always alike."""
    ways = habits(_drives(view), view.rest)
    # a view holds columns for all rows: the best is made again, sooner than that all are kept
    left = hands.each(lambda turns: with_habit(view, turns).rms, ways)
    return with_habit(view, ways[left.index(min(left))])


def with_own_pasts(view: View, habit: View) -> View:
    """Return the view in which every track has the past that fits it best, corrections free.

    habit  the view with the best habit, which is one of the pasts that are tried
    """
    view = cycled(view)
    weight = _forgetful_weight(view)
    sketches = [_sketch(view, k, weight) for k in range(len(view.tracks))]
    own = tuple(_best_past(view.envelope.turns[k], [s]) for k, s in enumerate(sketches))
    shared = (_best_past(view.envelope.turns[0], sketches),) * len(sketches)
    view = with_free_memory(view)
    ways = (own, shared, habit.envelope.turns)
    view = min(view, *(with_pasts(view, turns) for turns in ways), key=_error)
    for k, best in enumerate(own):
        here = view.envelope.turns
        view = min(view, with_pasts(view, (*here[:k], best, *here[k + 1 :])), key=_error)
    return view


def with_one_habit(view: View) -> View:
    """Return the view in which all drives came from one habit of a laboratory.

    A view whose memory nothing spoke against is such a one. Another habit than to cycle the drive
    over its range must do as well as pasts that were fitted one by one.
    """
    if not view.envelope.free:
        return view
    first, best = cycled(view), with_best_habit(view)
    return best if does_as_well(best, view, first) else first


def does_as_well(habit: View, own: View, first: View) -> bool:
    """Tell whether one habit leaves as little as pasts that were fitted one by one.

    A wide class follows nearly any past nearly as well as another, but the true one it needs no
    help with.

    first  the view with drives that were cycled
    """
    least, excess = own.rms**2, habit.rms**2 - own.rms**2
    as_good = excess < (AS_GOOD - 1.0) * least or own.rms > POOR * own.noise
    return as_good and excess < NEARLY * (first.rms**2 - least)


def _drives(view: View) -> list[Array]:
    return [track.drive for track in view.tracks]


def _error(view: View) -> float:
    return view.rms


def _forgetful_weight(view: View) -> Array:
    """Return the shared coefficients from rows at which every past is forgotten."""
    kept = np.concatenate([_forgotten(t.drive)[t.place] for t in view.tracks])
    columns = np.hstack([view.envelope.columns, view.accepted])
    if np.count_nonzero(kept) < FEWEST * columns.shape[1]:
        return view.weight
    null = Null(columns=columns[kept], response=view.response[kept], block=view.block[kept])
    return null.fit(null.response)[: view.envelope.shared]


def _forgotten(drive: Array) -> Array:
    """Return at which samples the drive has covered the whole range, 2, since the first."""
    span = np.maximum.accumulate(drive) - np.minimum.accumulate(drive)
    return np.asarray(span > COVERED * 2.0)


def _best_past(first: Turns, sketches: Sequence["_Sketch"]) -> Turns:
    """Return the past that misfits tracks least, refined turn by turn."""

    def misfit(turns: Turns) -> float:
        return sum(sketch.misfit(turns) ** 2 for sketch in sketches)

    best = min(pasts(sketches[0].drive), key=misfit)
    for part in PARTS:
        for place in range(len(best)):
            near = [_turned(best, place, sign * part) for sign in (1.0, -1.0)]
            best = min(best, *near, key=misfit)
    return best if misfit(best) < CLEARLY**2 * misfit(first) else first


def _turned(turns: Turns, place: int, step: float) -> Turns:
    moved = min(max(turns[place] + step, -FARTHEST), FARTHEST)
    return (*turns[:place], moved, *turns[place + 1 :])


@dataclass(frozen=True, kw_only=True, eq=False)
class _Sketch:
    """A track at few samples and its reversals, on which pasts are tried.

    began      (states,)         friction after a drive that was cycled before
    friction   (points, states)  from there
    remembers  (points, states)  the part of its beginning that is not forgotten
    """

    weight: Array
    knee: Knee | None
    drive: Array
    response: Array
    began: Array
    friction: Array
    remembers: Array

    def misfit(self, turns: Turns) -> float:
        """Return the standard deviation of what a past misses."""
        states, _ = play_columns(self.drive, THRESHOLD, past(self.drive, turns))
        rubs = self.friction + (rubbed(self.drive, turns) - self.began) * self.remembers
        model = shape(states, rubs, self.drive, self.weight[:SHARED])
        if self.knee:
            bent = bent_states(self.knee, turns, self.drive)
            model = model + knee_columns(bent, self.drive) @ self.weight[SHARED:]
        return float(np.std(model - self.response))


def _sketch(view: View, k: int, weight: Array) -> _Sketch:
    track = view.tracks[k]
    step = np.sign(np.diff(track.drive))
    reversals = np.flatnonzero(step[1:] * step[:-1] < 0) + 1
    spread = np.linspace(0, len(track.drive) - 1, POINTS).astype(int)
    points = np.unique([*spread, *reversals[:POINTS]])
    began = rubbed(track.drive, pasts(track.drive)[0])
    way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(track.drive)))])
    return _Sketch(
        weight=weight,
        knee=view.envelope.knee,
        drive=np.asarray(track.drive[points]),
        response=np.asarray(track.response[points]),
        began=began,
        friction=rubbing(track.drive, began)[points],
        remembers=np.exp(-way[points][:, None] / REACH),
    )
