"""Polynomials in q^-1: products, roots, the Bezout equation, responses of fractions.

An array ``p`` represents p[0] + p[1] q^-1 + ... + p[n] q^-n, where q^-1 delays by one sample.
"Root" always means a value of z = q. The notation is that of Landau & Zito (2006); control
toolboxes interpret ``p`` as descending powers of z, which is the same for a proper fraction.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piezoid.errors import DesignError
from piezoid.numerics.arrays import Array

Roots = NDArray[np.complex128]

# A Sylvester matrix with a smaller ratio of singular values has no usable solution in float64.
_MIN_RATIO = 1e-13


def product(*factors: ArrayLike) -> Array:
    """Return the product of polynomials; 1 for none."""
    result = np.ones(1)
    for factor in factors:
        result = np.convolve(result, np.asarray(factor, dtype=np.float64))
    return result


def total(*terms: ArrayLike) -> Array:
    """Return the sum of polynomials of any degrees."""
    arrays = [np.asarray(term, dtype=np.float64) for term in terms]
    result = np.zeros(max(len(array) for array in arrays))
    for array in arrays:
        result[: len(array)] += array
    return result


def delayed(polynomial: ArrayLike, samples: int) -> Array:
    """Return q^-samples times the polynomial."""
    return np.concatenate([np.zeros(samples), np.asarray(polynomial, dtype=np.float64)])


def trim(polynomial: ArrayLike) -> Array:
    """Drop trailing zero coefficients, so that the length shows the degree."""
    array = np.asarray(polynomial, dtype=np.float64)
    nonzero = np.flatnonzero(array)
    return array[: nonzero[-1] + 1].copy() if nonzero.size else np.zeros(1)


def roots_of(polynomial: ArrayLike) -> Roots:
    """Return the roots of a polynomial in z, without roots at z = 0."""
    array = trim(polynomial)
    nonzero = np.flatnonzero(array)
    return np.asarray(np.roots(array[nonzero[0] :]), dtype=np.complex128)


def from_roots(roots: ArrayLike) -> Array:
    """Return the monic polynomial with these roots in z; complex roots come in pairs."""
    expanded = np.atleast_1d(np.poly(np.asarray(roots, dtype=np.complex128)))
    return np.ascontiguousarray(expanded.real)


def spectral_radius(polynomial: ArrayLike) -> float:
    """Return the largest magnitude of the roots; the polynomial is stable (Schur) if it is < 1."""
    roots = roots_of(polynomial)
    return float(np.abs(roots).max()) if roots.size else 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class BezoutSolution:
    """Solution of the Bezout equation A S + B R = P, and its accuracy.

    S, R       polynomials
    residual   max |A S + B R - P| / max |P|
    condition  of the balanced Sylvester matrix
    """

    S: Array
    R: Array
    residual: float
    condition: float


def solve_bezout(A: ArrayLike, B: ArrayLike, P: ArrayLike) -> BezoutSolution:
    """Solve A S + B R = P for the pair of minimum degree.

        deg R = deg A - 1,   deg S = max(deg B - 1, deg P - deg A)    [Landau & Zito 2006]

    A, B  without common roots; a delay is leading zeros of B
    P     of any degree

    B is scaled by its largest coefficient, so that the accuracy does not depend on its unit.
    Raises ``DesignError`` naming the root that A and B (nearly) share.
    """
    a, b, p = trim(A), trim(B), trim(P)
    scale = float(np.abs(b).max())
    if scale == 0.0 or len(a) < 2:
        raise ValueError("solve_bezout needs a non-zero B and a denominator A of degree >= 1")
    degree_s = max(len(b) - 2, len(p) - len(a), 0)
    # The Sylvester matrix M of A S + B R = M [S; R]: shifts of A, then shifts of B.
    rows, scaled = len(a) + degree_s, b / scale
    matrix = np.zeros((rows, rows))
    for column in range(degree_s + 1):
        matrix[column : column + len(a), column] = a
    for column in range(len(a) - 1):
        stop = min(rows, column + len(b))
        matrix[column:stop, degree_s + 1 + column] = scaled[: stop - column]
    target = np.zeros(len(matrix))
    target[: len(p)] = p
    singular = np.linalg.svd(matrix, compute_uv=False)
    if singular[-1] < _MIN_RATIO * singular[0]:
        poles, zeros = roots_of(a), roots_of(b)
        if not zeros.size:
            zeros = np.array([np.inf + 0j])
        distance = np.abs(poles[:, None] - zeros[None, :])
        pole, zero = np.unravel_index(int(np.argmin(distance)), distance.shape)
        ratio = float(singular[-1] / singular[0])
        raise DesignError(
            f"the pole z = {poles[pole]:.6g} and the zero z = {zeros[zero]:.6g} of the plant "
            f"with its fixed parts nearly cancel (singular values in the ratio {ratio:.1e})",
            needed="A H_S and B H_R must have no common root",
            remedy="Remove the fixed part that makes the root, or reduce the model's order.",
            pole=complex(poles[pole]),
            zero=complex(zeros[zero]),
        )
    solution = np.linalg.solve(matrix, target)
    solution += np.linalg.solve(matrix, target - matrix @ solution)
    S, R = solution[: degree_s + 1], solution[degree_s + 1 :] / scale
    residual = total(product(a, S), product(b, R), -target)
    return BezoutSolution(
        S=np.asarray(S, dtype=np.float64),
        R=np.asarray(R, dtype=np.float64),
        residual=float(np.abs(residual).max() / np.abs(p).max()),
        condition=float(singular[0] / singular[-1]),
    )


Response = NDArray[np.complex128]


def grid_Hz(sampling_rate_Hz: float, *, lowest_Hz: float = 1.0, count: int = 400) -> Array:
    """Return frequencies from ``lowest_Hz`` to just below Nyquist.

    Half of them are spaced by equal ratios, for loop shaping over decades, and half by equal
    differences, for the peaks and delays in the last decade.

    returned  (about count,)  Hz, strictly increasing
    """
    highest_Hz = 0.4999 * sampling_rate_Hz
    half = max(count // 2, 2)
    by_ratio = np.geomspace(lowest_Hz, highest_Hz, half)
    by_difference = np.linspace(highest_Hz / half, highest_Hz, half)
    return np.unique(np.concatenate([by_ratio, by_difference]))


def unit_circle(frequency_Hz: ArrayLike, sampling_rate_Hz: float) -> Response:
    """Return q^-1 = exp(-2 pi j f / fs), (frequencies,)."""
    turns = np.asarray(frequency_Hz, dtype=np.float64) / sampling_rate_Hz
    return np.asarray(np.exp(-2j * np.pi * turns))


def polynomial_response(polynomial: ArrayLike, delay_operator: Response) -> Response:
    """Return p(q^-1) on given values of q^-1."""
    coefficients = np.asarray(polynomial, dtype=np.float64).tolist()
    value = np.full(delay_operator.shape, coefficients[-1], dtype=np.complex128)
    for coefficient in coefficients[-2::-1]:
        value *= delay_operator
        value += coefficient
    return value


def response(B: ArrayLike, A: ArrayLike, frequency_Hz: ArrayLike, rate_Hz: float) -> Response:
    """Return B/A on the unit circle, (frequencies,); the delay is leading zeros of B."""
    q = unit_circle(frequency_Hz, rate_Hz)
    return np.asarray(polynomial_response(B, q) / polynomial_response(A, q))


def decibel(magnitude: ArrayLike) -> Array:
    """Return 20 log10 |magnitude|; zero becomes -inf."""
    with np.errstate(divide="ignore"):
        return np.asarray(20.0 * np.log10(np.abs(np.asarray(magnitude))))
