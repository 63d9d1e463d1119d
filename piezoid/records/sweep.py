"""Sweep: the drive and response of one axis, cut into branches at the reversals of the drive."""

import itertools
from dataclasses import dataclass

import numpy as np

from piezoid.numerics.arrays import Array, frozen, same_length
from piezoid.records.recording import Recording


@dataclass(frozen=True, kw_only=True, eq=False)
class Sweep:
    """One uninterrupted piece of a recording, seen as a sequence of monotone branches.

    name              the recording's name
    sampling_rate_Hz  > 0
    voltage_V         (samples,)
    displacement_m    (samples,)
    reversals         (count,)  indices of the turning points of the drive, increasing
    """

    name: str
    sampling_rate_Hz: float
    voltage_V: Array
    displacement_m: Array
    reversals: tuple[int, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "voltage_V", frozen(self.voltage_V, "voltage_V"))
        object.__setattr__(self, "displacement_m", frozen(self.displacement_m, "displacement_m"))
        same_length([("voltage_V", self.voltage_V), ("displacement_m", self.displacement_m)])

    @property
    def branches(self) -> tuple[slice, ...]:
        """The monotone runs between reversals, each with both of its end points."""
        edges = (0, *self.reversals, len(self.voltage_V) - 1)
        return tuple(slice(a, b + 1) for a, b in itertools.pairwise(edges) if b > a)


def reversals_of(voltage_V: Array, noise_V: float) -> tuple[int, ...]:
    """Find turning points of the drive, ignoring excursions of at most ``noise_V``.

    A turning point is confirmed once the drive has come back from it by more than ``noise_V``,
    so converter steps and read-back noise make no reversals of their own.

    voltage_V  (samples,)  V
    noise_V    scalar      V, >= 0
    returned   indices, increasing, without the first and the last sample
    """
    found: list[int] = []
    high = low = 0
    direction = 0
    for k, value in enumerate(voltage_V.tolist()):
        if value > voltage_V[high]:
            high = k
        if value < voltage_V[low]:
            low = k
        if direction >= 0 and voltage_V[high] - value > noise_V:
            if direction > 0 or high > 0:
                found.append(high)
            direction, low, high = -1, k, k
        elif direction <= 0 and value - voltage_V[low] > noise_V:
            if direction < 0 or low > 0:
                found.append(low)
            direction, low, high = 1, k, k
    return tuple(found)


def sweeps_of(recording: Recording, noise_V: float) -> tuple[Sweep, ...]:
    """Cut a recording's own axis into sweeps, one for each piece between breaks."""
    voltage_V, displacement_m = recording.voltage_V(), recording.displacement_m()
    return tuple(
        Sweep(
            name=recording.name,
            sampling_rate_Hz=recording.sampling_rate_Hz,
            voltage_V=voltage_V[piece],
            displacement_m=displacement_m[piece],
            reversals=reversals_of(np.asarray(voltage_V[piece]), noise_V),
        )
        for piece in recording.pieces
        if piece.stop - piece.start > 1
    )
