"""Linear regression with cross-validation on blocks of rows.

    beta_f = (sum_(b not in f) C_b' C_b)^-1 sum_(b not in f) C_b' e_b,
    loss_b = |e_b - C_b beta_f|^2

The significance of a gain is the largest of three tests over blocks: of the mean, of the signs,
and of the likelihood ratio.

Source: Arlot & Celisse, Statistics Surveys 4 (2010) on blocks for dependent data; Vuong,
Econometrica 57 (1989) on sums of squares of blocks.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import log, sqrt

import numpy as np
from scipy.linalg import solve_triangular

from piezoid.diagnosis.segments import BLOCKS, Places
from piezoid.numerics.arrays import Array
from piezoid.numerics.executor import Once

FOLDS = 5
TIME_BLOCKS = 40  # of one recording at constant drive or in a hold
SCATTER_BLOCKS = 20  # of a residual, for the standard error of its mean square
SAME_ERROR = 1.02  # ratio of rms errors up to which two trends are equivalent
RIDGE = 1e-9
INFORMATIVE_POWER = 0.95  # share of the explained power in informative blocks
MIN_BLOCKS = 6  # informative ones, at least


@dataclass(frozen=True, kw_only=True, eq=False)
class CrossValidated:
    """Cross-validated gain of columns on left-out blocks.

    gain         1 - rms with / rms without the columns
    z            standard errors of the gain over blocks, the largest of three tests (``gain_z``)
    coefficient  (columns,)  fitted to all rows
    spread       (columns,)  its standard error, from leaving out folds
    loss         (blocks,)   sums of squares with the columns
    rms          with the columns
    """

    gain: float
    z: float
    coefficient: Array
    spread: Array
    loss: Array
    rms: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Null:
    """Null hypothesis: columns that are projected out of the residual and of every candidate.

    columns   (rows, columns)
    response  (rows,)
    block     (rows,)  global block of each row
    extra     (rows, columns)  a few further columns, separate to avoid a copy of all columns
    column_gram  Gram matrix of ``columns``, if it was computed before
    """

    columns: Array
    response: Array
    block: Places
    extra: Array | None = None
    column_gram: Array | None = None

    @property
    def all_columns(self) -> Array:
        """Return all columns, (rows, columns)."""
        return self.columns if self.extra is None else np.hstack([self.columns, self.extra])

    @Once
    def gram(self) -> Array:
        """Return the Gram matrix of all columns."""
        gram = self.columns.T @ self.columns if self.column_gram is None else self.column_gram
        if self.extra is None:
            return np.asarray(gram)
        right = self.columns.T @ self.extra
        return np.block([[gram, right], [right.T, self.extra.T @ self.extra]])

    @Once
    def scale(self) -> Array:
        """Return the length of every column, 1 where it is zero."""
        length = np.sqrt(np.diag(self.gram))
        return np.where(length > 0, length, 1.0)

    @Once
    def factor(self) -> Array:
        """Return the lower Cholesky factor of the scaled normal matrix."""
        gram = self.gram / np.outer(self.scale, self.scale)
        return np.asarray(np.linalg.cholesky(gram + RIDGE * np.eye(len(gram))))

    def fit(self, values: Array) -> Array:
        """Return the least-squares coefficients for values, (columns,) or (columns, values)."""
        from scipy.linalg import cho_solve

        scale = self.scale if values.ndim == 1 else self.scale[:, None]
        right = (values.T @ self.columns).T  # for few values a third of the time of C' v
        if self.extra is not None:
            right = np.concatenate([right, self.extra.T @ values])
        return np.asarray(cho_solve((self.factor, True), right / scale) / scale)

    @Once
    def coefficients(self) -> Array:
        """Return the least-squares coefficients for the response, (columns,)."""
        return self.fit(self.response)

    def project_out(self, values: Array) -> Array:
        """Project the columns of the null out of values."""
        return np.asarray(values - self._product(self.fit(values)))

    def _product(self, coefficients: Array) -> Array:
        """Return the sum of all columns with these coefficients."""
        count = self.columns.shape[1]
        product = (coefficients[:count].T @ self.columns.T).T
        if self.extra is not None:
            product += (coefficients[count:].T @ self.extra.T).T
        return np.asarray(product)

    @Once
    def residual(self) -> Array:
        """Return the residual of the response."""
        return np.asarray(self.response - self._product(self.coefficients))

    @Once
    def edges(self) -> Places:
        """Return the first row of every block."""
        return np.concatenate([[0], np.flatnonzero(np.diff(self.block)) + 1])

    @Once
    def fold(self) -> Places:
        """Return the fold of every block."""
        block = self.block[self.edges]
        return (block + block // BLOCKS) % FOLDS

    @Once
    def parts(self) -> tuple[slice, ...]:
        """Return the rows of every block."""
        stops = [*self.edges[1:], len(self.block)]
        return tuple(slice(int(a), int(b)) for a, b in zip(self.edges, stops, strict=True))

    def step_powers(self, values: Array, rows: slice, duration: int | None = None) -> Array:
        """Return the power explained by a step of gain and zero, for a step at each row of a part.

        The columns C of a step are ``values`` and 1, 0 before it. With sums over the orthonormal
        columns Q of the null, all steps take one pass over the rows:

            power = b' (C'C - C'Q Q'C)^-1 b,    b = C'r

        values    (rows,)  of the part
        rows      of the part
        duration  rows after which the step ends; None: it lasts until the end of the part
        """
        basis = solve_triangular(self.factor, (self.all_columns[rows] / self.scale).T, lower=True)
        residual = self.residual[rows]

        def from_step(table: Array) -> Array:
            total = np.cumsum(table[..., ::-1], axis=-1)[..., ::-1]
            if duration is not None:
                total[..., :-duration] -= total[..., duration:]
            return total

        gain, zero = from_step(basis * values), from_step(basis)
        square, product, count = from_step(np.stack([values**2, values, np.ones_like(values)]))
        gain_residual, zero_residual = from_step(np.stack([values * residual, residual]))
        a = square - np.einsum("ij,ij->j", gain, gain)
        b = product - np.einsum("ij,ij->j", gain, zero)
        c = count - np.einsum("ij,ij->j", zero, zero)
        determinant = a * c - b * b
        power = gain_residual**2 * c - 2.0 * gain_residual * zero_residual * b
        power += zero_residual**2 * a
        is_regular = determinant > RIDGE * square * count
        return np.where(is_regular, power / np.where(is_regular, determinant, 1.0), 0.0)

    def cross_validated(self, columns: Array, *, projected: bool = False) -> CrossValidated:
        """Cross-validate columns beside the null on left-out blocks.

        projected  whether the null is already projected out of the columns
        """
        orthogonal = columns if projected else self.project_out(columns)
        length = np.sqrt(np.einsum("ij,ij->j", orthogonal, orthogonal)) + 1e-300
        orthogonal = orthogonal / length
        residual = self.residual
        parts = [orthogonal[part] for part in self.parts]
        gram = np.array([part.T @ part for part in parts])
        right = np.array([a.T @ residual[p] for a, p in zip(parts, self.parts, strict=True)])
        energy = self.energy
        small = RIDGE * np.eye(orthogonal.shape[1])
        total, all_right = gram.sum(axis=0), right.sum(axis=0)
        loss, betas = np.empty(len(energy)), []
        for fold in range(FOLDS):
            out = self.fold == fold
            beta = np.linalg.solve(total - gram[out].sum(0) + small, all_right - right[out].sum(0))
            loss[out] = energy[out] - 2 * right[out] @ beta + (gram[out] @ beta) @ beta
            betas.append(beta)
        beta = np.linalg.solve(total + small, all_right)
        explained = np.einsum("i,bij,j->b", beta, gram, beta)
        spread = np.std(betas, axis=0, ddof=1) * (FOLDS - 1) / sqrt(FOLDS)
        gain = 1.0 - sqrt(max(float(loss.sum()), 0.0) / float(energy.sum()))
        return CrossValidated(
            gain=gain,
            z=gain_z(energy - loss, explained, gain),
            coefficient=beta / length,
            spread=spread / length,
            loss=loss,
            rms=sqrt(max(float(loss.sum()), 0.0) / len(residual)),
        )

    def clustered_covariance(self, columns: Array) -> Array:
        """Return the covariance of coefficients beside the null, with independent blocks.

            cov = G^-1 (sum_b s_b s_b') G^-1 n / (n - 1),   G = C'C,  s_b = C_b' e_b

        Source: Liang & Zeger, Biometrika 73 (1986).
        """
        orthogonal = self.project_out(columns)
        length = np.sqrt(np.einsum("ij,ij->j", orthogonal, orthogonal)) + 1e-300
        orthogonal = orthogonal / length
        residual = (
            self.residual - orthogonal @ np.linalg.lstsq(orthogonal, self.residual, rcond=1e-9)[0]
        )
        scores = np.array([orthogonal[part].T @ residual[part] for part in self.parts])
        inverse = np.linalg.pinv(orthogonal.T @ orthogonal, rcond=1e-9, hermitian=True)
        count = len(scores)
        cov = inverse @ (scores.T @ scores) @ inverse * (count / max(count - 1, 1))
        return np.asarray(cov / np.outer(length, length))

    @property
    def rms(self) -> float:
        """Return the rms of the residual."""
        return float(np.sqrt(np.mean(self.residual**2)))

    @Once
    def energy(self) -> Array:
        """Return the sum of squares of every block's residual."""
        return np.asarray(np.add.reduceat(self.residual**2, self.edges))


def compare_nulls(reference: Null, replacement: Null) -> CrossValidated:
    """Compare two nulls with the same number of columns, block by block.

    Both are refitted to all rows: one or two parameters are negligible beside thousands of rows.
    """
    energy, loss = reference.energy, replacement.energy
    gains = energy - loss
    gain = 1.0 - sqrt(float(loss.sum()) / float(energy.sum()))
    return CrossValidated(
        gain=gain,
        z=gain_z(gains, np.abs(gains), gain),
        coefficient=np.ones(1),
        spread=np.zeros(1),
        loss=loss,
        rms=sqrt(float(loss.sum()) / len(replacement.response)),
    )


def gain_z(gains: Array, explained: Array, gain: float) -> float:
    """Return the z value of a gain over blocks, the largest of three tests.

    gains      (blocks,)  decrease of the sum of squares by the columns
    explained  (blocks,)  power of the fitted columns: a block without any is not informative
    gain       1 - rms with / rms without, of all blocks
    """
    # the blocks that contain nearly all of the power of the columns
    order = np.argsort(explained)[::-1]
    power = np.cumsum(explained[order])
    count = max(int(np.searchsorted(power, INFORMATIVE_POWER * power[-1])) + 1, MIN_BLOCKS)
    is_informative = np.zeros(len(explained), dtype=bool)
    is_informative[order[:count]] = True
    informative = gains[is_informative]
    # outliers do not affect the sign test
    increase = float(np.sum(informative > 0) - 0.5 * len(informative) - 0.5)
    sign_z = increase / (0.5 * sqrt(len(informative)))
    # likelihood ratio 2 n ln(rms0 / rms1) of n blocks, the only test for a gain in a few blocks
    ratio_z = sqrt(-2.0 * len(gains) * log(1.0 - gain)) if 0.0 < gain < 1.0 else 0.0
    return max(_mean_z(informative), sign_z, ratio_z)


def paired_z(reference: Array, candidate: Array) -> float:
    """Return the difference of two losses over blocks in standard errors, > 0 if it decreases."""
    return _mean_z(reference - candidate)


def _mean_z(gains: Array) -> float:
    """Return the mean over its standard error."""
    return float(gains.sum()) / (float(gains.std(ddof=1)) * sqrt(len(gains)) + 1e-300)


def blocks_of(rows: int) -> Places:
    """Return the block of each row, (rows,)."""
    return np.arange(rows) * TIME_BLOCKS // rows


def held_out_residual(y: Array, parts: Sequence[Array]) -> Array:
    """Return the residual of columns and a constant on left-out blocks of time, (rows,)."""
    design = np.column_stack([np.ones(len(y)), *parts])
    residual, fold = np.empty(len(y)), blocks_of(len(y)) % FOLDS
    for out in range(FOLDS):
        inside = fold != out
        coefficient = np.linalg.lstsq(design[inside], y[inside], rcond=None)[0]
        residual[~inside] = y[~inside] - design[~inside] @ coefficient
    return residual


def gain_on_blocks(reference: Array, residual: Array) -> tuple[float, float]:
    """Return the relative reduction of the rms between two residuals, and its z over blocks."""
    block = blocks_of(len(reference))
    gain = 1.0 - float(np.sqrt(np.mean(residual**2) / max(float(np.mean(reference**2)), 1e-300)))
    gains = np.bincount(block, reference**2 - residual**2, TIME_BLOCKS).astype(np.float64)
    explained = np.bincount(block, (reference - residual) ** 2, TIME_BLOCKS).astype(np.float64)
    return gain, gain_z(gains, explained, gain)


def relative_scatter(residual_m: Array) -> float:
    """Return the relative standard error of the mean square of a correlated residual."""
    blocks = np.array_split(residual_m, SCATTER_BLOCKS)
    squares = np.array([np.mean(block**2) for block in blocks])
    std = float(np.std(squares, ddof=1))
    return std / max(float(np.mean(squares)), 1e-300) / sqrt(SCATTER_BLOCKS)
