"""Scenarios of every verification: paths and faults of the lateral axes, in ``SCENARIOS``."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from piezoid.numerics.arrays import Array, freeze, same_length

_CLV_CAP = 3.0
_TABLE = 20001
_ROUNDED = 0.1  # share of a raster line, at either end, that is a parabola

COMPARED_Hz = (1.0, 5.0, 10.0, 20.0, 50.0, 100.0)
_TURNS = 5.0
_FAULT_s = 0.02


@dataclass(frozen=True, kw_only=True, eq=False)
class Path:
    """Reference in the plane, sample by sample, of radius 1.

    x, y   (samples,)
    turns  number of turns of a spiral of pitch 1 / turns; 0 for any other path
    """

    x: Array
    y: Array
    turns: float = 0.0

    def __post_init__(self) -> None:
        freeze(self, "x", "y")
        same_length([("x", self.x), ("y", self.y)])


def constant_angular_velocity(rate_Hz: float, frequency_Hz: float, turns: float) -> Path:
    """Return an Archimedean spiral from the centre, of ``frequency_Hz`` turns per second.

    theta = 2 pi f t,   r = theta / (2 pi turns)
    """
    theta = 2.0 * np.pi * frequency_Hz / rate_Hz * np.arange(round(turns * rate_Hz / frequency_Hz))
    return _spiral(np.asarray(theta), turns)


def constant_linear_velocity(rate_Hz: float, frequency_Hz: float, turns: float) -> Path:
    """Return an Archimedean spiral of constant speed, ``frequency_Hz`` turns/s at its rim.

        ds/dtheta = p / (2 pi) sqrt(1 + theta^2),   dtheta/dt at most 3 times that at the rim

    The cap limits the angular velocity near the centre.
    """
    end = 2.0 * np.pi * turns
    theta = np.linspace(0.0, end, _TABLE)
    uncapped = 2.0 * np.pi * frequency_Hz * np.sqrt(1.0 + end**2) / np.sqrt(1.0 + theta**2)
    rate = np.minimum(uncapped, 2.0 * np.pi * frequency_Hz * _CLV_CAP)
    elapsed_s = np.concatenate([[0.0], np.cumsum(np.diff(theta) * 2 / (rate[1:] + rate[:-1]))])
    time_s = np.arange(int(elapsed_s[-1] * rate_Hz) + 1) / rate_Hz
    return _spiral(np.interp(time_s, elapsed_s, theta), turns)


def _spiral(theta: Array, turns: float) -> Path:
    r = theta / (2.0 * np.pi * turns)
    return Path(x=r * np.cos(theta), y=r * np.sin(theta), turns=turns)


def raster(rate_Hz: float, frequency_Hz: float, lines: float) -> Path:
    """Return a raster of ``frequency_Hz`` lines to and fro in x per second, with rounded ends.

    It begins at the centre. In the first quarter y moves to -1, then slowly to 1.
    """
    count = round(lines * rate_Hz / frequency_Hz)
    phase = np.arange(count) * frequency_Hz / rate_Hz
    # a triangle of period 1 from 0 upwards, its corners parabolas, its peaks at 1
    folded = np.abs((phase + 0.25) % 1.0 - 0.5)  # 1/4 at the start, 0 at the upper corner
    width = 0.5 * _ROUNDED
    corner_distance = np.minimum(folded, 0.5 - folded)
    straight = np.sign(0.25 - folded) * (0.25 - corner_distance)
    rounding = np.maximum(width - corner_distance, 0.0) ** 2 / (2.0 * width)
    parabola = np.sign(0.25 - folded) * (0.25 - corner_distance - rounding)
    x = np.where(corner_distance < width, parabola, straight) / (0.25 - 0.5 * width)
    y = np.linspace(0.0, 1.0, count)
    return Path(x=x, y=np.where(y < 0.25, -4.0 * y, (8.0 * y - 5.0) / 3.0))


def steps(rate_Hz: float, hold_s: float) -> Path:
    """Return steps of x up and down, each held; y has the same steps half a hold later."""
    levels = np.array([0.0, 0.5, 0.0, -0.5, 0.0, 0.9, -0.9, 0.0])
    hold = round(hold_s * rate_Hz)
    x = np.repeat(levels, hold)
    return Path(x=x, y=np.concatenate([np.zeros(hold // 2), x])[: len(x)])


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """One motion of the stage, and the conditions of its simulation.

    name          in tables
    kind          ``spiral``, ``raster`` or ``steps``
    frequency_Hz  of turns or lines
    path          function from a sampling rate to the path
    is_compared   run with every method of the file, for the table
    is_varied     run with the plants that the uncertainty allows, not with the identified plant
    fault         reading of the sensor from the middle on: NaN, or 1 for the last reading; None:
                  no fault
    fault_s       duration of the fault; infinite: permanent
    """

    name: str
    kind: str
    frequency_Hz: float
    path: Callable[[float], Path]
    is_compared: bool = False
    is_varied: bool = False
    fault: float | None = None
    fault_s: float = _FAULT_s


def spiral_speed_m_per_s(frequency_Hz: float, radius_m: float) -> float:
    """Return the speed of a compared spiral at its rim, where it is fastest.

    v = R f sqrt((2 pi)^2 + 1/turns^2),   along and across the turns
    """
    return float(radius_m * frequency_Hz * np.hypot(2.0 * np.pi, 1.0 / _TURNS))


def _spiral_scenario(name: str, frequency_Hz: float, **options: Any) -> Scenario:
    path = partial(constant_angular_velocity, frequency_Hz=frequency_Hz, turns=_TURNS)
    return Scenario(name=name, kind="spiral", frequency_Hz=frequency_Hz, path=path, **options)


SCENARIOS: tuple[Scenario, ...] = (
    *(_spiral_scenario(f"spiral, {f:g} Hz", f, is_compared=True) for f in COMPARED_Hz),
    Scenario(
        name="spiral of constant speed, 10 Hz at its rim",
        kind="spiral",
        frequency_Hz=10.0,
        path=partial(constant_linear_velocity, frequency_Hz=10.0, turns=10.0),
    ),
    Scenario(
        name="raster, 5 lines to and fro a second",
        kind="raster",
        frequency_Hz=5.0,
        path=partial(raster, frequency_Hz=5.0, lines=10.0),
    ),
    Scenario(name="steps", kind="steps", frequency_Hz=10.0, path=partial(steps, hold_s=0.1)),
    _spiral_scenario("spiral, 10 Hz, plants the recordings allow", 10.0, is_varied=True),
    _spiral_scenario("spiral, 10 Hz, sensor lost for 20 ms", 10.0, fault=np.nan),
    _spiral_scenario("spiral, 10 Hz, sensor frozen for 20 ms", 10.0, fault=1.0),
    _spiral_scenario("spiral, 10 Hz, sensor lost for good", 10.0, fault=np.nan, fault_s=np.inf),
    _spiral_scenario("spiral, 10 Hz, sensor frozen for good", 10.0, fault=1.0, fault_s=np.inf),
)
