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
    """Call the same controller and the operator without its poles from Python."""
    controller, plant = Controller(loop.parameters.values), loop.plant
    reading = SettledPlant(plant).rest_position
    controller.start(plant.rest_voltage_V, reading)
    assert isinstance(plant.response, Hysteresis)
    operator = plant.response.operator
    memory = operator.virgin_memory()
    for reference in loop.reference_m:
        voltage = controller.step(reference, reading)
        (reading,), memory = operator.run(np.array([voltage]), memory)
    return reading


def controller_alone(loop: Loop) -> Callable[[], object]:
    """Return a run of the controller without a plant, whose measurement is the reference."""
    controller = Controller(loop.parameters.values)
    controller.start(loop.plant.rest_voltage_V, SettledPlant(loop.plant).rest_position)
    return lambda: controller.run(loop.reference_m, loop.reference_m)


def with_plays(loop: Loop, plays: int) -> Loop:
    """Return the loop with a number of plays in controller and plant, of about equal slopes."""
    response = loop.plant.response
    assert isinstance(response, Hysteresis)
    plays_of_plant = response.operator.plays
    total, first = float(plays_of_plant.weight.sum()), float(plays_of_plant.weight[0])
    spread = PrandtlIshlinskii(
        threshold=np.linspace(0.0, float(plays_of_plant.threshold[-1]), plays),
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
