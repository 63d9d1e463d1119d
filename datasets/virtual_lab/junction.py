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

from piezoid_datasets.virtual_lab.signals import Array

SUBSTEPS = 10
_DECAY_AT_ONE_EV_PER_M = 1.02462e10  # 2 sqrt(2 m e) / hbar
_ELECTRON_C = 1.602176634e-19
_BOLTZMANN_J_PER_K = 1.380649e-23
_ROOM_K = 293.0
_CHUNK = 1000  # samples of noise per call of the generators


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
    rates_Hz = {junction.sampling_rate_Hz for junction in junctions}
    if len(rates_Hz) != 1 or len(seeds) != len(junctions):
        raise ValueError("expected one sampling rate and one seed for each junction")
    added_V = np.zeros_like(reference_nepers) if drive_dither_V is None else drive_dither_V
    # The last samples of each signal precede it, repeated if it is shorter.
    reference, added_V = (
        np.concatenate([np.resize(signal[::-1], settle_samples)[::-1], signal])
        for signal in (reference_nepers, added_V)
    )
    chain = _Chain(junctions, 1.0 / rates_Hz.pop(), seeds, len(reference))
    drive_step_V = chain.column("drive_range_V") / 2**15
    limit_V, gain_V = chain.column("drive_range_V"), chain.column("integral_gain_V")
    limit_A = chain.column("input_range_V") / chain.column("current_gain_V_per_A")
    current_step_A = chain.column("input_range_V") / 2**15 / chain.column("current_gain_V_per_A")
    set_point_A, lost_A = chain.column("set_point_A"), chain.column("lost_below_A")
    command_V = np.zeros(len(junctions))
    drive_V, current_A = (np.empty((len(reference), len(junctions))) for _ in range(2))
    for tick, target in enumerate(reference):
        read_A = np.round(chain.sensed_A / current_step_A) * current_step_A
        read_A = np.clip(read_A, -limit_A, limit_A)
        error = target - np.log(np.maximum(read_A, lost_A) / set_point_A)
        command_V = np.clip(command_V + gain_V * error, -limit_V, limit_V)
        current_A[tick] = read_A
        output_V = np.clip(command_V + added_V[tick], -limit_V, limit_V)
        drive_V[tick] = np.round(output_V / drive_step_V) * drive_step_V
        chain.advance(tick, drive_V[tick])
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


class _Chain:
    """The chains between the converters, advanced sample by sample in closed form.

    A chain runs at ten times the sampling rate, so that noise is aliased as in a laboratory. Every
    signal has one column for each junction.
    """

    def __init__(
        self, junctions: Sequence[Junction], tick_s: float, seeds: Sequence[int], ticks: int
    ) -> None:
        self.junctions, self.tick_s = junctions, tick_s
        self.generators = [np.random.default_rng(seed) for seed in seeds]
        pairs = zip(junctions, self.generators, strict=True)
        self.surface_m = np.column_stack([sunk_m(j, ticks + 1, tick_s, rng) for j, rng in pairs])
        step_s = tick_s / SUBSTEPS
        # The current is computed at the middle of each step, the amplifier also at the end.
        self.after_s = step_s * np.append(np.arange(SUBSTEPS) + 0.5, SUBSTEPS)[:, None]
        amplifier = 2.0 * np.pi * self.column("amplifier_pole_Hz")
        since_new_s = np.maximum(self.after_s - self.column("latency_s"), 0.0)
        self.start_share = np.exp(-amplifier * self.after_s)
        self.new_share = 1.0 - np.exp(-amplifier * since_new_s)
        self.old_share = 1.0 - self.start_share - self.new_share
        forget = np.exp(-2.0 * np.pi * self.column("sensor_pole_Hz") * step_s)
        self.sensor_share = forget**SUBSTEPS
        self.sensor_weight = (1.0 - forget) * forget ** np.arange(SUBSTEPS - 1, -1, -1)[:, None]
        self.shot_A = _ELECTRON_C / step_s
        feedback_ohm = self.column("current_gain_V_per_A")
        self.johnson_A2 = 2.0 * _BOLTZMANN_J_PER_K * _ROOM_K / feedback_ohm / step_s
        self.hum_rad_per_s = 2.0 * np.pi * self.column("mains_Hz")
        self.hum_A = self.column("mains_current_A")
        self.set_point_A, self.decay_per_m = self.column("set_point_A"), self.column("decay_per_m")
        self.gain_m_per_V = self.column("drive_gain_m_per_V")
        self.amplifier_V = self.previous_V = np.zeros(len(junctions))
        self.sensed_A = self.set_point_A.copy()
        self.noise = np.empty(0)

    def column(self, name: str) -> Array:
        """Return a parameter of all junctions."""
        return np.array([getattr(junction, name) for junction in self.junctions])

    def advance(self, tick: int, drive_V: Array) -> None:
        """Advance by one sample; the new drive arrives after the latency."""
        if tick % _CHUNK == 0:
            draws = [g.standard_normal((_CHUNK, SUBSTEPS)) for g in self.generators]
            self.noise = np.stack(draws, axis=-1)
        inside_V = (
            self.start_share * self.amplifier_V
            + self.old_share * self.previous_V
            + self.new_share * drive_V
        )
        before_m, after_m = self.surface_m[tick], self.surface_m[tick + 1]
        surface_m = before_m + (after_m - before_m) * (self.after_s / self.tick_s)
        gap_m = (surface_m - self.gain_m_per_V * inside_V)[:-1]
        tunnel_A = self.set_point_A * np.exp(-self.decay_per_m * gap_m)
        noise_A = self.noise[tick % _CHUNK] * np.sqrt(self.shot_A * tunnel_A + self.johnson_A2)
        time_s = tick * self.tick_s + self.after_s[:-1]
        hum_A = self.hum_A * np.sin(self.hum_rad_per_s * time_s)
        arriving = self.sensor_weight * (tunnel_A + noise_A + hum_A)
        self.sensed_A = self.sensor_share * self.sensed_A + arriving.sum(axis=0)
        self.amplifier_V, self.previous_V = inside_V[-1], drive_V


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
