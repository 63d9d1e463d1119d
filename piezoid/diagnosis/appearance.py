"""Appearance of an effect: along a coordinate, over time, or in the spectrum.

This module defines the coordinates of several effects; the file of an effect defines its own.
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

    label    of the coordinate
    unit     SI
    kind     ``classes`` of all recordings, or ``time`` or ``spectrum`` of one recording
    along    (recording) -> coordinate of every sample, (samples,), NaN for samples that are left
             out, and a sign by which the residual is multiplied, (samples,)
    reading  how to read the picture
    decades  whether coordinates are log10 of numbers in ``unit``
    """

    label: str
    unit: str
    kind: str
    along: Along
    reading: str
    decades: bool = False


def unsigned(positions: Array) -> tuple[Array, Array]:
    """Return positions, and the sign 1 for all of them."""
    return positions, np.ones(len(positions))


def _time(recording: Recording) -> tuple[Array, Array]:
    return unsigned(recording.time_s)


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


def over_time(coordinate: Appearance) -> Appearance:
    """Return the appearance over time, for recordings with too few samples of a coordinate."""
    return replace(
        OVER_TIME,
        reading="Drawn over time, because too few samples of these recordings have a "
        f"{coordinate.label}, where this effect shows best.",
    )
