"""The structural envelope: a wide class of hysteresis that does not know of rate, time or other
axes.

    y = sum_(i, n) c_in z_i^n + (d_i u + e_i u^2) z_i + sum_j f_j(x_j1, u) + g_j2 x_j2 + g_j3 x_j3
        + zero of the track

z_i plays, n = 1 .. 4; x_jn friction states that forget exponentially with the way the drive went,

    dx/dt = d(u^n)/dt - |du/dt| x / r,

f_j powers of the first and their products with the drive; and, where that beats every effect, one
Bouc-Wen state of free parameters, because its small loops do not close. Plays with powers of their
states are Preisach operators in play form; friction states are Dahl's, and with the powers of the
drive those of walls drawn to a curved anhysteretic; products with the drive let loops change with
bias. The class is far wider than any model that ships: what it can follow is no evidence of a
cause, and effects are decided on what it cannot.

Source: Krejci (1996); Dahl (1968); Jiles & Atherton (1986); Bouc (1967); a wide class of nulls,
Box (1980).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from piezoid.diagnosis.bouc_wen import Knee, bent_states
from piezoid.diagnosis.friction import rubbed, rubbing
from piezoid.diagnosis.pasts import Turns, past
from piezoid.diagnosis.shape import (
    KNEE_COLUMNS,
    PLAYS,
    SHARED,
    THRESHOLD,
    bias_places,
    knee_columns,
    shape,
    write_shape,
)
from piezoid.diagnosis.tracks import Places, Track
from piezoid.numerics.arrays import Array
from piezoid.operators.play import first_carry, play_columns, play_tangents

FORGETTING = 4  # groups of plays whose first states each track may correct
CHUNK = 65536


def _rows(columns: Array, place: Places) -> Array:
    """Return some rows of column-major columns, column-major again."""
    return np.asarray(np.take(columns.T, place, axis=1).T)


@dataclass(frozen=True, kw_only=True, eq=False)
class Envelope:
    """The class on some tracks, each with a past.

    tracks  what is followed
    turns   (tracks,)  values at which the drive turned before each track
    knee    a Bouc-Wen state beside the others, or none
    free    whether the first states of every track may be corrected
    """

    tracks: tuple[Track, ...]
    turns: tuple[Turns, ...]
    knee: Knee | None = None
    free: bool = False

    @cached_property
    def edges(self) -> Places:
        """Return the first row of each track, and the number of rows."""
        return np.concatenate([[0], np.cumsum([len(track.place) for track in self.tracks])])

    @cached_property
    def shared(self) -> int:
        """Return how many columns all tracks share."""
        return SHARED + (KNEE_COLUMNS if self.knee else 0)

    @property
    def own(self) -> int:
        """Return how many columns belong to one track."""
        return 1 + (FORGETTING if self.free else 0)

    @property
    def memory_columns(self) -> tuple[int, ...]:
        """Return the columns that correct the first states of each track, where these are free."""
        if not self.free:
            return ()
        firsts = [self.shared + self.own * k + 1 for k in range(len(self.tracks))]
        return tuple(first + g for first in firsts for g in range(FORGETTING))

    @property
    def bias_columns(self) -> tuple[int, ...]:
        """Return the columns that are products of a state with the drive."""
        return (*bias_places(), *range(SHARED, self.shared)[-2:])

    @cached_property
    def columns(self) -> Array:
        """Return the columns at all rows: shared ones, then each track's own."""
        total = self.shared + self.own * len(self.tracks)
        columns = np.zeros((self.edges[-1], total), order="F")
        for k, track in enumerate(self.tracks):
            rows = slice(self.edges[k], self.edges[k + 1])
            states, friction = self._states(k, track.drive)
            write_shape(columns[rows, :SHARED], states, friction, track.drive[track.place])
            first = self.shared + self.own * k
            columns[rows, first] = 1.0
            if self.free:
                columns[rows, first + 1 : first + self.own] = self._kept(k)
        if self.knee:
            columns[:, SHARED : self.shared] = self.bent_rows
        return columns

    def _states(self, k: int, drive: Array) -> tuple[Array, Array]:
        """Return states of plays and friction along another drive, at a track's rows."""
        turns, place = self.turns[k], self.tracks[k].place
        states, _ = play_columns(drive, THRESHOLD, past(drive, turns))
        friction = rubbing(drive, rubbed(drive, turns))
        return _rows(states, place), _rows(friction, place)

    def _kept(self, k: int) -> Array:
        """Return which part of its first states each group of plays keeps at a track's rows."""
        track = self.tracks[k]
        first = first_carry(past(track.drive, self.turns[k]))
        kept = _rows(play_tangents(track.drive, THRESHOLD, first).memory, track.place)
        groups = np.array_split(np.arange(PLAYS // 3, PLAYS), FORGETTING)
        return np.column_stack([kept[:, group].mean(axis=1) for group in groups])

    @cached_property
    def gram(self) -> Array:
        """Return the products of all columns with each other."""
        return np.asarray(self.columns.T @ self.columns)

    @property
    def bent_rows(self) -> Array:
        """Return the columns of the Bouc-Wen state at all rows."""
        parts = []
        for track, turns in zip(self.tracks, self.turns, strict=True):
            state = self.bent(turns, track.drive)[track.place]
            parts.append(knee_columns(state, track.drive[track.place]))
        return np.concatenate(parts)

    def static(self, k: int, weight: Array) -> Array:
        """Return what the shared columns make of a track's drive, (samples,)."""
        return self.along(self.tracks[k].drive, self.turns[k], weight)

    def along(self, drive: Array, turns: Turns, weight: Array) -> Array:
        """Return what the shared columns make of any drive that turned before, (samples,)."""
        memory = past(drive, turns)
        friction = rubbing(drive, rubbed(drive, turns))
        parts = []
        for first in range(0, len(drive), CHUNK):
            part = np.asarray(drive[first : first + CHUNK])
            states, memory = play_columns(part, THRESHOLD, memory)
            parts.append(shape(states, friction[first : first + CHUNK], part, weight[:SHARED]))
        total = np.concatenate(parts)
        if self.knee:
            total += knee_columns(self.bent(turns, drive), drive) @ weight[SHARED:]
        return np.asarray(total)

    def bent(self, turns: Turns, drive: Array) -> Array:
        """Return the Bouc-Wen state along a drive that turned before, (samples,)."""
        assert self.knee is not None
        return bent_states(self.knee, turns, drive)

    def static_rows(self, k: int, weight: Array, drive: Array) -> Array:
        """Return what the shared columns make of another drive at a track's rows, (rows,)."""
        place = self.tracks[k].place
        states, friction = self._states(k, drive)
        rows = shape(states, friction, drive[place], weight[:SHARED])
        if self.knee:
            rows = (
                rows
                + knee_columns(self.bent(self.turns[k], drive)[place], drive[place])
                @ weight[SHARED:]
            )
        return np.asarray(rows)
