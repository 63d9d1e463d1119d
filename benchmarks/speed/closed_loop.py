"""The closed loop: the shipped step and the identified plant in C, or called from Python."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from benchmarks.speed.chain import Loop
from piezoid.operators.prandtl_ishlinskii import PrandtlIshlinskii
from piezoid.runtime.controller import Controller
from piezoid.verification.closed_loop import run_axis
from piezoid.verification.loop_plant import SettledPlant
from piezoid.verification.plant import Hysteresis


def run(loop: Loop) -> object:
    """Run the loop as verification does."""
    rng = np.random.default_rng(0)
    return run_axis(loop.plant, loop.parameters, loop.reference_m, rng=rng)


def from_python(loop: Loop) -> object:
    """Step the same controller and the bare operator, without its poles, from Python."""
    controller, plant = Controller(loop.parameters.values), loop.plant
    reading = SettledPlant(plant).rest_position
    controller.start(plant.rest_voltage_V, reading)
    assert isinstance(plant.response, Hysteresis)
    operator = plant.response.operator
    memory = operator.virgin_memory()
    for wanted in loop.reference_m:
        voltage = controller.step(wanted, reading)
        (reading,), memory = operator.run(np.array([voltage]), memory)
    return reading


def controller_alone(loop: Loop) -> Callable[[], object]:
    """Return the work of the controller without a plant: it reads what it wants."""
    controller = Controller(loop.parameters.values)
    controller.start(loop.plant.rest_voltage_V, SettledPlant(loop.plant).rest_position)
    return lambda: controller.run(loop.reference_m, loop.reference_m)


def with_plays(loop: Loop, plays: int) -> Loop:
    """Return the loop with so many plays in controller and plant, the slopes about the same."""
    response = loop.plant.response
    assert isinstance(response, Hysteresis)
    known = response.operator.plays
    total, first = float(known.weight.sum()), float(known.weight[0])
    spread = PrandtlIshlinskii(
        threshold=np.linspace(0.0, float(known.threshold[-1]), plays),
        weight=np.concatenate([[first], np.full(plays - 1, (total - first) / (plays - 1))]),
    )
    values = {
        **loop.parameters.values,
        "play_count": plays,
        "play_threshold_V": spread.threshold,
        "play_weight_m_per_V": spread.weight,
    }
    plant = replace(
        loop.plant, response=replace(response, operator=replace(response.operator, plays=spread))
    )
    return replace(loop, plant=plant, parameters=replace(loop.parameters, values=values))
