"""Frequency response with variances, and its estimate from periodic data."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter, uniform_filter1d
from scipy.special import gammainccinv

from piezoid.errors import ExcitationError
from piezoid.numerics.arrays import (
    Array,
    ComplexArray,
    freeze,
    same_length,
    strictly_increasing,
)

_BY_LINE = (
    "frequency_Hz", "response", "variance", "coherence", "is_interference", "is_rejected",
)  # fmt: skip
EXCITED_FRACTION = 0.02  # of the strongest line: designed lines lie above, leakage below
TARGET_FREEDOM = 30  # degrees of freedom behind a smoothed variance: weights with little noise
LEAST_COHERENCE = 0.5
LEVEL_LINES = 41  # whose median is the local level of a variance
FALSE_ALARMS = 0.01  # expected per response without interference


@dataclass(frozen=True, kw_only=True, eq=False)
class FrequencyResponse:
    """Non-parametric frequency response of an axis to its own drive, with its variance.

    axis              name of the axis
    sampling_rate_Hz  of the data
    frequency_Hz      (lines,)  increasing, > 0
    response          (lines,)  m/V, complex
    variance          (lines,)  m2/V2, of the estimate
    coherence         (lines,)  share of the power of the output that a linear system explains
    is_interference   (lines,)  single lines with an outlying residual: mains, drift
    is_rejected       (lines,)  interference, or coherence below ``least_coherence``: shown in
                      plots, left out of fits
    least_coherence   limit of the coherence
    variance_freedom  complex degrees of freedom of each variance after smoothing
    drive_rms_V       level of the drive

    This is the best linear approximation at one level, not the small-signal response.
    """

    axis: str
    sampling_rate_Hz: float
    frequency_Hz: Array
    response: ComplexArray
    variance: Array
    coherence: Array
    is_interference: NDArray[np.bool_]
    is_rejected: NDArray[np.bool_]
    least_coherence: float
    variance_freedom: float
    drive_rms_V: float

    def __post_init__(self) -> None:
        freeze(self, "frequency_Hz", "variance", "coherence")
        freeze(self, "response", dtype=np.complex128)
        freeze(self, "is_interference", "is_rejected", dtype=np.bool_)
        strictly_increasing(self.frequency_Hz, "frequency_Hz")
        same_length([(name, getattr(self, name)) for name in _BY_LINE])

    def weights(self) -> Array:
        """Return one over the standard deviation, V/m; zero at rejected lines."""
        spread = np.sqrt(self.variance)
        floor = 1e-9 * np.abs(self.response).max()  # a noiseless simulation must not divide by 0
        return np.asarray(np.where(self.is_rejected, 0.0, 1.0 / (spread + floor)))

    def at_lines(self, lines: NDArray[np.int_]) -> "FrequencyResponse":
        """Return the response at some of its lines, given by their increasing indices."""
        return replace(self, **{name: getattr(self, name)[lines] for name in _BY_LINE})

    def without_rejected(self) -> "FrequencyResponse":
        """Return the response at its lines that are not rejected."""
        return self.at_lines(np.flatnonzero(~self.is_rejected))


@dataclass(frozen=True, kw_only=True, eq=False)
class PeriodicData:
    """Steady-state response to periodic drives, cut into periods.

    sampling_rate_Hz  > 0
    inputs, outputs   names of the driven and of the measured axes
    voltage_V         (samples, inputs, realisations, periods)
    displacement_m    (samples, outputs, realisations, periods)

    Realisations differ in their random phases; periods of one realisation differ only in the
    noise.
    """

    sampling_rate_Hz: float
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    voltage_V: Array
    displacement_m: Array

    def __post_init__(self) -> None:
        freeze(self, "voltage_V", "displacement_m", ndim=4)
        samples, _, realisations, periods = self.voltage_V.shape
        expected = (
            (samples, len(self.inputs), realisations, periods),
            (samples, len(self.outputs), realisations, periods),
        )
        if (shapes := (self.voltage_V.shape, self.displacement_m.shape)) != expected:
            raise ValueError(f"voltage_V and displacement_m have shapes {shapes}, not {expected}")

    def select(self, realisations: Sequence[int]) -> "PeriodicData":
        """Return the data of some realisations, for fitting or as held-out data.

        >>> levels[0].select([0, 1]).voltage_V.shape[2]
        2
        """
        indices = list(realisations)
        return replace(
            self,
            voltage_V=self.voltage_V[:, :, indices, :],
            displacement_m=self.displacement_m[:, :, indices, :],
        )

    def spectra(self, lines: NDArray[np.int64]) -> tuple[ComplexArray, ComplexArray]:
        """Return the Fourier coefficients of drive and response at these lines.

        returned  (lines, inputs or outputs, realisations, periods)  peak amplitudes, V and m

        >>> drive, response = levels[0].spectra(levels[0].excited_lines())
        >>> drive.shape == response.shape
        True
        """
        scale = 2.0 / len(self.voltage_V)
        drive = scale * np.fft.rfft(self.voltage_V, axis=0)[lines]
        return drive, scale * np.fft.rfft(self.displacement_m, axis=0)[lines]

    def excited_lines(self) -> NDArray[np.int64]:
        """Return the lines that the drive excites, as multiples of one over the period.

        >>> bool(np.all(np.diff(levels[0].excited_lines()) > 0))
        True
        """
        mean = self.voltage_V.mean(axis=3)
        power = (np.abs(np.fft.rfft(mean, axis=0)) ** 2).sum(axis=(1, 2))
        power[0] = 0.0
        if len(mean) % 2 == 0:
            power[-1] = 0.0  # the line at half the rate has no phase
        return np.flatnonzero(power > EXCITED_FRACTION**2 * power.max()).astype(np.int64)

    def frequency_Hz(self, lines: NDArray[np.int64]) -> Array:
        """Return the frequencies of lines.

        >>> levels[0].frequency_Hz(np.array([1, 2])).tolist()
        [1.953125, 3.90625]
        """
        return np.asarray(lines * self.sampling_rate_Hz / len(self.voltage_V))


def estimate_response(data: PeriodicData) -> tuple[FrequencyResponse, ...]:
    """Return the best linear approximation of each axis to its own drive.

        G = Y U^H (U U^H)^-1,   E = Y - G U              [Pintelon & Schoukens 2012]

    Y, U are means over periods, one column per realisation. The variance of E between the periods
    of a realisation is noise; further variance between realisations is nonlinear distortion.

    data  of the same axes as inputs and outputs; at least as many realisations as inputs, and one
          realisation or one period more

    Lines with a coherence below ``LEAST_COHERENCE`` are rejected, and so are single lines with an
    outlying residual, which show interference. Orthogonal multisines keep U U^H well conditioned.
    With as many realisations as inputs distortion is not measured.
    """
    lines = data.excited_lines()
    drive, response = data.spectra(lines)
    inputs, realisations, periods = drive.shape[1:]
    if realisations < inputs or (realisations == inputs and periods < 2):
        raise ExcitationError(
            f"{realisations} realisations of {periods} periods for {inputs} inputs",
            needed="as many realisations as inputs, and one realisation or one period more to "
            "see the variance",
            remedy="Record orthogonal multisines: twice as many realisations as inputs.",
        )
    U, Y = drive.mean(axis=3), response.mean(axis=3)
    adjoint = np.conj(np.swapaxes(U, 1, 2))
    inverse = np.linalg.inv(U @ adjoint)
    G = Y @ adjoint @ inverse
    total, freedom, is_interference = _output_variances(drive, response, G)
    power = (np.abs(Y) ** 2).mean(axis=2)
    coherence = np.clip(1.0 - total / np.maximum(power, np.finfo(float).tiny), 0.0, 1.0)
    return tuple(
        FrequencyResponse(
            axis=axis,
            sampling_rate_Hz=data.sampling_rate_Hz,
            frequency_Hz=data.frequency_Hz(lines),
            response=G[:, k, k],
            variance=total[:, k] * inverse[:, k, k].real,
            coherence=coherence[:, k],
            is_interference=is_interference[:, k],
            is_rejected=(coherence[:, k] < LEAST_COHERENCE) | is_interference[:, k],
            least_coherence=LEAST_COHERENCE,
            variance_freedom=freedom,
            drive_rms_V=float(data.voltage_V[:, k].std()),
        )
        for k, axis in enumerate(data.outputs)
    )


def _output_variances(
    drive: ComplexArray, response: ComplexArray, G: ComplexArray
) -> tuple[Array, float, NDArray[np.bool_]]:
    """Return the variance of the means over periods, (lines, outputs).

    Noise is smoothed over neighbouring lines directly, distortion as a share of the power of the
    output: it arises before the dynamics and has their peaks, which are sharper than the
    smoothing. Also returned are the complex degrees of freedom of the variance, and which lines
    are interference, (lines, outputs); these are excluded from the smoothing.
    """
    inputs, realisations, periods = drive.shape[1:]
    residual = response - np.einsum("koi,kirp->korp", G, drive)
    noise = np.zeros(residual.shape[:2])
    noise_freedom = realisations * (periods - 1)
    if noise_freedom:
        noise = residual.var(axis=3, ddof=1).mean(axis=2) / periods
    freedom = realisations - inputs
    draws = freedom or noise_freedom
    odd_lines = (len(residual) - 1) // 2 * 2 + 1
    width = max(1, min(int(np.ceil(TARGET_FREEDOM / draws)) // 2 * 2 + 1, odd_lines))
    total = noise
    if freedom:
        total = (np.abs(residual.mean(axis=3)) ** 2).sum(axis=2) / freedom
    power = (np.abs(np.einsum("koi,kirp->korp", G, drive)) ** 2).mean(axis=(2, 3))
    # Interference is far above its neighbours: mains, its harmonics, drift. Both the variance and
    # its share of the output power must exceed the limit: distortion at a sharp resonance exceeds
    # only the first, noise between resonances only the second.
    limit = gammainccinv(draws, FALSE_ALARMS / total.size) / gammainccinv(draws, 0.5)
    level_lines = min(LEVEL_LINES, odd_lines)
    is_interference = np.ones(total.shape, dtype=np.bool_)
    for quantity in (total, total / np.maximum(power, np.finfo(float).tiny)):
        level = median_filter(quantity, (level_lines, 1), mode="mirror")
        is_interference &= quantity > limit * level
    is_usable = ~is_interference
    share = smooth_lines(is_usable * (total - noise), width) / np.maximum(
        smooth_lines(is_usable * power, width), np.finfo(float).tiny
    )
    variance = smooth_lines(noise, width) + np.maximum(share, 0.0) * power
    return variance, float(width * draws), is_interference


def smooth_lines(variance: Array, width: int) -> Array:
    """Return the mean over an odd number of neighbouring lines, reflected at the ends."""
    return np.asarray(uniform_filter1d(variance, width, axis=0, mode="mirror"))
