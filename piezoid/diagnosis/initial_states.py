"""Pasts: histories of a drive before its first sample, and the memory they leave.

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
FREE = 4  # of the histories are what a laboratory does on purpose wherever 0 V lies
DECAYING = 24  # turns that end at rest
ROUND = 0.03  # of a drive's span: so near an end it has come there
ROUNDS = 3  # that show that a drive goes round
SAME = 1.4  # times the mean round: a first one that is longer begins a sweep of the frequency
Reversals = tuple[float, ...]


def memory_after(drive: Array, reversals: Sequence[float]) -> Array:
    """Return the memory a drive leaves that turned at these values before the first sample."""
    way = np.array([*reversals, float(drive[0])])
    return play_columns(way, THRESHOLD, np.zeros(PLAYS))[1]


def hypotheses(drive: Array) -> tuple[Reversals, ...]:
    """Return histories to choose from, cycled over the range first, then what people do instead.

    They cycle the other way, come from rest, or from ever smaller turns about the first value.
    Or they come from rest or from one end, and turn once or twice more, or at random.
    """
    low, high = min(-1.0, float(drive.min())), max(1.0, float(drive.max()))
    once = np.linspace(low, high, ONCE + 2)[1:-1].tolist()
    twice = np.linspace(low, high, TWICE + 2)[1:-1].tolist()
    chance = np.random.default_rng(RANDOM_HYPOTHESES)
    drawn = [
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
        *drawn,
    )


def _decaying(about: float) -> Reversals:
    away = np.linspace(1.0, 0.0, DECAYING, endpoint=False)
    away[1::2] *= -1.0
    return (*(about + away).tolist(),)


def shared_hypotheses(drives: Sequence[Array], rest: float) -> tuple[tuple[Reversals, ...], ...]:
    """Return what was done before drives by a laboratory that does it always alike.

    Before each of them, or before the first, and each goes on where the one before it ended. A
    drive that goes round and round may have begun with its recording, or long before.

    rest  the drive at 0 V, where a stage lies that nobody uses
    """
    known = [_on_purpose(drive, rest) for drive in drives]
    ends = [np.array(_left_by((), drive)) for drive in drives]  # all that later ones can know
    rounds = [_round_of(drive) for drive in drives]
    found: list[tuple[Reversals, ...]] = []
    for led in (False, True) if any(rounds) else (False,):
        lead = rounds if led else [()] * len(drives)
        found += [tuple(map(_led, reversals, lead)) for reversals in zip(*known, strict=True)]
        found += [_one_after_another(reversals, ends, lead) for reversals in known[0]]
    return tuple(found)


def _round_of(drive: Array) -> Reversals:
    """Return the last two turns of a drive that goes round and round, before it began."""
    low, high = float(drive.min()), float(drive.max())
    near = ROUND * (high - low)
    at_end = np.flatnonzero((drive < low + near) | (drive > high - near))
    above = drive[at_end] > 0.5 * (low + high)
    crossed = at_end[1:][above[1:] != above[:-1]]  # where it comes to the other end
    if len(crossed) < 2 * ROUNDS or crossed[1] * (len(crossed) - 1) > 2.0 * SAME * crossed[-1]:
        return ()
    began_there = at_end[0] == 0
    return (high, low) if above[0] != began_there else (low, high)


def _led(reversals: Reversals, lead: Reversals) -> Reversals:
    return _left_by(reversals, np.array(lead)) if lead else reversals


def _on_purpose(drive: Array, rest: float) -> tuple[Reversals, ...]:
    free = hypotheses(drive)[:FREE]
    return (*free, *((*cycled, rest) for cycled in free[:2]))


def _one_after_another(
    reversals: Reversals, ends: Sequence[Array], lead: Sequence[Reversals]
) -> tuple[Reversals, ...]:
    found = [_led(reversals, lead[0])]
    for end, first in zip(ends[:-1], lead[1:], strict=True):
        found.append(_led(_left_by(found[-1], end), first))
    return (*found,)


def _left_by(reversals: Reversals, drive: Array) -> Reversals:
    """Return the turns that nothing later wiped out: seen from the end, each goes farther.

    The end itself is one: the next drive may go either way from there.
    """
    way = np.array([*reversals, *drive])[::-1]
    higher = np.diff(np.maximum.accumulate(way)) > 0.0
    lower = np.diff(np.minimum.accumulate(way)) < 0.0
    places = np.flatnonzero(higher | lower)
    outermost = np.append(higher[places][1:] != higher[places][:-1], True)
    return (*way[1:][places[outermost]][::-1].tolist(), float(way[0]))
