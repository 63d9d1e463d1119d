"""What other axes' drives could add to the rows of this one."""

import numpy as np

from piezoid.diagnosis.view import View
from piezoid.numerics.arrays import Array
from piezoid.operators.play import play_columns

GAPS = np.array([0.2, 0.5, 0.8])  # of another axis' half range: thresholds of its plays


def answers_of_others(view: View, *, backwards: bool = False) -> Array:
    """Return each other axis' drive, its square and its plays, (rows, columns).

    backwards  the same drives run backwards in time, which nothing can answer to
    """
    axes = sorted({axis for track in view.tracks for axis in track.others})
    parts = [np.zeros((len(view.response), 0))]
    return np.column_stack([*parts, *(_answer(view, axis, backwards) for axis in axes)])


def _answer(view: View, axis: str, backwards: bool) -> Array:
    columns = np.zeros((len(view.response), 2 + len(GAPS)))
    edges = view.nuisance.edges
    for k, track in enumerate(view.tracks):
        if axis not in track.others:
            continue
        drive = track.others[axis][:: -1 if backwards else 1]
        plays, _ = play_columns(drive, GAPS, np.full(len(GAPS), drive[0]))
        part = np.column_stack([drive, drive**2, plays])[track.place]
        columns[edges[k] : edges[k + 1]] = part
    return columns
