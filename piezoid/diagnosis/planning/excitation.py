"""Drives to send to the converters: limits, a drive as CSV, and odd random-phase multisines."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezoid.errors import ExcitationError
from piezoid.numerics.arrays import Array, frozen

CREST_TRIALS = 20  # draws of phases; the one with the lowest peak is taken


@dataclass(frozen=True, kw_only=True)
class DriveLimits:
    """What amplifier and actuator bear; every waveform is made to stay inside.

    voltage_min_V    lowest voltage
    voltage_max_V    highest voltage
    slew_V_per_s     largest rate of change, > 0
    """

    voltage_min_V: float
    voltage_max_V: float
    slew_V_per_s: float

    def __post_init__(self) -> None:
        if not (self.voltage_max_V > self.voltage_min_V and self.slew_V_per_s > 0):
            raise ValueError(f"limits must be ordered and the slew positive, found {self}")


@dataclass(frozen=True, kw_only=True, eq=False)
class Drive:
    """What to send to the converters, one column per axis.

    name              of the experiment
    why               one sentence: what it will show
    sampling_rate_Hz  > 0
    axes              names of the driven axes
    voltage_V         (samples, axes)
    period_samples    length of one period; 0 where nothing repeats
    periods           how many, the first of which is for settling
    """

    name: str
    why: str
    sampling_rate_Hz: float
    axes: tuple[str, ...]
    voltage_V: Array
    period_samples: int = 0
    periods: int = 1

    def __post_init__(self) -> None:
        object.__setattr__(self, "voltage_V", frozen(self.voltage_V, "voltage_V", ndim=2))
        if self.voltage_V.shape[1] != len(self.axes):
            raise ValueError(f"{self.voltage_V.shape[1]} columns for axes {self.axes}")

    def to_csv(self) -> str:
        """Return the drive as text: a header with units, then one row per sample.

        Numbers come back exactly; ingest reads the header as it is.
        """
        header = ",".join(["time [s]", *(f"voltage_{axis} [V]" for axis in self.axes)])
        time_s = np.arange(len(self.voltage_V)) / self.sampling_rate_Hz
        rows = np.column_stack([time_s, self.voltage_V]).tolist()
        return "\n".join([header, *(",".join(map(repr, row)) for row in rows)]) + "\n"


def odd_lines(
    lowest_Hz: float,
    highest_Hz: float,
    resolution_Hz: float,
    *,
    left_out_of: int,
    rng: np.random.Generator,
) -> NDArray[np.int64]:
    """Return odd multiples of the resolution in a band, one of every group left out at random.

    left_out_of  size of a group; the line left out detects odd distortion, as all even lines
                 detect even distortion. 0 leaves none out
    """
    first = int(np.ceil(lowest_Hz / resolution_Hz))
    lines = np.arange(first + 1 - first % 2, int(highest_Hz / resolution_Hz) + 1, 2)
    if left_out_of > 1:
        groups = len(lines) // left_out_of
        silent = np.arange(groups) * left_out_of + rng.integers(0, left_out_of, groups)
        lines = np.delete(lines, silent)
    return np.asarray(lines, dtype=np.int64)


def multisines(
    lines: NDArray[np.int64],
    *,
    period_samples: int,
    periods: int,
    realisations: int,
    rms_V: float,
    offset_V: float,
    axes: Sequence[str],
    sampling_rate_Hz: float,
    limits: DriveLimits,
    rng: np.random.Generator,
) -> tuple[Drive, ...]:
    """Return random-phase multisines, one drive per realisation.

        u(t) = offset + a sum_k cos(2 pi k f_0 t + phi_k)         [Pintelon & Schoukens 2012]

    lines          which multiples of the inverse period to excite, with equal amplitude
    periods        to record; the first is for settling
    realisations   with several axes a multiple of their number: within such a block the axes
                   turn by exp(2 pi j r c / axes), so that their spectra are orthogonal
    rms_V          of each axis about the offset

    Of several draws of phases the one with the lowest peak is kept. Refuses a drive that would
    leave the limits: a clipped multisine excites other lines as well.
    """
    count = len(axes)
    if realisations % count:
        raise ExcitationError(
            f"{realisations} realisations for {count} axes",
            needed="a multiple of the number of axes, for orthogonal blocks",
            remedy=f"Ask for {(realisations // count + 1) * count} realisations.",
        )
    drives = []
    for block in range(realisations // count):
        phases = [_calm_phases(lines, period_samples, rng) for _ in axes]
        for r in range(count):
            turns = np.exp(2j * np.pi * r * np.arange(count) / count)
            columns = [
                _sum_of_lines(lines, np.exp(1j * phase) * turn, period_samples)
                for phase, turn in zip(phases, turns, strict=True)
            ]
            period_V = offset_V + rms_V * np.column_stack(columns)
            _check_periodic(period_V, sampling_rate_Hz, limits)
            drives.append(
                Drive(
                    name=f"multisine_{block * count + r + 1}",
                    why="Linear response, noise and distortion apart, at one level.",
                    sampling_rate_Hz=sampling_rate_Hz,
                    axes=tuple(axes),
                    voltage_V=np.tile(period_V, (periods, 1)),
                    period_samples=period_samples,
                    periods=periods,
                )
            )
    return tuple(drives)


def _sum_of_lines(
    lines: NDArray[np.int64], coefficient: NDArray[np.complex128], samples: int
) -> Array:
    """One period of unit rms."""
    spectrum = np.zeros(samples // 2 + 1, dtype=np.complex128)
    spectrum[lines] = coefficient
    wave = np.fft.irfft(spectrum, samples)
    return np.asarray(wave / np.sqrt(np.mean(wave**2)))


def _calm_phases(lines: NDArray[np.int64], samples: int, rng: np.random.Generator) -> Array:
    draws = rng.uniform(0, 2 * np.pi, (CREST_TRIALS, len(lines)))
    peaks = [np.abs(_sum_of_lines(lines, np.exp(1j * draw), samples)).max() for draw in draws]
    return np.asarray(draws[int(np.argmin(peaks))])


def _check_periodic(period_V: Array, rate_Hz: float, limits: DriveLimits) -> None:
    low_V, high_V = float(period_V.min()), float(period_V.max())
    jumps_V = np.diff(period_V, axis=0, append=period_V[:1])
    slew_V_per_s = float(np.abs(jumps_V).max()) * rate_Hz
    inside = limits.voltage_min_V <= low_V and high_V <= limits.voltage_max_V
    if not inside or slew_V_per_s > limits.slew_V_per_s:
        raise ExcitationError(
            f"the multisine spans {low_V:.4g} to {high_V:.4g} V at up to {slew_V_per_s:.4g} V/s",
            needed=f"{limits.voltage_min_V:g} to {limits.voltage_max_V:g} V and at most "
            f"{limits.slew_V_per_s:g} V/s",
            remedy="Lower rms_V, move the offset, or end the band lower.",
        )
