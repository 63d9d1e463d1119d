"""Records of a model beside its modes: slow part, fit of a measured response, joint fit."""

from dataclasses import dataclass

import numpy as np

from piezoid.numerics.arrays import Array, ComplexArray
from piezoid.numerics.robust import NORMAL_95

# Creep of 1 to 5 % per decade is 0.1 to 0.4 dB, loops of 15 % lag by 9 degrees: far below.
MAX_SLOPE_dB = 3.0
MAX_LAG_deg = 30.0


@dataclass(frozen=True, kw_only=True)
class SlowPart:
    """Creep and hysteresis in a frequency response, at all frequencies.

        G_slow(f) = (f / from_Hz)^(slope / 20 dB) e^(j phase)

    Creep makes the gain fall with frequency; creep and hysteresis make the phase lag by the same
    angle at every frequency. A pole or a filter does neither.

    slope_dB, slope_ci95   of the gain, dB per decade
    phase_deg, phase_ci95  without delay and modes
    low_Hz, high_Hz        range of the fitted lines, far below the first mode
    from_Hz                frequency of the first mode, at which the gain of the slow part is 1
    is_taken               whether it may be creep and hysteresis, and was fitted with the modes
    """

    slope_dB: float
    slope_ci95: tuple[float, float]
    phase_deg: float
    phase_ci95: tuple[float, float]
    low_Hz: float
    high_Hz: float
    from_Hz: float
    is_taken: bool

    @staticmethod
    def of(
        power: float,
        power_std: float,
        phase: float,
        phase_std: float,
        band_Hz: tuple[float, float],
        from_Hz: float,
    ) -> "SlowPart":
        """Return the slow part of a power of the frequency and a phase, not yet taken."""
        slope_dB, phase_deg = 20.0 * power, float(np.degrees(phase))
        half_dB = 20.0 * NORMAL_95 * power_std
        half_deg = NORMAL_95 * float(np.degrees(phase_std))
        return SlowPart(
            slope_dB=slope_dB,
            slope_ci95=(slope_dB - half_dB, slope_dB + half_dB),
            phase_deg=phase_deg,
            phase_ci95=(phase_deg - half_deg, phase_deg + half_deg),
            low_Hz=band_Hz[0],
            high_Hz=band_Hz[1],
            from_Hz=from_Hz,
            is_taken=False,
        )

    @property
    def falls(self) -> bool:
        """Whether the gain falls significantly, as with creep."""
        return self.is_taken and self.slope_ci95[1] < 0.0

    def response(self, frequency_Hz: Array) -> ComplexArray:
        """Return the response of the slow part, (lines,); 1 if it is not taken."""
        if not self.is_taken:
            return np.ones(len(frequency_Hz), dtype=np.complex128)
        gain = (frequency_Hz / self.from_Hz) ** (self.slope_dB / 20.0)
        return np.asarray(gain * np.exp(1j * np.radians(self.phase_deg)))


@dataclass(frozen=True, kw_only=True)
class ResponseFit:
    """Record of a fit of dynamics to a measured frequency response.

    name            of the file
    lines, used     number of lines in the file, and of coherent lines without interference
    left_out_Hz     coherent lines that were left out as interference
    gain_m_per_V    of the modes of the model at rest
    gain_ratio      that gain over the middle of the slopes of the hysteresis
    factor          from the response in the file to that of the model: negative if the sign is
                    opposite to the polarity of the axis, not +-1 if a recording determines the
                    gain
    noise_relative  standard deviation of one line far below the first mode, over the gain
    left_relative   largest residual of the model, over the larger of the gain at that line and the
                    gain at rest
    left_Hz         frequency of that residual
    slow            None: too few lines far below the first mode
    """

    name: str
    lines: int
    used: int
    left_out_Hz: tuple[float, ...]
    gain_m_per_V: float
    gain_ratio: float
    factor: float
    noise_relative: float
    left_relative: float
    left_Hz: float
    slow: SlowPart | None


@dataclass(frozen=True, kw_only=True)
class JointFit:
    """Record of a joint fit of operator and dynamics; the axis contains the dynamics.

    recordings            names, one for every segment
    play_threshold_V      (plays,)  of the operator, and smaller ones for the exciting drive
    play_weight_m_per_V   (plays,)
    dead_zone_weight      (zones,)  at the operator's thresholds
    separate_rms_m        residual of separate fits of operator and dynamics, for each segment
    joint_rms_m           residual of the joint fit, for each segment
    """

    recordings: tuple[str, ...]
    play_threshold_V: tuple[float, ...]
    play_weight_m_per_V: tuple[float, ...]
    dead_zone_weight: tuple[float, ...]
    separate_rms_m: tuple[float, ...]
    joint_rms_m: tuple[float, ...]
