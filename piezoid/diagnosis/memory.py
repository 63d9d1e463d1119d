"""Memory: what each track remembers from before its first sample.

The envelope is fitted where that is forgotten: to rows before which the drive has covered its
whole range since the track began. Pasts are then compared by how such an envelope follows a track
from its first sample on. What else is wrong must not pass for memory: a past other than that of a drive
cycled over its range must be clearly better for its track, and better for all tracks together once
everything is refitted.

Source: Krejci (1996) on forgetting; Mayergoyz (1991) on wiping out.
"""

from dataclasses import dataclass

import numpy as np

from piezoid.diagnosis.envelope import (
    FRICTION,
    SHARED,
    THRESHOLD,
    Turns,
    friction_states,
    knee_columns,
    past,
    pasts,
    rubbed,
    shape,
)
from piezoid.diagnosis.folds import Null
from piezoid.diagnosis.view import View, cycled, with_pasts
from piezoid.numerics.arrays import Array
from piezoid.operators.bouc_wen import bouc_wen_states
from piezoid.operators.play import play_columns

COVERED = 0.97  # of the whole range: then all is forgotten
FEWEST = 4  # rows for a column, or all rows are taken
FOR_ALL = 0.97  # of the error of all tracks: what such a past must leave
CLEARLY = 0.7  # of the misfit of a cycled past: what another past must leave to be believed
POINTS = 500  # of a track that are compared
PARTS = (0.15, 0.05, 0.015)  # of half the range, by which turns are moved
FARTHEST = 1.2


def with_own_pasts(view: View) -> View:
    """Return the view in which every track has the past that fits it best."""
    view = cycled(view)
    weight = _forgetful_weight(view)
    turns = tuple(_best_past(view, k, weight) for k in range(len(view.tracks)))
    together = with_pasts(view, turns)
    view = together if together.rms < FOR_ALL * view.rms else view
    for k, best in enumerate(turns):
        here = view.envelope.turns
        if best != here[k]:
            other = with_pasts(view, (*here[:k], best, *here[k + 1 :]))
            view = other if other.rms < FOR_ALL * view.rms else view
    return view


def _forgetful_weight(view: View) -> Array:
    """Return the shared coefficients from rows at which every past is forgotten."""
    kept = np.concatenate([_forgotten(t.drive)[t.place] for t in view.tracks])
    memory = list(view.envelope.memory_columns)
    columns = np.hstack([np.delete(view.envelope.columns, memory, axis=1), view.accepted])
    if np.count_nonzero(kept) < FEWEST * columns.shape[1]:
        return view.weight
    null = Null(columns=columns[kept], response=view.response[kept], block=view.block[kept])
    return null.fit(null.response)[: view.envelope.shared]


def _forgotten(drive: Array) -> Array:
    """Return at which samples the drive has covered the whole range, 2, since the first."""
    span = np.maximum.accumulate(drive) - np.minimum.accumulate(drive)
    return np.asarray(span > COVERED * 2.0)


def _best_past(view: View, k: int, weight: Array) -> Turns:
    """Return the past that misfits a track least, refined turn by turn."""
    sketch = _sketch(view, k, weight)
    options = pasts(view.tracks[k].drive)
    best = min(options, key=sketch.misfit)
    if sketch.misfit(best) > CLEARLY * min(sketch.misfit(turns) for turns in options[:2]):
        return options[0]
    for part in PARTS:
        for place in range(len(best)):
            near = [_turned(best, place, sign * part) for sign in (1.0, -1.0)]
            best = min(best, *near, key=sketch.misfit)
    return best


def _turned(turns: Turns, place: int, step: float) -> Turns:
    moved = min(max(turns[place] + step, -FARTHEST), FARTHEST)
    return (*turns[:place], moved, *turns[place + 1 :])


@dataclass(frozen=True, kw_only=True, eq=False)
class _Sketch:
    """A track at few samples and its reversals, on which pasts are tried.

    began     (states,)         friction after a drive that was cycled before
    friction  (points, states)  from there
    way       (points,)         the drive has gone
    """

    weight: Array
    knee: tuple[float, float, float] | None
    drive: Array
    response: Array
    began: Array
    friction: Array
    way: Array

    def misfit(self, turns: Turns) -> float:
        """Return the standard deviation of what a past misses."""
        states, _ = play_columns(self.drive, THRESHOLD, past(self.drive, turns))
        forgotten = np.exp(-self.way[:, None] / FRICTION)
        rubs = self.friction + (rubbed(self.drive, turns) - self.began) * forgotten
        model = shape(states, rubs, self.drive, self.weight[:SHARED])
        if self.knee:
            way = np.array([*turns, float(self.drive[0])])
            start = float(bouc_wen_states(way, *self.knee)[-1])
            bent = bouc_wen_states(self.drive, *self.knee, start)
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
        friction=friction_states(track.drive, began)[points],
        way=way[points],
    )
