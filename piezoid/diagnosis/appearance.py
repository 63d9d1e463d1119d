"""Appearance of an effect: along a coordinate, over time, or in the spectrum.

The coordinates that several effects share stand here; one of a single effect stands in its file.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.records.recording import Recording

Along = Callable[[Recording], tuple[Array, Array]]


@dataclass(frozen=True, kw_only=True)
class Appearance:
    """Coordinate against which a residual is drawn.

    label    of the axis
    unit     SI
    kind     ``classes`` of all recordings, ``time`` of one, or ``spectrum`` of one
    along    (recording) -> place of every sample of its axis, (samples,), NaN where it does not
             count, and a sign that the residual is multiplied by, (samples,)
    reading  how to read the picture
    decades  whether places are log10 of numbers in ``unit``
    """

    label: str
    unit: str
    kind: str
    along: Along
    reading: str
    decades: bool = False


def unsigned(positions: Array) -> tuple[Array, Array]:
    """Return positions at which the residual keeps its sign."""
    return positions, np.ones(len(positions))


def _time(recording: Recording) -> tuple[Array, Array]:
    return unsigned(np.arange(recording.samples) / recording.sampling_rate_Hz)


def _speed(recording: Recording) -> tuple[Array, Array]:
    return unsigned(np.gradient(recording.voltage_V()) * recording.sampling_rate_Hz)


OVER_TIME = Appearance(
    label="time",
    unit="s",
    kind="time",
    along=_time,
    reading="Drift: one slow motion whatever the drive does. A slip: small before, large "
    "after. Outliers: single spikes. A wrong initial state: gone after the first large cycle.",
)
OVER_SPEED = Appearance(
    label="speed of the drive",
    unit="V/s",
    kind="classes",
    along=_speed,
    reading="Delay and lag: a straight line through zero. Rate dependence: bent. A slew "
    "limit: flat, then steep beyond the limit.",
)
IN_SPECTRUM = Appearance(
    label="frequency",
    unit="Hz",
    decades=True,
    kind="spectrum",
    along=_time,
    reading="A mode: a hill where the stage rings. Hum: needles at 50 or 60 Hz and multiples.",
)
OVER_DRIVE = Appearance(
    label="drive",
    unit="V",
    kind="classes",
    along=lambda recording: unsigned(recording.voltage_V()),
    reading="Saturation: nothing, then steep at an end. Asymmetry: one side bends.",
)


def over_time(where: Appearance) -> Appearance:
    """Return the course over time, for recordings in which a coordinate hardly occurs."""
    return replace(
        OVER_TIME,
        reading="Drawn over time, because too few samples of these recordings have a "
        f"{where.label}, where this effect shows best.",
    )
