"""Rig: converters, amplifier, actuator and sensor of a stage."""

from dataclasses import dataclass

import numpy as np

from piezoid_datasets.virtual_lab.signals import Array


@dataclass(frozen=True, kw_only=True)
class Rig:
    """Converters, amplifier, actuator and sensor of one stage.

    clock_Hz                rate of the converters; slower recordings contain every n-th row
    drive_min_V, _max_V     range of commands at the DAC
    converter_range_V       full scale of DAC and ADC
    amplifier_*             gain, first-order bandwidth, declared output limits
    stroke_m                static displacement between the two ends of the drive range
    sensor_*                gain and first-order bandwidth
    noise_rms_m             of the sensor reading, aliased into the band of the recording
    flicker_share           fraction of the noise variance with a 1/f spectrum
    """

    name: str = "virtual stage"
    clock_Hz: float = 20e3
    drive_min_V: float = 0.0
    drive_max_V: float = 10.0
    converter_range_V: tuple[float, float] = (-10.0, 10.0)
    dac_bits: int = 16
    adc_bits: int = 16
    amplifier_gain_V_per_V: float = 15.0
    amplifier_bandwidth_Hz: float = 4e3
    amplifier_min_V: float = -30.0
    amplifier_max_V: float = 180.0
    stroke_m: float = 33e-6
    sensor_bandwidth_Hz: float = 8.5e3
    sensor_gain_V_per_m: float = 2e5
    noise_rms_m: float = 10e-9
    flicker_share: float = 0.2

    @property
    def dac_step_V(self) -> float:
        """Resolution of the command."""
        low, high = self.converter_range_V
        return (high - low) / 2.0**self.dac_bits

    @property
    def adc_step_m(self) -> float:
        """Resolution of the reading."""
        low, high = self.converter_range_V
        return (high - low) / 2.0**self.adc_bits / self.sensor_gain_V_per_m

    def field_of(self, amplifier_V: Array) -> Array:
        """Convert amplifier volts to the normalised field of the ceramic, -1 to 1."""
        low = self.amplifier_gain_V_per_V * self.drive_min_V
        high = self.amplifier_gain_V_per_V * self.drive_max_V
        return (2.0 * amplifier_V - low - high) / (high - low)


def draw_rig(rng: np.random.Generator, *, name: str = "virtual stage") -> Rig:
    """Return a random rig with a stroke of 20-40 um and noise of 0.02-0.06 % of the stroke."""
    stroke_m = float(rng.uniform(20e-6, 40e-6))
    return Rig(
        name=name,
        stroke_m=stroke_m,
        noise_rms_m=float(rng.uniform(2e-4, 6e-4)) * stroke_m,
        flicker_share=float(rng.uniform(0.05, 0.4)),
    )
