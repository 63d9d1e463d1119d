"""Drive waveforms between -1 and 1, which start and end at -1.

Each function returns ``(samples,)`` positions in the drive range. Staircases rise along half a
cosine, because steps would excite the resonances of the stage.
"""

import itertools

import numpy as np

from piezoid_datasets.virtual_lab.signals import Array


def decaying_sweep(
    rate_Hz: float, frequency_Hz: float, cycles: int, *, keep: float = 0.0, triangle: bool = True
) -> Array:
    """Sweep around the middle with an amplitude that falls linearly from full to ``keep``.

    The turning points are nested, so that all of them remain in the memory.
    """
    phase = _cycles(rate_Hz, frequency_Hz, cycles)
    amplitude = 1.0 - (1.0 - keep) * phase / cycles
    sweep = amplitude * wave(phase - 0.25, triangle=triangle)
    return np.concatenate((sweep, ramp(rate_Hz, float(sweep[-1]), -1.0, 0.5 / frequency_Hz)))


def nested_loops(rate_Hz: float, slope_per_s: float, levels: tuple[float, ...]) -> Array:
    """Move through given turning points at constant speed."""
    stops = (-1.0, *levels, -1.0)
    parts = [np.array([-1.0])]
    for start, end in itertools.pairwise(stops):
        parts.append(ramp(rate_Hz, start, end, abs(end - start) / slope_per_s))
    return np.concatenate(parts)


def random_levels(rate_Hz: float, move_s: float, moves: int, rng: np.random.Generator) -> Array:
    """Move up and down in turn between random levels, without pauses.

    Each move covers a random fraction of the distance to the edge, which gives minor loops of all
    spans at all biases.
    """
    parts, position, edge = [np.array([-1.0])], -1.0, 0.95
    for _ in range(moves):
        target = position + (edge - position) * float(rng.uniform(0.2, 1.0))
        parts.append(glide(rate_Hz, position, target, move_s * float(rng.uniform(0.7, 1.3))))
        position, edge = target, -edge
    return np.concatenate((*parts, glide(rate_Hz, position, -1.0, move_s)))


def staircase(
    rate_Hz: float, move_s: float, hold_s: float, steps: int, rng: np.random.Generator
) -> Array:
    """Move to random levels and hold each."""
    levels = [-1.0, *rng.uniform(-0.95, 0.95, steps).tolist(), -1.0]
    hold = np.ones(round(hold_s * rate_Hz))
    parts = [-hold[: len(hold) // 2]]
    for start, end in itertools.pairwise(levels):
        parts += [glide(rate_Hz, start, end, move_s), end * hold]
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
    """Rise to the end, return to a level, and hold it, so that creep and drift are visible."""
    hold = np.full(round(hold_s * rate_Hz), level)
    up, down = glide(rate_Hz, -1.0, 1.0, move_s), glide(rate_Hz, 1.0, level, move_s)
    return np.concatenate((up, down, hold, glide(rate_Hz, level, -1.0, move_s)))


def wave(phase: Array, *, triangle: bool) -> Array:
    """Return a sine of unit amplitude, or a triangle with the same turning points."""
    sine = np.sin(2.0 * np.pi * phase)
    return 2.0 / np.pi * np.arcsin(np.clip(sine, -1.0, 1.0)) if triangle else sine


def ramp(rate_Hz: float, start: float, end: float, time_s: float) -> Array:
    """Return a linear ramp from start (excluded) to end."""
    count = max(round(time_s * rate_Hz), 1)
    return start + (end - start) * np.arange(1, count + 1) / count


def glide(rate_Hz: float, start: float, end: float, time_s: float) -> Array:
    """Return half a cosine from start (excluded) to end."""
    count = max(round(time_s * rate_Hz), 1)
    return start + (end - start) * 0.5 * (1.0 - np.cos(np.pi * np.arange(1, count + 1) / count))


def _cycles(rate_Hz: float, frequency_Hz: float, cycles: int) -> Array:
    """Return the phase, in cycles, from 0 to ``cycles`` inclusive."""
    count = round(cycles / frequency_Hz * rate_Hz) + 1
    return np.asarray(np.arange(count) * frequency_Hz / rate_Hz, dtype=np.float64)
