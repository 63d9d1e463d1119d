"""Even and odd distortion and noise, measured at lines without drive.

    u of odd lines only:   u^2 responds at even lines, u^3 at odd lines    [Pintelon & Schoukens]

Lines left out of an odd multisine are silent in the drive. The part of the displacement at these
lines that repeats in every period is distortion, the rest noise. Asymmetry responds at even lines,
symmetric hysteresis and saturation at odd lines.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from piezoid.errors import ExcitationError
from piezoid.identification.dynamics.frequency_response import (
    PeriodicData,
    cut_periods,
    estimate_response,
)
from piezoid.numerics.arrays import Array, freeze
from piezoid.numerics.repetition import FEWEST, SETTLING, STILL, Repetition, find_repetition
from piezoid.records.recording import Quantity, Recording

MIN_DRIVEN = 8  # lines: a triangle or a sine has fewer
MIN_SILENT = 3  # odd lines, for an odd level
ONE_SIDED_95 = 1.6448536269514722


@dataclass(frozen=True, kw_only=True, eq=False)
class DetectionLines:
    """Amplitudes at driven and at silent lines, peak; rms over realisations.

    driven_Hz     (driven,)
    driven_m      (driven, outputs)
    frequency_Hz  (silent,)
    is_even       (silent,)
    amplitude_m   (silent, outputs)  without the response to drive at these lines
    noise_m       (silent, outputs)  one standard deviation of that amplitude
    drive_rms_V   (inputs,)
    realisations  number of realisations
    periods       number of periods of each
    recordings    names, one realisation each; empty for data from arrays
    """

    driven_Hz: Array
    driven_m: Array
    frequency_Hz: Array
    is_even: NDArray[np.bool_]
    amplitude_m: Array
    noise_m: Array
    drive_rms_V: Array
    realisations: int
    periods: int
    recordings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        freeze(self, "driven_Hz", "frequency_Hz", "drive_rms_V")
        freeze(self, "driven_m", "amplitude_m", "noise_m", ndim=2)

    def driven_level_m(self) -> Array:
        """Return the rms amplitude of driven lines, (outputs,), m."""
        return np.asarray(np.sqrt((self.driven_m**2).mean(axis=0)))

    def noise_level_m(self) -> Array:
        """Return the rms noise of a line's amplitude, after averaging periods, (outputs,), m."""
        return np.asarray(np.sqrt((self.noise_m**2).mean(axis=0)))

    def level_m(self, *, even: bool) -> Array:
        """Return the rms amplitude on even or odd silent lines beyond noise, (outputs,), m."""
        lines = self._lines(even=even)
        excess = self.amplitude_m[lines] ** 2 - self.noise_m[lines] ** 2
        return np.asarray(np.sqrt(np.maximum(excess.mean(axis=0), 0.0)))

    def limit_m(self, *, even: bool) -> Array:
        """Return the 95 % quantile of the level of noise alone, (outputs,), m.

        The standard deviation of a squared noise amplitude equals its mean, and so does that of
        its estimate from periods - 1 differences.
        """
        lines = self._lines(even=even)
        draws = max(int(lines.sum()) * self.realisations, 1)
        spread = np.sqrt((1.0 + 1.0 / (self.periods - 1)) / draws)
        mean = (self.noise_m[lines] ** 2).mean(axis=0)
        return np.asarray(np.sqrt(ONE_SIDED_95 * spread * mean))

    def _lines(self, *, even: bool) -> NDArray[np.bool_]:
        lines = self.is_even if even else ~self.is_even
        if not lines.any():
            raise ExcitationError(
                f"no silent {'even' if even else 'odd'} line in the band",
                needed="lines of that kind left out of the multisine",
                remedy="Record an odd random-phase multisine with detection lines.",
            )
        return np.asarray(lines)


def distortion_of(recordings: Sequence[Recording], axis: str) -> tuple[DetectionLines, ...]:
    """Return the detection lines of every odd multisine among the recordings.

    recordings  any; those in which the axis alone is driven, without breaks, for three periods or
                more, are grouped by their lines, one realisation each
    """
    groups: dict[tuple[float, int, bytes], list[tuple[Recording, Repetition]]] = {}
    for recording in recordings:
        channels = [recording.find(q, axis) for q in (Quantity.VOLTAGE, Quantity.DISPLACEMENT)]
        if recording.breaks or None in channels:
            continue
        reach_V = float(np.ptp(recording.voltage_V(axis)))
        is_alone = reach_V > 0.0 and all(
            float(np.ptp(channel.values)) <= STILL * reach_V
            for channel in recording.channels
            if channel.quantity is Quantity.VOLTAGE and channel.axis != axis
        )
        repetition = find_repetition(recording.voltage_V(axis)) if is_alone else None
        if repetition is None or repetition.periods < SETTLING + FEWEST:
            continue
        lines = _cut([(recording, repetition)], axis).excited_lines()
        key = (recording.sampling_rate_Hz, repetition.period_samples, lines.tobytes())
        groups.setdefault(key, []).append((recording, repetition))
    detected = []
    for group in groups.values():
        data = _cut(group, axis)
        excited = data.excited_lines()
        if len(excited) < MIN_DRIVEN or (excited % 2 == 0).any():
            continue
        silent_odd = (excited[-1] - excited[0]) // 2 + 1 - len(excited)
        if silent_odd >= MIN_SILENT:
            names = tuple(recording.name for recording, _ in group)
            detected.append(replace(detect_distortion(data), recordings=names))
    return tuple(detected)


def detect_distortion(data: PeriodicData) -> DetectionLines:
    """Return the amplitudes at the lines between the excited lines, inside the excited band.

    data  an odd multisine with lines left out; at least two periods

    The response to leakage of the drive is interpolated from the excited lines and removed.
    """
    excited = data.excited_lines()
    band = np.arange(excited[0], excited[-1] + 1)
    silent = np.setdiff1d(band, excited)
    realisations, periods = data.voltage_V.shape[2:]
    if not len(silent) or periods < 2:
        raise ExcitationError(
            f"{len(silent)} lines without drive, {periods} periods",
            needed="lines left out of the multisine, and two periods to know the noise",
            remedy="Record an odd random-phase multisine with detection lines.",
        )
    response = estimate_response(data)
    frequency_Hz = data.frequency_Hz(silent)
    G = make_interp_spline(response.frequency_Hz, response.response, k=1)(frequency_Hz)
    drive, displacement = data.spectra(silent)
    residual = displacement - np.einsum("koi,kirp->korp", G, drive)
    spread = residual.var(axis=3, ddof=1).mean(axis=2) / periods
    _, driven = data.spectra(excited)
    driven_m, amplitude_m = (
        np.sqrt((np.abs(amplitude.mean(axis=3)) ** 2).mean(axis=2))
        for amplitude in (driven, residual)
    )
    return DetectionLines(
        driven_Hz=response.frequency_Hz,
        driven_m=driven_m,
        frequency_Hz=frequency_Hz,
        is_even=silent % 2 == 0,
        amplitude_m=amplitude_m,
        noise_m=np.sqrt(spread),
        drive_rms_V=response.drive_rms_V,
        realisations=realisations,
        periods=periods,
    )


def _cut(group: Sequence[tuple[Recording, Repetition]], axis: str) -> PeriodicData:
    """Return the last periods of every recording, the same number from each.

    Periodic motion has the same mean in every period, so linear drift is fitted to these means; a
    line fitted to the samples would remove part of the motion.
    """
    periods = min(repetition.periods for _, repetition in group) - SETTLING
    data = cut_periods(group, (axis,), periods)
    measured_m, samples = data.displacement_m, len(data.displacement_m)
    period = np.arange(periods) - 0.5 * (periods - 1)
    time = np.arange(samples * periods).reshape(periods, samples).T / samples
    drift_m = measured_m.mean(axis=0) @ period / (period @ period)
    line_m = np.multiply.outer(drift_m, time - time.mean())
    return replace(data, displacement_m=measured_m - np.moveaxis(line_m, 2, 0))
