"""Drive history: hysteresis states along a track, including reversals before its start.

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
from piezoid.operators.play import play_columns, thinned_drive

CHUNK = 65536
ONCE_BEYOND = (0.0, 0.5)  # of half the range: where walls are moved for good
States = tuple[Array, Array]  # of plays, of friction


@dataclass(frozen=True, kw_only=True, eq=False)
class History:
    """Hysteresis states of one track from one initial state.

    reversals  values at which the drive turned before the track
    origin     the same drive and initial state with other readings or rows; its states are reused
    """

    track: Track
    reversals: Reversals
    origin: "History | None" = None

    def with_reversals(self, reversals: Reversals) -> "History":
        """Return the history of the same track from another initial state."""
        return (
            self if reversals == self.reversals else History(track=self.track, reversals=reversals)
        )

    def on(self, track: Track) -> "History":
        """Return the history of another track from the same initial state."""
        if track is self.track:
            return self
        is_same_drive = np.array_equal(track.drive, self.track.drive)
        return History(
            track=track,
            reversals=self.reversals,
            origin=self.origin or self if is_same_drive else None,
        )

    @Once
    def rows(self) -> States:
        """Return the states at the track's rows, (rows, plays) and (rows, friction states)."""
        return _states_on(*self.track.path, self.reversals)

    @Once
    def states(self) -> States:
        """Return the states at every sample, (samples, plays) and (samples, friction states)."""
        if self.origin is not None:
            return self.origin.states
        drive = self.track.drive
        plays, _ = play_columns(drive, THRESHOLD, memory_after(drive, self.reversals))
        return plays, rubbing(drive, rubbed(drive, self.reversals))

    def static(self, weight: Array) -> Array:
        """Return the static response of the shared columns, (samples,), keeping all states."""
        return shape(*self.states, self.track.drive, weight[:SHARED])

    def retained_memory(self, groups: int) -> Array:
        """Return the share of plays in each group that still hold their initial state at the rows.

        A play keeps its initial state until it moves. Narrow plays forget it at once and are left
        out.
        """
        first = memory_after(self.track.drive, self.reversals)
        highest, lowest = self._farthest
        up = np.searchsorted(highest, first + THRESHOLD, side="right")
        down = np.searchsorted(-lowest, THRESHOLD - first, side="right")
        is_retained = self.track.rows[:, None] < np.minimum(up, down)
        plays = len(THRESHOLD)
        parts = np.array_split(np.arange(plays // 3, plays), groups)
        return np.column_stack([is_retained[:, part].mean(axis=1) for part in parts])

    def poled(self) -> Array:
        """Return how far the drive has exceeded some levels so far, at the rows.

        Domain walls that the drive cannot move back are moved only when it first gets there.
        """
        distances = [side[self.track.rows] - side[0] for side in self._beyond()]
        return np.column_stack(distances)

    def _beyond(self) -> list[Array]:
        highest, lowest = self._farthest
        sides = (highest, -lowest)
        return [np.maximum(side - level, 0.0) for side in sides for level in ONCE_BEYOND]

    @Once
    def _farthest(self) -> tuple[Array, Array]:
        """Return how far up and down the drive has come by every sample."""
        drive = self.track.drive
        return np.maximum.accumulate(drive), np.minimum.accumulate(drive)


def states_at(drive: Array, reversals: Reversals, rows: Places) -> States:
    """Return the states at some samples of a drive with given earlier reversals."""
    return _states_on(*thinned_drive(drive, rows), reversals)


def _states_on(path: Array, rows: Places, reversals: Reversals) -> States:
    plays, _ = play_columns(path, THRESHOLD, memory_after(path, reversals))
    return _rows(plays, rows), _rows(rubbing(path, rubbed(path, reversals)), rows)


def _rows(columns: Array, rows: Places) -> Array:
    """Return some rows of column-major columns, in column-major order."""
    return np.asarray(np.take(columns.T, rows, axis=1).T)


def static_of(drive: Array, reversals: Reversals, weight: Array) -> Array:
    """Return the static response to a drive after given reversals, without keeping states."""
    memory = memory_after(drive, reversals)
    friction = rubbing(drive, rubbed(drive, reversals))
    parts = []
    for first in range(0, len(drive), CHUNK):
        part = np.asarray(drive[first : first + CHUNK])
        states, memory = play_columns(part, THRESHOLD, memory)
        parts.append(shape(states, friction[first : first + CHUNK], part, weight[:SHARED]))
    return np.concatenate(parts)
