"""Consistency: a filter of the chain is the same in every recording that can show it.

At the fitted time each track may have a time of its own,

    y = h(t - tau) + sum_k d_k dh/dtau [track k],

and a d_k that surely differs from none by a good part of tau belongs to that recording alone: a
slip of its clock, say, and no delay of the stage.
"""

import numpy as np

from piezoid.diagnosis.extended import SelectedEffect, offset_of
from piezoid.diagnosis.refinement import stepped
from piezoid.diagnosis.view import View

NUDGE = 0.1  # of a parameter's width
TELLING = 0.15  # of the longest column: what a track's column must keep beside the null
APART = 0.35  # of the fitted time
SURE = 4.0  # standard errors


def is_consistent(one: SelectedEffect, view: View) -> bool:
    """Tell whether no track asks for a clearly different time than the fitted one."""
    name = next(iter(one.free))
    there = stepped(one, name, NUDGE)
    ratio = there.parameters[name] / one.parameters[name] - 1.0
    change = offset_of(view, [there]) - offset_of(view, [one])
    edges = view.nuisance.edges
    columns = np.column_stack(
        [
            view.of_track(k, change[edges[k] : edges[k + 1]] / ratio)
            for k in range(len(view.tracks))
        ]
    )
    length = np.linalg.norm(view.null.without(columns), axis=0)
    columns = columns[:, length > TELLING * length.max()]
    across = view.null.without(columns)
    apart = np.linalg.lstsq(across, view.null.residual, rcond=1e-9)[0]
    error = np.sqrt(np.diag(view.null.doubt(columns)))
    return not bool(np.any((np.abs(apart) > APART) & (np.abs(apart) > SURE * error)))
