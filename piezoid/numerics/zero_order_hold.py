"""Exact sampling of a continuous linear system behind a zero-order hold, with any delay."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from piezoid.numerics.arrays import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class SampledSystem:
    """x[k+1] = A x[k] + sum_j taps[:, j] u[k - j],   y[k] = C x[k].

    A     (n, n)
    taps  (n, m)  one column for each whole or broken sample of delay, the newest input first
    C     (n,)
    """

    A: Array
    taps: Array
    C: Array


def hold_matrices(A: Array, B: Array, duration_s: float) -> tuple[Array, Array]:
    """Return exp(A t) and the integral of exp(A s) B over [0, t], from one exponential.

        exp([A B; 0 0] t) = [Ad Bd; 0 1]                                    [Van Loan 1978]

    A  (n, n)    B  (n,)    Bd  (n,)
    """
    order = len(A)
    block = np.zeros((order + 1, order + 1))
    block[:order, :order], block[:order, order] = A, B
    exponential = expm(block * duration_s)
    return exponential[:order, :order], exponential[:order, order]


def sample(A: Array, B: Array, C: Array, period_s: float, delay_s: float = 0.0) -> SampledSystem:
    """Sample dx/dt = A x + B u(t - delay), y = C x exactly.

    A delay of d + f periods (0 <= f < 1) splits each period: the first f of it still sees the
    input u[k - d - 1], the rest u[k - d].

    A  (n, n)    B  (n,)    C  (n,)
    delay_s  >= 0
    """
    delay_samples = int(np.floor(delay_s / period_s + 1e-9))
    rest_s = max(delay_s - delay_samples * period_s, 0.0)
    if rest_s < 1e-9 * period_s:
        rest_s = 0.0
    transition, _ = hold_matrices(A, B, period_s)
    following, newest = hold_matrices(A, B, period_s - rest_s)
    columns = [np.zeros(len(B))] * delay_samples + [newest]
    if rest_s > 0.0:
        columns.append(following @ hold_matrices(A, B, rest_s)[1])
    return SampledSystem(A=transition, taps=np.stack(columns, axis=1), C=np.asarray(C, float))


def realised(system: SampledSystem) -> tuple[Array, Array, Array]:
    """Return plain A, B, C in which past inputs are states, the newest first.

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
    """Return B and A in q^-1: the characteristic polynomial, and the numerator that goes with
    the first samples of the impulse response. The delay stands in B as leading zeros.
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
