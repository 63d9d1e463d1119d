"""Hysteresis laws outside the model class, and recordings of them."""

from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.records.collection import collect
from piezoid.records.recording import Recording
from piezoid_datasets.virtual_lab.truths import TRUTHS

Law = Callable[[Array], Array]
RATE_Hz = 500.0
CYCLED = np.array([1.0, -1.0, 1.0, -1.0])


def _of_the_laboratory(number: int) -> Law:
    ceramic = TRUTHS[number].draw(np.random.default_rng(7))
    return lambda field: np.asarray(sum(ceramic.respond(field, CYCLED)))


def _dahl(field: Array) -> Array:
    """Return the law of saturating friction, dz = du (1 - z sgn(du) / 0.15)."""
    state, friction = 0.0, np.empty_like(field)
    for k, step in enumerate(np.diff(field, prepend=field[0]).tolist()):
        state = min(max(state + step * (1.0 - state * np.sign(step) / 0.15), -0.15), 0.15)
        friction[k] = state
    return field + 0.03 * field**2 - 0.5 * friction


def _duhem(field: Array) -> Array:
    """Return the law of Coleman and Hodgdon with a cubic anhysteretic curve."""
    state, states = 0.0, np.empty_like(field)
    for k, step in enumerate(np.diff(field, prepend=field[0]).tolist()):
        difference = 0.9 * field[k] + 0.1 * field[k] ** 3 - state
        state += 1.3 * abs(step) * difference + 0.25 * step
        states[k] = state
    return np.asarray(0.5 * field + 0.5 * states)


def _plays(field: Array) -> Array:
    """Return a sum of twelve plays followed by a saturation."""
    total = np.array(field)
    for threshold in np.linspace(0.05, 0.8, 12).tolist():
        state, states = field[0], np.empty_like(field)
        for k, value in enumerate(field.tolist()):
            state = min(max(state, value - threshold), value + threshold)
            states[k] = state
        total += 0.05 * np.exp(-2.0 * threshold) * states
    return np.asarray(np.tanh(0.6 * total) / 0.6)


LAWS: Mapping[str, Law] = {
    **{truth.name: _of_the_laboratory(number) for number, truth in enumerate(TRUTHS)},
    "dahl": _dahl,
    "duhem": _duhem,
    "plays": _plays,
}


def triangles(cycles: int, samples: int, shrinking: float = 0.0) -> Array:
    """Return a triangle from -1 whose cycles shrink by a share each, (cycles * samples,)."""
    phase = np.arange(cycles * samples) / samples
    wave = 1.0 - np.abs(2.0 * (phase % 1.0) - 1.0)
    size = np.clip(1.0 - shrinking * np.floor(phase), 0.1, 1.0)
    return np.asarray(size * (2.0 * wave - 1.0))


@cache
def swept_um(law: str) -> tuple[Array, Array]:
    """Return a drive of eight shrinking triangles, and the response of a law in micrometres."""
    field = triangles(8, 300, 0.1)
    noise = 0.008 * np.random.default_rng(1).standard_normal(len(field))
    return field, np.asarray(6.0 + 10.0 * LAWS[law](field) + noise)


def write(path: Path, field: Array, reading_um: Array, *, rate_Hz: float = RATE_Hz) -> Path:
    """Write a drive of +-5 V and a reading to a CSV file; return its path."""
    lines = ["time [s],voltage [V],displacement [um]"]
    lines += [
        f"{k / rate_Hz:.6f},{5.0 * u:.5f},{y:.6f}"
        for k, (u, y) in enumerate(zip(field.tolist(), reading_um.tolist(), strict=True))
    ]
    path.write_text("\n".join(lines) + "\n")
    return path


def recorded(folder: Path, field: Array, reading_um: Array, **options: float) -> Recording:
    """Return the recording of a drive and a reading, read from a file."""
    return collect([write(folder / "sweep.csv", field, reading_um, **options)])[0]
