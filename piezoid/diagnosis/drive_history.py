"""Drive history: reversals before a track, and the hysteresis states along it.

Rate-independent hysteresis depends on the reversals of the drive and not on its course between
them. The states at rows are therefore computed from the drive at these rows and at its reversals.
A reversal wipes out all earlier reversals that it exceeds. Those before a recording are unknown,
and are compared as hypotheses.

Source: Krejci (1996); Mayergoyz (1991) on rate independence and wiping out.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from piezoid.diagnosis.nuisance_columns import (
    PLAYS,
    SHARED,
    THRESHOLD,
    friction_along,
    initial_friction,
    shared_response,
)
from piezoid.diagnosis.segments import Places, Track
from piezoid.numerics.arrays import Array
from piezoid.numerics.executor import Once
from piezoid.operators.play import play_columns

RANDOM_HYPOTHESES = 16
SINGLE_LEVELS, PAIR_LEVELS = 9, 5  # levels of one reversal, and of each of two
DELIBERATE = 4  # first hypotheses: histories as laboratories make them
DECAYING = 24  # reversals of a cycle that decays to rest
AT_END = 0.03  # of a drive's span: distance from an end below which the drive reaches it
MIN_CYCLES = 3  # of a periodic drive
MAX_FIRST_CYCLE = 1.4  # over the mean cycle: a longer first cycle begins a sweep of the frequency
Reversals = tuple[float, ...]
CHUNK = 65536
POLING_LEVELS = (0.0, 0.5)  # of half the range: drives from which walls move irreversibly
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
