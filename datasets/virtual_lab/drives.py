"""Drive waveforms a lab plays: all between -1 and 1, at rest at -1 before and after.

Each returns ``(samples,)`` positions in the drive range. A lab rounds its corners: an amplifier
that is asked for a step rings the stage, so staircases rise along half a cosine.
"""

import itertools

import numpy as np

from piezoid_datasets.virtual_lab.signals import Array


def decaying_sweep(
    rate_Hz: float, frequency_Hz: float, cycles: int, *, keep: float = 0.0, triangle: bool = True
) -> Array:
    """Sweep around the middle with an amplitude falling linearly from full to ``keep``.

    The turning points lie inside each other, so every one of them stays in memory.
    """
    phase = _cycles(rate_Hz, frequency_Hz, cycles)
    amplitude = 1.0 - (1.0 - keep) * phase / cycles
    sweep = amplitude * wave(phase - 0.25, triangle=triangle)
    return np.concatenate((sweep, ramp(rate_Hz, float(sweep[-1]), -1.0, 0.5 / frequency_Hz)))


def nested_loops(rate_Hz: float, slope_per_s: float, levels: tuple[float, ...]) -> Array:
    """Walk through turning points at one speed: minor loops where the lab wants them."""
    stops = (-1.0, *levels, -1.0)
    parts = [np.array([-1.0])]
    for here, there in itertools.pairwise(stops):
        parts.append(ramp(rate_Hz, here, there, abs(there - here) / slope_per_s))
    return np.concatenate(parts)


def random_levels(rate_Hz: float, move_s: float, moves: int, rng: np.random.Generator) -> Array:
    """Glide up and down in turn between random levels, resting nowhere.

    Each move goes a random part of the way to the edge: minor loops of every span at every bias.
    """
    parts, here, edge = [np.array([-1.0])], -1.0, 0.95
    for _ in range(moves):
        there = here + (edge - here) * float(rng.uniform(0.2, 1.0))
        parts.append(glide(rate_Hz, here, there, move_s * float(rng.uniform(0.7, 1.3))))
        here, edge = there, -edge
    return np.concatenate((*parts, glide(rate_Hz, here, -1.0, move_s)))


def staircase(
    rate_Hz: float, move_s: float, hold_s: float, steps: int, rng: np.random.Generator
) -> Array:
    """Step to random levels of random sign and hold each."""
    levels = [-1.0, *rng.uniform(-0.95, 0.95, steps).tolist(), -1.0]
    held = np.ones(round(hold_s * rate_Hz))
    parts = [-held[: len(held) // 2]]
    for here, there in itertools.pairwise(levels):
        parts += [glide(rate_Hz, here, there, move_s), there * held]
    return np.concatenate(parts)


def rates(rate_Hz: float, plan: tuple[tuple[float, int], ...], *, triangle: bool = False) -> Array:
    """Play the same full loop at several frequencies: pairs of frequency in Hz and cycles."""
    parts = []
    for frequency_Hz, cycles in plan:
        phase = _cycles(rate_Hz, frequency_Hz, cycles)[:-1]
        parts.append(wave(phase - 0.25, triangle=triangle))
    return np.concatenate(parts)


def chirp(rate_Hz: float, low_Hz: float, high_Hz: float, time_s: float, amplitude: float) -> Array:
    """Rise to the middle and sweep a small sine logarithmically from low to high frequency."""
    time = np.arange(round(time_s * rate_Hz)) / rate_Hz
    growth = np.log(high_Hz / low_Hz) / time_s
    sweep = amplitude * np.sin(2.0 * np.pi * low_Hz * np.expm1(growth * time) / growth)
    up, down = (glide(rate_Hz, a, b, 0.1 * time_s) for a, b in ((-1.0, 0.0), (sweep[-1], -1.0)))
    return np.concatenate((up, sweep, down))


def long_hold(rate_Hz: float, move_s: float, level: float, hold_s: float) -> Array:
    """Go up, come half the way back, hold: what moves now, moves by itself."""
    held = np.full(round(hold_s * rate_Hz), level)
    up, back = glide(rate_Hz, -1.0, 1.0, move_s), glide(rate_Hz, 1.0, level, move_s)
    return np.concatenate((up, back, held, glide(rate_Hz, level, -1.0, move_s)))


def wave(phase: Array, *, triangle: bool) -> Array:
    """Return a sine of unit amplitude, or the triangle that turns where the sine does."""
    sine = np.sin(2.0 * np.pi * phase)
    return 2.0 / np.pi * np.arcsin(np.clip(sine, -1.0, 1.0)) if triangle else sine


def ramp(rate_Hz: float, start: float, end: float, time_s: float) -> Array:
    """Go straight from start (left out) to end."""
    count = max(round(time_s * rate_Hz), 1)
    return start + (end - start) * np.arange(1, count + 1) / count


def glide(rate_Hz: float, start: float, end: float, time_s: float) -> Array:
    """Go from start (left out) to end along half a cosine."""
    count = max(round(time_s * rate_Hz), 1)
    return start + (end - start) * 0.5 * (1.0 - np.cos(np.pi * np.arange(1, count + 1) / count))


def _cycles(rate_Hz: float, frequency_Hz: float, cycles: int) -> Array:
    """Return the phase, in cycles, from 0 to ``cycles`` inclusive."""
    count = round(cycles / frequency_Hz * rate_Hz) + 1
    return np.asarray(np.arange(count) * frequency_Hz / rate_Hz, dtype=np.float64)
