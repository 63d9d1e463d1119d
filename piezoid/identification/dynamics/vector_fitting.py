"""Vector fitting: start values for the common poles of a matrix of responses."""

import numpy as np

from piezoid.numerics.arrays import Array, ComplexArray

TOLERANCE = 1e-6  # relative change of the poles at which the iteration stops


def vector_fit(
    s: ComplexArray, response: ComplexArray, weight: Array, poles: ComplexArray, *, rounds: int
) -> ComplexArray:
    """Fit the common poles of sum_m R_m / (s - p_m) + D to several responses.

        sigma(s) = d + sum_m c_m / (s - p_m),   sigma G = sum_m R_m / (s - p_m) + D
        new poles = zeros of sigma = eigenvalues of diag(p) - 1 c^T / d
                                              [Gustavsen & Semlyen 1999; Gustavsen 2006]

    s         (lines,)           j w, scaled so that the band is of order one
    response  (lines, entries)   entries share their poles
    weight    (lines, entries)   one over the standard deviation; zero excludes a line
    poles     (n,)               start; a complex pole with Im > 0 represents a pair
    rounds    maximum number of iterations, if the poles do not settle to ``TOLERANCE`` before
    returned  stable poles: the upper pole of each pair, and real poles

    Noise biases the poles: they are a start for maximum likelihood.
    """
    direct = np.ones((len(s), 1))
    scale = float(np.linalg.norm(weight * np.abs(response)))
    for _ in range(rounds):
        fractions = _fractions(s, poles)
        numerator = np.concatenate([fractions, direct], axis=1)
        triangles = []
        for g, w in zip(response.T, weight.T, strict=True):
            sigma = -g[:, None] * numerator
            equations = stack_parts(np.concatenate([numerator, sigma], axis=1) * w[:, None])
            unknowns = numerator.shape[1]
            triangles.append(np.asarray(np.linalg.qr(equations, mode="r"))[unknowns:, unknowns:])
        # Coefficients of sigma, its mean over the lines held at one (relaxed form, not d = 1).
        mean = np.append(fractions.sum(axis=0).real, len(s)) * scale / len(s)
        matrix = np.concatenate([*triangles, mean[None]])
        target = np.zeros(len(matrix))
        target[-1] = scale
        size = np.maximum(np.linalg.norm(matrix, axis=0), np.finfo(float).tiny)
        solution = np.linalg.lstsq(matrix / size, target, rcond=None)[0] / size
        d = float(solution[-1])
        d = d if abs(d) > 1e-8 else float(np.copysign(1e-8, d))
        # The zeros of sigma, made stable, are the new poles.
        pairs, real = poles[poles.imag > 0], poles[poles.imag == 0].real
        n = len(pairs)
        pair = np.arange(n)
        realised = np.zeros((2 * n + len(real), 2 * n + len(real)))
        realised[pair, pair] = realised[n + pair, n + pair] = pairs.real
        realised[pair, n + pair], realised[n + pair, pair] = pairs.imag, -pairs.imag
        realised[2 * n :, 2 * n :] = np.diag(real)
        residue_sums = np.concatenate([np.full(n, 2.0), np.zeros(n), np.ones(len(real))])
        zeros = np.linalg.eigvals(realised - np.outer(residue_sums, solution[:-1]) / d)
        stable = -np.abs(zeros.real) + 1j * zeros.imag
        tiny = 1e-12 * np.abs(stable)
        upper = stable[stable.imag > tiny]
        upper = upper[np.argsort(upper.imag)]
        flat = np.sort(stable[np.abs(stable.imag) <= tiny].real)[::-1]
        previous, poles = poles, np.concatenate([upper, flat.astype(np.complex128)])
        if len(poles) != len(previous):
            continue
        if (np.abs(poles - previous) < TOLERANCE * np.abs(poles)).all():
            break
    return poles


def start_poles(lowest: float, highest: float, pairs: int, real: int) -> ComplexArray:
    """Return lightly damped pairs, spread evenly over a band, and real poles, logarithmically."""
    imaginary = np.linspace(lowest, highest, pairs + 2)[1:-1]
    lags = np.geomspace(max(lowest, 1e-2 * highest), highest, real + 2)[1:-1]
    return np.concatenate([(-0.01 + 1j) * imaginary, -lags.astype(np.complex128)])


def weighted_misfit(
    s: ComplexArray, response: ComplexArray, weight: Array, poles: ComplexArray
) -> float:
    """Return the weighted sum of squared residuals for optimal residues and direct terms."""
    columns = np.concatenate([_fractions(s, poles), np.ones((len(s), 1))], axis=1)
    misfit = 0.0
    for g, w in zip(response.T, weight.T, strict=True):
        matrix, target = stack_parts(columns * w[:, None]), stack_parts((g * w)[:, None])[:, 0]
        scale = np.linalg.norm(matrix, axis=0)
        solution = np.linalg.lstsq(matrix / scale, target, rcond=None)[0]
        misfit += float(np.sum((target - (matrix / scale) @ solution) ** 2))
    return misfit


def stack_parts(matrix: ComplexArray) -> Array:
    """Return real parts above imaginary parts: complex least squares with real unknowns."""
    return np.concatenate([matrix.real, matrix.imag])


def _fractions(s: ComplexArray, poles: ComplexArray) -> ComplexArray:
    """Return partial fractions with real coefficients: two columns per pair, one per real pole."""
    pairs, real = poles[poles.imag > 0], poles[poles.imag == 0]
    upper, lower = 1 / (s[:, None] - pairs), 1 / (s[:, None] - np.conj(pairs))
    return np.concatenate([upper + lower, 1j * (upper - lower), 1 / (s[:, None] - real)], axis=1)
