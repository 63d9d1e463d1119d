"""Pasts: histories of a drive before its first sample, and the memory they leave."""

from collections.abc import Sequence

import numpy as np

from piezoid.diagnosis.shape import PLAYS, THRESHOLD
from piezoid.numerics.arrays import Array
from piezoid.operators.play import play_columns

PASTS = 16
ONCE, TWICE = 9, 5  # places of turns to try
Turns = tuple[float, ...]


def past(drive: Array, turns: Sequence[float]) -> Array:
    """Return the memory a drive leaves that turned at these values before the first sample."""
    way = np.array([*turns, float(drive[0])])
    return play_columns(way, THRESHOLD, np.zeros(PLAYS))[1]


def pasts(drive: Array) -> tuple[Turns, ...]:
    """Return histories to choose from: cycled over the range first, then what people do instead.

    They come from rest or from one end, and turn once or twice more, or at random.
    """
    low, high = min(-1.0, float(drive.min())), max(1.0, float(drive.max()))
    once = np.linspace(low, high, ONCE + 2)[1:-1].tolist()
    twice = np.linspace(low, high, TWICE + 2)[1:-1].tolist()
    chance = np.random.default_rng(PASTS)
    drawn = [
        (*chance.uniform((-0.3, -1, -0.3, -1, -0.3, -1), (1, 0.3, 1, 0.3, 1, 0.3)).tolist(),)
        for _ in range(PASTS)
    ]
    return (
        (low, high),
        (high, low),
        (0.0,),
        *((end, turn) for end in (low, high, 0.0) for turn in once),
        *((end, a, b) for end in (low, high) for a in twice for b in twice if a != b),
        *drawn,
    )
