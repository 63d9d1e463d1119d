"""A table played on a plant, with the compiled controller or without, period after period."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.runtime.controller import Controller, Status
from piezoid.runtime.values import Values
from piezoid.targets.box_loop import run_box
from piezoid.verification.approach import led_to
from piezoid.verification.loop_plant import rest_position
from piezoid.verification.plant import AxisPlant

_SETTLED_s = 0.1  # before what is kept: ten time constants of a loop of 16 Hz
LIMITED = Status.VOLTAGE_LIMITED | Status.VOLTAGE_STEP | Status.REFERENCE_LIMITED


@dataclass(frozen=True, kw_only=True, eq=False)
class Played:
    """What is kept of a table's playing, (periods, points) each.

    position_m  in front of the sensor
    measured_m  as the sensor's converter reads it
    voltage_V   put out
    status      of the controller over these periods, all bits
    """

    position_m: Array
    measured_m: Array
    voltage_V: Array
    status: Status


def play(
    plant: AxisPlant,
    wanted_m: Array,
    table_V: Array,
    *,
    values: Values | None,
    periods: int = 1,
    rng: np.random.Generator,
) -> Played:
    """Play a table from rest until the motion has settled, and keep the periods after that.

    values  of the controller; None: the table is all of the voltage

    With a controller the stage is led to where the period begins, and the table fades in over the
    first period: so should a laboratory.
    """
    points = len(wanted_m)
    settling = 1 + int(np.ceil(_SETTLED_s * plant.sampling_rate_Hz / points))
    if values is None:
        drive = iter(np.tile(table_V, settling + periods).tolist())
        reference_m = np.zeros((settling + periods) * points)
        record = run_box(plant, lambda _reference, _measured: next(drive), reference_m, rng=rng)
        seen = Status(0)
    else:
        led_m = led_to(plant, float(wanted_m[0]))
        reference_m = np.concatenate([led_m, np.tile(wanted_m, settling + periods)])
        ahead = np.arange(len(reference_m)) + int(values["preview_samples"])
        late = ahead >= len(reference_m)
        ahead[late] -= points  # the path goes on after the record
        fed_V = np.tile(table_V, settling + periods)
        fed_V[:points] *= np.arange(points) / points
        controller = Controller(values)
        controller.start(plant.rest_voltage_V, rest_position_of(plant))
        step = _stepping(controller, np.concatenate([np.zeros(len(led_m)), fed_V]))
        record = run_box(plant, step, reference_m[ahead], rng=rng)
        seen = controller.status_ever
    kept = (
        one[-periods * points :].reshape(periods, points)
        for one in (record.position_m, record.measured_m, record.voltage_V)
    )
    position_m, measured_m, voltage_V = kept
    return Played(position_m=position_m, measured_m=measured_m, voltage_V=voltage_V, status=seen)


def rest_position_of(plant: AxisPlant) -> float:
    """Return what the sensor shows of a plant at rest, m."""
    return float(np.clip(rest_position(plant), *plant.reading_range))


def _stepping(controller: Controller, fed_V: Array) -> Callable[[float, float], float]:
    table = iter(fed_V.tolist())
    return lambda reference_m, measured_m: controller.step(reference_m, measured_m, next(table))
