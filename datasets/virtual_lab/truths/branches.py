"""Divide a path into monotone branches, which are computed without a Python loop."""

import itertools
from collections.abc import Iterator

import numpy as np

from piezoid_datasets.virtual_lab.signals import Array

ROUNDING = 13  # decimals of the field; the last bit of a filter's output is not a reversal


def settled(field: Array) -> Array:
    """Return the field without rounding noise, which would create reversals."""
    return np.round(field, ROUNDING)


def branches(path: Array) -> Iterator[tuple[int, int, bool]]:
    """Yield ``(start, end, rising)`` of each monotone branch; neighbours share a sample.

    Pauses belong to the preceding branch; a constant path has no branch.
    """
    steps = np.sign(np.diff(path))
    moving = np.flatnonzero(steps)
    if len(moving) == 0:
        return
    turns = moving[1:][steps[moving[1:]] != steps[moving[:-1]]]
    edges = [0, *turns.tolist(), len(path) - 1]
    rising = bool(steps[moving[0]] > 0)
    for start, end in itertools.pairwise(edges):
        yield start, end, rising
        rising = not rising
