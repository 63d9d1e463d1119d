"""Exact sampling of a continuous linear system behind a zero-order hold, with any delay."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from piezoid.numerics.arrays import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class SampledSystem:
    """x[k+1] = A x[k] + sum_j taps[:, j] u[k - j],   y[k] = C x[k].

    A     (n, n)
    taps  (n, m)  one column for each whole or fractional sample of delay, the newest input first
    C     (n,)
    """

    A: Array
    taps: Array
    C: Array


def hold_matrices(A: Array, B: Array, duration_s: float) -> tuple[Array, Array]:
    """Return exp(A t) and the integral of exp(A s) B over [0, t], from one exponential.

        exp([A B; 0 0] t) = [Ad Bd; 0 I]                                    [Van Loan 1978]

    A  (n, n)    B, Bd  (n,) or (n, inputs)
    """
    order, inputs = len(A), B.shape[1] if B.ndim == 2 else 1
    block = np.zeros((order + inputs, order + inputs))
    block[:order, :order], block[:order, order:] = A, B.reshape(order, inputs)
    exponential = expm(block * duration_s)
    held = exponential[:order, order:]
    return exponential[:order, :order], held if B.ndim == 2 else held[:, 0]


def split_delay(delay_s: float, period_s: float) -> tuple[int, float]:
    """Return a delay as whole samples and the remaining seconds, 0 below rounding."""
    delay_samples = int(np.floor(delay_s / period_s + 1e-9))
    remainder_s = delay_s - delay_samples * period_s
    return delay_samples, (remainder_s if remainder_s > 1e-9 * period_s else 0.0)


def sample(A: Array, B: Array, C: Array, period_s: float, delay_s: float = 0.0) -> SampledSystem:
    """Sample dx/dt = A x + B u(t - delay), y = C x exactly.

    A delay of d + f periods (0 <= f < 1) splits each period: its first f has the input
    u[k - d - 1], the remainder u[k - d].

    A  (n, n)    B  (n,)    C  (n,)
    delay_s  >= 0
    """
    delay_samples, remainder_s = split_delay(delay_s, period_s)
    transition, _ = hold_matrices(A, B, period_s)
    following, newest = hold_matrices(A, B, period_s - remainder_s)
    columns = [np.zeros(len(B))] * delay_samples + [newest]
    if remainder_s > 0.0:
        columns.append(following @ hold_matrices(A, B, remainder_s)[1])
    return SampledSystem(A=transition, taps=np.stack(columns, axis=1), C=np.asarray(C, float))


def realised(system: SampledSystem) -> tuple[Array, Array, Array]:
    """Return A, B, C of a state-space model with past inputs as states, the newest first.

    returned  (n + m - 1, n + m - 1), (n + m - 1,), (n + m - 1,)
    """
    order, count = system.taps.shape
    size = order + count - 1
    A, B, C = np.zeros((size, size)), np.zeros(size), np.zeros(size)
    A[:order, :order], A[:order, order:] = system.A, system.taps[:, 1:]
    B[:order], C[:order] = system.taps[:, 0], system.C
    if count > 1:
        B[order] = 1.0
        A[order + 1 :, order:-1] = np.eye(count - 2)
    return A, B, C


def fraction(system: SampledSystem) -> tuple[Array, Array]:
    """Return the transfer function B/A in q^-1; the delay is leading zeros of B.

    A is the characteristic polynomial. B follows from A and the first samples of the impulse
    response.
    """
    order, count = system.taps.shape
    denominator = np.ascontiguousarray(np.poly(system.A).real)
    A, B, C = realised(system)
    impulse = np.zeros(order + count)
    state = B
    for k in range(1, order + count):
        impulse[k] = C @ state
        state = A @ state
    return np.convolve(impulse, denominator)[: order + count], denominator
