"""The simulation's own error before and after, on rows left out, where no model is at hand.

With a fitted model that one is refitted, by ``refit``; this stand-in is linear and quicker. It is
a modified Prandtl-Ishlinskii model,

    y = h + sum_j v_j S_j(h) + zero and memory of the track,     h = sum_i w_i z_i,

S_j dead zones, on fixed dense thresholds so that weights alone are fitted, with the columns of the
selected effects beside it. The dead zones act on the h of a first fit, and both sets of weights
are then free: one linear problem, refitted fold by fold.

Source: Kuhnen, Eur. J. Control 9 (2003).
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from piezoid.diagnosis.extended import extended
from piezoid.diagnosis.folds import Null
from piezoid.diagnosis.shape import PLAYS
from piezoid.diagnosis.something_else import NAME, Explained, with_it
from piezoid.diagnosis.view import View
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array

KINKS = (-0.75, -0.5, -0.25, 0.25, 0.5, 0.75)


@dataclass(frozen=True, kw_only=True)
class Simulated:
    """Errors on rows left out, in scaled units.

    baseline  of the raw recordings
    final     with everything found
    without   with everything found but one, by its name
    model     what ships with everything found; None where no model was at hand
    """

    baseline: float
    final: float
    without: Mapping[str, float]
    model: AxisModel | None = None


def simulated(found: Explained) -> Simulated:
    """Return the simulation's errors before, after, and without each thing that was found."""
    outcome = found.outcome
    selected = [cause.selected for cause in outcome.causes if cause.selected.is_active]
    baseline = error_of(found.raw)
    final = error_of(outcome.final)
    structural = [cause for cause in outcome.causes if not cause.selected.is_active]
    without = {
        f.effect.name: final / (1.0 - float(np.clip(f.cv.gain, 0, 0.99))) for f in structural
    }
    for one in selected:
        rest = [other for other in selected if other is not one]
        without[one.effect.name] = error_of(extended(outcome.clean, rest))
    if outcome.faults:
        raw = error_of(extended(outcome.first, selected))
        without |= dict.fromkeys(outcome.faults, raw)
    if found.discovered is not None:
        whole = with_it(outcome.clean, found.discovered)
        without[NAME] = error_of(extended(whole, selected))
    return Simulated(baseline=baseline, final=final, without=without)


def error_of(view: View) -> float:
    """Return the rms the simulation leaves with the view's selected columns, on rows left out."""
    plays = view.nuisance.columns[:, : PLAYS + 1]
    own = _own(view)
    # without the effects: a change of gain would stand for h itself
    null = Null(columns=np.hstack([plays, own]), response=view.response, block=view.block)
    h = plays @ null.fit(view.response)[: plays.shape[1]]
    zones = np.column_stack([np.sign(k) * np.maximum(np.sign(k) * (h - k), 0) for k in KINKS])
    columns = np.hstack([plays, zones[:, np.abs(zones).max(axis=0) > 0.0], own])
    columns = np.hstack([columns, view.selected])
    return Null(columns=columns, response=view.response, block=view.block).held_out_rms


def _own(view: View) -> Array:
    """Return zero and memory of every track."""
    nuisance = view.nuisance
    kept = [
        nuisance.shared + nuisance.own * k + j
        for k in range(len(view.tracks))
        for j in range(nuisance.own)
    ]
    columns = nuisance.columns[:, kept]
    return np.asarray(columns[:, np.abs(columns).max(axis=0) > 0.0])
