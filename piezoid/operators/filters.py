"""First-order lags and delays, of one signal or of many columns."""

from dataclasses import dataclass

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.operators.library import KERNELS, address

Coefficients = tuple[float, float, float]
EVERY = slice(None)


@dataclass(frozen=True, kw_only=True)
class FirstOrder:
    """Exact first-order lag of a signal that is linear between its samples.

        y[k] = p y[k-1] + b0 x[k] + b1 x[k-1]
        p = exp(-T/tau),  b0 = 1 - (tau/T)(1 - p),  b1 = (tau/T)(1 - p) - p

    tau = 0: no lag.
    """

    time_s: float
    rate_Hz: float

    @property
    def coefficients(self) -> tuple[float, float, float]:
        """Return p, b0, b1."""
        ratio = self.time_s * self.rate_Hz
        if ratio < 1e-9:
            return 0.0, 1.0, 0.0
        pole = float(np.exp(-1.0 / ratio))
        mean_decay = -ratio * float(np.expm1(-1.0 / ratio))
        return pole, 1.0 - mean_decay, mean_decay - pole

    @property
    def by_time(self) -> tuple[float, float, float]:
        """Return the derivatives of p, b0 and b1 by tau, 1/s."""
        ratio = self.time_s * self.rate_Hz
        if ratio < 1e-9:
            return 0.0, -self.rate_Hz, self.rate_Hz
        pole = float(np.exp(-1.0 / ratio)) / ratio**2
        mean_decay = -float(np.expm1(-1.0 / ratio)) - ratio * pole
        return pole * self.rate_Hz, -mean_decay * self.rate_Hz, (mean_decay - pole) * self.rate_Hz


def first_order(time_constant_s: float, sampling_rate_Hz: float) -> Coefficients:
    """Return p, b0, b1 of the exact first-order lag of a piecewise linear signal."""
    return FirstOrder(time_s=time_constant_s, rate_Hz=sampling_rate_Hz).coefficients


def relaxed(signal: Array, time_s: float, rate_Hz: float) -> Array:
    """Filter a signal by a first-order lag, with linear interpolation between samples."""
    if len(signal) == 0:
        return signal
    values = np.array(signal if signal.ndim == 2 else signal[:, None], order="F")
    state = np.repeat(values[:1], 2, axis=0)  # last input and last output
    KERNELS.pk_first_order(
        len(values),
        values.shape[1],
        len(values),
        address(values),
        *first_order(time_s, rate_Hz),
        address(state[0]),
        address(state[1]),
    )
    return values.reshape(signal.shape)


def later(signal: Array, samples: float, keep: slice = EVERY) -> Array:
    """Delay a signal by a number of samples, interpolated linearly, in the rows to keep."""
    whole_samples = int(np.floor(samples))
    fraction = samples - whole_samples
    first, stop, step = keep.indices(len(signal))
    rows = len(range(first, stop, step))
    # The first rows depend on the first sample only.
    initial_rows = min(rows, len(range(first, whole_samples + 1, step)))
    shifted = np.empty((rows, *signal.shape[1:]), order="F")
    shifted[:initial_rows] = (1.0 - fraction) * signal[:1] + fraction * signal[:1]
    if initial_rows < rows:
        first += initial_rows * step - whole_samples
        newer, older = (signal[first - k : stop - whole_samples - k : step] for k in (0, 1))
        columns = (np.atleast_2d(table.T) for table in (shifted[initial_rows:], newer, older))
        for column, new, old in zip(*columns, strict=True):  # single columns fit into the cache
            column[:] = (1.0 - fraction) * new + fraction * old
    return shifted


def lagged(
    signal: Array, kind: str, lag_s: float, rate_Hz: float, *, keep: slice = EVERY
) -> Array:
    """Apply a lag to a signal: kind ``none``, ``delay`` or ``first_order``.

    keep  rows to return; a delay computes only these
    """
    if kind == "delay":
        return later(signal, lag_s * rate_Hz, keep)
    return (relaxed(signal, lag_s, rate_Hz) if kind == "first_order" else signal)[keep]
