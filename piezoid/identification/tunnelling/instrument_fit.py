"""Fit the plant of the junction to cross spectra with an instrument, by moments that vanish.

    m_k(theta) = mean over blocks of  (Y_bk - G_theta(w_k) U_bk) Z_bk*

With the external dither as Z, the noise in the bracket is uncorrelated with Z also in closed loop,
and the m_k vanish at the true plant [Soderstrom & Stoica 1983, instrumental variables]. With Z = U
they would not, because U responds to the noise through the controller. For a periodic dither the
moments are those of the ratio of mean output to mean drive.

Poles and delay have similar phases: the declared poles separate them, within the tolerance of a
data sheet, which no record reduces. A mode of the drive of the tip,

    G_theta -> G_theta ( 1 - a + a / (1 - (f/f_m)^2 + j f / (f_m Q)) )

is added if the residual of the plant without a mode exceeds the noise; otherwise the mode would
change gain and delay. Without a mode, the tail of modes beyond the recorded lines is fitted,

    G_theta -> G_theta ( 1 + r (f / sampling rate)^2 ),   r = (sampling rate / f_m)^2

for a mode of the whole extension. The tail raises the gain like a faster pole; without it the
interval of the delay would be too narrow. Errors of the declared poles give r either sign.
Limitation: an undetected undamped mode between 0.5 and 1.25 times the sampling rate rings in the
images of the hold, which no tail describes, and the interval of the delay is too narrow.

Spectra are of differences of all signals: G commutes with differences, and drift, which would leak
from the edges of the blocks to all lines, becomes a constant. A periodic dither is cut into its
periods, without leakage; any other dither into tapered blocks without overlap, which are
independent. A block contains the response to the drive just before it: with poles of 2 kHz and
blocks of 512 samples this reduces the gain by 0.2 %, more than noise does. The drive can therefore
be filtered by a plant close to the true plant before it is cut, and divided by the response of
that plant afterwards: only the ratio of both plants is subject to that error. Lines at multiples
of 50 and 60 Hz are left out: mains hum repeats in every period that contains a whole number of its
cycles, and would look like a response to the dither.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from piezoid.errors import ExcitationError
from piezoid.identification.tunnelling.junction_plant import DriveMode, JunctionPlant
from piezoid.identification.tunnelling.loop_files import LoopRecord
from piezoid.numerics.arrays import Array, ComplexArray, freeze

MIN_BLOCKS = 8
_MAINS_Hz = (50.0, 60.0)
_HIGHEST_MAINS_Hz = 500.0
_MIN_POWER = 1e-3  # of the strongest line; a periodic dither has no power at other lines

MIN_POLE_Hz = 100.0
HIGHEST_POLE_SHARE = 0.5  # of the sampling rate
# Standard deviation of ln(true pole / declared pole): uniform within a tolerance of 10 %.
POLE_SPREAD = 0.1 / math.sqrt(3.0)
MISFIT = 2.0  # mean square of the weighted moments; 1 expected, 0.1 its scatter at 200 lines
_ROUNDS = 4  # weights depend weakly on the plant: they converge to a per mille after two
_STEPS = 60  # of the solver; ten suffice if the plant is identifiable
_NEIGHBOURS = 9  # lines over which a variance of few blocks is smoothed
_MIN_IMPROVEMENT = 30.0  # of the cost by the three parameters of a mode; noise gives 3 +- 2.5
_MODE_STARTS = (0.1, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.6, 0.8)  # of the sampling rate
_MODE_LOW = (math.log(0.05), math.log(1.5), -1.0)  # ln(f_m / rate), ln Q, a
_MODE_HIGH = (math.log(1.5), math.log(100.0), 1.0)
_MAX_TAIL = 4.0  # r of a mode at half the sampling rate: modes below are fitted as such
_TAIL_SPREAD = 1.0  # prior standard deviation of r: a mode at the sampling rate
_PLANT, _WITH_TAIL = 3, 4  # number of parameters of the plant, and with the tail
_LN_POLE, _TAIL = 1, 3  # their indices


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopSpectra:
    """Fourier coefficients of one record.

    frequency_Hz  (lines,)
    reference     (blocks, lines)
    drive         (blocks, lines)
    output        (blocks, lines)  of the log current
    """

    frequency_Hz: Array
    reference: ComplexArray
    drive: ComplexArray
    output: ComplexArray

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return len(self.reference)

    @cached_property
    def drive_moment(self) -> ComplexArray:
        """Mean cross spectrum of drive and reference, (lines,)."""
        return np.asarray(np.mean(self.drive * self.reference.conj(), axis=0))

    @cached_property
    def output_moment(self) -> ComplexArray:
        """Mean cross spectrum of output and reference, (lines,)."""
        return np.asarray(np.mean(self.output * self.reference.conj(), axis=0))


def spectra_of_dither(
    record: LoopRecord, *, highest_Hz: float, through: JunctionPlant | None = None
) -> LoopSpectra:
    """Return the spectra at the lines excited by the dither, up to a highest frequency.

    through  plant close to the true one: the drive is filtered by it before it is cut, and divided
             by its response afterwards; None: the drive is cut as recorded
    """
    window = _block_window(record)
    length = len(window)
    frequency_Hz = np.asarray(np.fft.rfftfreq(length, 1.0 / record.sampling_rate_Hz), float)
    drive_V = np.diff(record.drive_V)
    signals = (
        np.diff(record.reference),
        drive_V if through is None else through.respond(drive_V),
        np.diff(record.log_current),
    )
    reference, drive, output = (
        np.fft.rfft(sliding_window_view(signal, length)[::length] * window, axis=1)
        for signal in signals
    )
    inside = (frequency_Hz > 0.0) & (frequency_Hz <= highest_Hz)
    difference = 2.0 * np.sin(np.pi * frequency_Hz / record.sampling_rate_Hz)
    power = np.sum(np.abs(reference) ** 2, axis=0)
    power[inside] /= difference[inside] ** 2  # power of the dither, not of its differences
    for mains_Hz in _MAINS_Hz:  # lines within half a line of a harmonic
        harmonic_Hz = np.maximum(np.round(frequency_Hz / mains_Hz), 1.0) * mains_Hz
        distance_Hz = np.abs(frequency_Hz - harmonic_Hz)
        is_mains = distance_Hz < 0.5 * record.sampling_rate_Hz / length
        inside &= ~(is_mains & (frequency_Hz <= _HIGHEST_MAINS_Hz))
    if not np.max(power[inside], initial=0.0) > 0.0:
        raise ExcitationError(
            f"{record.label}: the reference does not move",
            needed="a dither that does not depend on the current",
            remedy="Add a small multisine to the set point or to the drive and record it.",
        )
    inside &= power > _MIN_POWER * np.max(power[inside])
    frequency_Hz, drive = frequency_Hz[inside], drive[:, inside]
    return LoopSpectra(
        frequency_Hz=frequency_Hz,
        reference=reference[:, inside],
        drive=drive if through is None else drive / through.frequency_response(frequency_Hz),
        output=output[:, inside],
    )


def naive_gain(record: LoopRecord, *, highest_Hz: float, flat_Hz: float) -> tuple[float, float]:
    """Return the median of |S_yu / S_uu| at low frequency, and the share of the dither.

    The share is the part of the power of the drive that the dither explains, 0 to 1:
    |S_ur|^2 / (S_uu S_rr), averaged over all lines with the weight S_uu

    highest_Hz  of the lines
    flat_Hz     up to which the plant is flat
    """
    from scipy.signal import csd

    rate_Hz, length = record.sampling_rate_Hz, _block_length(record)
    reference, drive = np.diff(record.reference), np.diff(record.drive_V)
    frequency_Hz = np.fft.rfftfreq(length, 1.0 / rate_Hz)
    inside = (frequency_Hz > 0.0) & (frequency_Hz <= highest_Hz)

    def cross_power(first: Array, second: Array) -> Array:
        _, cross = csd(first, second, rate_Hz, nperseg=length, detrend=False)
        return np.asarray(np.abs(cross[inside]))

    drive_power = cross_power(drive, drive)
    gain = cross_power(drive, np.diff(record.log_current)) / np.maximum(drive_power, 1e-300)
    explained = cross_power(drive, reference) ** 2
    explained /= np.maximum(cross_power(reference, reference), 1e-300)
    share = float(np.sum(explained) / np.sum(drive_power))
    return float(np.median(gain[frequency_Hz[inside] <= flat_Hz])), share


def _block_window(record: LoopRecord) -> Array:
    """Return the window of one block: a period of the dither, or a tapered part of the record."""
    if record.period_samples is None:
        length = _block_length(record)
        taper = length // 20  # a twentieth of the length as cosine taper at either end
        window = np.ones(length)
        window[:taper] = 0.5 - 0.5 * np.cos(np.pi * (np.arange(taper) + 0.5) / max(taper, 1))
        window[length - taper :] = window[:taper][::-1]
        return window
    periods = (record.samples - 1) // record.period_samples
    if periods < MIN_BLOCKS:
        raise ExcitationError(
            f"{record.label}: {record.samples} samples contain {periods} whole periods of "
            f"{record.period_samples}, without the first sample",
            needed=f"at least {MIN_BLOCKS} periods, to separate the dither from the noise",
            remedy="Record longer, or shorten the dither's period.",
        )
    return np.ones(record.period_samples)


def _block_length(record: LoopRecord) -> int:
    """Return the power of two that gives at least 32 blocks without overlap."""
    return max(int(2 ** np.floor(np.log2(record.samples / 33))), 16)


@dataclass(frozen=True, kw_only=True, eq=False)
class InstrumentFit:
    """Plant between drive and log current, with its uncertainty.

    plant       gain, sensor pole, delay
    logs        (3,)  ln gain, ln sensor pole, delay over the sampling period
    covariance  (3, 3)  of logs: scatter over blocks, misfit, and tolerance of the declared poles
    common      (3, 3)  part of the covariance that is common to all records of one rig
    misfit      mean square of the weighted moments; near 1 if the form of the plant is right
    mode        of the drive of the tip; None: not detected
    """

    plant: JunctionPlant
    logs: Array
    covariance: Array
    common: Array
    misfit: float
    mode: DriveMode | None

    def __post_init__(self) -> None:
        freeze(self, "logs")
        freeze(self, "covariance", "common", ndim=2)


def fit_with_instrument(
    spectra: LoopSpectra,
    *,
    amplifier_pole_Hz: float,
    sensor_pole_Hz: float | None = None,
    sampling_rate_Hz: float,
) -> InstrumentFit:
    """Fit the plant by instrumental variables, with the reference as instrument.

    spectra         of the loop
    sensor_pole_Hz  declared, within 10 %; None: estimated from the record

    Moments are weighted by their variance over blocks. The parameters are logarithms of gain and
    pole, which keep both positive. Several starts of the delay are tried, because the phase is
    periodic.
    """
    problem = _Moments(
        spectra=spectra,
        amplifier_pole_Hz=amplifier_pole_Hz,
        declared_pole_Hz=sensor_pole_Hz,
        sampling_rate_Hz=sampling_rate_Hz,
    )
    moment = spectra.drive_moment
    drive = np.where(np.abs(moment) > 0.0, moment, 1e-300)
    response = spectra.output_moment / drive  # S_yz / S_uz
    gain = float(np.median(np.abs(response[: max(len(response) // 4, 1)])))
    poles_Hz = (0.1 * sampling_rate_Hz, 0.4 * sampling_rate_Hz)
    starts = [
        np.array([math.log(max(gain, 1e-12)), math.log(pole_Hz), delay, 0.0])
        for pole_Hz in (poles_Hz if sensor_pole_Hz is None else (sensor_pole_Hz,))
        for delay in (0.2, 1.0, 2.0)
    ]
    logs, cost, deviation = problem.settle(starts, problem.deviation(response))
    freedom = problem.freedom(_WITH_TAIL)
    if cost > freedom + 2.0 * math.sqrt(2.0 * freedom):
        starts_with_mode = [
            np.append(logs[:_PLANT], [math.log(frequency), math.log(10.0), share])
            for frequency in _MODE_STARTS
            for share in (0.1, 0.9)
        ]
        with_mode = problem.settle(starts_with_mode, deviation)
        if with_mode[1] < cost - _MIN_IMPROVEMENT * cost / freedom:
            logs, cost, deviation = with_mode
    misfit = cost / problem.freedom(len(logs))
    covariance, common = problem.covariance(logs, deviation, max(misfit, 1.0))
    return InstrumentFit(
        plant=problem.plant(logs),
        logs=logs[:_PLANT],
        covariance=covariance[:_PLANT, :_PLANT],
        common=common[:_PLANT, :_PLANT],
        misfit=misfit,
        mode=problem.mode(logs),
    )


def bounds_of_logs(
    sampling_rate_Hz: float, declared_pole_Hz: float | None = None
) -> tuple[list[float], list[float]]:
    """Return the bounds of logs: any gain, poles from 100 Hz to half the rate, 0 to 8 samples.

    Behind a hold, a faster pole is indistinguishable from a delay. A declared pole extends the
    upper bound to twice its frequency.
    """
    highest_Hz = max(HIGHEST_POLE_SHARE * sampling_rate_Hz, 2.0 * (declared_pole_Hz or 0.0))
    return [-60.0, math.log(MIN_POLE_Hz), 0.0], [60.0, math.log(highest_Hz), 8.0]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Moments:
    """Moments of one record as functions of logs: of the plant, then tail or mode."""

    spectra: LoopSpectra
    amplifier_pole_Hz: float
    declared_pole_Hz: float | None
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
        if len(logs) == _WITH_TAIL:
            return None
        return DriveMode(
            frequency_Hz=math.exp(logs[3]) * self.sampling_rate_Hz,
            quality=math.exp(logs[4]),
            share=float(logs[5]),
        )

    def freedom(self, parameters: int) -> int:
        return max(2 * len(self.spectra.frequency_Hz) - parameters, 1)

    def modelled(self, logs: Array) -> ComplexArray:
        """Return the response of plant and mode or tail, (lines,)."""
        frequency_Hz = self.spectra.frequency_Hz
        response = self.plant(logs).frequency_response(frequency_Hz, self.mode(logs))
        if len(logs) == _WITH_TAIL:
            response = response * (1.0 + logs[_TAIL] * (frequency_Hz / self.sampling_rate_Hz) ** 2)
        return np.asarray(response)

    def block_moments(self, response: ComplexArray) -> ComplexArray:
        """Return the moments of each block for a response, (blocks, lines)."""
        bracket = self.spectra.output - response * self.spectra.drive
        return np.asarray(bracket * self.spectra.reference.conj())

    def deviation(self, response: ComplexArray) -> Array:
        """Return the standard deviation of each part of the mean moments, (lines,)."""
        moments = self.block_moments(response)
        variance = np.var(moments, axis=0, ddof=1) / (2.0 * len(moments))
        kernel = np.ones(min(_NEIGHBOURS, len(variance)))
        share = np.convolve(np.ones_like(variance), kernel, mode="same")
        smooth = np.convolve(variance, kernel, mode="same") / share
        return np.asarray(np.sqrt(np.maximum(smooth, 1e-300)))

    def weighted(self, logs: Array, deviation: Array) -> Array:
        """Return real and imaginary parts of the mean moments, standardised, (2 lines,)."""
        modelled = self.modelled(logs) * self.spectra.drive_moment
        mean = (self.spectra.output_moment - modelled) / deviation
        return np.concatenate([mean.real, mean.imag])

    def settle(self, starts: Sequence[Array], deviation: Array) -> tuple[Array, float, Array]:
        """Solve from every start, then update weights and logs in turn: logs, cost, deviation."""
        logs, cost = min((self.solve(s, deviation) for s in starts), key=lambda pair: pair[1])
        for _ in range(_ROUNDS):
            deviation = self.deviation(self.modelled(logs))
            logs, cost = self.solve(logs, deviation)
        return logs, cost, deviation

    def solve(self, start: Array, deviation: Array) -> tuple[Array, float]:
        from scipy.optimize import least_squares

        low, high = self.bounds(len(start))
        rows, centers = self.priors(len(start))
        result = least_squares(
            lambda logs: np.append(self.weighted(logs, deviation), rows @ logs - centers),
            np.clip(start, low + 1e-9, high - 1e-9),
            bounds=(low, high),
            max_nfev=_STEPS,
        )
        return np.asarray(result.x, dtype=np.float64), 2.0 * float(result.cost)

    def bounds(self, parameters: int) -> tuple[Array, Array]:
        low, high = bounds_of_logs(self.sampling_rate_Hz, self.declared_pole_Hz)
        if parameters == _WITH_TAIL:
            return np.array([*low, -_MAX_TAIL]), np.array([*high, _MAX_TAIL])
        return np.array([*low, *_MODE_LOW]), np.array([*high, *_MODE_HIGH])

    def priors(self, parameters: int) -> tuple[Array, Array]:
        """Return rows (priors, parameters) and centers of unit variance: rows @ logs ~ centers."""
        facts = [(_TAIL, 0.0, _TAIL_SPREAD)] if parameters == _WITH_TAIL else []
        if self.declared_pole_Hz is not None:
            facts.append((_LN_POLE, math.log(self.declared_pole_Hz), POLE_SPREAD))
        rows = np.zeros((len(facts), parameters))
        for row, (number, _, spread) in zip(rows, facts, strict=True):
            row[number] = 1.0 / spread
        return rows, np.array([center / spread for _, center, spread in facts])

    def covariance(self, logs: Array, deviation: Array, misfit: float) -> tuple[Array, Array]:
        """Return the covariance, and the part of it due to the tolerance of declared poles.

        A sandwich over blocks: the squared influences of the blocks are summed and widened by the
        misfit. With few blocks it is uncertain, so that variances are at least those of moments of
        unit variance, (J' J)^-1. Declared values have the same influence in every record; so has
        the pole of the amplifier, which is not fitted: its tolerance times the change it causes.
        """
        moments = self.block_moments(self.modelled(logs)) / deviation
        moments = moments - moments.mean(axis=0)
        parts = np.concatenate([moments.real, moments.imag], axis=1)
        # d weighted / d logs by central differences, (2 lines, parameters)
        low, high = self.bounds(len(logs))
        columns = []
        for step in 1e-5 * np.eye(len(logs)):
            forward, backward = np.minimum(logs + step, high), np.maximum(logs - step, low)
            difference = self.weighted(forward, deviation) - self.weighted(backward, deviation)
            columns.append(difference / (forward - backward).sum())
        jacobian = np.column_stack(columns)
        prior, _ = self.priors(len(logs))
        inverse = np.linalg.pinv(np.vstack([jacobian, prior]))
        by_moments, by_prior = np.split(inverse, [len(jacobian)], axis=1)
        influences = parts @ by_moments.T / len(parts)
        sandwich = influences.T @ influences * len(parts) / (len(parts) - 1)
        expected = by_moments @ by_moments.T
        stretch = np.sqrt(np.maximum(np.diag(expected) / np.diag(sandwich), 1.0))
        faster = replace(self, amplifier_pole_Hz=self.amplifier_pole_Hz * math.exp(1e-4))
        change = 1e4 * (faster.weighted(logs, deviation) - self.weighted(logs, deviation))
        by_amplifier = POLE_SPREAD * (by_moments @ change)
        common = by_prior @ by_prior.T + np.outer(by_amplifier, by_amplifier)
        widened: Array = misfit * sandwich * np.outer(stretch, stretch)
        return widened + common, common
