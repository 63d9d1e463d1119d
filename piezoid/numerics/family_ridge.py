"""Ridge regression with one prior variance for each family of columns.

    y = X w + e,   w_k ~ N(0, v_f),   e ~ N(0, s^2),   f the family of column k

The variances maximise the marginal likelihood by MacKay's fixed point,

    v_f <- sum_f w_k^2 / g_f,   g_f = n_f - sum_f S_kk / v_f
    s^2 <- |y - X w|^2 / (n - sum_f g_f)

with S the posterior covariance; g_f is the number of parameters that the data determine.
Everything is computed from X'X, X'y and y'y.

Source: MacKay, Neural Computation 4 (1992) 415; Tipping, J. Machine Learning Research 1 (2001).
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_solve, cholesky
from scipy.linalg.lapack import dtrtri

from piezoid.numerics.arrays import Array

CONVERGED = 1e-4  # relative change of the noise variance that ends the fixed point
MIN_STEPS = 15
JITTER = (0.0, 1e-14, 1e-12, 1e-10)  # of the trace, if rounding makes the matrix indefinite


@dataclass(frozen=True, kw_only=True, eq=False)
class Moments:
    """Sums over the rows of a regression.

    gram    (columns, columns)  X'X
    moment  (columns,)          X'y
    square  y'y
    count   rows
    """

    gram: Array
    moment: Array
    square: float
    count: int

    def __add__(self, rows: "Moments") -> "Moments":
        """Return the moments of the rows of both."""
        return Moments(
            gram=self.gram + rows.gram,
            moment=self.moment + rows.moment,
            square=self.square + rows.square,
            count=self.count + rows.count,
        )

    def __sub__(self, rows: "Moments") -> "Moments":
        """Return the moments without some of the rows."""
        return Moments(
            gram=self.gram - rows.gram,
            moment=self.moment - rows.moment,
            square=self.square - rows.square,
            count=self.count - rows.count,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class FamilyRidge:
    """Prior of the coefficients and noise of the rows.

    family    (columns,)   index of the family of each column
    variance  (families,)  v_f; infinite: not penalised
    noise     s^2
    """

    family: NDArray[np.intp]
    variance: Array
    noise: float

    def mean(self, moments: Moments) -> Array:
        """Return the posterior mean of the coefficients, (columns,)."""
        return self._posterior(moments)[0]

    def maximised(
        self, moments: Moments, *, ceiling: Array, steps: int = 40
    ) -> tuple["FamilyRidge", Array, float]:
        """Return the ridge with the largest marginal likelihood, its coefficients and sum_f g_f.

        ceiling  (families,)  largest prior variance of each family
        """
        ridge, previous_noise = self, np.inf
        power = moments.square / max(moments.count, 1)
        w, determined = ridge._determined(moments)
        for step in range(steps):
            energy = np.bincount(self.family, w**2, len(self.variance))
            variance = np.clip(energy / determined, 1e-12 * power, ceiling)
            variance = np.where(np.isinf(ridge.variance), np.inf, variance)
            residual_power = moments.square - 2.0 * w @ moments.moment + w @ moments.gram @ w
            free = max(moments.count - float(determined.sum()), 1.0)
            noise = max(float(residual_power) / free, 1e-18 * power)
            ridge = replace(ridge, variance=variance, noise=noise)
            w, determined = ridge._determined(moments)
            if step > MIN_STEPS and abs(np.log(noise / previous_noise)) < CONVERGED:
                break
            previous_noise = noise
        return ridge, w, float(determined.sum())

    def _determined(self, moments: Moments) -> tuple[Array, Array]:
        """Return the coefficients, and g_f: the number determined by the data in each family."""
        w, factor, scale = self._posterior(moments)
        inverse, _ = dtrtri(factor, lower=1)
        spread = (inverse**2).sum(axis=0) * scale**2
        sizes = np.bincount(self.family, minlength=len(self.variance))
        undetermined = np.bincount(self.family, spread, len(self.variance)) / self.variance
        return w, np.maximum(sizes - undetermined, 1e-3)

    def _posterior(self, moments: Moments) -> tuple[Array, Array, Array]:
        """Return the mean, the Cholesky factor of the scaled posterior precision, and the scale.

        The factor is lower triangular, (columns, columns), zero above its diagonal; the posterior
        covariance is D (L L')^-1 D, with D the diagonal matrix of the scale.
        """
        largest = 1e4 * moments.square / max(moments.count, 1)
        scale = np.sqrt(np.minimum(self.variance, largest))[self.family]
        matrix = moments.gram * (scale[:, None] * scale) / self.noise
        diagonal = np.diag_indices(len(matrix))
        matrix[diagonal] += 1.0
        for jitter in JITTER:
            matrix[diagonal] += jitter * np.trace(matrix)
            try:
                factor = cholesky(matrix, lower=True)
                break
            except LinAlgError:
                continue
        mean = scale * cho_solve((factor, True), scale * moments.moment / self.noise)
        return mean, factor, scale
