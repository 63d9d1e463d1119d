"""Plant of the junction from drive to log current, sampled exactly behind the hold.

    dy = K wa/(s + wa) wi/(s + wi) e^(-s tau) du      wa amplifier, wi current sensor, rad/s

A mode of the drive is the factor 1 - a + a / (1 + s/(w Q) + s^2/w^2). Sampling is exact also
beyond half the sampling rate, where the images of the mode fall into the band. Amplifier and
sensor enter symmetrically, so only one of their poles can be identified: that of the amplifier is
declared. Positive drive extends the tip: K > 0.
"""

import cmath
import math
from dataclasses import dataclass, replace

import numpy as np

from piezoid.numerics.arrays import Array, ComplexArray
from piezoid.operators.linear import (
    ContinuousSystem,
    cascade,
    first_order,
    resonance,
    sample,
    sampled_fractions,
)


@dataclass(frozen=True, kw_only=True)
class DriveMode:
    """Mode of the drive of the tip, in addition to the poles of the plant.

    frequency_Hz, quality  of the mode
    share                  a, of the extension
    """

    frequency_Hz: float
    quality: float
    share: float

    def response(self, frequency_Hz: Array) -> ComplexArray:
        """Return 1 - a + a M(f), (frequencies,)."""
        relative = frequency_Hz / self.frequency_Hz
        stiffness = 1.0 - relative**2 + 1j * relative / self.quality
        return np.asarray(1.0 - self.share + self.share / stiffness, dtype=np.complex128)

    @property
    def system(self) -> ContinuousSystem:
        """The mode in continuous time, with gain 1 at rest."""
        mode = resonance(self.frequency_Hz, 0.5 / self.quality)
        return replace(mode, C=self.share * mode.C, D=np.array([[1.0 - self.share]]))

    @property
    def poles(self) -> list[complex]:
        """Both poles, rad/s."""
        damping, frequency = 0.5 / self.quality, 2.0 * math.pi * self.frequency_Hz
        root = cmath.sqrt(damping**2 - 1.0)
        return [frequency * (-damping + root), frequency * (-damping - root)]


@dataclass(frozen=True, kw_only=True)
class JunctionPlant:
    """Linear plant of the junction around a set point.

    gain_nepers_per_V  K = decay times tip extension per volt
    sensor_pole_Hz     of the current sensor
    delay_s            between writing a sample and the drive at the amplifier, >= 0
    amplifier_pole_Hz  declared
    sampling_rate_Hz   of the controller
    """

    gain_nepers_per_V: float
    sensor_pole_Hz: float
    delay_s: float
    amplifier_pole_Hz: float
    sampling_rate_Hz: float

    def __post_init__(self) -> None:
        if not self.delay_s >= 0.0:
            raise ValueError(f"delay_s is {self.delay_s}, expected at least 0")

    def frequency_response(
        self, frequency_Hz: Array, mode: DriveMode | None = None
    ) -> ComplexArray:
        """Return G at each frequency, (frequencies,) nepers per volt.

        mode  of the drive, sampled with the plant: 1 - a times the plant, plus a times the plant
              with the two poles of the mode
        """
        poles_Hz = (self.amplifier_pole_Hz, self.sensor_pole_Hz)
        plant_poles = [-2.0 * math.pi * pole_Hz for pole_Hz in poles_Hz]
        parts: list[tuple[float, list[complex]]] = [(1.0, [])]
        if mode is not None:
            parts = [(1.0 - mode.share, []), (mode.share, mode.poles)]
        response = np.zeros(len(frequency_Hz), dtype=np.complex128)
        for share, mode_poles in parts:
            poles = np.array([[*plant_poles, *mode_poles]], dtype=np.complex128)
            response += sampled_fractions(
                self.gain_nepers_per_V * share * np.prod(-poles, axis=1).real,
                poles,
                np.array([self.delay_s]),
                self.sampling_rate_Hz,
                frequency_Hz,
            )[0]
        return response

    def respond(self, drive_V: Array) -> Array:
        """Return the response of the log current to a drive from rest, (samples,) nepers."""
        poles = cascade(first_order(self.amplifier_pole_Hz), first_order(self.sensor_pole_Hz))
        system = sample(replace(poles, delay_s=self.delay_s), self.sampling_rate_Hz)
        return self.gain_nepers_per_V * system.run(drive_V)[0]
