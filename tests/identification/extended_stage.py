"""Recordings of a known stage with extensions."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from piezoid.identification.extensions.extension import Extension
from piezoid.identification.hysteresis.pieces import MINIMUM_SAMPLES, PieceStart
from piezoid.identification.model import AxisModel
from piezoid.identification.simulation import simulate_recording
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Channel, Quantity, Recording
from tests.reports.known_stage import axis_model

RATES_Hz = {"slow.csv": 200.0, "fast.csv": 2000.0}
NOISE_m = 3e-9
MEMORY_V = np.array([0.0, 0.0, 0.0])


def known_model(*extensions: Extension) -> AxisModel:
    starts = tuple(
        PieceStart(recording=name, memory_V=MEMORY_V, zero_m=np.array([2e-6]), first=0, last=5000)
        for name in RATES_Hz
    )
    assert MINIMUM_SAMPLES < 5000
    return replace(axis_model(recordings=()), starts=starts, extensions=tuple(extensions))


def recordings_of(*extensions: Extension, seed: int = 3) -> tuple[Recording, ...]:
    """Return two recordings of the known stage with these extensions."""
    rng = np.random.default_rng(seed)
    recordings = []
    for name, rate_Hz in RATES_Hz.items():
        blank = _recording(name, rate_Hz, np.zeros(5000))
        displacement_m = simulate_recording(known_model(*extensions), blank)
        recordings.append(
            _recording(name, rate_Hz, displacement_m + NOISE_m * rng.standard_normal(5000))
        )
    return tuple(recordings)


def disturbed(recording: Recording, rows: slice, by_m: float) -> Recording:
    """Return a recording with an offset in some rows."""
    changed = recording.displacement_m().copy()
    changed[rows] += by_m
    return _recording(recording.name, recording.sampling_rate_Hz, changed)


def _recording(name: str, rate_Hz: float, displacement_m: Array) -> Recording:
    time_s = np.arange(5000) / rate_Hz
    other_V = 5.0 + 4.0 * np.sin(2 * np.pi * 0.23 * time_s)
    channels: Sequence[Channel] = (
        Channel(quantity=Quantity.VOLTAGE, axis="x", values=drive_V(time_s), label="U"),
        Channel(quantity=Quantity.VOLTAGE, axis="y", values=other_V, label="V"),
        Channel(quantity=Quantity.DISPLACEMENT, axis="x", values=displacement_m, label="y"),
    )
    return Recording(
        name=name,
        digest="sha256:" + "0" * 64,
        axis="x",
        sampling_rate_Hz=rate_Hz,
        channels=tuple(channels),
    )


def drive_V(time_s: Array) -> Array:
    """Return triangles of decreasing height, each with a corner."""
    cycles = 12.3 * time_s / time_s[-1]
    triangle = 4.0 * np.abs(cycles - np.floor(cycles + 0.5)) - 1.0
    height = 5.0 * (1.0 - 0.7 * time_s / time_s[-1])
    return np.asarray(5.0 + height * triangle * (1.0 - 0.1 * np.cos(2 * np.pi * 0.37 * cycles)))
