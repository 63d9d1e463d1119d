"""In front of the hysteresis or behind it: where a filter stands.

An amplifier that charges the ceramic slowly rounds the turns of the drive before walls see them, a
sensor's filter those of what walls have done. What the one leaves of the other looks like walls
that need time.
"""

from dataclasses import replace

from piezoid.diagnosis.candidates import Beside
from piezoid.diagnosis.extended import Accepted
from piezoid.diagnosis.judgement import Judged
from piezoid.diagnosis.refinement import refined

CLEARLY = 0.98  # of the error that another place leaves, or another effect beside it


def placed_elsewhere(beside: Beside, best: Judged | None) -> tuple[Accepted, ...] | None:
    """Return what was accepted with one on the other side of the hysteresis, where it fits better.

    best  what else is evidence: asked is for one that looks like it, or for any where nothing is
    """
    for k, one in enumerate(beside.accepted):
        other = one.effect.elsewhere
        if other is None or not (best is None or one.effect.resembles(best.effect)):
            continue
        rest = [*beside.accepted[:k], *beside.accepted[k + 1 :]]
        there, view = refined(replace(one, effect=other), beside.clean, rest, finer=1)
        if view.rms < CLEARLY * min(beside.view.rms, best.view.rms if best else beside.view.rms):
            return (*beside.accepted[:k], there, *beside.accepted[k + 1 :])
    return None
