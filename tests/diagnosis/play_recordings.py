"""Stage of plays with known initial states, on segments of the drives of a healthy campaign."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.signals import with_displacement
from piezoid.numerics.arrays import Array
from piezoid.operators.play import play_columns
from piezoid.records.recording import Channel, Quantity, Recording

from .bench import healthy, single_axis_recording, view_of_recordings

WIDTH = np.linspace(0.05, 0.9, 12)
WEIGHT = 0.12 * np.exp(-1.5 * WIDTH)
HALF_STROKE_m = 1.5e-5
EVERY = 4  # samples: the stage does not depend on time
SEGMENTS = {
    "sweep": slice(6900, 12800, EVERY),
    "staircase": slice(3000, 9000, EVERY),
    "other_axis": slice(1500, 7000, EVERY),
}
GLIDE = 0.01  # of half the range per sample, on the path to the next recording
NOISE = 3e-4  # of the stroke
RINGING_NOISE = 6e-4  # of half the stroke
TurnsBefore = Callable[[float], Sequence[float]]  # (first value) -> turns before it


def at_rest(first: float) -> Array:
    """Return turns of decreasing amplitude about the first value: demagnetisation."""
    return first + np.geomspace(1.0, 1e-3, 60) * np.where(np.arange(60) % 2, 1.0, -1.0)


def cycled(_: float) -> Sequence[float]:
    return (-1.0, 1.0)


def cycled_the_other_way(_: float) -> Sequence[float]:
    return (1.0, -1.0)


def forgotten(_: float) -> Sequence[float]:
    return (-1.0, 0.6, -0.5, 0.3)


def play_response(drive: Array, memory: Array) -> tuple[Array, Array]:
    """Return the response, about half the drive, and the final play states."""
    states, memory = play_columns(drive, WIDTH, memory)
    return 0.4 * drive + 0.02 * drive**2 + states @ WEIGHT, memory


def memory_after(turns: TurnsBefore, first: float) -> Array:
    return play_response(np.array([*turns(first), first]), np.zeros(len(WIDTH)))[1]


def drive_recording(name: str, rate_Hz: float, drive: Array, displacement_m: Array) -> Recording:
    return single_axis_recording(name, rate_Hz, 5.0 + 5.0 * drive, displacement_m)


@cache
def recordings_after(*histories: TurnsBefore | None) -> tuple[Recording, ...]:
    """Record three drives after their initial states; None continues the previous recording."""
    recordings, _ = healthy()
    rng, memory, previous = np.random.default_rng(1), np.zeros(len(WIDTH)), 0.0
    continuations = []
    for (name, rows), reversals in zip(SEGMENTS.items(), histories, strict=True):
        healthy_recording = next(r for r in recordings if r.name.startswith(name))
        drive = healthy_recording.voltage_V()[rows] / 5.0 - 1.0
        if reversals is None:
            steps = max(int(abs(drive[0] - previous) / GLIDE), 2)
            drive = np.concatenate([np.linspace(previous, drive[0], steps)[:-1], drive])
        else:
            memory = memory_after(reversals, float(drive[0]))
        response, memory = play_response(drive, memory)
        noise = NOISE * float(np.ptp(response)) * rng.normal(size=len(drive))
        rate_Hz = healthy_recording.sampling_rate_Hz / EVERY
        continuations.append(
            drive_recording(name, rate_Hz, drive, HALF_STROKE_m * (response + noise))
        )
        previous = float(drive[-1])
    return tuple(continuations)


def ringing(
    drives: Mapping[tuple[str, float], Array],
    ring: Callable[[Array, float], Array],
    rng: np.random.Generator,
) -> tuple[Recording, ...]:
    """Record drives (name, rate in Hz) after cycles; ring maps (response, rate in Hz)."""
    recordings = []
    for (name, rate_Hz), drive in drives.items():
        static, _ = play_response(drive, memory_after(cycled, float(drive[0])))
        reading = ring(static, rate_Hz) + RINGING_NOISE * rng.normal(size=len(drive))
        recordings.append(drive_recording(name, rate_Hz, drive, HALF_STROKE_m * reading))
    return tuple(recordings)


def with_another_axis(recording: Recording) -> Recording:
    """Return a recording with the drive of another axis."""
    time_s = np.arange(recording.samples) / recording.sampling_rate_Hz
    other_V = 40.0 * np.sin(2.3 * time_s + 1.0) + 15.0 * np.sin(12.1 * time_s)
    channel = Channel(quantity=Quantity.VOLTAGE, axis="y", values=other_V, label="y")
    return replace(recording, channels=(*recording.channels, channel))


def wobbling(recordings: Iterable[Recording], share: float) -> tuple[Recording, ...]:
    """Modulate the gain of each recording sinusoidally: no effect of the catalogue does."""
    modulated = []
    for k, recording in enumerate(recordings):
        phase = 2.0 * np.pi * (7.3 + k) * np.arange(recording.samples) / recording.samples
        centred_m = recording.displacement_m() - recording.displacement_m().mean()
        modulated.append(
            with_displacement(recording, centred_m * (1.0 + share * np.sin(phase + k)))
        )
    return tuple(modulated)


@cache
def view_after(*histories: TurnsBefore | None) -> View:
    """Return the residual view of the recordings after these turns."""
    return view_of_recordings(recordings_after(*histories))
