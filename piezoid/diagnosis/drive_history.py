"""Drive history: hysteresis states along a track, including reversals before its start.

Rate-independent hysteresis depends on the reversals of the drive and not on its course between
them. The states at rows are therefore computed from the drive at these rows and at its reversals.

Source: Krejci (1996); Mayergoyz (1991) on rate independence.
"""

from dataclasses import dataclass

import numpy as np

from piezoid.diagnosis.initial_states import Reversals, memory_after
from piezoid.diagnosis.nuisance_columns import (
    SHARED,
    THRESHOLD,
    friction_along,
    initial_friction,
    shared_response,
)
from piezoid.diagnosis.segments import Places, Track
from piezoid.numerics.arrays import Array
from piezoid.numerics.executor import Once
from piezoid.operators.play import play_columns, thinned_drive

CHUNK = 65536
POLING_LEVELS = (0.0, 0.5)  # of half the range: drives from which walls move irreversibly
States = tuple[Array, Array]  # of plays, of friction


@dataclass(frozen=True, kw_only=True, eq=False)
class History:
    """Hysteresis states of one track from one initial state.

    reversals  values of the drive at its reversals before the track
    origin     history of the same drive and initial state with other readings or rows; its states
               are reused
    """

    track: Track
    reversals: Reversals
    origin: "History | None" = None

    def with_reversals(self, reversals: Reversals) -> "History":
        """Return the history of the same track from another initial state."""
        return (
            self if reversals == self.reversals else History(track=self.track, reversals=reversals)
        )

    def with_track(self, track: Track) -> "History":
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
        return plays, friction_along(drive, initial_friction(drive, self.reversals))

    def static(self, weight: Array) -> Array:
        """Return the static response of the shared columns, (samples,), keeping all states."""
        return shared_response(*self.states, self.track.drive, weight[:SHARED])

    def retained_memory(self, groups: int) -> Array:
        """Return the share of plays in each group that are in their initial state at the rows.

        A play keeps its initial state until it moves. Narrow plays move at once and are left out.
        """
        first = memory_after(self.track.drive, self.reversals)
        highest, lowest = self._extremes
        up = np.searchsorted(highest, first + THRESHOLD, side="right")
        down = np.searchsorted(-lowest, THRESHOLD - first, side="right")
        is_retained = self.track.rows[:, None] < np.minimum(up, down)
        plays = len(THRESHOLD)
        members = np.array_split(np.arange(plays // 3, plays), groups)
        return np.column_stack([is_retained[:, group].mean(axis=1) for group in members])

    def poling(self) -> Array:
        """Return how far the drive has exceeded the poling levels so far, at the rows.

        Domain walls that the drive cannot move back move only when it first reaches them.
        """
        highest, lowest = self._extremes
        columns = []
        for side in (highest, -lowest):
            for level in POLING_LEVELS:
                excess = np.maximum(side - level, 0.0)
                columns.append(excess[self.track.rows] - excess[0])
        return np.column_stack(columns)

    @Once
    def _extremes(self) -> tuple[Array, Array]:
        """Return the highest and the lowest drive up to every sample."""
        drive = self.track.drive
        return np.maximum.accumulate(drive), np.minimum.accumulate(drive)


def states_at(drive: Array, reversals: Reversals, rows: Places) -> States:
    """Return the states at samples of a drive after earlier reversals."""
    return _states_on(*thinned_drive(drive, rows), reversals)


def _states_on(path: Array, rows: Places, reversals: Reversals) -> States:
    plays, _ = play_columns(path, THRESHOLD, memory_after(path, reversals))
    return _rows(plays, rows), _rows(friction_along(path, initial_friction(path, reversals)), rows)


def _rows(columns: Array, rows: Places) -> Array:
    """Return rows of a column-major matrix, in column-major order."""
    return np.asarray(np.take(columns.T, rows, axis=1).T)


def static_response(drive: Array, reversals: Reversals, weight: Array) -> Array:
    """Return the static response to a drive after earlier reversals, without keeping states."""
    memory = memory_after(drive, reversals)
    friction = friction_along(drive, initial_friction(drive, reversals))
    parts = []
    for first in range(0, len(drive), CHUNK):
        part = np.asarray(drive[first : first + CHUNK])
        states, memory = play_columns(part, THRESHOLD, memory)
        parts.append(
            shared_response(states, friction[first : first + CHUNK], part, weight[:SHARED])
        )
    return np.concatenate(parts)
