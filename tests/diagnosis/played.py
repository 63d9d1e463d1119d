"""A stage that is a sum of plays alone and remembers what we say, recorded on drives of ours."""

from collections.abc import Callable, Sequence

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.operators.play import play_columns
from piezoid.records.recording import Channel, Quantity, Recording

WIDTH = np.linspace(0.05, 0.9, 12)
WEIGHT = 0.12 * np.exp(-1.5 * WIDTH)
HALF_STROKE_m = 1.5e-5
Before = Callable[[float], Sequence[float]]  # (first value) -> turns before it


def at_rest(first: float) -> Array:
    """Return ever smaller turns about the first value, finer than any that the search knows of."""
    return first + np.geomspace(1.0, 1e-3, 60) * np.where(np.arange(60) % 2, 1.0, -1.0)


def cycled(_: float) -> Sequence[float]:
    return (-1.0, 1.0)


def cycled_the_other_way(_: float) -> Sequence[float]:
    return (1.0, -1.0)


def moved(drive: Array, memory: Array) -> tuple[Array, Array]:
    """Return the response, about half the drive, and the memory that is left."""
    states, memory = play_columns(drive, WIDTH, memory)
    return 0.4 * drive + 0.02 * drive**2 + states @ WEIGHT, memory


def memory_after(before: Before, first: float) -> Array:
    return moved(np.array([*before(first), first]), np.zeros(len(WIDTH)))[1]


def recorded_as(name: str, rate_Hz: float, drive: Array, moved_m: Array) -> Recording:
    values = {Quantity.VOLTAGE: 5.0 + 5.0 * drive, Quantity.DISPLACEMENT: moved_m}
    channels = tuple(
        Channel(quantity=quantity, axis="x", values=signal, label=quantity.name)
        for quantity, signal in values.items()
    )
    return Recording(name=name, digest="", axis="x", sampling_rate_Hz=rate_Hz, channels=channels)
