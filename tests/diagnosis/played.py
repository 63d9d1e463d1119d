"""A stage that is a sum of plays alone and remembers what we say, recorded on drives of ours.

Some of them are parts of a healthy campaign's drives.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.signals import with_displacement
from piezoid.numerics.arrays import Array
from piezoid.operators.play import play_columns
from piezoid.records.lab import Lab
from piezoid.records.recording import Channel, Quantity, Recording

from .bench import healthy, view_of_recordings

WIDTH = np.linspace(0.05, 0.9, 12)
WEIGHT = 0.12 * np.exp(-1.5 * WIDTH)
HALF_STROKE_m = 1.5e-5
EVERY = 4  # of the samples: a stage that does not know time needs no more
STRETCH = {
    "sweep": slice(6900, 12800, EVERY),
    "staircase": slice(3000, 9000, EVERY),
    "other_axis": slice(1500, 7000, EVERY),
}
GLIDE = 0.01  # of half the range for a sample, on the way to where the next recording begins
NOISE = 3e-4  # of the stroke
RINGING_NOISE = 6e-4  # of half the stroke
Before = Callable[[float], Sequence[float]]  # (first value) -> turns before it


def at_rest(first: float) -> Array:
    """Return ever smaller turns about the first value, finer than any that the search knows of."""
    return first + np.geomspace(1.0, 1e-3, 60) * np.where(np.arange(60) % 2, 1.0, -1.0)


def cycled(_: float) -> Sequence[float]:
    return (-1.0, 1.0)


def cycled_the_other_way(_: float) -> Sequence[float]:
    return (1.0, -1.0)


def forgotten(_: float) -> Sequence[float]:
    return (-1.0, 0.6, -0.5, 0.3)


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


@cache
def recordings_after(*before: Before | None) -> tuple[Recording, ...]:
    """Record three drives after some initial states; None: each goes on from the one before it."""
    recordings, _ = healthy()
    chance, memory, last = np.random.default_rng(1), np.zeros(len(WIDTH)), 0.0
    made = []
    for (name, part), reversals in zip(STRETCH.items(), before, strict=True):
        whole = next(r for r in recordings if r.name.startswith(name))
        drive = whole.voltage_V()[part] / 5.0 - 1.0
        if reversals is None:
            steps = max(int(abs(drive[0] - last) / GLIDE), 2)
            drive = np.concatenate([np.linspace(last, drive[0], steps)[:-1], drive])
        else:
            memory = memory_after(reversals, float(drive[0]))
        response, memory = moved(drive, memory)
        noise = NOISE * float(np.ptp(response)) * chance.normal(size=len(drive))
        rate_Hz = whole.sampling_rate_Hz / EVERY
        made.append(recorded_as(name, rate_Hz, drive, HALF_STROKE_m * (response + noise)))
        last = float(drive[-1])
    return tuple(made)


def ringing(
    drives: Mapping[tuple[str, float], Array],
    ring: Callable[[Array, float], Array],
    chance: np.random.Generator,
) -> tuple[Recording, ...]:
    """Record drives after cycles, (name, rate in Hz) -> drive; ring is (response, rate in Hz)."""
    made = []
    for (name, rate_Hz), drive in drives.items():
        still, _ = moved(drive, memory_after(cycled, float(drive[0])))
        reading = ring(still, rate_Hz) + RINGING_NOISE * chance.normal(size=len(drive))
        made.append(recorded_as(name, rate_Hz, drive, HALF_STROKE_m * reading))
    return tuple(made)


def with_another_axis(one: Recording) -> Recording:
    """Return a recording with the drive of another axis."""
    time_s = np.arange(one.samples) / one.sampling_rate_Hz
    other_V = 40.0 * np.sin(2.3 * time_s + 1.0) + 15.0 * np.sin(12.1 * time_s)
    channel = Channel(quantity=Quantity.VOLTAGE, axis="y", values=other_V, label="y")
    return replace(one, channels=(*one.channels, channel))


def wobbling(recordings: Iterable[Recording], share: float) -> tuple[Recording, ...]:
    """Return recordings whose gain goes up and down by a share, as no effect does."""
    found = []
    for k, one in enumerate(recordings):
        turn = 2.0 * np.pi * (7.3 + k) * np.arange(one.samples) / one.samples
        moved_m = one.displacement_m() - one.displacement_m().mean()
        found.append(with_displacement(one, moved_m * (1.0 + share * np.sin(turn + k))))
    return tuple(found)


@cache
def view_after(*before: Before | None) -> View:
    """Return the view of these recordings."""
    return view_of_recordings(recordings_after(*before), Lab())
