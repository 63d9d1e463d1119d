"""Effects of the mechanics: modes, loads, other axes and expansion of the frame."""

import numpy as np

from piezoid_datasets.virtual_lab.effects.effect import (
    Bench,
    Fault,
    Measure,
    Place,
    Scene,
    Trace,
    bisected,
    effect,
    proportional,
)
from piezoid_datasets.virtual_lab.signals import Array, second_order
from piezoid_datasets.virtual_lab.truths.return_point import draw_preisach

MAIN_MODES_Hz = (120.0, 6000.0)
SIDE_MODES_Hz = (150.0, 600.0)
SETTLING_s = 2e-3  # of a change of the gain
AT_REST = np.array([1.0, -1.0])  # the other axis was cycled before the recording
BETWEEN_RECORDINGS_s = 120.0


@effect(0.15, shown_by=("chirp",))
def resonance(size_m: float, bench: Bench, rng: np.random.Generator) -> Fault:
    """Resonance: the stage is a mass on a spring and rings after fast drives.

        m'' + 2 z w m' + w^2 m = w^2 h,      x = (1 - p) h + p m

    with w = 2 pi f and a damping z of some per cent. Either the complete displacement passes
    through the main mode (p = 1; its frequency determines the size), or a side mode of the
    flexures at a lower frequency contributes a fraction p.

    Draw the damping and the type of mode; search for its frequency or its fraction.

    Source: any flexure stage's data sheet; Devasia, Eleftheriou & Moheimani, IEEE TCST 15 (2007).
    """
    damping = float(rng.uniform(0.01, 0.06))
    frequency_Hz = float(np.exp(rng.uniform(*np.log(SIDE_MODES_Hz))))

    def swing(trace: Trace, softness_s: float) -> Array:
        """Return the change of the displacement by a mode at the frequency ``1 / softness_s``."""
        still_m = trace.displacement_m
        return second_order(still_m, 1.0 / softness_s, damping, trace.scene.rate_Hz) - still_m

    unit = [swing(trace, 1.0 / frequency_Hz) for trace in bench.traces]
    share = proportional(size_m, unit, why="the stage does not move")
    if share > 1.0 or rng.random() < 0.5:
        share = 1.0
        frequency_Hz = 1.0 / bisected(
            size_m,
            bench.traces,
            swing,
            (1.0 / MAIN_MODES_Hz[1], 1.0 / MAIN_MODES_Hz[0]),
        )

    def ring(stage_m: Array, scene: Scene, _: np.random.Generator) -> Array:
        mode_m = second_order(stage_m, frequency_Hz, damping, scene.rate_Hz)
        return stage_m + share * (mode_m - stage_m)

    numbers = {"frequency_Hz": frequency_Hz, "damping": damping, "share": share}
    return Fault(Place.MECHANICS, ring, numbers)


@effect(0.8, shown_by=("sweep",), measure=Measure.PEAK)
def gain_change(size_m: float, bench: Bench, rng: np.random.Generator) -> Fault:
    """Gain change: at one instant the sensitivity of the stage changes permanently.

    A load is added, a connector moves, or a heater switches: the displacement is multiplied by
    ``1 + d`` from an instant in one recording on, including all later recordings.

    Draw the instant and the sign; scale to the size at the largest displacement after it.

    Source: spring load on a ceramic of finite stiffness, as in manufacturers' application notes.
    """
    order = int(rng.integers(len(bench.traces)))
    instant_s = float(rng.uniform(0.3, 0.7)) * float(bench.traces[order].scene.time_s[-1])
    sign = float(rng.choice([-1.0, 1.0]))

    def changed(scene: Scene) -> Array:
        if scene.order != order:
            return np.full_like(scene.time_s, float(scene.order > order))
        return -np.expm1(-np.maximum(scene.time_s - instant_s, 0.0) / SETTLING_s)

    farthest_m = max(
        float(np.max(np.abs(trace.displacement_m * changed(trace.scene))))
        for trace in bench.traces
    )
    gain = sign * size_m / farthest_m
    return Fault(
        Place.MECHANICS,
        lambda stage_m, scene, _: stage_m * (1.0 + gain * changed(scene)),
        {"relative_change": gain, "recording": float(order), "instant_s": instant_s},
    )


@effect(0.2, shown_by=("other_axis",))
def cross_coupling(size_m: float, bench: Bench, rng: np.random.Generator) -> Fault:
    """Cross coupling: the motion of another axis moves this axis.

    Mechanical: the other ceramic, with its own hysteresis, acts through a misalignment of the
    flexures, ``x + c x_other``. Electrical: the voltage of the other amplifier leaks into the
    output of this amplifier, ``V + c V_other``, before the hysteresis of this axis.

    Draw the path and the sign of the coupling, and scale it.

    Source: Devasia, Eleftheriou & Moheimani, IEEE TCST 15 (2007), section on coupling.
    """
    sign = float(rng.choice([-1.0, 1.0]))
    second_ceramic = None if rng.random() < 0.5 else draw_preisach(rng)

    def coupled(scene: Scene) -> Array:
        """Return the sum of the other voltages (electrical) or displacements (mechanical)."""
        total = np.zeros_like(scene.time_s)
        for voltage_V in scene.others_V.values():
            if second_ceramic is None:
                total += voltage_V
                continue
            reversible, irreversible = second_ceramic.respond(
                scene.rig.field_of(voltage_V), AT_REST
            )
            total += scene.rig.stroke_m * (reversible + irreversible)
        return total

    path, place, unit_m = "mechanical", Place.MECHANICS, 1.0
    if second_ceramic is None:
        rig = bench.rig
        range_V = rig.amplifier_gain_V_per_V * (rig.drive_max_V - rig.drive_min_V)
        path, place, unit_m = "electrical", Place.OUTPUT, rig.stroke_m / range_V
    unit = [unit_m * coupled(trace.scene) for trace in bench.traces]
    why = "no other axis is driven"
    factor = proportional(sign * size_m, unit, why=why)
    return Fault(
        place,
        lambda signal, scene, _: signal + factor * coupled(scene),
        {"path": path, "coupling": factor},
    )


@effect(0.2, shown_by=("long_hold", "staircase"))
def thermal_drift(size_m: float, bench: Bench, rng: np.random.Generator) -> Fault:
    """Thermal drift: expansion of the frame, independent of the drive.

    Three heat sources move the stage relative to its sensor: the electronics during warm-up (one
    exponential), the time of day (a straight line), and the air conditioning (a slow sine):

        d(t) = a (1 - exp(-t / tau)) + b t + c sin(2 pi t / P + phi)

    Time continues through the campaign; the sensor is zeroed before each recording.

    Draw the three sources and scale them together.

    Source: Kuhnen, Eur. J. Control 9 (2003) on what remains after hysteresis and creep are
    removed; heat conduction as in any laboratory.
    """
    warm_up_s = float(np.exp(rng.uniform(np.log(30.0), np.log(900.0))))
    period_s = float(rng.uniform(300.0, 1200.0))
    phase = float(rng.uniform(0.0, 2.0 * np.pi))
    shares = rng.uniform(0.3, 1.0, 3) * rng.choice([-1.0, 1.0], 3)

    def drift(scene: Scene) -> Array:
        start_s = scene.order * BETWEEN_RECORDINGS_s
        time_s = np.concatenate(([0.0], scene.time_s)) + start_s
        expansion = (
            shares[0] * -np.expm1(-time_s / warm_up_s)
            + shares[1] * time_s / warm_up_s
            + shares[2] * np.sin(2.0 * np.pi * time_s / period_s + phase)
        )
        return np.asarray(expansion[1:] - expansion[0])

    scale_m = proportional(
        size_m,
        [drift(trace.scene) for trace in bench.traces],
        why="no time passes",
    )
    return Fault(
        Place.MECHANICS,
        lambda stage_m, scene, _: stage_m + scale_m * drift(scene),
        {
            "warm_up_m": scale_m * float(shares[0]),
            "warm_up_s": warm_up_s,
            "ramp_m_per_s": scale_m * float(shares[1]) / warm_up_s,
            "cycle_m": scale_m * float(shares[2]),
            "cycle_s": period_s,
        },
    )
