"""A tunnelling junction under a 20 kHz integral controller, with its disturbances.

    converter -> amplifier pole -> Z piezo (instant) -> gap -> i_set exp(-k (gap - gap_set))
    -> shot and Johnson noise -> current sensor pole -> converter -> log -> integrator -> converter

The chain between the converters runs at ten times the sampling rate, so that noise above half the
sampling rate is aliased as in a laboratory. Positive drive extends the tip: the gap falls and the
current rises. Drift, a random walk of the surface, a vibration, flicker of the tip and mains hum
change the gap; the current also picks up hum. Several junctions are simulated in parallel, each
with its own random generator, so that a recording does not depend on the others.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from piezoid_datasets.virtual_lab.junction_chain import Chain, Constants
from piezoid_datasets.virtual_lab.signals import Array

_DECAY_AT_ONE_EV_PER_M = 1.02462e10  # 2 sqrt(2 m e) / hbar


@dataclass(frozen=True, kw_only=True)
class Junction:
    """A tip over a surface, its electronics and its controller.

    barrier_eV              apparent barrier height
    set_point_A             magnitude; the integrator holds ln(i / set point) at the reference
    drive_gain_m_per_V      extension per converter volt: amplifier 15 V/V times 1.2 nm/V
    amplifier_pole_Hz       of the high-voltage amplifier
    sensor_pole_Hz          of the current sensor
    latency_s               from sampling the current to the new drive, at most one tick
    sampling_rate_Hz        of both converters
    drive_range_V           converter spans plus and minus this in 2^16 steps
    input_range_V           likewise for the current
    current_gain_V_per_A    of the sensor; its reciprocal is taken as the feedback resistor
    integral_gain_V         per neper and tick
    lost_below_A            floor of the logarithm
    drift_m_per_s           of the surface away from the tip
    wander_m_per_root_s     random walk of the surface
    vibration_m             rms of a resonance of the frame
    vibration_Hz            its frequency
    flicker_m               rms of the restless tip, up to flicker_Hz: current noise in proportion
    flicker_Hz              its corner
    mains_Hz                50 or 60
    mains_gap_m             amplitude of the hum of the gap; a third of it at the third harmonic
    mains_current_A         amplitude of the hum picked up by the current sensor
    """

    barrier_eV: float = 4.0
    set_point_A: float = 1e-9
    drive_gain_m_per_V: float = 18e-9
    amplifier_pole_Hz: float = 4000.0
    sensor_pole_Hz: float = 7000.0
    latency_s: float = 30e-6
    sampling_rate_Hz: float = 20000.0
    drive_range_V: float = 10.0
    input_range_V: float = 10.0
    current_gain_V_per_A: float = 1e9
    integral_gain_V: float = 2.5e-4
    lost_below_A: float = 1e-12
    drift_m_per_s: float = 20e-12
    wander_m_per_root_s: float = 20e-12
    vibration_m: float = 3e-12
    vibration_Hz: float = 140.0
    flicker_m: float = 2e-12
    flicker_Hz: float = 1000.0
    mains_Hz: float = 50.0
    mains_gap_m: float = 3e-12
    mains_current_A: float = 2e-12

    def __post_init__(self) -> None:
        if not 0.0 <= self.latency_s <= 1.0 / self.sampling_rate_Hz:
            raise ValueError(f"latency_s is {self.latency_s}, expected at most one tick")

    @property
    def decay_per_m(self) -> float:
        """Decay of the current per metre of gap."""
        return _DECAY_AT_ONE_EV_PER_M * math.sqrt(self.barrier_eV)


@dataclass(frozen=True, kw_only=True, eq=False)
class JunctionRecord:
    """Recording of the controller.

    reference_nepers  (samples,)  set point with dither, ln relative to set_point_A
    drive_V           (samples,)  output of the converter, in integer steps
    current_A         (samples,)  converted current before that drive
    """

    sampling_rate_Hz: float
    set_point_A: float
    reference_nepers: Array
    drive_V: Array
    current_A: Array


def multisine(
    period_samples: int,
    periods: int,
    *,
    lines: Sequence[int],
    rms: float,
    rng: np.random.Generator,
) -> Array:
    """Return a periodic multisine with equal amplitudes and random phases.

    lines  harmonics of the period, below half the sampling rate
    rms    of the multisine, in its unit
    """
    spectrum = np.zeros(period_samples // 2 + 1, dtype=np.complex128)
    spectrum[list(lines)] = np.exp(2j * np.pi * rng.uniform(size=len(lines)))
    period = np.fft.irfft(spectrum, period_samples)
    dither: Array = np.tile(period * (rms / np.std(period)), periods)
    return dither


def simulate_junctions(
    junctions: Sequence[Junction],
    *,
    reference_nepers: Array,
    seeds: Sequence[int],
    drive_dither_V: Array | None = None,
    settle_samples: int = 2000,
) -> tuple[JunctionRecord, ...]:
    """Simulate junctions in parallel with the same reference, and return one recording each.

    junctions         of one sampling rate
    reference_nepers  (samples,)  set point with dither
    seeds             one for each junction
    drive_dither_V    (samples,)  added to the drive before the converter; None for no dither
    settle_samples    simulated before the recording, with the last samples of the reference;
                      default: ten time constants of a slow loop
    """
    reference = _led_in(reference_nepers, settle_samples)
    added_V = np.zeros_like(reference_nepers) if drive_dither_V is None else drive_dither_V
    bench = _Bench(junctions, seeds, len(reference))
    drive_V, current_A = bench.run(reference, _led_in(added_V, settle_samples))
    return tuple(
        JunctionRecord(
            sampling_rate_Hz=junction.sampling_rate_Hz,
            set_point_A=junction.set_point_A,
            reference_nepers=np.array(reference_nepers, dtype=np.float64),
            drive_V=drive_V[settle_samples:, n].copy(),
            current_A=current_A[settle_samples:, n].copy(),
        )
        for n, junction in enumerate(junctions)
    )


def _led_in(signal: Array, settle_samples: int) -> Array:
    """Return a signal preceded by its last samples, repeated if the signal is shorter."""
    return np.concatenate([np.resize(signal[::-1], settle_samples)[::-1], signal])


class _Bench:
    """Constants, disturbances and generators of all junctions, one column each."""

    def __init__(self, junctions: Sequence[Junction], seeds: Sequence[int], ticks: int) -> None:
        rates_Hz = {junction.sampling_rate_Hz for junction in junctions}
        if len(rates_Hz) != 1 or len(seeds) != len(junctions):
            raise ValueError("expected one sampling rate and one seed for each junction")
        self.junctions = junctions
        self.tick_s = 1.0 / rates_Hz.pop()
        self.generators = [np.random.default_rng(seed) for seed in seeds]
        self.surface_m = np.column_stack(
            [
                sunk_m(junction, ticks + 1, self.tick_s, rng)
                for junction, rng in zip(junctions, self.generators, strict=True)
            ]
        )

    def column(self, name: str) -> Array:
        return np.array([getattr(junction, name) for junction in self.junctions])

    def constants(self) -> Constants:
        return Constants(
            tick_s=self.tick_s,
            set_point_A=self.column("set_point_A"),
            decay_per_m=self.column("decay_per_m"),
            drive_gain_m_per_V=self.column("drive_gain_m_per_V"),
            amplifier_pole_Hz=self.column("amplifier_pole_Hz"),
            sensor_pole_Hz=self.column("sensor_pole_Hz"),
            latency_s=self.column("latency_s"),
            feedback_ohm=self.column("current_gain_V_per_A"),
            mains_Hz=self.column("mains_Hz"),
            mains_current_A=self.column("mains_current_A"),
        )

    def run(self, reference: Array, added_V: Array) -> tuple[Array, Array]:
        """Simulate all samples and return drive and current, (ticks, junctions) each."""
        drive_step_V = self.column("drive_range_V") / 2**15
        current_step_A = self.column("input_range_V") / 2**15 / self.column("current_gain_V_per_A")
        set_point_A, lost_A = self.column("set_point_A"), self.column("lost_below_A")
        gain_V, limit_V = self.column("integral_gain_V"), self.column("drive_range_V")
        limit_A = self.column("input_range_V") / self.column("current_gain_V_per_A")
        chain = Chain(self.constants(), self.surface_m, self.generators)
        command_V = np.zeros(len(self.junctions))
        drive_V, current_A = (np.empty((len(reference), len(self.junctions))) for _ in range(2))
        for tick, wanted in enumerate(reference):
            read_A = np.round(chain.sensed_A / current_step_A) * current_step_A
            read_A = np.clip(read_A, -limit_A, limit_A)
            error = wanted - np.log(np.maximum(read_A, lost_A) / set_point_A)
            command_V = np.clip(command_V + gain_V * error, -limit_V, limit_V)
            current_A[tick] = read_A
            wanted_V = np.clip(command_V + added_V[tick], -limit_V, limit_V)
            drive_V[tick] = np.round(wanted_V / drive_step_V) * drive_step_V
            chain.advance(tick, drive_V[tick])
        return drive_V, current_A


def sunk_m(junction: Junction, ticks: int, tick_s: float, rng: np.random.Generator) -> Array:
    """Return the distance by which the surface has moved away from the tip, (ticks,) m."""
    from scipy.signal import lfilter

    time_s = tick_s * np.arange(ticks)
    wander_m = np.cumsum(rng.standard_normal(ticks)) * junction.wander_m_per_root_s
    wander_m *= math.sqrt(tick_s)
    angle = 2.0 * np.pi * junction.vibration_Hz * tick_s
    radius = math.exp(-0.05 * angle)  # 5 % of critical damping
    resonance = [1.0, -2.0 * radius * math.cos(angle), radius**2]
    shaken = lfilter([1.0], resonance, rng.standard_normal(ticks))
    vibration_m = junction.vibration_m * shaken / np.std(shaken)
    forget = math.exp(-2.0 * np.pi * junction.flicker_Hz * tick_s)
    flicker = lfilter([math.sqrt(1.0 - forget**2)], [1.0, -forget], rng.standard_normal(ticks))
    flicker_m = junction.flicker_m * flicker
    phase = 2.0 * np.pi * junction.mains_Hz * time_s
    first, third = rng.uniform(0.0, 2.0 * np.pi, 2)
    hum_m = junction.mains_gap_m * (np.sin(phase + first) + np.sin(3.0 * phase + third) / 3.0)
    surface_m: Array = junction.drift_m_per_s * time_s + wander_m + vibration_m
    surface_m += flicker_m + hum_m
    return surface_m
