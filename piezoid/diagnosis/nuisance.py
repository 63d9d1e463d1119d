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

Rate-independent hysteresis depends on the reversals of the drive and not on its course between
them. The states at rows are therefore computed from the drive at these rows and at its reversals.
A reversal wipes out all earlier reversals that it exceeds. Those before a recording are unknown,
and are compared as hypotheses.

Source: Krejci (1996); Mayergoyz (1991) on rate independence and wiping out; Dahl (1968); Jiles &
Atherton (1986); Bouc (1967); a wide class of nulls, Box (1980).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from piezoid.diagnosis.nuisance_columns import (
    BOUC_WEN_COLUMNS,
    PLAYS,
    SHARED,
    THRESHOLD,
    BoucWenLaw,
    bias_column_indices,
    bouc_wen_along,
    bouc_wen_columns,
    friction_along,
    initial_friction,
    shared_response,
    write_shared_columns,
)
from piezoid.diagnosis.segments import Places, Track
from piezoid.numerics.arrays import Array
from piezoid.numerics.executor import Once
from piezoid.operators.play import play_columns, thinned_drive

RANDOM_HYPOTHESES = 16
SINGLE_LEVELS, PAIR_LEVELS = 9, 5  # levels of one reversal, and of each of two
DELIBERATE = 4  # first hypotheses: histories as laboratories make them
DECAYING = 24  # reversals of a cycle that decays to rest
AT_END = 0.03  # of a drive's span: distance from an end below which the drive reaches it
MIN_CYCLES = 3  # of a periodic drive
MAX_FIRST_CYCLE = 1.4  # over the mean cycle: a longer first cycle begins a sweep of the frequency
CHUNK = 65536
POLING_LEVELS = (0.0, 0.5)  # of half the range: drives from which walls move irreversibly
MEMORY_GROUPS = 4  # groups of plays whose initial states each track may correct
MEMORY_COLUMNS = MEMORY_GROUPS + 2 * len(POLING_LEVELS)  # of one initial state, with poling
MAX_KEPT = 1 << 20  # samples; for more the states are not kept in memory, which takes 300 MB

Reversals = tuple[float, ...]
States = tuple[Array, Array]  # of plays, of friction


def memory_after(drive: Array, reversals: Sequence[float]) -> Array:
    """Return the play memory at the first sample after these reversals of the drive."""
    path = np.array([*reversals, float(drive[0])])
    return play_columns(path, THRESHOLD, np.zeros(PLAYS))[1]


def hypotheses(drive: Array) -> tuple[Reversals, ...]:
    """Return hypotheses of earlier reversals, cycles over the full range first.

    These are followed by cycles in the opposite order, rest, decaying cycles about the first
    value, one or two reversals after rest or an end of the range, and random reversals.
    """
    low, high = min(-1.0, float(drive.min())), max(1.0, float(drive.max()))
    single = np.linspace(low, high, SINGLE_LEVELS + 2)[1:-1].tolist()
    pair = np.linspace(low, high, PAIR_LEVELS + 2)[1:-1].tolist()
    rng = np.random.default_rng(RANDOM_HYPOTHESES)
    random = [
        (*rng.uniform((-0.3, -1, -0.3, -1, -0.3, -1), (1, 0.3, 1, 0.3, 1, 0.3)).tolist(),)
        for _ in range(RANDOM_HYPOTHESES)
    ]
    deviations = np.linspace(1.0, 0.0, DECAYING, endpoint=False)
    deviations[1::2] *= -1.0
    return (
        (low, high),
        (high, low),
        (0.0,),
        (*(float(drive[0]) + deviations).tolist(),),
        *((end, level) for end in (low, high, 0.0) for level in single),
        *((end, a, b) for end in (low, high) for a in pair for b in pair if a != b),
        *random,
    )


def shared_hypotheses(
    drives: Sequence[Array], rest_drive: float
) -> tuple[tuple[Reversals, ...], ...]:
    """Return hypotheses of earlier reversals for the drives of all recordings.

    Either every drive has the same history, or the first drive has it and each further drive
    continues where the previous one ended. A periodic drive may have started long before its
    recording.

    rest_drive  the drive at 0 V
    """
    deliberate = []
    for drive in drives:
        usual = hypotheses(drive)[:DELIBERATE]
        deliberate.append((*usual, *((*cycled, rest_drive) for cycled in usual[:2])))
    extremes = [np.array(_remaining_reversals((), drive)) for drive in drives]
    earlier_cycles = [_earlier_cycle(drive) for drive in drives]
    candidates: list[tuple[Reversals, ...]] = []
    for has_cycles in (False, True) if any(earlier_cycles) else (False,):
        cycles = earlier_cycles if has_cycles else [()] * len(drives)
        candidates += [
            tuple(map(_before_cycle, reversals, cycles))
            for reversals in zip(*deliberate, strict=True)
        ]
        for reversals in deliberate[0]:
            histories = [_before_cycle(reversals, cycles[0])]
            for previous, cycle in zip(extremes[:-1], cycles[1:], strict=True):
                end = _remaining_reversals(histories[-1], previous)
                histories.append(_before_cycle(end, cycle))
            candidates.append((*histories,))
    return tuple(candidates)


def _earlier_cycle(drive: Array) -> Reversals:
    """Return the two reversals before a periodic drive; empty if the drive is not periodic."""
    low, high = float(drive.min()), float(drive.max())
    margin = AT_END * (high - low)
    at_end = np.flatnonzero((drive < low + margin) | (drive > high - margin))
    is_high = drive[at_end] > 0.5 * (low + high)
    arrivals = at_end[1:][is_high[1:] != is_high[:-1]]  # at the opposite end
    if len(arrivals) < 2 * MIN_CYCLES:
        return ()
    if arrivals[1] * (len(arrivals) - 1) > 2.0 * MAX_FIRST_CYCLE * arrivals[-1]:
        return ()
    starts_at_end = at_end[0] == 0
    return (high, low) if is_high[0] != starts_at_end else (low, high)


def _before_cycle(reversals: Reversals, cycle: Reversals) -> Reversals:
    return _remaining_reversals(reversals, np.array(cycle)) if cycle else reversals


def _remaining_reversals(reversals: Reversals, drive: Array) -> Reversals:
    """Return the reversals that a drive after them does not wipe out, and its last value.

    Going back in time, each of them exceeds all later ones. The last value may become a reversal.
    """
    path = np.array([*reversals, *drive])[::-1]
    higher = np.diff(np.maximum.accumulate(path)) > 0.0
    lower = np.diff(np.minimum.accumulate(path)) < 0.0
    extrema = np.flatnonzero(higher | lower)
    if not len(extrema):  # neither the drive nor the reversals before it move
        return (float(path[0]),)
    outermost = np.append(higher[extrema][1:] != higher[extrema][:-1], True)
    return (*path[1:][extrema[outermost]][::-1].tolist(), float(path[0]))


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
        return states_on(*self.track.path, self.reversals)

    @Once
    def states(self) -> States:
        """Return the states at every sample, (samples, plays) and (samples, friction states)."""
        if self.origin is not None:
            return self.origin.states
        return states_along(self.track.drive, self.reversals)

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


def states_along(drive: Array, reversals: Reversals) -> States:
    """Return the states at every value of a drive after earlier reversals."""
    plays, _ = play_columns(drive, THRESHOLD, memory_after(drive, reversals))
    return plays, friction_along(drive, initial_friction(drive, reversals))


def states_on(path: Array, rows: Places, reversals: Reversals) -> States:
    """Return the states at rows of a thinned drive after earlier reversals."""
    # rows of a column-major matrix, in column-major order
    plays, friction = (np.take(s.T, rows, axis=1).T for s in states_along(path, reversals))
    return plays, friction


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

    def columns_behind(self, filtered: Callable[[Array, float], Array]) -> Array:
        """Return the columns at all rows, the shared ones behind a linear filter.

        filtered  (signals, rate_Hz) -> filtered signals, (samples, columns)

        Long tracks are filtered in chunks, each from a chunk earlier on.
        """
        columns = self.columns.copy(order="F")
        for k, (track, history) in enumerate(zip(self.tracks, self.histories, strict=True)):
            plays, friction = history.states
            for first in range(0, len(track.drive), CHUNK):
                inside = slice(*np.searchsorted(track.rows, (first, first + CHUNK)).tolist())
                if inside.start == inside.stop:
                    continue
                start = max(first - CHUNK, 0)
                span = slice(start, first + CHUNK)
                drive = track.drive[span]
                signals = np.empty((len(drive), self.shared), order="F")
                write_shared_columns(signals[:, :SHARED], plays[span], friction[span], drive)
                if self.bouc_wen:
                    signals[:, SHARED:] = bouc_wen_columns(self._bouc_wen_states[k][span], drive)
                rows = slice(self.edges[k] + inside.start, self.edges[k] + inside.stop)
                columns[rows, : self.shared] = filtered(signals, track.rate_Hz)[
                    track.rows[inside] - start
                ]
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
