"""The closed loop of the bundled axis x, in C or called from Python, and its relative times.

The loop consists of the shipped step and the identified plant. It is compared with the same
controller called from Python, with the controller alone, and with the simulated time.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

import piezoid_datasets
from benchmarks.speed.stopwatch import Growth, Stopwatch
from benchmarks.speed.table import Row
from piezoid.design.design_stage import design_stage
from piezoid.export.export_stage import export_stage
from piezoid.export.parameter_file import AxisParameters
from piezoid.identification.fit import fit
from piezoid.numerics.arrays import Array
from piezoid.operators.prandtl_ishlinskii import PrandtlIshlinskii
from piezoid.records.collection import collect
from piezoid.records.lab import read_lab
from piezoid.runtime.controller import Controller
from piezoid.verification.closed_loop import run_axis
from piezoid.verification.loop_plant import SettledPlant
from piezoid.verification.plant import AxisPlant, Hysteresis
from piezoid.verification.verify_stage import plant_of

AXIS = "x"
LOOP = "closed loop"
DIGEST = "0" * 64  # no file is written
PYTHON_SAMPLES = 2000  # of the loop in Python
PLAYS = (4, 8, 16, 32)
DIVISORS = (16, 4, 1)  # of the number of ticks


@dataclass(frozen=True, kw_only=True, eq=False)
class Loop:
    """Plant, controller and reference of one axis."""

    plant: AxisPlant
    parameters: AxisParameters
    reference_m: Array


def bundled_loop(samples: int) -> Loop:
    """Return controller and identified plant of the bundled axis, and ten sines as reference."""
    lab = read_lab(piezoid_datasets.LAB)
    files = [path for path in piezoid_datasets.recordings() if path.name.startswith(AXIS)]
    model = fit(collect(files, lab).recordings, lab=lab)
    design = design_stage(model, model_digest=DIGEST, lab=lab)
    parameters = export_stage(model, design, design_digest=DIGEST, lab=lab).axis(AXIS)
    low_m, high_m = (float(parameters.values[f"reference_{k}_m"]) for k in ("minimum", "maximum"))
    sine = np.sin(np.linspace(0.0, 20.0 * np.pi, samples))
    reference_m = 0.5 * (low_m + high_m) + 0.3 * (high_m - low_m) * sine
    plant = plant_of(parameters, model, lab)
    return Loop(plant=plant, parameters=parameters, reference_m=reference_m)


def loop_row(watch: Stopwatch, loop: Loop) -> Row:
    """Compare the closed loop with the same in Python, and with its controller alone."""
    loop_s = watch.cpu_s(lambda: run(loop))
    short = replace(loop, reference_m=loop.reference_m[:PYTHON_SAMPLES])
    ratio = len(loop.reference_m) / len(short.reference_m)
    duration_s = len(loop.reference_m) / loop.plant.sampling_rate_Hz
    return Row(
        stage=LOOP,
        loop=watch.cpu_s(lambda: from_python(short)) * ratio / loop_s,
        bounds={
            "controller alone": loop_s / watch.cpu_s(controller_alone(loop)),
            "of the simulated time": loop_s / duration_s,
        },
    )


def loop_growths(watch: Stopwatch, loop: Loop) -> list[Growth]:
    """Return the growth of the closed loop with samples and plays."""
    ticks = len(loop.reference_m)
    shorter = [replace(loop, reference_m=loop.reference_m[: ticks // n]) for n in DIVISORS]
    lengths = {len(part.reference_m): partial(run, part) for part in shorter}
    widths = {plays: partial(run, with_plays(loop, plays)) for plays in PLAYS}
    return [watch.growth(LOOP, "samples", lengths), watch.growth(LOOP, "plays", widths)]


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
