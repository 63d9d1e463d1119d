"""A box with PID, notches and a slew limit: as a fraction, and sample by sample as it computes."""

from dataclasses import dataclass, replace

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.numerics.polynomial import product, total

_FILTERED = 2.0  # samples: time constant of the filter of D


@dataclass(frozen=True, kw_only=True)
class Notch:
    """A band stop, H(s) = (s^2 + 2 z_n w s + w^2) / (s^2 + 2 z_d w s + w^2), w = 2 pi f.

    frequency_Hz  of its middle, which Tustin's transform keeps
    depth, width  z_n and z_d: depth over width is left in the middle
    """

    frequency_Hz: float
    depth: float
    width: float

    def fraction(self, rate_Hz: float) -> tuple[Array, Array]:
        """Return numerator and monic denominator in q^-1."""
        t = np.tan(np.pi * self.frequency_Hz / rate_Hz)
        top, bottom = (
            np.array([1.0 + 2.0 * z * t + t * t, 2.0 * (t * t - 1.0), 1.0 - 2.0 * z * t + t * t])
            for z in (self.depth, self.width)
        )
        return np.asarray(top / bottom[0]), np.asarray(bottom / bottom[0])


@dataclass(frozen=True, kw_only=True)
class Pid:
    """The settings of the box; every sample, with T = 1 / sampling_rate_Hz and e = r - y,

        i += integral T e;   d += (1 - a) ((e - e_before) / T - d),   a = exp(-1/2)
        v = notches(proportional e + i + derivative d);   u = rest + v

    then u moves by the slew limit at most, stays within the voltages, and is rounded to the
    converter. While a limit holds it, i takes up no error that would drive it farther.
    """

    sampling_rate_Hz: float
    proportional_V_per_m: float
    integral_V_per_m_s: float
    derivative_V_s_per_m: float
    notches: tuple[Notch, ...]
    rest_V: float
    minimum_V: float
    maximum_V: float
    lsb_V: float = 0.0
    slew_V_per_s: float = np.inf

    def times(self, factor: float) -> "Pid":
        """Return the same with all gains by a factor larger."""
        return replace(
            self,
            proportional_V_per_m=self.proportional_V_per_m * factor,
            integral_V_per_m_s=self.integral_V_per_m_s * factor,
            derivative_V_s_per_m=self.derivative_V_s_per_m * factor,
        )

    def sections(self, rate_Hz: float) -> tuple[tuple[Array, Array], ...]:
        """Return B and monic A in q^-1 of the PID and of each notch, V/m, at another rate.

        The filter of D keeps its time constant, each notch its frequency.
        """
        period_s = 1.0 / rate_Hz
        difference = np.array([1.0, -1.0])
        P, integral = self.proportional_V_per_m, self.integral_V_per_m_s * period_s
        notches = tuple(notch.fraction(rate_Hz) for notch in self.notches)
        if self.derivative_V_s_per_m == 0.0:
            return ((np.array([P + integral, -P]), difference), *notches)
        kept = _kept() ** (self.sampling_rate_Hz / rate_Hz)
        pole = np.array([1.0, -kept])
        top = total(
            P * product(difference, pole),
            integral * pole,
            self.derivative_V_s_per_m / period_s * (1.0 - kept) * product(difference, difference),
        )
        return ((top, product(difference, pole)), *notches)

    def polynomials(self) -> tuple[Array, Array]:
        """Return R and S of S u = R (r - y), coefficients in q^-1, S monic."""
        tops, bottoms = zip(*self.sections(self.sampling_rate_Hz), strict=True)
        return product(*tops), product(*bottoms)


class PidBox:
    """The box itself: one call a sample."""

    def __init__(self, pid: Pid) -> None:
        self._pid = pid
        self._integral_V = self._derivative_m_per_s = self._before_m = 0.0
        self._voltage_V = pid.rest_V
        self._is_first = True
        self._sections = [notch.fraction(pid.sampling_rate_Hz) for notch in pid.notches]
        self._memory = [[0.0, 0.0] for _ in pid.notches]

    def __call__(self, reference_m: float, measured_m: float) -> float:
        """Return what is put out for a reference and a reading."""
        pid = self._pid
        error_m = reference_m - measured_m
        rate_m_per_s = 0.0 if self._is_first else (error_m - self._before_m) * pid.sampling_rate_Hz
        self._is_first, self._before_m = False, error_m
        self._derivative_m_per_s += (1.0 - _kept()) * (rate_m_per_s - self._derivative_m_per_s)
        taken_V = pid.integral_V_per_m_s * error_m / pid.sampling_rate_Hz
        self._integral_V += taken_V
        wanted_V = pid.rest_V + self._notched(
            pid.proportional_V_per_m * error_m
            + self._integral_V
            + pid.derivative_V_s_per_m * self._derivative_m_per_s
        )
        step_V = pid.slew_V_per_s / pid.sampling_rate_Hz
        allowed_V = min(max(wanted_V, self._voltage_V - step_V), self._voltage_V + step_V)
        allowed_V = min(max(allowed_V, pid.minimum_V), pid.maximum_V)
        if (wanted_V - allowed_V) * taken_V > 0.0:
            self._integral_V -= taken_V
        self._voltage_V = allowed_V
        return pid.lsb_V * round(allowed_V / pid.lsb_V) if pid.lsb_V > 0.0 else allowed_V

    def _notched(self, value: float) -> float:
        for (b, a), memory in zip(self._sections, self._memory, strict=True):
            out = float(b[0]) * value + memory[0]
            memory[0] = float(b[1]) * value - float(a[1]) * out + memory[1]
            memory[1] = float(b[2]) * value - float(a[2]) * out
            value = out
        return value


def _kept() -> float:
    return float(np.exp(-1.0 / _FILTERED))
