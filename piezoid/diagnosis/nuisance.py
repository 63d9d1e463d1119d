"""Nuisance class: hysteresis of nearly any kind, without rate, time or other axes.

    y = sum_(i, n) c_in z_i^n + (d_i u + e_i u^2) z_i + sum_j f_j(x_j1, u) + g_j2 x_j2 + g_j3 x_j3
        + zero of the track

z_i plays, n = 1 .. 4; x_jn friction states that decay exponentially with the travel of the drive,

    dx/dt = d(u^n)/dt - |du/dt| x / r,

f_j powers of x_j1 and their products with the drive. A Bouc-Wen state with free parameters, whose
minor loops do not close, is added if it explains more than every effect. Plays with powers of
their states are Preisach operators in play form. Friction states are Dahl's; driven by powers of
the drive, they represent domain walls that are attracted by a curved anhysteretic. Products with
the drive let loops change with bias. The class is far wider than any model that ships: motion that
it can follow is no evidence of an effect, and effects are tested on the residual.

Source: Krejci (1996); Dahl (1968); Jiles & Atherton (1986); Bouc (1967); a wide class of nulls,
Box (1980).
"""

from dataclasses import dataclass

import numpy as np

from piezoid.diagnosis.drive_history import (
    POLING_LEVELS,
    History,
    Reversals,
    states_on,
    static_response,
)
from piezoid.diagnosis.nuisance_columns import (
    BOUC_WEN_COLUMNS,
    SHARED,
    BoucWenLaw,
    bias_column_indices,
    bouc_wen_along,
    bouc_wen_columns,
    shared_response,
    write_shared_columns,
)
from piezoid.diagnosis.segments import Places, Track
from piezoid.numerics.arrays import Array
from piezoid.numerics.executor import Once
from piezoid.operators.play import thinned_drive

MEMORY_GROUPS = 4  # groups of plays whose initial states each track may correct
MEMORY_COLUMNS = MEMORY_GROUPS + 2 * len(POLING_LEVELS)  # of one initial state, with poling
MAX_KEPT = 1 << 20  # samples; for more the states are not kept in memory, which takes 300 MB


@dataclass(frozen=True, kw_only=True, eq=False)
class NuisanceClass:
    """The class on tracks with their initial states.

    histories  tracks with their initial states
    bouc_wen   parameters of a Bouc-Wen state, or None
    free       whether the initial state of every track is corrected
    """

    histories: tuple[History, ...]
    bouc_wen: BoucWenLaw | None = None
    free: bool = False

    @Once
    def tracks(self) -> tuple[Track, ...]:
        """Return the tracks of the histories."""
        return tuple(history.track for history in self.histories)

    @Once
    def reversals(self) -> tuple[Reversals, ...]:
        """Return the reversals of the drive before each track."""
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
        """Number of separate columns of each track."""
        return 1 + (MEMORY_COLUMNS if self.free else 0)

    @property
    def memory_columns(self) -> tuple[int, ...]:
        """Indices of the columns that correct the initial state of each track, if it is free."""
        if not self.free:
            return ()
        firsts = [self.shared + self.columns_per_track * k + 1 for k in range(len(self.tracks))]
        return tuple(first + g for first in firsts for g in range(MEMORY_COLUMNS))

    @property
    def bias_columns(self) -> tuple[int, ...]:
        """Return the indices of the columns that are products of a state with the drive."""
        return (*bias_column_indices(), *range(SHARED, self.shared)[-2:])

    @Once
    def columns(self) -> Array:
        """Return all columns at all rows: shared columns, then the columns of each track."""
        total = self.shared + self.columns_per_track * len(self.tracks)
        columns = np.zeros((self.edges[-1], total), order="F")
        for k, track in enumerate(self.tracks):
            rows = slice(self.edges[k], self.edges[k + 1])
            write_shared_columns(
                columns[rows, :SHARED], *self.histories[k].rows, track.drive[track.rows]
            )
            first = self.shared + self.columns_per_track * k
            columns[rows, first] = 1.0
            if self.free:
                history, poling = self.histories[k], first + 1 + MEMORY_GROUPS
                columns[rows, first + 1 : poling] = history.retained_memory(MEMORY_GROUPS)
                columns[rows, poling : first + self.columns_per_track] = history.poling()
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
            state = self.bouc_wen_state(history.reversals, path)[rows]
            parts.append(bouc_wen_columns(state, path[rows]))
        return np.concatenate(parts)

    @Once
    def _bouc_wen_states(self) -> tuple[Array, ...]:
        return tuple(self.bouc_wen_state(h.reversals, h.track.drive) for h in self.histories)

    def static(self, k: int, weight: Array) -> Array:
        """Return the static response to the drive of a track, (samples,)."""
        drive = self.tracks[k].drive
        if sum(len(track.drive) for track in self.tracks) > MAX_KEPT:
            return self.static_along(drive, self.reversals[k], weight)
        # the states of all samples stay in memory, for use with other weights
        total = self.histories[k].static(weight)
        return (
            total + bouc_wen_response(self._bouc_wen_states[k], drive, weight)
            if self.bouc_wen
            else total
        )

    def static_along(self, drive: Array, reversals: Reversals, weight: Array) -> Array:
        """Return the static response to a drive after earlier reversals, (samples,)."""
        total = static_response(drive, reversals, weight)
        return (
            total + bouc_wen_response(self.bouc_wen_state(reversals, drive), drive, weight)
            if self.bouc_wen
            else total
        )

    def bouc_wen_state(self, reversals: Reversals, drive: Array) -> Array:
        """Return the Bouc-Wen state along a drive after earlier reversals, (samples,)."""
        assert self.bouc_wen is not None
        return bouc_wen_along(self.bouc_wen, reversals, drive)

    def bouc_wen_state_at(self, reversals: Reversals, drive: Array, samples: Places) -> Array:
        """Return the Bouc-Wen state at samples of a drive after earlier reversals, (rows,)."""
        path, rows = thinned_drive(drive, samples)
        return self.bouc_wen_state(reversals, path)[rows]

    def static_rows(self, k: int, weight: Array, drive: Array) -> Array:
        """Return the static response to another drive at a track's rows, (rows,)."""
        samples, reversals = self.tracks[k].rows, self.reversals[k]
        rows = shared_response(
            *states_on(*thinned_drive(drive, samples), reversals), drive[samples], weight[:SHARED]
        )
        if not self.bouc_wen:
            return rows
        return rows + bouc_wen_response(
            self.bouc_wen_state_at(reversals, drive, samples), drive[samples], weight
        )


def bouc_wen_response(state: Array, drive: Array, weight: Array) -> Array:
    """Return the weighted sum of the Bouc-Wen columns, whose weights follow the shared ones."""
    return np.asarray(bouc_wen_columns(state, drive) @ weight[SHARED:])
