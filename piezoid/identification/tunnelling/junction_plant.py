"""Plant of the junction from drive to log current, sampled exactly behind the hold.

    dy = K wa/(s + wa) wi/(s + wi) e^(-s tau) du      wa amplifier, wi current sensor, rad/s

With the step response's terms c_p e^(-p t), c_a = wi/(wi - wa), c_i = wa/(wa - wi), n the least
whole number of samples not below tau, and rho = n Ts - tau the rest, the held plant is

    G(q) = K q^-n [ 1 - (1 - q^-1) sum_p c_p e^(-p rho) / (1 - e^(-p Ts) q^-1) ]

A mode of the drive, 1 - a + a / (1 + s/(w Q) + s^2/w^2), adds a pair of poles to the sum; this
sampling is exact also beyond half the sampling rate, where the images of the mode fall into the
band. Amplifier and sensor enter symmetrically, so only one of their poles can be identified: that
of the amplifier is declared. Positive drive extends the tip: K > 0.
"""

import cmath
import math
from dataclasses import dataclass, replace

import numpy as np

from piezoid.numerics.arrays import Array, ComplexArray
from piezoid.operators.linear import ContinuousSystem, recursive_filter, resonance


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
    def poles(self) -> tuple[complex, complex]:
        """Poles p of the transients e^(-p t), rad/s."""
        damping, frequency = 0.5 / self.quality, 2.0 * math.pi * self.frequency_Hz
        root = cmath.sqrt(damping**2 - 1.0)
        return frequency * (damping + root), frequency * (damping - root)


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

    def _terms(self, mode: DriveMode | None) -> tuple[int, list[tuple[complex, complex]]]:
        """Return n, and for each pole its pulse pole e^(-p Ts) and c_p e^(-p rho).

        c_p is minus the residue of the step response at -p.
        """
        period_s = 1.0 / self.sampling_rate_Hz
        samples = math.ceil(self.delay_s / period_s - 1e-9)
        remainder_s = max(samples * period_s - self.delay_s, 0.0)
        amplifier = 2.0 * math.pi * self.amplifier_pole_Hz
        sensor = 2.0 * math.pi * self.sensor_pole_Hz
        if abs(sensor / amplifier - 1.0) < 1e-6:
            sensor = amplifier * (1.0 + 1e-6)  # a double pole, split by a negligible amount
        poles: list[complex] = [amplifier, sensor, *(() if mode is None else mode.poles)]
        terms = []
        for k, pole in enumerate(poles):
            numerator: complex = amplifier * sensor
            if mode is not None:
                stiffness = (2.0 * math.pi * mode.frequency_Hz) ** 2
                spring = pole**2 - pole * math.sqrt(stiffness) / mode.quality + stiffness
                numerator *= (1.0 - mode.share) * spring + mode.share * stiffness
            distance = math.prod(zero - pole for zero in poles[:k] + poles[k + 1 :])
            share = numerator / (pole * distance)
            terms.append((cmath.exp(-pole * period_s), share * cmath.exp(-pole * remainder_s)))
        return samples, terms

    def frequency_response(
        self, frequency_Hz: Array, mode: DriveMode | None = None
    ) -> ComplexArray:
        """Return G at each frequency, (frequencies,) nepers per volt.

        mode  of the drive, sampled with the plant
        """
        samples, terms = self._terms(mode)
        delay = np.exp(-2j * np.pi * frequency_Hz / self.sampling_rate_Hz)
        remainder = sum(share / (1.0 - pulse * delay) for pulse, share in terms)
        response: ComplexArray = (
            self.gain_nepers_per_V * delay**samples * (1.0 - (1.0 - delay) * remainder)
        )
        return response

    def polynomials(self) -> tuple[Array, Array]:
        """Return B and A in q^-1 with G = B / A, A[0] = 1; the delay leads B as zeros."""
        samples, terms = self._terms(None)
        (pulse_a, share_a), (pulse_i, share_i) = ((p.real, c.real) for p, c in terms)
        pole_a, pole_i = np.array([1.0, -pulse_a]), np.array([1.0, -pulse_i])
        denominator = np.convolve(pole_a, pole_i)
        transient = np.convolve([1.0, -1.0], share_a * pole_i + share_i * pole_a)
        numerator = self.gain_nepers_per_V * (denominator - transient)
        return np.concatenate([np.zeros(samples), numerator]), denominator

    def respond(self, drive_V: Array) -> Array:
        """Return the response of the log current to a drive from rest, (samples,) nepers."""
        numerator, denominator = self.polynomials()
        return recursive_filter(numerator, denominator, drive_V)
