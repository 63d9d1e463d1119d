"""What is run: the tuple SCENARIOS. To run another, write it there."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.verification.trajectories import (
    Path,
    constant_angular_velocity,
    constant_linear_velocity,
    raster,
    steps,
)

COMPARED_Hz = (1.0, 5.0, 10.0, 20.0, 50.0, 100.0)
_TURNS = 5.0
_FAULT_s = 0.02


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """One thing the stage is made to do.

    name          as in tables
    kind          ``spiral``, ``raster``, ``steps``: how it is judged
    frequency_Hz  of turns or lines
    path          makes the path at a sampling rate
    is_compared   run with every method the file holds, for the table
    is_varied     run with every plant the uncertainty allows instead of the identified one
    fault         None, or what the sensor reads from the middle on: NaN, or 1 for the same as
                  before
    fault_s       for how long; infinite: for good
    """

    name: str
    kind: str
    frequency_Hz: float
    path: Callable[[float], Path]
    is_compared: bool = False
    is_varied: bool = False
    fault: float | None = None
    fault_s: float = _FAULT_s

    def fault_of(self, samples: int, rate_Hz: float) -> Array | None:
        """Return the sensor's fault, (samples,), or None."""
        if self.fault is None:
            return None
        found = np.zeros(samples)
        lasts = samples if np.isinf(self.fault_s) else round(self.fault_s * rate_Hz)
        found[samples // 2 : samples // 2 + lasts] = self.fault
        return found


def spiral_speed_m_per_s(frequency_Hz: float, radius_m: float) -> float:
    """Return how fast a compared spiral is at its rim, where it is fastest.

    v = R f sqrt((2 pi)^2 + 1/turns^2),   along and across the turns
    """
    return float(radius_m * frequency_Hz * np.hypot(2.0 * np.pi, 1.0 / _TURNS))


def _constant_angular(f: float) -> Callable[[float], Path]:
    return partial(constant_angular_velocity, frequency_Hz=f, turns=_TURNS)


SCENARIOS: tuple[Scenario, ...] = (
    *(
        Scenario(
            name=f"spiral, {f:g} Hz",
            kind="spiral",
            frequency_Hz=f,
            path=_constant_angular(f),
            is_compared=True,
        )
        for f in COMPARED_Hz
    ),
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
    Scenario(
        name="spiral, 10 Hz, plants the recordings allow",
        kind="spiral",
        frequency_Hz=10.0,
        path=_constant_angular(10.0),
        is_varied=True,
    ),
    Scenario(
        name="spiral, 10 Hz, sensor lost for 20 ms",
        kind="spiral",
        frequency_Hz=10.0,
        path=_constant_angular(10.0),
        fault=np.nan,
    ),
    Scenario(
        name="spiral, 10 Hz, sensor frozen for 20 ms",
        kind="spiral",
        frequency_Hz=10.0,
        path=_constant_angular(10.0),
        fault=1.0,
    ),
    *(
        Scenario(
            name=f"spiral, 10 Hz, sensor {how} for good",
            kind="spiral",
            frequency_Hz=10.0,
            path=_constant_angular(10.0),
            fault=fault,
            fault_s=np.inf,
        )
        for how, fault in (("lost", np.nan), ("frozen", 1.0))
    ),
)
