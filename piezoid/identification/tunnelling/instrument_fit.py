"""The junction's plant from cross spectra with an instrument: moments that vanish at the truth.

    m_k(theta) = mean over blocks of  (Y_bk - G_theta(w_k) U_bk) Z_bk*

With Z the external dither the noise in the bracket is uncorrelated with it, loop or no loop, and
the m_k vanish at the true plant [Soderstrom & Stoica 1983, instrumental variables]. With Z = U
they would not: U answers to the noise through the controller. For a periodic dither the moments
are those of the ratio of mean output to mean drive.

Poles and delay all delay: what is declared of the poles decides between them, to within a data
sheet's tolerance, which no record averages away. A mode of the tip's drive,

    G_theta -> G_theta ( 1 - a + a / (1 - (f/f_m)^2 + j f / (f_m Q)) )

is let in where the plant without one leaves more than noise: it would pass for gain and delay.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from piezoid.identification.tunnelling.junction_plant import JunctionPlant
from piezoid.identification.tunnelling.loop_spectra import LoopSpectra
from piezoid.numerics.arrays import Array
from piezoid.operators.analogue import resonance
from piezoid.operators.linear import ContinuousSystem

ComplexArray = NDArray[np.complex128]

LEAST_POLE_Hz = 100.0
HIGHEST_POLE_SHARE = 0.5  # of the sampling rate
# Standard deviation of ln(true pole / data sheet's): a tolerance of 10 %, anything inside alike.
POLE_SPREAD = 0.1 / math.sqrt(3.0)
MISFIT = 2.0  # mean square of the weighted moments; 1 expected, 0.1 its scatter at 200 lines
_SUSPECT = 1.2  # misfit from which a mode is sought: two of its standard deviations
_ROUNDS = 4  # weights depend on the plant, weakly: they settle to a per mille after two
_STEPS = 60  # of the solver; ten suffice where there is a plant to find
_NEIGHBOURS = 9  # lines over which a variance is smoothed: few blocks make it rough
_MODE_WORTH = 30.0  # fall of the cost for three numbers more; noise gives 3 +- 2.5
_MODE_STARTS_SHARE = (0.1, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45)  # of the sampling rate
_MODE_LOW = (math.log(0.05), math.log(1.0), -0.8)  # ln(f_m / rate), ln Q, a
_MODE_HIGH = (math.log(0.6), math.log(100.0), 0.8)


@dataclass(frozen=True, kw_only=True)
class DriveMode:
    """A mode of the tip's drive beside the plant's poles.

    frequency_Hz, quality  of the mode
    share                  a, of the extension that it carries
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
        """The same in continuous time, gain 1 at rest."""
        mode = resonance(self.frequency_Hz, 0.5 / self.quality)
        return replace(mode, C=self.share * mode.C, D=np.array([[1.0 - self.share]]))


@dataclass(frozen=True, kw_only=True, eq=False)
class InstrumentFit:
    """A plant and how well it is known.

    plant       fitted
    logs        (3,)  ln gain, ln sensor pole, delay over the sampling period
    covariance  (3, 3)  of logs: scatter over blocks, misfit, and the declared poles' tolerance
    common      (3, 3)  the part of it that every record of this rig has alike
    misfit      mean square of the weighted moments; near 1 when the plant's form fits
    mode        of the drive; None where the plant does without
    """

    plant: JunctionPlant
    logs: Array
    covariance: Array
    common: Array
    misfit: float
    mode: DriveMode | None


def fit_with_instrument(
    spectra: LoopSpectra,
    instrument: ComplexArray,
    *,
    amplifier_pole_Hz: float,
    sensor_pole_Hz: float | None = None,
    known_mode: DriveMode | None = None,
    sampling_rate_Hz: float,
) -> InstrumentFit:
    """Return the plant at which the moments with an instrument vanish as well as they can.

    spectra         of the loop
    instrument      (blocks, lines)  the reference
    sensor_pole_Hz  as declared, 10 % either way; None: found from the record alone
    known_mode      of the drive, as another record of the rig has shown it; None: to be seen

    Moments are weighted by their variance over blocks; gain and pole are kept positive by their
    logarithms; the delay is sought from several starts, because a phase repeats.
    """
    problem = _Moments(
        spectra=spectra,
        instrument=instrument,
        amplifier_pole_Hz=amplifier_pole_Hz,
        declared_pole_Hz=sensor_pole_Hz,
        known_mode=known_mode,
        sampling_rate_Hz=sampling_rate_Hz,
    )
    response = problem.response()
    gain = float(np.median(np.abs(response[: max(len(response) // 4, 1)])))
    poles_Hz = (0.1 * sampling_rate_Hz, 0.4 * sampling_rate_Hz)
    starts = [
        np.array([math.log(max(gain, 1e-12)), math.log(pole_Hz), delay])
        for pole_Hz in (poles_Hz if sensor_pole_Hz is None else (sensor_pole_Hz,))
        for delay in (0.2, 1.0, 2.0)
    ]
    logs, cost, deviation = problem.settle(starts, problem.deviation(response))
    if cost > _SUSPECT * problem.freedom(3):
        beside = [
            np.append(logs, [math.log(share), math.log(10.0), 0.1]) for share in _MODE_STARTS_SHARE
        ]
        with_mode = problem.settle(beside, deviation)
        if with_mode[1] < cost - _MODE_WORTH * cost / problem.freedom(3):
            logs, cost, deviation = with_mode
    misfit = cost / problem.freedom(len(logs))
    covariance, common = problem.covariance(logs, deviation, max(misfit, 1.0))
    return InstrumentFit(
        plant=problem.plant(logs),
        logs=logs[:3],
        covariance=covariance,
        common=common,
        misfit=misfit,
        mode=problem.mode(logs),
    )


def bounds_of_logs(
    sampling_rate_Hz: float, declared_pole_Hz: float | None = None
) -> tuple[list[float], list[float]]:
    """A gain of any size, a pole of 100 Hz to half the sampling rate, a delay of 0 to 8 ticks.

    A hold shows nothing of a faster pole but a delay: what is sought ends where it can be told,
    or at twice the pole that is declared.
    """
    highest_Hz = max(HIGHEST_POLE_SHARE * sampling_rate_Hz, 2.0 * (declared_pole_Hz or 0.0))
    return [-60.0, math.log(LEAST_POLE_Hz), 0.0], [60.0, math.log(highest_Hz), 8.0]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Moments:
    spectra: LoopSpectra
    instrument: ComplexArray
    amplifier_pole_Hz: float
    declared_pole_Hz: float | None
    known_mode: DriveMode | None
    sampling_rate_Hz: float

    def plant(self, logs: Array) -> JunctionPlant:
        return JunctionPlant(
            gain_nepers_per_V=math.exp(logs[0]),
            sensor_pole_Hz=math.exp(logs[1]),
            delay_s=float(logs[2]) / self.sampling_rate_Hz,
            amplifier_pole_Hz=self.amplifier_pole_Hz,
            sampling_rate_Hz=self.sampling_rate_Hz,
        )

    def mode(self, logs: Array) -> DriveMode | None:
        if len(logs) == 3:
            return self.known_mode
        return DriveMode(
            frequency_Hz=math.exp(logs[3]) * self.sampling_rate_Hz,
            quality=math.exp(logs[4]),
            share=float(logs[5]),
        )

    def freedom(self, numbers: int) -> int:
        return max(2 * len(self.output) - numbers, 1)

    def modelled(self, logs: Array) -> ComplexArray:
        """The response over that of the plant the drive has passed already, (lines,)."""
        frequency_Hz, mode = self.spectra.frequency_Hz, self.mode(logs)
        response = self.plant(logs).frequency_response(frequency_Hz)
        if mode is not None:
            response = response * mode.response(frequency_Hz)
        return response / self.passed

    @cached_property
    def passed(self) -> ComplexArray:
        through, frequency_Hz = self.spectra.through, self.spectra.frequency_Hz
        if through is None:
            return np.ones(len(frequency_Hz), dtype=np.complex128)
        return through.frequency_response(frequency_Hz)

    def response(self) -> ComplexArray:
        """The non-parametric estimate, S_yz / S_uz, (lines,)."""
        ratio: ComplexArray = self.output / np.where(np.abs(self.drive) > 0.0, self.drive, 1e-300)
        return ratio * self.passed

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

    def block_moments(self, relative: ComplexArray) -> ComplexArray:
        """Each block's moments, (blocks, lines)."""
        bracket = self.spectra.output - relative * self.spectra.drive
        moments: ComplexArray = bracket * self.instrument.conj()
        return moments

    def deviation(self, response: ComplexArray) -> Array:
        """Standard deviation of each part of the mean moments, (lines,)."""
        moments = self.block_moments(response / self.passed)
        variance = np.var(moments, axis=0, ddof=1) / (2.0 * len(moments))
        kernel = np.ones(min(_NEIGHBOURS, len(variance)))
        share = np.convolve(np.ones_like(variance), kernel, mode="same")
        smooth = np.convolve(variance, kernel, mode="same") / share
        deviation: Array = np.sqrt(np.maximum(smooth, 1e-300))
        return deviation

    def weighted(self, logs: Array, deviation: Array) -> Array:
        """Mean moments in standard deviations, real and imaginary, (2 lines,)."""
        mean = (self.output - self.modelled(logs) * self.drive) / deviation
        return np.concatenate([mean.real, mean.imag])

    def settle(self, starts: Sequence[Array], deviation: Array) -> tuple[Array, float, Array]:
        """Solve from every start, then weigh and solve in turn; (numbers, cost, deviation)."""
        logs, cost = min((self.solve(s, deviation) for s in starts), key=lambda pair: pair[1])
        for _ in range(_ROUNDS):
            deviation = self.deviation(self.modelled(logs) * self.passed)
            logs, cost = self.solve(logs, deviation)
        return logs, cost, deviation

    def solve(self, start: Array, deviation: Array) -> tuple[Array, float]:
        from scipy.optimize import least_squares

        low, high = bounds_of_logs(self.sampling_rate_Hz, self.declared_pole_Hz)
        if len(start) > 3:
            low, high = [*low, *_MODE_LOW], [*high, *_MODE_HIGH]
        result = least_squares(
            lambda logs: np.append(self.weighted(logs, deviation), self.of_declared(logs)),
            np.clip(start, np.add(low, 1e-9), np.subtract(high, 1e-9)),
            bounds=(low, high),
            max_nfev=_STEPS,
        )
        return np.asarray(result.x, dtype=np.float64), 2.0 * float(result.cost)

    def of_declared(self, logs: Array) -> list[float]:
        """How far the sensor's pole lies from the declared one, in standard deviations."""
        if self.declared_pole_Hz is None:
            return []
        return [(float(logs[1]) - math.log(self.declared_pole_Hz)) / POLE_SPREAD]

    def jacobian(self, logs: Array, deviation: Array) -> Array:
        """d weighted / d logs by central differences, (2 lines, numbers)."""
        columns = []
        least = np.where(np.arange(len(logs)) == 2, 0.0, -np.inf)
        for place in range(len(logs)):
            step = np.zeros(len(logs))
            step[place] = 1e-5
            forward = np.maximum(logs + step, least)
            backward = np.maximum(logs - step, least)
            change = self.weighted(forward, deviation) - self.weighted(backward, deviation)
            columns.append(change / (forward - backward)[place])
        return np.column_stack(columns)

    def covariance(self, logs: Array, deviation: Array, misfit: float) -> tuple[Array, Array]:
        """Sandwich over blocks, widened by misfit, and what the declared poles leave open.

        Each block's pull on the estimate, squared and summed. Few blocks make it uncertain, so
        that no variance is taken below the one expected of moments of unit variance, (J' J)^-1.
        A pole that is declared pulls alike in every record; so does the amplifier's, which is
        not fitted: by its tolerance times the shift of the estimate it would cause.
        """
        moments = self.block_moments(self.modelled(logs)) / deviation
        moments = moments - moments.mean(axis=0)
        parts = np.concatenate([moments.real, moments.imag], axis=1)
        jacobian = self.jacobian(logs, deviation)
        prior = np.zeros(len(logs))
        prior[1] = 0.0 if self.declared_pole_Hz is None else 1.0 / POLE_SPREAD
        inverse = np.linalg.pinv(np.vstack([jacobian, prior]))
        pulls = parts @ inverse[:, :-1].T / len(parts)
        sandwich = pulls.T @ pulls * len(parts) / (len(parts) - 1)
        expected = inverse[:, :-1] @ inverse[:, :-1].T
        stretch = np.sqrt(np.maximum(np.diag(expected) / np.diag(sandwich), 1.0))
        faster = replace(self, amplifier_pole_Hz=self.amplifier_pole_Hz * math.exp(1e-4))
        change = 1e4 * (faster.weighted(logs, deviation) - self.weighted(logs, deviation))
        of_amplifier = POLE_SPREAD * (inverse[:, :-1] @ change)
        common = np.outer(inverse[:, -1], inverse[:, -1]) + np.outer(of_amplifier, of_amplifier)
        own: Array = misfit * sandwich * np.outer(stretch, stretch)
        return (own + common)[:3, :3], common[:3, :3]
