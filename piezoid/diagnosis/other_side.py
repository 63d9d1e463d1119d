"""In front of the hysteresis or behind it: where a filter stands.

An amplifier that charges the ceramic slowly rounds the turns of the drive before walls see them, a
sensor's filter those of what walls have done. What the one leaves of the other looks like walls
that need time.
"""

from dataclasses import replace

from piezoid.diagnosis.candidate import Candidate
from piezoid.diagnosis.extended import SelectedEffect
from piezoid.diagnosis.refinement import refined
from piezoid.diagnosis.shortlist import SelectionContext

CLEARLY = 0.98  # of the error that another place leaves, or another effect beside it


def moved_to_other_side(
    beside: SelectionContext, best: Candidate | None
) -> tuple[SelectedEffect, ...] | None:
    """Return what was selected with one on the other side of the hysteresis, where it fits better.

    best  what else is evidence: asked is for one that looks like it, or for any where nothing is
    """
    for k, one in enumerate(beside.selected):
        other = one.effect.other_side
        if other is None or not (best is None or one.effect.resembles(best.effect)):
            continue
        rest = [*beside.selected[:k], *beside.selected[k + 1 :]]
        there, view = refined(replace(one, effect=other), beside.clean, rest, finer=1)
        if view.rms < CLEARLY * min(beside.view.rms, best.view.rms if best else beside.view.rms):
            return (*beside.selected[:k], there, *beside.selected[k + 1 :])
    return None
