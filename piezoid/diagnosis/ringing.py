"""Ringing: what drives a mode, from recordings that hardly ring themselves.

A drive that repeats puts its harmonics on a mode, and plays follow ringing that repeats as if it
were hysteresis. A mode as sharp as Q makes Q times as much of what they followed, so columns made
of that fit lead away from the mode. Slow recordings know the hysteresis without it; where there
are none, a curve of the drive, which cannot ring, is nearer to what drives the mode.
"""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np

from piezoid.diagnosis.folds import Null
from piezoid.diagnosis.view import View
from piezoid.numerics.arrays import Array

CURVE = 3  # degree
CALM = 0.03  # of the power of the recording that rings most
FEWEST = 2  # rows for a column


def without_memory(view: View) -> View:
    """Return the view with curves of the drive for static responses, where none were given."""
    if view.guess is not None:
        return view
    drive, static = view.of(lambda _, t: t.drive), view.rows(view.static)
    curve = np.polyfit(drive, static, CURVE)
    return replace(view, guess=tuple(np.asarray(np.polyval(curve, t.drive)) for t in view.tracks))


def undisturbed(view: View, rung: Callable[[View], Array]) -> View:
    """Return the view with static responses that know nothing of ringing, where none were given.

    rung  (view) -> what rings there, (rows, columns)
    """
    if view.guess is not None:
        return view
    plain = without_memory(view)
    power = np.sum(rung(plain) ** 2, axis=1)
    edges = view.nuisance.edges
    mean = np.array([power[a:b].mean() for a, b in pairwise(edges)])
    calm = np.repeat(mean < CALM * mean.max(), np.diff(edges))
    columns = view.nuisance.columns
    if np.count_nonzero(calm) < FEWEST * columns.shape[1]:
        return plain
    null = Null(columns=columns[calm], response=view.response[calm], block=view.block[calm])
    weight = null.fit(null.response)[: view.nuisance.shared]
    static = [view.nuisance.static(k, weight) for k in range(len(view.tracks))]
    return replace(view, guess=tuple(static))
