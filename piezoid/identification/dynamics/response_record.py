"""ResponseFit: what a model keeps of a measured frequency response beside its modes."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np

from piezoid.numerics.arrays import Array, ComplexArray

# Creep of 1 to 5 % a decade is 0.1 to 0.4 dB, loops of 15 % lag by 9 degrees: far below these.
STEEPEST_dB = 3.0
FURTHEST_deg = 30.0


@dataclass(frozen=True, kw_only=True)
class SlowPart:
    """The response far below the first mode, where it is that of creep and hysteresis.

        G_slow(f) = (f / from_Hz)^(slope / 20 dB) exp(j phase),   of gain 1 above from_Hz

    Of a slope that is none of creep, or of a phase that may be zero, 1 stands here.

    slope_dB, slope_ci95   of the gain, dB per decade; falling where creep goes on at low frequency
    phase_deg, phase_ci95  the same at all frequencies, delay and modes taken out
    low_Hz, high_Hz        lines it was found in
    from_Hz                the first mode, where it is 1
    """

    slope_dB: float
    slope_ci95: tuple[float, float]
    phase_deg: float
    phase_ci95: tuple[float, float]
    low_Hz: float
    high_Hz: float
    from_Hz: float

    @property
    def falls(self) -> bool:
        """Whether the gain falls for certain, and no faster than creep makes it."""
        return self.slope_ci95[1] < 0.0 and self.slope_dB > -STEEPEST_dB

    @property
    def lags(self) -> bool:
        """Whether the phase lags for certain, and no further than creep and hysteresis make it."""
        return self.phase_ci95[1] < 0.0 and self.phase_deg > -FURTHEST_deg

    def response(self, frequency_Hz: Array) -> ComplexArray:
        """Return the slow part at some frequencies, (lines,)."""
        power = self.slope_dB / 20.0 if self.falls else 0.0
        turn = np.radians(self.phase_deg) if self.lags else 0.0
        gain = (np.minimum(frequency_Hz, self.from_Hz) / self.from_Hz) ** power
        return np.asarray(gain * np.exp(1j * turn))


@dataclass(frozen=True, kw_only=True)
class ResponseFit:
    """How the dynamics of an axis were found in a measured frequency response.

    name            of the file
    lines, used     in the file; coherent, and no single lines of interference
    left_out_Hz     coherent lines that were left out for standing alone: mains and the like
    gain_m_per_V    of the model's modes at rest
    gain_ratio      over the middle of the hysteresis' slopes
    factor          of the file's response, to be that of the model: below zero where its sign
                    was against the axis' polarity, other than one where a recording says the gain
    noise_relative  standard deviation of one line far below the first mode, over the gain
    left_relative   what the model leaves of the response at its worst, over the larger of gain
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

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return asdict(self)

    @staticmethod
    def from_json(content: Mapping[str, Any]) -> "ResponseFit":
        """Return the record that ``to_json`` wrote, number for number."""
        held = {field.name: content[field.name] for field in fields(ResponseFit)}
        slow = held["slow"]
        if slow is not None:
            ends = {key: tuple(slow[key]) for key in ("slope_ci95", "phase_ci95")}
            slow = SlowPart(**{**slow, **ends})
        return ResponseFit(**{**held, "left_out_Hz": tuple(held["left_out_Hz"]), "slow": slow})

    def scaled(self, factor: float) -> "ResponseFit":
        """Return it with another gain, as where a recording says it."""
        return replace(
            self,
            factor=self.factor * factor,
            gain_m_per_V=self.gain_m_per_V * factor,
            gain_ratio=self.gain_ratio * factor,
        )
