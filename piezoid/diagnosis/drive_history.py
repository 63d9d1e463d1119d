"""History: a track with what its drive did before, and the states that leaves along it.

What hysteresis knows of a way depends on where it turned and on nothing between: states at some
rows follow from these rows and the turns of the drive alone.

Source: Krejci (1996); Mayergoyz (1991) on rate independence.
"""

from dataclasses import dataclass

import numpy as np

from piezoid.diagnosis.initial_states import Reversals, memory_after
from piezoid.diagnosis.nuisance_columns import SHARED, THRESHOLD, rubbed, rubbing, shape
from piezoid.diagnosis.segments import Places, Track
from piezoid.numerics.arrays import Array
from piezoid.numerics.executor import Once
from piezoid.operators.play import play_columns, way_to

CHUNK = 65536
ONCE_BEYOND = (0.0, 0.5)  # of half the range: where walls are moved for good
States = tuple[Array, Array]  # of plays, of friction


@dataclass(frozen=True, kw_only=True, eq=False)
class History:
    """One track with one initial state.

    reversals  values at which the drive turned before the track
    other  the same drive and initial state with other readings or rows; its states are reused
    """

    track: Track
    reversals: Reversals
    other: "History | None" = None

    def after(self, reversals: Reversals) -> "History":
        """Return the track with another initial state."""
        return (
            self if reversals == self.reversals else History(track=self.track, reversals=reversals)
        )

    def on(self, track: Track) -> "History":
        """Return another track with the same initial state."""
        if track is self.track:
            return self
        same = np.array_equal(track.drive, self.track.drive)
        return History(
            track=track, reversals=self.reversals, other=self.other or self if same else None
        )

    @Once
    def rows(self) -> States:
        """Return the states at the track's rows, (rows, plays) and (rows, friction states)."""
        return _states_on(*self.track.way, self.reversals)

    @Once
    def states(self) -> States:
        """Return the states at every sample, (samples, plays) and (samples, friction states)."""
        if self.other is not None:
            return self.other.states
        drive = self.track.drive
        plays, _ = play_columns(drive, THRESHOLD, memory_after(drive, self.reversals))
        return plays, rubbing(drive, rubbed(drive, self.reversals))

    def static(self, weight: Array) -> Array:
        """Return what the shared columns make of the drive, (samples,); all states are kept."""
        return shape(*self.states, self.track.drive, weight[:SHARED])

    def kept(self, groups: int) -> Array:
        """Return which part of its first states each group of plays keeps at the rows.

        One keeps its first state until it moves. Narrow plays have forgotten them at once.
        """
        first = memory_after(self.track.drive, self.reversals)
        highest, lowest = self._farthest
        up = np.searchsorted(highest, first + THRESHOLD, side="right")
        down = np.searchsorted(-lowest, THRESHOLD - first, side="right")
        kept = self.track.place[:, None] < np.minimum(up, down)
        plays = len(THRESHOLD)
        parts = np.array_split(np.arange(plays // 3, plays), groups)
        return np.column_stack([kept[:, part].mean(axis=1) for part in parts])

    def poled(self) -> Array:
        """Return how far the drive has gone beyond some levels for the first time, at the rows.

        Walls that the drive cannot bring back are moved once, when it first comes that far.
        """
        way = [side[self.track.place] - side[0] for side in self._beyond()]
        return np.column_stack(way)

    def _beyond(self) -> list[Array]:
        highest, lowest = self._farthest
        sides = (highest, -lowest)
        return [np.maximum(side - level, 0.0) for side in sides for level in ONCE_BEYOND]

    @Once
    def _farthest(self) -> tuple[Array, Array]:
        """Return how far up and down the drive has come by every sample."""
        drive = self.track.drive
        return np.maximum.accumulate(drive), np.minimum.accumulate(drive)


def states_at(drive: Array, reversals: Reversals, place: Places) -> States:
    """Return the states at some samples of any drive that turned before."""
    return _states_on(*way_to(drive, place), reversals)


def _states_on(path: Array, rows: Places, reversals: Reversals) -> States:
    plays, _ = play_columns(path, THRESHOLD, memory_after(path, reversals))
    return _rows(plays, rows), _rows(rubbing(path, rubbed(path, reversals)), rows)


def _rows(columns: Array, place: Places) -> Array:
    """Return some rows of column-major columns, column-major again."""
    return np.asarray(np.take(columns.T, place, axis=1).T)


def static_of(drive: Array, reversals: Reversals, weight: Array) -> Array:
    """Return what shared columns make of any drive that turned before, keeping no states."""
    memory = memory_after(drive, reversals)
    friction = rubbing(drive, rubbed(drive, reversals))
    parts = []
    for first in range(0, len(drive), CHUNK):
        part = np.asarray(drive[first : first + CHUNK])
        states, memory = play_columns(part, THRESHOLD, memory)
        parts.append(shape(states, friction[first : first + CHUNK], part, weight[:SHARED]))
    return np.concatenate(parts)
