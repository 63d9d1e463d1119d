"""The analogue chain of a tunnelling junction between the two converters.

It runs at ten times the sampling rate, so that noise is aliased as in a laboratory.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from piezoid_datasets.virtual_lab.signals import Array

SUBSTEPS = 10
_ELECTRON_C = 1.602176634e-19
_BOLTZMANN_J_PER_K = 1.380649e-23
_ROOM_K = 293.0
_CHUNK = 1000  # samples of noise per call of the generators


@dataclass(frozen=True, kw_only=True, eq=False)
class Constants:
    """Parameters of the chains of all junctions; all but ``tick_s`` are (junctions,)."""

    tick_s: float
    set_point_A: Array
    decay_per_m: Array
    drive_gain_m_per_V: Array
    amplifier_pole_Hz: Array
    sensor_pole_Hz: Array
    latency_s: Array
    feedback_ohm: Array
    mains_Hz: Array
    mains_current_A: Array


class Chain:
    """The chains between the converters, advanced sample by sample in closed form."""

    def __init__(
        self,
        constants: Constants,
        surface_m: Array,
        generators: Sequence[np.random.Generator],
    ) -> None:
        self.constants = constants
        self.surface_m = surface_m
        self.generators = generators
        step_s = constants.tick_s / SUBSTEPS
        # The current is computed at the middle of each step, the amplifier also at the end.
        middles = np.arange(SUBSTEPS) + 0.5
        self.after_s = step_s * np.append(middles, SUBSTEPS)[:, None]
        amplifier = 2.0 * np.pi * constants.amplifier_pole_Hz
        since_new_s = np.maximum(self.after_s - constants.latency_s, 0.0)
        self.start_left = np.exp(-amplifier * self.after_s)
        self.new_share = 1.0 - np.exp(-amplifier * since_new_s)
        self.old_share = 1.0 - self.start_left - self.new_share
        sensor = 2.0 * np.pi * constants.sensor_pole_Hz
        forget = np.exp(-sensor * step_s)
        self.sensor_left = forget**SUBSTEPS
        self.sensor_weight = (1.0 - forget) * forget ** np.arange(SUBSTEPS - 1, -1, -1)[:, None]
        self.shot_A = _ELECTRON_C / step_s
        self.johnson_A2 = 2.0 * _BOLTZMANN_J_PER_K * _ROOM_K / constants.feedback_ohm / step_s
        self.hum_rad_per_s = 2.0 * np.pi * constants.mains_Hz
        self.amplifier_V = np.zeros(len(generators))
        self.previous_V = np.zeros(len(generators))
        self.sensed_A = constants.set_point_A.copy()
        self.noise = np.empty(0)

    def advance(self, tick: int, drive_V: Array) -> None:
        """Advance by one sample; the new drive arrives after the latency."""
        known = self.constants
        if tick % _CHUNK == 0:
            draws = [g.standard_normal((_CHUNK, SUBSTEPS)) for g in self.generators]
            self.noise = np.stack(draws, axis=-1)
        inside_V = (
            self.start_left * self.amplifier_V
            + self.old_share * self.previous_V
            + self.new_share * drive_V
        )
        before_m, after_m = self.surface_m[tick], self.surface_m[tick + 1]
        surface_m = before_m + (after_m - before_m) * (self.after_s / known.tick_s)
        gap_m = (surface_m - known.drive_gain_m_per_V * inside_V)[:-1]
        tunnel_A = known.set_point_A * np.exp(-known.decay_per_m * gap_m)
        noise_A = self.noise[tick % _CHUNK] * np.sqrt(self.shot_A * tunnel_A + self.johnson_A2)
        now_s = tick * known.tick_s + self.after_s[:-1]
        hum_A = known.mains_current_A * np.sin(self.hum_rad_per_s * now_s)
        arriving = self.sensor_weight * (tunnel_A + noise_A + hum_A)
        self.sensed_A = self.sensor_left * self.sensed_A + arriving.sum(axis=0)
        self.amplifier_V, self.previous_V = inside_V[-1], drive_V
