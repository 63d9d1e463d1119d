"""Hypotheses of earlier reversals of a drive, and the initial states after them.

Of all that a drive did, later turns wipe out those between them.

Source: Krejci (1996); Mayergoyz (1991) on wiping out.
"""

from collections.abc import Sequence

import numpy as np

from piezoid.diagnosis.nuisance_columns import PLAYS, THRESHOLD
from piezoid.numerics.arrays import Array
from piezoid.operators.play import play_columns

RANDOM_HYPOTHESES = 16
ONCE, TWICE = 9, 5  # places of turns to try
FREE = 4  # number of deliberate histories that do not depend on 0 V
DECAYING = 24  # turns that end at rest
ROUND = 0.03  # of a drive's span: so near an end it has come there
ROUNDS = 3  # that show that a drive goes round
SAME = 1.4  # times the mean round: a first one that is longer begins a sweep of the frequency
Reversals = tuple[float, ...]


def memory_after(drive: Array, reversals: Sequence[float]) -> Array:
    """Return the play memory at the first sample after these reversals of the drive."""
    path = np.array([*reversals, float(drive[0])])
    return play_columns(path, THRESHOLD, np.zeros(PLAYS))[1]


def hypotheses(drive: Array) -> tuple[Reversals, ...]:
    """Return hypotheses of earlier reversals, cycles over the full range first.

    The others: cycles in the opposite order, rest, decaying cycles about the first value, one or
    two reversals after rest or an end of the range, and random reversals.
    """
    low, high = min(-1.0, float(drive.min())), max(1.0, float(drive.max()))
    once = np.linspace(low, high, ONCE + 2)[1:-1].tolist()
    twice = np.linspace(low, high, TWICE + 2)[1:-1].tolist()
    chance = np.random.default_rng(RANDOM_HYPOTHESES)
    random = [
        (*chance.uniform((-0.3, -1, -0.3, -1, -0.3, -1), (1, 0.3, 1, 0.3, 1, 0.3)).tolist(),)
        for _ in range(RANDOM_HYPOTHESES)
    ]
    return (
        (low, high),
        (high, low),
        (0.0,),
        _decaying(float(drive[0])),
        *((end, turn) for end in (low, high, 0.0) for turn in once),
        *((end, a, b) for end in (low, high) for a in twice for b in twice if a != b),
        *random,
    )


def _decaying(about: float) -> Reversals:
    deviations = np.linspace(1.0, 0.0, DECAYING, endpoint=False)
    deviations[1::2] *= -1.0
    return (*(about + deviations).tolist(),)


def shared_hypotheses(
    drives: Sequence[Array], rest_drive: float
) -> tuple[tuple[Reversals, ...], ...]:
    """Return hypotheses of earlier reversals for the drives of all recordings.

    Either every drive has the same history, or the first one has it and each further drive
    continues where the previous one ended. A periodic drive may have started long before its
    recording.

    rest_drive  the drive at 0 V
    """
    single_drive = [_on_purpose(drive, rest_drive) for drive in drives]
    extremes = [
        np.array(_left_by((), drive)) for drive in drives
    ]  # extremes that a later drive depends on
    rounds = [_round_of(drive) for drive in drives]
    candidates: list[tuple[Reversals, ...]] = []
    for led in (False, True) if any(rounds) else (False,):
        lead = rounds if led else [()] * len(drives)
        candidates += [
            tuple(map(_led, reversals, lead)) for reversals in zip(*single_drive, strict=True)
        ]
        candidates += [
            _one_after_another(reversals, extremes, lead) for reversals in single_drive[0]
        ]
    return tuple(candidates)


def _round_of(drive: Array) -> Reversals:
    """Return the two reversals before a periodic drive; empty if the drive is not periodic."""
    low, high = float(drive.min()), float(drive.max())
    margin = ROUND * (high - low)
    at_end = np.flatnonzero((drive < low + margin) | (drive > high - margin))
    above = drive[at_end] > 0.5 * (low + high)
    crossed = at_end[1:][above[1:] != above[:-1]]  # arrivals at the opposite end
    if len(crossed) < 2 * ROUNDS or crossed[1] * (len(crossed) - 1) > 2.0 * SAME * crossed[-1]:
        return ()
    began_there = at_end[0] == 0
    return (high, low) if above[0] != began_there else (low, high)


def _led(reversals: Reversals, lead: Reversals) -> Reversals:
    return _left_by(reversals, np.array(lead)) if lead else reversals


def _on_purpose(drive: Array, rest_drive: float) -> tuple[Reversals, ...]:
    free = hypotheses(drive)[:FREE]
    return (*free, *((*cycled, rest_drive) for cycled in free[:2]))


def _one_after_another(
    reversals: Reversals, extremes: Sequence[Array], lead: Sequence[Reversals]
) -> tuple[Reversals, ...]:
    histories = [_led(reversals, lead[0])]
    for end, first in zip(extremes[:-1], lead[1:], strict=True):
        histories.append(_led(_left_by(histories[-1], end), first))
    return (*histories,)


def _left_by(reversals: Reversals, drive: Array) -> Reversals:
    """Return the reversals that no later one has wiped out, and the last value.

    Going back in time, each of them exceeds all later ones. The last value may become a reversal.
    """
    path = np.array([*reversals, *drive])[::-1]
    higher = np.diff(np.maximum.accumulate(path)) > 0.0
    lower = np.diff(np.minimum.accumulate(path)) < 0.0
    extrema = np.flatnonzero(higher | lower)
    outermost = np.append(higher[extrema][1:] != higher[extrema][:-1], True)
    return (*path[1:][extrema[outermost]][::-1].tolist(), float(path[0]))
