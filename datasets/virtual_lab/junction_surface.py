"""What moves the gap of a tunnelling junction: drift, a walk, a vibration, a restless tip, hum."""

import math
from dataclasses import dataclass

import numpy as np

from piezoid_datasets.virtual_lab.signals import Array


@dataclass(frozen=True, kw_only=True)
class Unrest:
    """How large each part is; named and described as in a Junction."""

    drift_m_per_s: float
    wander_m_per_root_s: float
    vibration_m: float
    vibration_Hz: float
    flicker_m: float
    flicker_Hz: float
    mains_Hz: float
    mains_gap_m: float


def sunk_m(unrest: Unrest, ticks: int, tick_s: float, rng: np.random.Generator) -> Array:
    """Return how far the surface has sunk below the tip at rest, (ticks,) m."""
    from scipy.signal import lfilter

    time_s = tick_s * np.arange(ticks)
    wander_m = np.cumsum(rng.standard_normal(ticks)) * unrest.wander_m_per_root_s
    wander_m *= math.sqrt(tick_s)
    angle = 2.0 * np.pi * unrest.vibration_Hz * tick_s
    radius = math.exp(-0.05 * angle)  # a twentieth of critical damping
    resonance = [1.0, -2.0 * radius * math.cos(angle), radius**2]
    shaken = lfilter([1.0], resonance, rng.standard_normal(ticks))
    vibration_m = unrest.vibration_m * shaken / np.std(shaken)
    forget = math.exp(-2.0 * np.pi * unrest.flicker_Hz * tick_s)
    flicker = lfilter([math.sqrt(1.0 - forget**2)], [1.0, -forget], rng.standard_normal(ticks))
    flicker_m = unrest.flicker_m * flicker
    phase = 2.0 * np.pi * unrest.mains_Hz * time_s
    first, third = rng.uniform(0.0, 2.0 * np.pi, 2)
    hum_m = unrest.mains_gap_m * (np.sin(phase + first) + np.sin(3.0 * phase + third) / 3.0)
    surface_m: Array = unrest.drift_m_per_s * time_s + wander_m + vibration_m
    surface_m += flicker_m + hum_m
    return surface_m
