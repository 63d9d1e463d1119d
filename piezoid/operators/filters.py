"""Lags, delays, the relaxation ladder of creep, slew limit and thermally activated motion."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from piezoid.numerics.arrays import Array
from piezoid.operators.library import KERNELS, address, contiguous

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


def relaxed(signal: Array, time_s: float, rate_Hz: float) -> Array:
    """Filter a signal by a first-order lag, with linear interpolation between samples.

    signal  (samples,) or (samples, columns)
    """
    return each_column(lambda column: ladder(column, [time_s], rate_Hz), signal)


def each_column(filter_column: Callable[[Array], Array], signal: Array) -> Array:
    """Filter a signal, or its columns one by one: a single column fits into the cache.

    signal    (samples,) or (samples, columns)
    returned  of the same shape, column-major
    """
    result = np.empty(signal.shape, order="F")
    for output, column in zip(np.atleast_2d(result.T), np.atleast_2d(signal.T), strict=True):
        output[:] = filter_column(column)
    return result


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


def slewed(signal: Array, step: float) -> Array:
    """Limit the change of a signal between samples.

        z[k] = z[k-1] + clamp(u[k] - z[k-1], -step, step),   z[0] = u[0]

    signal    (samples,)
    step      scalar, > 0, in the signal's unit
    returned  (samples,)
    """
    source = contiguous(signal)
    output = np.empty_like(source)
    KERNELS.pk_slew(len(source), address(source), step, address(output))
    return output


def activated(irreversible: Array, time_s: float, sampling_rate_Hz: float, strain: float) -> Array:
    """Return a rate-dependent irreversible response: barriers crossed by thermal activation.

        dx/dt = (s / tau) sinh((h - x) / s),   exact for steps of h    [Eyring 1936]

    h    irreversible  (samples,)  any unit; the quasi-static response
    tau  time_s        scalar      s, time constant of small lags
    s    strain        scalar      unit of h; lags beyond it grow with the logarithm of the speed
    """
    source = contiguous(irreversible)
    output = np.empty_like(source)
    step = float(np.exp(-1.0 / (time_s * sampling_rate_Hz)))
    KERNELS.pk_activated(len(source), address(source), step, 2.0 * strain, address(output))
    return output


def ladder(
    signal: Array, times_s: Sequence[float], rate_Hz: float, share: ArrayLike = 1.0
) -> Array:
    """Return the sum of parallel first-order lags of one signal, at rest before it starts.

        y[k] = sum_i c_i y_i[k],    y_i[k] = p_i y_i[k-1] + b0_i x[k] + b1_i x[k-1]

    signal    (samples,)
    times_s   (rungs,)    time constants, as ``FirstOrder``
    share     (rungs,)    c, or a common value
    returned  (samples,)  unit of the signal; zero without rungs
    """
    source = contiguous(signal)
    output = np.empty_like(source)
    rungs = [FirstOrder(time_s=time_s, rate_Hz=rate_Hz).coefficients for time_s in times_s]
    pole, b0, b1 = np.array(rungs, dtype=np.float64).reshape(-1, 3).T.copy()
    weight = np.broadcast_to(np.asarray(share, dtype=np.float64), pole.shape)
    b0, b1 = b0 * weight, b1 * weight
    KERNELS.pk_ladder(
        len(source),
        address(source),
        len(pole),
        address(pole),
        address(b0),
        address(b1),
        address(weight * source[:1].sum()),
        address(output),
    )
    return output
