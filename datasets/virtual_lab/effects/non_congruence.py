"""Non-congruence: equal minor loops have different shapes at different biases.

Domain walls are more mobile at one end of the range than at the other, so the irreversible strain
has wider loops there:

    w + c E (w - m(E)),      m the middle line of the major loop, E from -1 to 1

Loops between the same two fields then depend on the history, which no Preisach operator allows.
The mobility increases at the end at which the loops are already wider, because the opposite
sign would compensate the asymmetry of a pinned ceramic.

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
BIAS, HALF_SPAN = 0.5, 0.25  # of the loops that tell at which end walls are freer
CYCLES, STEPS = 6, 100  # after which a loop closes; of each branch


def install(size_m: float, bench: Bench, _: np.random.Generator) -> Fault:
    """Increase the mobility at the end with wider loops, and scale the effect."""
    field, middle = middle_line(bench.ceramic)

    def opened(irreversible: Array, at: Array) -> Array:
        return at * (irreversible - np.interp(at, field, middle))

    unit = [
        bench.rig.stroke_m * opened(trace.irreversible, trace.scene.field)
        for trace in bench.traces
    ]
    size_m *= freer_end(bench.ceramic)
    freedom = proportional(size_m, EFFECT.measure, unit, why="no loop is opened")
    act = Act(
        name=EFFECT.name,
        place=Place.IRREVERSIBLE,
        change=lambda still, scene, _: still + freedom * opened(still, scene.field),
    )
    return Fault(acts=(act,), numbers={"opening_per_field": freedom})


def middle_line(ceramic: Ceramic) -> tuple[Array, Array]:
    """Return field and mean of both branches of the irreversible part of the major loop."""
    up = np.linspace(-1.0, 1.0, POINTS)
    _, loop = ceramic.respond(np.concatenate((up[::-1], up)), np.array([-1.0, 1.0]))
    return up, 0.5 * (loop[:POINTS][::-1] + loop[POINTS:])


def freer_end(ceramic: Ceramic) -> float:
    """Return the end of the range at which loops of one span are wider, -1 or 1."""
    return 1.0 if opening_at(ceramic, BIAS) >= opening_at(ceramic, -BIAS) else -1.0


def opening_at(ceramic: Ceramic, bias: float) -> float:
    """Return the width of a closed small loop in the middle of its span at a bias."""
    corners = np.tile([-HALF_SPAN, HALF_SPAN], CYCLES)
    place = np.arange((2 * CYCLES - 1) * STEPS + 1) / STEPS
    path = bias + np.interp(place, np.arange(2 * CYCLES), corners)
    _, loop = ceramic.respond(path, np.array([-1.0, 1.0]))
    up, down = loop[-STEPS // 2 - 1], loop[-3 * STEPS // 2 - 1]
    return float(abs(up - down))


EFFECT = Effect(
    name="non_congruence",
    measure=Measure.RMS,
    visible_percent=0.3,
    shown_by=("sweep", "check"),
    install=install,
)
