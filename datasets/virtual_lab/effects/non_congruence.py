"""Non-congruence: the same minor loop has another shape at another bias.

Domain walls are freer at one end of the range than at the other, so what is irreversible opens
more there:

    w + c E (w - m(E)),      m the middle line of the major loop, E from -1 to 1

Loops between the same two fields then differ with what went before, which no Preisach operator
allows. Walls become freer at the end at which loops are wider anyhow: a pinned ceramic opens to
one end by itself, and what works against that would hide what it is meant to show.

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
    """Let walls be freer at the end at which they are, and scale."""
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
    """Return (field, mean of the two branches of the major loop's irreversible part)."""
    up = np.linspace(-1.0, 1.0, POINTS)
    _, loop = ceramic.respond(np.concatenate((up[::-1], up)), np.array([-1.0, 1.0]))
    return up, 0.5 * (loop[:POINTS][::-1] + loop[POINTS:])


def freer_end(ceramic: Ceramic) -> float:
    """Return the end at which loops of one span are wider, -1 or 1."""
    return 1.0 if opening_at(ceramic, BIAS) >= opening_at(ceramic, -BIAS) else -1.0


def opening_at(ceramic: Ceramic, bias: float) -> float:
    """Return how wide a small loop about a bias is in its middle, once it closes."""
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
