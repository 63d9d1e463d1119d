"""Non-congruence: the same minor loop has another shape at another bias.

Domain walls are freer at one end of the range than at the other, so what is irreversible opens
more there:

    w + c E (w - m(E)),      m the middle line of the major loop, E from -1 to 1

Loops of equal span at different bias then differ, which no Preisach operator allows.

Source: Mayergoyz, Mathematical Models of Hysteresis (1991), the nonlinear (input-dependent) model.
"""

import numpy as np

from piezoid_datasets.virtual_lab.effects.effect import (
    Act,
    Bench,
    Effect,
    Fault,
    Measure,
    Place,
)
from piezoid_datasets.virtual_lab.effects.sizing import proportional
from piezoid_datasets.virtual_lab.signals import Array
from piezoid_datasets.virtual_lab.truths.truth import Ceramic

POINTS = 401


def install(size_m: float, bench: Bench, rng: np.random.Generator) -> Fault:
    """Draw the end at which walls are freer, and scale."""
    field, middle = middle_line(bench.ceramic)

    def opened(irreversible: Array, at: Array) -> Array:
        return at * (irreversible - np.interp(at, field, middle))

    unit = [
        bench.rig.stroke_m * opened(trace.irreversible, trace.scene.field)
        for trace in bench.traces
    ]
    size_m *= float(rng.choice([-1.0, 1.0]))
    freedom = proportional(size_m, EFFECT.measure, unit, why="no loop is opened")
    act = Act(
        name=EFFECT.name,
        place=Place.IRREVERSIBLE,
        change=lambda still, scene, _: still + freedom * opened(still, scene.field),
    )
    return Fault(acts=(act,), numbers={"opening_per_field": freedom})


def middle_line(ceramic: Ceramic) -> tuple[Array, Array]:
    """Return (field, mean of the two branches of the major loop's irreversible part)."""
    up = np.linspace(-1.0, 1.0, POINTS)
    _, loop = ceramic.respond(np.concatenate((up[::-1], up)), np.array([-1.0, 1.0]))
    return up, 0.5 * (loop[:POINTS][::-1] + loop[POINTS:])


EFFECT = Effect(
    name="non_congruence",
    measure=Measure.RMS,
    visible_percent=0.3,
    shown_by=("sweep", "check"),
    install=install,
)
