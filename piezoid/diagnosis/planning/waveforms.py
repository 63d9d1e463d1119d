"""Waveforms inside the limits: loops, reversal curves, held levels, sines, ramps, multisines.

A waveform is preceded by two cycles over the whole range, which determine the initial state of
every play, and followed by a return to rest.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from piezoid.diagnosis.planning.drive_limits import DriveLimits
from piezoid.numerics.arrays import Array

CREST_TRIALS = 20  # draws of phases; the one with the lowest peak is taken
CYCLES_BEFORE = 2
CYCLE_s = 2.0  # of one such cycle, where the slew limit allows
FULL_AT_Hz = 100.0  # fastest sine of the full range, to protect the mechanics
GLIDE = np.pi / 2  # peak speed of half a cosine over its mean speed


def rest_V(limits: DriveLimits) -> float:
    """Return the voltage within the limits that is nearest to 0 V."""
    return float(np.clip(0.0, limits.voltage_min_V, limits.voltage_max_V))


def with_lead_in(body_V: Array, rate_Hz: float, limits: DriveLimits) -> Array:
    """Return a drive preceded by cycles over the whole range and followed by a return to rest."""
    full_cycle_V = (limits.voltage_max_V, limits.voltage_min_V)
    stops_V = [rest_V(limits), *full_cycle_V * CYCLES_BEFORE, float(body_V[0])]
    lead_in_V = path_V(stops_V, limits, rate_Hz, move_s=CYCLE_s / 2)
    return_V = path_V([float(body_V[-1]), rest_V(limits)], limits, rate_Hz, move_s=CYCLE_s / 2)
    return np.concatenate([lead_in_V, body_V, return_V])


def path_V(
    stops_V: Sequence[float],
    limits: DriveLimits,
    rate_Hz: float,
    *,
    move_s: float,
    hold_s: float = 0.0,
) -> Array:
    """Return a drive through voltages, with half-cosine moves and holds.

    move_s  of each move; longer if the slew limit requires it
    """
    parts = [np.array([stops_V[0]])]
    for start_V, stop_V in pairwise(stops_V):
        time_s = max(move_s, GLIDE * abs(stop_V - start_V) / limits.slew_V_per_s)
        count = max(int(np.ceil(time_s * rate_Hz)), 1)
        share = 0.5 * (1.0 - np.cos(np.pi * np.arange(1, count + 1) / count))
        parts += [start_V + (stop_V - start_V) * share, np.full(round(hold_s * rate_Hz), stop_V)]
    return np.concatenate(parts)


def decaying_loops(
    limits: DriveLimits, rate_Hz: float, *, frequency_Hz: float, cycles: int
) -> Array:
    """Return triangles about the middle with decaying amplitude: nested minor loops."""
    middle_V, reach_V = _middle(limits)
    frequency_Hz = min(frequency_Hz, limits.slew_V_per_s / (4.5 * reach_V))
    phase = np.arange(round(cycles / frequency_Hz * rate_Hz)) * frequency_Hz / rate_Hz
    amplitude_V = reach_V * (1.0 - phase / cycles)
    return middle_V + np.asarray(amplitude_V) * triangle(np.asarray(phase))


def reversal_curves(limits: DriveLimits, rate_Hz: float, *, curves: int, move_s: float) -> Array:
    """Return first-order reversal curves: from the top down to ever lower turns and back."""
    top_V, low_V = limits.voltage_max_V, limits.voltage_min_V
    turns = np.linspace(top_V, low_V, curves + 1)[1:]
    stops = [top_V, *(stop for turn in turns.tolist() for stop in (turn, top_V))]
    return path_V(stops, limits, rate_Hz, move_s=move_s)


def held_levels(
    limits: DriveLimits,
    rate_Hz: float,
    *,
    levels: int,
    hold_s: float,
    mirrored: bool,
    rng: np.random.Generator,
) -> Array:
    """Return random levels, each held; if ``mirrored``, followed by their mirror image."""
    middle_V, reach_V = _middle(limits)
    shares = rng.uniform(-0.95, 0.95, levels)
    shares = np.concatenate([shares, -shares]) if mirrored else shares
    stops_V = (middle_V + reach_V * shares).tolist()
    return path_V([limits.voltage_min_V, *stops_V], limits, rate_Hz, move_s=0.05, hold_s=hold_s)


def sine_grid(
    limits: DriveLimits,
    rate_Hz: float,
    *,
    shares: Sequence[float],
    frequencies_Hz: Sequence[float],
    block_s: float,
) -> Array:
    """Return sines of every amplitude at every frequency that the slew limit allows.

    shares   amplitudes, of half the range; small and fast ones come first
    block_s  of one sine, and at least three cycles of it
    """
    middle_V, reach_V = _middle(limits)
    parts = [np.array([middle_V])]
    for share in sorted(shares):
        for frequency_Hz in sorted(frequencies_Hz, reverse=True):
            speed_V_per_s = 2 * np.pi * frequency_Hz * share * reach_V
            if speed_V_per_s > limits.slew_V_per_s or share * frequency_Hz > FULL_AT_Hz:
                continue
            cycles = max(round(block_s * frequency_Hz), 3)
            count = round(cycles / frequency_Hz * rate_Hz)
            phase = cycles * np.arange(1, count + 1) / count
            parts.append(middle_V + share * reach_V * np.sin(2 * np.pi * phase))
    return np.concatenate(parts)


def rising_ramps(limits: DriveLimits, rate_Hz: float, *, slowest: float, steps: int) -> Array:
    """Return full triangles whose speed rises from a share of the slew limit up to it."""
    low_V, (_, reach_V) = limits.voltage_min_V, _middle(limits)
    parts = [np.array([low_V])]
    for share in np.geomspace(slowest, 1.0, steps):
        frequency_Hz = share * limits.slew_V_per_s / (4.5 * reach_V)
        count = max(round(2.0 / frequency_Hz * rate_Hz), 8)
        phase = 2.0 * np.arange(1, count + 1) / count
        parts.append(low_V + reach_V * (1.0 + triangle(phase - 0.25)))
    return np.concatenate(parts)


def equal_cycles(
    limits: DriveLimits, rate_Hz: float, *, frequency_Hz: float, cycles: int
) -> Array:
    """Return equal sine cycles."""
    middle_V, reach_V = _middle(limits)
    frequency_Hz = min(frequency_Hz, limits.slew_V_per_s / (2 * np.pi * reach_V))
    phase = np.arange(round(cycles / frequency_Hz * rate_Hz)) * frequency_Hz / rate_Hz
    return np.asarray(middle_V + reach_V * np.sin(2 * np.pi * phase))


def odd_lines(
    lowest_Hz: float,
    highest_Hz: float,
    resolution_Hz: float,
    *,
    left_out_of: int,
    rng: np.random.Generator,
) -> NDArray[np.int64]:
    """Return odd multiples of the resolution in a band, with one of each group left out at random.

    left_out_of  size of a group; the line left out detects odd distortion, as all even lines
                 detect even distortion. 0: no line is left out
    """
    first = int(np.ceil(lowest_Hz / resolution_Hz))
    lines = np.arange(first + 1 - first % 2, int(highest_Hz / resolution_Hz) + 1, 2)
    if left_out_of > 1:
        groups = len(lines) // left_out_of
        silent = np.arange(groups) * left_out_of + rng.integers(0, left_out_of, groups)
        lines = np.delete(lines, silent)
    return np.asarray(lines, dtype=np.int64)


def multisine_period(lines: NDArray[np.int64], samples: int, rng: np.random.Generator) -> Array:
    """Return one period of a random-phase multisine of equal lines and rms 1, (samples,).

        u(t) = sum_k cos(2 pi k f_0 t + phi_k)         [Pintelon & Schoukens 2012]

    Of several draws of the phases the one with the lowest peak is taken.

    lines  multiples of the inverse period that it contains
    """

    def period(phase_rad: Array) -> Array:
        spectrum = np.zeros(samples // 2 + 1, dtype=np.complex128)
        spectrum[lines] = np.exp(1j * phase_rad)
        wave = np.fft.irfft(spectrum, samples)
        return np.asarray(wave / np.sqrt(np.mean(wave**2)))

    draws = rng.uniform(0.0, 2.0 * np.pi, (CREST_TRIALS, len(lines)))
    return min((period(draw) for draw in draws), key=lambda wave: float(np.abs(wave).max()))


def triangle(phase: Array) -> Array:
    """Return a triangle with the reversals of the sine of 2 pi phase."""
    return np.asarray(2.0 / np.pi * np.arcsin(np.sin(2.0 * np.pi * phase)))


def _middle(limits: DriveLimits) -> tuple[float, float]:
    low_V, high_V = limits.range_V
    return 0.5 * (low_V + high_V), 0.5 * (high_V - low_V)
