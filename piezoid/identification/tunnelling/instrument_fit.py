"""The junction's plant from cross spectra with an instrument: moments that vanish at the truth.

    m_k(theta) = mean over blocks of  (Y_bk - G_theta(w_k) U_bk) Z_bk*

With Z the external dither the noise in the bracket is uncorrelated with it, loop or no loop, and
the m_k vanish at the true plant [Soderstrom & Stoica 1983, instrumental variables]. With Z = U
they would not: U answers to the noise through the controller. For a periodic dither the moments
are those of the ratio of mean output to mean drive.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from piezoid.identification.tunnelling.junction_plant import JunctionPlant
from piezoid.identification.tunnelling.loop_spectra import LoopSpectra
from piezoid.numerics.arrays import Array

ComplexArray = NDArray[np.complex128]

LEAST_POLE_Hz = 100.0
HIGHEST_POLE_SHARE = 0.5  # of the sampling rate
_ROUNDS = 4  # weights depend on the plant, weakly: they settle to a per mille after two
_STEPS = 60  # of the solver; ten suffice where there is a plant to find
_NEIGHBOURS = 9  # lines over which a variance is smoothed: few blocks make it rough


@dataclass(frozen=True, kw_only=True, eq=False)
class InstrumentFit:
    """A plant and how well it is known.

    plant       fitted
    logs        (3,)  ln gain, ln sensor pole, delay over the sampling period
    covariance  (3, 3)  of logs, from the scatter over blocks
    misfit      mean square of the weighted moments; near 1 when the plant's form fits
    """

    plant: JunctionPlant
    logs: Array
    covariance: Array
    misfit: float


def fit_with_instrument(
    spectra: LoopSpectra,
    instrument: ComplexArray,
    *,
    amplifier_pole_Hz: float,
    sampling_rate_Hz: float,
) -> InstrumentFit:
    """Return the plant at which the moments with an instrument vanish as well as they can.

    spectra     of the loop
    instrument  (blocks, lines)  the reference

    Moments are weighted by their variance over blocks; gain and pole are kept positive by their
    logarithms; the delay is sought from several starts, because a phase repeats.
    """
    problem = _Moments(
        spectra=spectra,
        instrument=instrument,
        amplifier_pole_Hz=amplifier_pole_Hz,
        sampling_rate_Hz=sampling_rate_Hz,
    )
    response = problem.response()
    gain = float(np.median(np.abs(response[: max(len(response) // 4, 1)])))
    starts = [
        np.array([math.log(max(gain, 1e-12)), math.log(pole_Hz), delay])
        for pole_Hz in (0.1 * sampling_rate_Hz, 0.4 * sampling_rate_Hz)
        for delay in (0.2, 1.0, 2.0)
    ]
    deviation = problem.deviation(response)
    found = [problem.solve(start, deviation) for start in starts]
    logs = min(found, key=lambda pair: pair[1])[0]
    for _ in range(_ROUNDS):
        deviation = problem.deviation(problem.plant(logs).frequency_response(spectra.frequency_Hz))
        logs, cost = problem.solve(logs, deviation)
    return InstrumentFit(
        plant=problem.plant(logs),
        logs=logs,
        covariance=problem.covariance(logs, deviation),
        misfit=cost / max(2 * len(response) - 3, 1),
    )


def bounds_of_logs(sampling_rate_Hz: float) -> tuple[list[float], list[float]]:
    """A gain of any size, a pole of 100 Hz to half the sampling rate, a delay of 0 to 8 ticks.

    A hold shows nothing of a faster pole but a delay: what is sought ends where it can be told.
    """
    return (
        [-60.0, math.log(LEAST_POLE_Hz), 0.0],
        [60.0, math.log(HIGHEST_POLE_SHARE * sampling_rate_Hz), 8.0],
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Moments:
    spectra: LoopSpectra
    instrument: ComplexArray
    amplifier_pole_Hz: float
    sampling_rate_Hz: float

    def plant(self, logs: Array) -> JunctionPlant:
        return JunctionPlant(
            gain_nepers_per_V=math.exp(logs[0]),
            sensor_pole_Hz=math.exp(logs[1]),
            delay_s=float(logs[2]) / self.sampling_rate_Hz,
            amplifier_pole_Hz=self.amplifier_pole_Hz,
            sampling_rate_Hz=self.sampling_rate_Hz,
        )

    def response(self) -> ComplexArray:
        """The non-parametric estimate, S_yz / S_uz, (lines,)."""
        ratio: ComplexArray = self.output / np.where(np.abs(self.drive) > 0.0, self.drive, 1e-300)
        return ratio

    @cached_property
    def output(self) -> ComplexArray:
        """Mean cross spectrum of output and instrument, (lines,)."""
        mean: ComplexArray = np.mean(self.spectra.output * self.instrument.conj(), axis=0)
        return mean

    @cached_property
    def drive(self) -> ComplexArray:
        """Mean cross spectrum of drive and instrument, (lines,)."""
        mean: ComplexArray = np.mean(self.spectra.drive * self.instrument.conj(), axis=0)
        return mean

    def block_moments(self, response: ComplexArray) -> ComplexArray:
        """Each block's moments, (blocks, lines)."""
        bracket = self.spectra.output - response * self.spectra.drive
        moments: ComplexArray = bracket * self.instrument.conj()
        return moments

    def deviation(self, response: ComplexArray) -> Array:
        """Standard deviation of each part of the mean moments, (lines,)."""
        moments = self.block_moments(response)
        variance = np.var(moments, axis=0, ddof=1) / (2.0 * len(moments))
        kernel = np.ones(min(_NEIGHBOURS, len(variance)))
        share = np.convolve(np.ones_like(variance), kernel, mode="same")
        smooth = np.convolve(variance, kernel, mode="same") / share
        deviation: Array = np.sqrt(np.maximum(smooth, 1e-300))
        return deviation

    def weighted(self, logs: Array, deviation: Array) -> Array:
        """Mean moments in standard deviations, real and imaginary, (2 lines,)."""
        response = self.plant(logs).frequency_response(self.spectra.frequency_Hz)
        mean = (self.output - response * self.drive) / deviation
        return np.concatenate([mean.real, mean.imag])

    def solve(self, start: Array, deviation: Array) -> tuple[Array, float]:
        from scipy.optimize import least_squares

        low, high = bounds_of_logs(self.sampling_rate_Hz)
        result = least_squares(
            lambda logs: self.weighted(logs, deviation),
            np.clip(start, np.add(low, 1e-9), np.subtract(high, 1e-9)),
            bounds=(low, high),
            max_nfev=_STEPS,
        )
        return np.asarray(result.x, dtype=np.float64), 2.0 * float(result.cost)

    def jacobian(self, logs: Array, deviation: Array) -> Array:
        """d weighted / d logs by central differences, (2 lines, 3)."""
        columns = []
        for place in range(3):
            step = np.zeros(3)
            step[place] = 1e-5
            forward = np.maximum(logs + step, [-np.inf, -np.inf, 0.0])
            backward = np.maximum(logs - step, [-np.inf, -np.inf, 0.0])
            change = self.weighted(forward, deviation) - self.weighted(backward, deviation)
            columns.append(change / (forward - backward)[place])
        return np.column_stack(columns)

    def covariance(self, logs: Array, deviation: Array) -> Array:
        """Sandwich over blocks: each block's pull on the estimate, squared and summed.

        Few blocks make it uncertain, so that no variance is taken below the one expected of
        moments of unit variance, (J' J)^-1.
        """
        response = self.plant(logs).frequency_response(self.spectra.frequency_Hz)
        moments = self.block_moments(response) / deviation
        moments = moments - moments.mean(axis=0)
        parts = np.concatenate([moments.real, moments.imag], axis=1)
        inverse = np.linalg.pinv(self.jacobian(logs, deviation))
        pulls = parts @ inverse.T / len(parts)
        sandwich = pulls.T @ pulls * len(parts) / (len(parts) - 1)
        expected = inverse @ inverse.T
        stretch = np.sqrt(np.maximum(np.diag(expected) / np.diag(sandwich), 1.0))
        covariance: Array = sandwich * np.outer(stretch, stretch)
        return covariance
