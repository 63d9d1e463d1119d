"""Stage of plays and a weak Bouc-Wen state, recorded with three drives; independent of piezoid."""

from functools import cache

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.records.recording import Recording
from tests.diagnosis.bench import single_axis_recording, view_of_recordings

STROKE_m = 30e-6
NOISE_m = 5e-4 * STROKE_m


def drive(kind: str) -> tuple[float, Array]:
    rate_Hz = {"sweep": 1000.0, "walk": 500.0, "waves": 4000.0}[kind]
    time_s = np.arange(9000) / rate_Hz
    if kind == "sweep":
        turn = np.arcsin(np.sin(2 * np.pi * (1.1 * time_s - 0.25)))
        return rate_Hz, np.linspace(1.0, 0.3, 9000) * 2 / np.pi * turn
    if kind == "walk":
        levels = np.random.default_rng(5).uniform(-0.9, 0.9, 31)
        position = np.linspace(0, 29.999, 9000)
        progress = 0.5 - 0.5 * np.cos(np.pi * (position % 1.0))
        segment = position.astype(int)
        return rate_Hz, levels[segment] + (levels[segment + 1] - levels[segment]) * progress
    return rate_Hz, 0.6 * np.sin(2 * np.pi * 2.7 * time_s) + 0.3 * np.sin(2 * np.pi * 17 * time_s)


def stroke_fraction(field: Array) -> Array:
    """Return the displacement divided by the stroke."""
    state, friction, out = np.zeros(6), 0.0, np.empty(len(field))
    width = np.linspace(0.05, 0.6, 6)
    for i, (u, step) in enumerate(zip(field, np.diff(field, prepend=field[0]), strict=True)):
        state = np.clip(state, u - width, u + width)
        friction += 0.8 * step - 2.0 * abs(step) * friction
        out[i] = 0.3 * u + 0.025 * state.sum() + 0.1 * friction + 0.01 * u * u
    return out


def noisy_reading_m(field: Array, seed: int) -> Array:
    noise_m = np.random.default_rng(seed).normal(0.0, NOISE_m, len(field))
    return STROKE_m * stroke_fraction(field) + noise_m


@cache
def clean(kind: str) -> tuple[float, Array, Array]:
    rate_Hz, field = drive(kind)
    return rate_Hz, field, noisy_reading_m(field, len(kind))


def recording(kind: str, reading_m: Array | None = None, field: Array | None = None) -> Recording:
    rate_Hz, default_field, default_m = clean(kind)
    voltage_V = 50.0 + 40.0 * (default_field if field is None else field)
    displacement_m = default_m if reading_m is None else reading_m
    return single_axis_recording(kind, rate_Hz, voltage_V, displacement_m)


def view_with(**readings_m: Array):
    kinds = ("sweep", "walk", "waves")
    recordings = [recording(kind, readings_m.get(kind)) for kind in kinds]
    return view_of_recordings(recordings)


@cache
def healthy():
    return view_with()


def with_slip(reading_m: Array, at: int, samples: int) -> Array:
    """Delay the readings after one sample, or advance them if the number is negative."""
    sample = np.arange(len(reading_m))
    source = np.where(sample >= at, np.maximum(sample - samples, at if samples > 0 else 0), sample)
    return reading_m[np.minimum(source, len(reading_m) - 1)]


def is_within_interval(fault, value: float) -> bool:
    return abs(fault.value - value) <= 1.96 * fault.spread
