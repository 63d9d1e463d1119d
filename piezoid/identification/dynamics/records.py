"""Records of the dynamics beside the modes: joint fit, measured response."""

from dataclasses import dataclass

import numpy as np

from piezoid.numerics.arrays import Array, ComplexArray
from piezoid.numerics.robust import NORMAL_95

# Creep of 1 to 5 % a decade is 0.1 to 0.4 dB, loops of 15 % lag by 9 degrees: far below these.
MAX_SLOPE_dB = 3.0
MAX_LAG_deg = 30.0


@dataclass(frozen=True, kw_only=True)
class SlowPart:
    """Quasi-static part of a response: creep and hysteresis, at all frequencies.

        G_slow(f) = (f / from_Hz)^(slope / 20 dB) e^(j phase)

    Creep that goes on at low frequency makes the gain fall; it and hysteresis make the phase lag,
    by the same angle at every frequency. A pole or a filter does neither.

    slope_dB, slope_ci95   of the gain, dB per decade
    phase_deg, phase_ci95  delay and modes taken out
    low_Hz, high_Hz        lines far below the first mode, which tell it
    from_Hz                the first mode, where its gain is 1
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
        """Whether the gain falls for certain, as with creep."""
        return self.is_taken and self.slope_ci95[1] < 0.0

    def response(self, frequency_Hz: Array) -> ComplexArray:
        """Return the slow part at some frequencies, (lines,); 1 where it is not taken."""
        if not self.is_taken:
            return np.ones(len(frequency_Hz), dtype=np.complex128)
        gain = (frequency_Hz / self.from_Hz) ** (self.slope_dB / 20.0)
        return np.asarray(gain * np.exp(1j * np.radians(self.phase_deg)))


@dataclass(frozen=True, kw_only=True)
class ResponseFit:
    """Record of a fit of dynamics to a measured frequency response.

    name            of the file
    lines, used     in the file; coherent, and no single lines of interference
    left_out_Hz     coherent lines that were left out for standing alone: mains and the like
    gain_m_per_V    of the model's modes at rest
    gain_ratio      over the middle of the hysteresis' slopes
    factor          of the file's response, to be that of the model: below zero where its sign
                    was against the axis' polarity, other than one where a recording says the gain
    noise_relative  standard deviation of one line far below the first mode, over the gain
    left_relative   largest residual of the model, over the larger of gain
                    there and gain at rest
    left_Hz         and where
    slow            None where too few lines lie far below the first mode
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
    """Operator and dynamics fitted together; the dynamics themselves are in the axis.

    recordings            of the fit, one for every segment
    play_threshold_V      (plays,)  those of the operator, and small ones of the exciting drive
    play_weight_m_per_V   (plays,)
    dead_zone_weight      (zones,)  at the operator's thresholds
    separate_rms_m        residual of a separate fit of operator and dynamics, each segment
    joint_rms_m           residual of the joint fit, each segment
    """

    recordings: tuple[str, ...]
    play_threshold_V: tuple[float, ...]
    play_weight_m_per_V: tuple[float, ...]
    dead_zone_weight: tuple[float, ...]
    separate_rms_m: tuple[float, ...]
    joint_rms_m: tuple[float, ...]
