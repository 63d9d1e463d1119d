"""Hypotheses of earlier reversals of a drive, and the initial states after them.

A reversal wipes out all earlier reversals that it exceeds.

Source: Krejci (1996); Mayergoyz (1991) on wiping out.
"""

from collections.abc import Sequence

import numpy as np

from piezoid.diagnosis.nuisance_columns import PLAYS, THRESHOLD
from piezoid.numerics.arrays import Array
from piezoid.operators.play import play_columns

RANDOM_HYPOTHESES = 16
SINGLE_LEVELS, PAIR_LEVELS = 9, 5  # levels of one reversal, and of each of two
DELIBERATE = 4  # first hypotheses: histories as laboratories make them
DECAYING = 24  # reversals of a cycle that decays to rest
AT_END = 0.03  # of a drive's span: distance from an end below which the drive reaches it
MIN_CYCLES = 3  # of a periodic drive
MAX_FIRST_CYCLE = 1.4  # over the mean cycle: a longer first cycle begins a sweep of the frequency
Reversals = tuple[float, ...]


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
    return (
        (low, high),
        (high, low),
        (0.0,),
        _decaying(float(drive[0])),
        *((end, level) for end in (low, high, 0.0) for level in single),
        *((end, a, b) for end in (low, high) for a in pair for b in pair if a != b),
        *random,
    )


def _decaying(middle: float) -> Reversals:
    deviations = np.linspace(1.0, 0.0, DECAYING, endpoint=False)
    deviations[1::2] *= -1.0
    return (*(middle + deviations).tolist(),)


def shared_hypotheses(
    drives: Sequence[Array], rest_drive: float
) -> tuple[tuple[Reversals, ...], ...]:
    """Return hypotheses of earlier reversals for the drives of all recordings.

    Either every drive has the same history, or the first drive has it and each further drive
    continues where the previous one ended. A periodic drive may have started long before its
    recording.

    rest_drive  the drive at 0 V
    """
    deliberate = [_deliberate_hypotheses(drive, rest_drive) for drive in drives]
    extremes = [np.array(_remaining_reversals((), drive)) for drive in drives]
    cycles = [_earlier_cycle(drive) for drive in drives]
    candidates: list[tuple[Reversals, ...]] = []
    for has_cycles in (False, True) if any(cycles) else (False,):
        cycle = cycles if has_cycles else [()] * len(drives)
        candidates += [
            tuple(map(_before_cycle, reversals, cycle))
            for reversals in zip(*deliberate, strict=True)
        ]
        candidates += [
            _continued_histories(reversals, extremes, cycle) for reversals in deliberate[0]
        ]
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


def _deliberate_hypotheses(drive: Array, rest_drive: float) -> tuple[Reversals, ...]:
    first = hypotheses(drive)[:DELIBERATE]
    return (*first, *((*cycled, rest_drive) for cycled in first[:2]))


def _continued_histories(
    reversals: Reversals, extremes: Sequence[Array], cycles: Sequence[Reversals]
) -> tuple[Reversals, ...]:
    """Return the histories of all drives if each drive continues where the previous one ended.

    extremes  reversals of each drive that a later drive depends on
    """
    histories = [_before_cycle(reversals, cycles[0])]
    for previous, cycle in zip(extremes[:-1], cycles[1:], strict=True):
        histories.append(_before_cycle(_remaining_reversals(histories[-1], previous), cycle))
    return (*histories,)


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
