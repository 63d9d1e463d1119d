"""JunctionPlant: from drive volts to log current, sampled exactly behind the converter's hold.

    dy = K wa/(s + wa) wi/(s + wi) e^(-s tau) du      wa amplifier, wi current sensor, rad/s

With the step response's terms c_p e^(-p t), c_a = wi/(wi - wa), c_i = wa/(wa - wi), n the least
whole number of samples not below tau, and rho = n Ts - tau the rest, the held plant is

    G(q) = K q^-n [ 1 - (1 - q^-1) sum_p c_p e^(-p rho) / (1 - e^(-p Ts) q^-1) ]

The Z piezo (120 kHz) counts as instant at 20 kHz. Amplifier and sensor enter alike, so only one
of their poles can be found from data: the amplifier's is declared. Positive drive extends the
tip: K > 0.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezoid.numerics.arrays import Array
from piezoid.operators.recursive_filter import recursive_filter

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True, kw_only=True)
class JunctionPlant:
    """The junction around a set point, as a controller sees it.

    gain_nepers_per_V  K = decay times tip extension per volt
    sensor_pole_Hz     of the current sensor
    delay_s            from the sample that wrote a drive to the drive at the amplifier, >= 0
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

    def _modes(self) -> tuple[int, list[tuple[float, float]]]:
        """Whole samples n, and for each pole its pulse pole and c_p e^(-p rho)."""
        period_s = 1.0 / self.sampling_rate_Hz
        samples = math.ceil(self.delay_s / period_s - 1e-9)
        rest_s = max(samples * period_s - self.delay_s, 0.0)
        amplifier = 2.0 * math.pi * self.amplifier_pole_Hz
        sensor = 2.0 * math.pi * self.sensor_pole_Hz
        if abs(sensor / amplifier - 1.0) < 1e-6:
            sensor = amplifier * (1.0 + 1e-6)  # a double pole, split by less than it matters
        shares = (
            (amplifier, sensor / (sensor - amplifier)),
            (sensor, amplifier / (amplifier - sensor)),
        )
        modes = [
            (math.exp(-pole * period_s), share * math.exp(-pole * rest_s))
            for pole, share in shares
        ]
        return samples, modes

    def frequency_response(self, frequency_Hz: Array) -> ComplexArray:
        """Return G at each frequency, (frequencies,) nepers per volt."""
        samples, modes = self._modes()
        back = np.exp(-2j * np.pi * frequency_Hz / self.sampling_rate_Hz)
        remainder = sum(share / (1.0 - pulse * back) for pulse, share in modes)
        response: ComplexArray = (
            self.gain_nepers_per_V * back**samples * (1.0 - (1.0 - back) * remainder)
        )
        return response

    def polynomials(self) -> tuple[Array, Array]:
        """Return B and A in q^-1 with G = B / A, A[0] = 1; the delay leads B as zeros."""
        samples, ((pulse_a, share_a), (pulse_i, share_i)) = self._modes()
        pole_a, pole_i = np.array([1.0, -pulse_a]), np.array([1.0, -pulse_i])
        denominator = np.convolve(pole_a, pole_i)
        missing = np.convolve([1.0, -1.0], share_a * pole_i + share_i * pole_a)
        numerator = self.gain_nepers_per_V * (denominator - missing)
        return np.concatenate([np.zeros(samples), numerator]), denominator

    def respond(self, drive_V: Array) -> Array:
        """Return the log current a drive makes from rest, (samples,) nepers."""
        numerator, denominator = self.polynomials()
        return recursive_filter(numerator, denominator, drive_V)
