"""FrequencyResponse: measured lines with variances, and rejected lines."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezoid.numerics.arrays import (
    Array,
    ComplexArray,
    expect_shapes,
    freeze,
    frozen_complex,
    strictly_increasing,
)


@dataclass(frozen=True, kw_only=True, eq=False)
class FrequencyResponse:
    """A non-parametric response of several inputs and outputs, with its variances.

    inputs, outputs      names of the axes
    sampling_rate_Hz     of the data
    frequency_Hz         (lines,)  increasing, > 0
    response             (lines, outputs, inputs)  m/V, complex
    noise_variance       (lines, outputs, inputs)  m2/V2, of the estimate, from what changes
                         between periods
    distortion_variance  (lines, outputs, inputs)  m2/V2, of the estimate, from what changes
                         between realisations beyond noise; zero where it could not be told apart
    coherence            (lines, outputs)  share of the output's power a linear system explains
    is_interference      (lines, outputs)  single lines whose residual stands out: mains, drift
    is_rejected          (lines, outputs)  those, and where coherence is below
                         ``least_coherence``: kept to be shown, left out of fits
    least_coherence      the limit used
    variance_freedom     complex degrees of freedom behind each variance after smoothing
    drive_rms_V          (inputs,)  the level at which all this holds
    realisations         how many there were
    periods              how many of each

    At one level this is the best linear approximation, not the small-signal response.
    """

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    sampling_rate_Hz: float
    frequency_Hz: Array
    response: ComplexArray
    noise_variance: Array
    distortion_variance: Array
    coherence: Array
    is_interference: NDArray[np.bool_]
    is_rejected: NDArray[np.bool_]
    least_coherence: float
    variance_freedom: float
    drive_rms_V: Array
    realisations: int = 1
    periods: int = 1

    def __post_init__(self) -> None:
        freeze(self, "frequency_Hz", "drive_rms_V")
        freeze(self, "coherence", ndim=2)
        freeze(self, "noise_variance", "distortion_variance", ndim=3)
        object.__setattr__(self, "response", frozen_complex(self.response, "response"))
        for name in ("is_interference", "is_rejected"):
            flags = np.array(getattr(self, name), dtype=np.bool_)
            flags.setflags(write=False)
            object.__setattr__(self, name, flags)
        strictly_increasing(self.frequency_Hz, "frequency_Hz")
        shape = (len(self.frequency_Hz), len(self.outputs), len(self.inputs))
        by_path = ("response", "noise_variance", "distortion_variance")
        by_output = ("coherence", "is_interference", "is_rejected")
        expect_shapes(self, dict.fromkeys(by_path, shape))
        expect_shapes(self, dict.fromkeys(by_output, shape[:2]))

    @property
    def variance(self) -> Array:
        """Variance of the estimate from noise and distortion together, m2/V2."""
        return np.asarray(self.noise_variance + self.distortion_variance)

    def weights(self) -> Array:
        """Return one over the standard deviation, V/m; zero where a line is rejected."""
        spread = np.sqrt(self.variance)
        floor = 1e-9 * np.abs(self.response).max()  # a noiseless simulation must not divide by 0
        return np.asarray(np.where(self.is_rejected[:, :, None], 0.0, 1.0 / (spread + floor)))

    def at_lines(self, lines: NDArray[np.int_]) -> "FrequencyResponse":
        """Return some of the lines, by their numbers in increasing order."""
        cut = {name: getattr(self, name)[lines] for name in _BY_LINE}
        return FrequencyResponse(**{**vars(self), **cut})


_BY_LINE = (
    "frequency_Hz",
    "response",
    "noise_variance",
    "distortion_variance",
    "coherence",
    "is_interference",
    "is_rejected",
)
