"""A PID controller with notches and limits: its settings, its polynomials, and its computation."""

from dataclasses import dataclass, replace

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.numerics.polynomial import product, total

_FILTER_SAMPLES = 2.0  # time constant of the filter of D
_DECAY = float(np.exp(-1.0 / _FILTER_SAMPLES))


@dataclass(frozen=True, kw_only=True)
class Notch:
    """A band stop, H(s) = (s^2 + 2 z_n w s + w^2) / (s^2 + 2 z_d w s + w^2), w = 2 pi f.

    frequency_Hz  centre, which Tustin's transform keeps
    depth, width  z_n and z_d; the gain at the centre is depth / width
    """

    frequency_Hz: float
    depth: float
    width: float

    def section(self, rate_Hz: float) -> tuple[Array, Array]:
        """Return numerator and monic denominator in q^-1."""
        t = np.tan(np.pi * self.frequency_Hz / rate_Hz)
        top, bottom = (
            np.array([1.0 + 2.0 * z * t + t * t, 2.0 * (t * t - 1.0), 1.0 - 2.0 * z * t + t * t])
            for z in (self.depth, self.width)
        )
        return np.asarray(top / bottom[0]), np.asarray(bottom / bottom[0])


@dataclass(frozen=True, kw_only=True)
class Pid:
    """Settings; every sample, with T = 1 / sampling_rate_Hz and e = reference - reading,

        i += integral T e;   d += (1 - a) ((e - e_previous) / T - d),   a = exp(-1/2)
        v = notches(proportional e + i + derivative d);   u = rest + v

    then u moves by the slew limit at most, stays within the voltages, and is rounded to the
    converter. While a limit is active, i does not integrate an error that would drive u further.
    """

    sampling_rate_Hz: float
    proportional_V_per_m: float = 0.0
    integral_V_per_m_s: float = 0.0
    derivative_V_s_per_m: float = 0.0
    notches: tuple[Notch, ...] = ()
    rest_V: float
    minimum_V: float
    maximum_V: float
    lsb_V: float = 0.0
    slew_V_per_s: float = np.inf

    def scaled(self, factor: float) -> "Pid":
        """Return the settings with all gains multiplied by a factor."""
        return replace(
            self,
            proportional_V_per_m=self.proportional_V_per_m * factor,
            integral_V_per_m_s=self.integral_V_per_m_s * factor,
            derivative_V_s_per_m=self.derivative_V_s_per_m * factor,
        )

    def sections(self, rate_Hz: float) -> tuple[tuple[Array, Array], ...]:
        """Return B and monic A in q^-1 of the PID (V/m) and of each notch at a sampling rate.

        The filter of D keeps its time constant, each notch its frequency.
        """
        period_s = 1.0 / rate_Hz
        difference = np.array([1.0, -1.0])
        P, integral = self.proportional_V_per_m, self.integral_V_per_m_s * period_s
        notches = tuple(notch.section(rate_Hz) for notch in self.notches)
        if self.derivative_V_s_per_m == 0.0:
            return ((np.array([P + integral, -P]), difference), *notches)
        decay = _DECAY ** (self.sampling_rate_Hz / rate_Hz)
        pole = np.array([1.0, -decay])
        top = total(
            P * product(difference, pole),
            integral * pole,
            self.derivative_V_s_per_m / period_s * (1.0 - decay) * product(difference, difference),
        )
        return ((top, product(difference, pole)), *notches)

    def polynomials(self) -> tuple[Array, Array]:
        """Return R and S of S u = R (r - y), coefficients in q^-1, S monic."""
        tops, bottoms = zip(*self.sections(self.sampling_rate_Hz), strict=True)
        return product(*tops), product(*bottoms)


class PidController:
    """The computation of ``Pid``: one call for each sample."""

    def __init__(self, pid: Pid) -> None:
        self._pid = pid
        self._integral_V = self._derivative_m_per_s = 0.0
        self._previous_m: float | None = None
        self._voltage_V = pid.rest_V
        self._sections = [notch.section(pid.sampling_rate_Hz) for notch in pid.notches]
        self._states = [[0.0, 0.0] for _ in pid.notches]

    def __call__(self, reference_m: float, measured_m: float) -> float:
        """Return the output, V, for one reference and one reading."""
        pid = self._pid
        error_m = reference_m - measured_m
        previous_m = error_m if self._previous_m is None else self._previous_m
        rate_m_per_s = (error_m - previous_m) * pid.sampling_rate_Hz
        self._previous_m = error_m
        self._derivative_m_per_s += (1.0 - _DECAY) * (rate_m_per_s - self._derivative_m_per_s)
        increment_V = pid.integral_V_per_m_s * error_m / pid.sampling_rate_Hz
        self._integral_V += increment_V
        free_V = pid.rest_V + self._notched(
            pid.proportional_V_per_m * error_m
            + self._integral_V
            + pid.derivative_V_s_per_m * self._derivative_m_per_s
        )
        step_V = pid.slew_V_per_s / pid.sampling_rate_Hz
        limited_V = min(max(free_V, self._voltage_V - step_V), self._voltage_V + step_V)
        limited_V = min(max(limited_V, pid.minimum_V), pid.maximum_V)
        if (free_V - limited_V) * increment_V > 0.0:
            self._integral_V -= increment_V
        self._voltage_V = limited_V
        return pid.lsb_V * round(limited_V / pid.lsb_V) if pid.lsb_V > 0.0 else limited_V

    def _notched(self, value: float) -> float:
        """Return the value behind the notches, in transposed direct form II."""
        for (b, a), state in zip(self._sections, self._states, strict=True):
            output = float(b[0]) * value + state[0]
            state[0] = float(b[1]) * value - float(a[1]) * output + state[1]
            state[1] = float(b[2]) * value - float(a[2]) * output
            value = output
        return value
