"""Cross coupling: the motion of another axis moves this axis.

Mechanical: the other ceramic, with its own hysteresis, acts through a misalignment of the
flexures, ``x + c x_other``. Electrical: the voltage of the other amplifier leaks into the output
of this amplifier, ``V + c V_other``, before the hysteresis of this axis.

Source: Devasia, Eleftheriou & Moheimani, IEEE TCST 15 (2007), section on coupling.
"""

import numpy as np

from piezoid_datasets.virtual_lab.effects.effect import (
    Act,
    Bench,
    Effect,
    Fault,
    Measure,
    Place,
    Scene,
)
from piezoid_datasets.virtual_lab.effects.sizing import proportional
from piezoid_datasets.virtual_lab.signals import Array
from piezoid_datasets.virtual_lab.truths.return_point import draw_preisach

WHY = "no other axis is driven"
AT_REST = np.array([1.0, -1.0])  # the other axis was cycled before the recording


def install(size_m: float, bench: Bench, rng: np.random.Generator) -> Fault:
    """Draw the path and the sign of the coupling, and scale it."""
    sign = float(rng.choice([-1.0, 1.0]))
    if rng.random() < 0.5:
        return _electrical(sign * size_m, bench)
    other = draw_preisach(rng)

    def moved(scene: Scene) -> Array:
        total = np.zeros_like(scene.time_s)
        for voltage_V in scene.others_V.values():
            reversible, irreversible = other.respond(scene.rig.field_of(voltage_V), AT_REST)
            total += scene.rig.stroke_m * (reversible + irreversible)
        return total

    unit = [moved(trace.scene) for trace in bench.traces]
    factor = proportional(sign * size_m, EFFECT.measure, unit, why=WHY)
    act = Act(
        name=EFFECT.name,
        place=Place.MECHANICS,
        change=lambda stage_m, scene, _: stage_m + factor * moved(scene),
    )
    return Fault(acts=(act,), numbers={"path": "mechanical", "coupling": factor})


def _electrical(size_m: float, bench: Bench) -> Fault:
    def leaked(scene: Scene) -> Array:
        total = np.zeros_like(scene.time_s)
        for voltage_V in scene.others_V.values():
            total += voltage_V
        return total

    range_V = bench.rig.amplifier_gain_V_per_V * (bench.rig.drive_max_V - bench.rig.drive_min_V)
    unit = [bench.rig.stroke_m / range_V * leaked(trace.scene) for trace in bench.traces]
    factor = proportional(size_m, EFFECT.measure, unit, why=WHY)
    act = Act(
        name=EFFECT.name,
        place=Place.OUTPUT,
        change=lambda output_V, scene, _: output_V + factor * leaked(scene),
    )
    return Fault(acts=(act,), numbers={"path": "electrical", "coupling": factor})


EFFECT = Effect(
    name="cross_coupling",
    measure=Measure.RMS,
    visible_percent=0.2,
    shown_by=("other_axis",),
    install=install,
)
