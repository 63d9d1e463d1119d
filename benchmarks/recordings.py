"""Recordings and drives that several benchmarks make."""

from itertools import pairwise

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.records.recording import Channel, Quantity, Recording


def recording_of(
    voltage_V: Array, displacement_m: Array, sampling_rate_Hz: float, name: str = "recording"
) -> Recording:
    """Return a recording of axis x, without the checks of files."""
    channels = (
        Channel(quantity=Quantity.VOLTAGE, axis="x", values=voltage_V, label="voltage"),
        Channel(quantity=Quantity.DISPLACEMENT, axis="x", values=displacement_m, label="position"),
    )
    return Recording(
        name=name, digest="", axis="x", sampling_rate_Hz=sampling_rate_Hz, channels=channels
    )


def polyline(levels: Array, samples_per_unit: int) -> Array:
    """Return straight lines between levels with a given number of samples per unit."""
    lines = [
        np.linspace(a, b, int(samples_per_unit * abs(b - a)) + 3)[1:] for a, b in pairwise(levels)
    ]
    return np.concatenate([levels[:1], *lines])
