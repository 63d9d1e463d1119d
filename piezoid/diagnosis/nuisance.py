"""Nuisance class: hysteresis of nearly any kind, without rate, time or other axes.

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

import numpy as np

from piezoid.diagnosis.drive_history import ONCE_BEYOND, History, states_at, static_of
from piezoid.diagnosis.initial_states import Reversals
from piezoid.diagnosis.nuisance_columns import (
    BOUC_WEN_COLUMNS,
    SHARED,
    BoucWenLaw,
    bias_places,
    bouc_wen_columns,
    shape,
    states_under,
    write_shape,
)
from piezoid.diagnosis.segments import Places, Track
from piezoid.numerics.arrays import Array
from piezoid.numerics.executor import Once
from piezoid.operators.play import thinned_drive

FORGETTING = 4  # groups of plays whose first states each track may correct
MEMORY = FORGETTING + 2 * len(ONCE_BEYOND)  # columns of the initial state, with poling
KEPT = 1 << 20  # samples of which all states are kept: some 300 MB


@dataclass(frozen=True, kw_only=True, eq=False)
class NuisanceClass:
    """The class on some tracks, each with an initial state.

    histories  tracks with their initial states
    bouc_wen   a Bouc-Wen state beside the others, or none
    free       whether the first states of every track may be corrected
    """

    histories: tuple[History, ...]
    bouc_wen: BoucWenLaw | None = None
    free: bool = False

    @Once
    def tracks(self) -> tuple[Track, ...]:
        """Return the tracks."""
        return tuple(history.track for history in self.histories)

    @Once
    def reversals(self) -> tuple[Reversals, ...]:
        """Return the values at which the drive turned before each track."""
        return tuple(history.reversals for history in self.histories)

    @Once
    def edges(self) -> Places:
        """Return the first row of each track, and the number of rows."""
        return np.concatenate([[0], np.cumsum([len(track.rows) for track in self.tracks])])

    @Once
    def shared(self) -> int:
        """Number of columns shared by all tracks."""
        return SHARED + (BOUC_WEN_COLUMNS if self.bouc_wen else 0)

    @property
    def columns_per_track(self) -> int:
        """Number of columns of one track only."""
        return 1 + (MEMORY if self.free else 0)

    @property
    def memory_columns(self) -> tuple[int, ...]:
        """Indices of the columns that correct the initial state of each track, if it is free."""
        if not self.free:
            return ()
        firsts = [self.shared + self.columns_per_track * k + 1 for k in range(len(self.tracks))]
        return tuple(first + g for first in firsts for g in range(MEMORY))

    @property
    def bias_columns(self) -> tuple[int, ...]:
        """Return the columns that are products of a state with the drive."""
        return (*bias_places(), *range(SHARED, self.shared)[-2:])

    @Once
    def columns(self) -> Array:
        """Return the columns at all rows: shared ones, then those of each track."""
        total = self.shared + self.columns_per_track * len(self.tracks)
        columns = np.zeros((self.edges[-1], total), order="F")
        for k, track in enumerate(self.tracks):
            rows = slice(self.edges[k], self.edges[k + 1])
            write_shape(columns[rows, :SHARED], *self.histories[k].rows, track.drive[track.rows])
            first = self.shared + self.columns_per_track * k
            columns[rows, first] = 1.0
            if self.free:
                history, poled = self.histories[k], first + 1 + FORGETTING
                columns[rows, first + 1 : poled] = history.retained_memory(FORGETTING)
                columns[rows, poled : first + self.columns_per_track] = history.poled()
        if self.bouc_wen:
            columns[:, SHARED : self.shared] = self.bouc_wen_rows
        return columns

    @Once
    def gram(self) -> Array:
        """Return the products of all columns with each other."""
        return np.asarray(self.columns.T @ self.columns)

    @property
    def bouc_wen_rows(self) -> Array:
        """Return the columns of the Bouc-Wen state at all rows."""
        parts = []
        for history in self.histories:
            path, rows = history.track.path
            state = self.bent(history.reversals, path)[rows]
            parts.append(bouc_wen_columns(state, path[rows]))
        return np.concatenate(parts)

    @Once
    def _keeps(self) -> bool:
        """Whether all states of all samples are kept, to be weighted again and again."""
        return sum(len(track.drive) for track in self.tracks) <= KEPT

    @Once
    def _bends(self) -> tuple[Array, ...]:
        return tuple(self.bent(h.reversals, h.track.drive) for h in self.histories)

    def static(self, k: int, weight: Array) -> Array:
        """Return the static response to the drive of a track, (samples,)."""
        drive = self.tracks[k].drive
        if not self._keeps:
            return self.along(drive, self.reversals[k], weight)
        total = self.histories[k].static(weight)
        return total + bent_part(self._bends[k], drive, weight) if self.bouc_wen else total

    def along(self, drive: Array, reversals: Reversals, weight: Array) -> Array:
        """Return the static response to a drive after given reversals, (samples,)."""
        total = static_of(drive, reversals, weight)
        return (
            total + bent_part(self.bent(reversals, drive), drive, weight)
            if self.bouc_wen
            else total
        )

    def bent(self, reversals: Reversals, drive: Array) -> Array:
        """Return the Bouc-Wen state along a drive that turned before, (samples,)."""
        assert self.bouc_wen is not None
        return states_under(self.bouc_wen, reversals, drive)

    def bent_at(self, reversals: Reversals, drive: Array, samples: Places) -> Array:
        """Return the Bouc-Wen state at some samples of a drive after given reversals, (rows,)."""
        path, rows = thinned_drive(drive, samples)
        return self.bent(reversals, path)[rows]

    def static_rows(self, k: int, weight: Array, drive: Array) -> Array:
        """Return the static response to another drive at a track's rows, (rows,)."""
        samples, reversals = self.tracks[k].rows, self.reversals[k]
        rows = shape(*states_at(drive, reversals, samples), drive[samples], weight[:SHARED])
        if not self.bouc_wen:
            return rows
        return rows + bent_part(self.bent_at(reversals, drive, samples), drive[samples], weight)


def bent_part(state: Array, drive: Array, weight: Array) -> Array:
    """Return the response of the Bouc-Wen columns, weighted by the last shared weights."""
    return np.asarray(bouc_wen_columns(state, drive) @ weight[SHARED:])
