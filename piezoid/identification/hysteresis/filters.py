"""Linear filters behind the operator, applied to the output and to every tangent column alike."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.operators.library import KERNELS, address

Coefficients = tuple[float, float, float]


def filter_columns(columns: Array, coefficients: Coefficients, state: Array) -> Array:
    """Run a first-order filter down every column, y[k] = p y[k-1] + b0 x[k] + b1 x[k-1].

    columns       (samples, columns)
    coefficients  p, b0, b1
    state         (2, columns)  last input and last output; updated
    returned      (samples, columns), column-major, new
    """
    values = np.array(columns, order="F")
    KERNELS.pk_first_order(
        len(values),
        values.shape[1],
        len(values),
        address(values),
        *coefficients,
        address(state[0]),
        address(state[1]),
    )
    return values


def first_order(time_constant_s: float, sampling_rate_Hz: float) -> Coefficients:
    """Return the exact first-order lag of a signal that is straight between its samples.

    p = exp(-T/tau), b0 = 1 - (tau/T)(1 - p), b1 = (tau/T)(1 - p) - p; tau = 0 passes everything.
    """
    ratio = time_constant_s * sampling_rate_Hz
    if ratio < 1e-9:
        return 0.0, 1.0, 0.0
    pole = float(np.exp(-1.0 / ratio))
    held = -ratio * float(np.expm1(-1.0 / ratio))
    return pole, 1.0 - held, held - pole


class Lag(Protocol):
    """A filter with one time constant, run chunk by chunk over [output | tangents]."""

    def run(self, columns: Array) -> tuple[Array, Array]:
        """Return the filtered columns, and d(first column)/d(time constant)."""


@dataclass
class NoLag:
    """Passes everything."""

    def run(self, columns: Array) -> tuple[Array, Array]:
        """Return the columns as they are."""
        return columns, np.zeros((len(columns), 0))


@dataclass
class Delay:
    """A pure delay of ``lag_s``, straight between samples; constant before the first one."""

    lag_s: float
    sampling_rate_Hz: float
    tail: Array | None = None

    def run(self, columns: Array) -> tuple[Array, Array]:
        """Return y(t - tau) of every column and -dy/dt of the first."""
        whole = int(np.floor(self.lag_s * self.sampling_rate_Hz))
        part = self.lag_s * self.sampling_rate_Hz - whole
        if self.tail is None:
            self.tail = np.repeat(columns[:1], whole + 1, axis=0)
        joined = np.asfortranarray(np.vstack([self.tail, columns]))
        self.tail = joined[len(columns) :]
        newer, older = joined[1 : 1 + len(columns)], joined[: len(columns)]
        tangent = (older[:, :1] - newer[:, :1]) * self.sampling_rate_Hz
        return (1.0 - part) * newer + part * older, tangent


@dataclass
class FirstOrder:
    """A first-order lag of time constant ``lag_s``, steady before the first sample."""

    lag_s: float
    sampling_rate_Hz: float
    states: dict[str, Array] | None = None

    def run(self, columns: Array) -> tuple[Array, Array]:
        """Return the filtered columns and the derivative of the first by central difference."""
        step_s = 1e-4 * max(self.lag_s, 1.0 / self.sampling_rate_Hz)
        low_s, high_s = max(self.lag_s - step_s, 0.0), self.lag_s + step_s
        if self.states is None:
            start = np.repeat(columns[:1], 2, axis=0)
            self.states = {
                "all": start.copy(),
                "low": start[:, :1].copy(),
                "high": start[:, :1].copy(),
            }
        runs = {}
        for name, time_s, part in (
            ("all", self.lag_s, columns),
            ("low", low_s, columns[:, :1]),
            ("high", high_s, columns[:, :1]),
        ):
            coefficients = first_order(time_s, self.sampling_rate_Hz)
            runs[name] = filter_columns(part, coefficients, self.states[name])
        return runs["all"], (runs["high"] - runs["low"]) / (high_s - low_s)


def lag_of(kind: str, lag_s: float, sampling_rate_Hz: float) -> Lag:
    """Return a fresh lag of this kind for the beginning of a piece."""
    if kind == "delay":
        return Delay(lag_s, sampling_rate_Hz)
    return FirstOrder(lag_s, sampling_rate_Hz) if kind == "first_order" else NoLag()
