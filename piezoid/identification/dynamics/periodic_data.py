"""PeriodicData: steady periods of several realisations, inputs and outputs side by side."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezoid.numerics.arrays import Array, freeze

Spectrum = NDArray[np.complex128]
EXCITED_FRACTION = 0.02  # designed lines differ by less; what leaks onto the others lies below


@dataclass(frozen=True, kw_only=True, eq=False)
class PeriodicData:
    """The steady answer to periodic drives, cut at its periods.

    sampling_rate_Hz  > 0
    inputs, outputs   names of the driven and of the measured axes
    voltage_V         (samples, inputs, realisations, periods)
    displacement_m    (samples, outputs, realisations, periods)

    Realisations differ in their random phases; periods of one realisation only in the noise.
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
        if (found := (self.voltage_V.shape, self.displacement_m.shape)) != expected:
            raise ValueError(f"voltage_V and displacement_m have shapes {found}, not {expected}")

    def select(self, realisations: Sequence[int]) -> "PeriodicData":
        """Return the data of these realisations alone, for fitting or for holding out.

        >>> levels[0].select([0, 1]).voltage_V.shape[2]
        2
        """
        chosen = list(realisations)
        return replace(
            self,
            voltage_V=self.voltage_V[:, :, chosen, :],
            displacement_m=self.displacement_m[:, :, chosen, :],
        )

    def spectra(self, lines: NDArray[np.int64]) -> tuple[Spectrum, Spectrum]:
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
        """Return the lines the drive occupies, as multiples of one over the period.

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
