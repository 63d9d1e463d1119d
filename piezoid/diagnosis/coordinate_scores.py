"""Share of the residual that a curve along one coordinate explains on left-out blocks.

The residual is orthogonal to the nuisance class, the selected effects and the tangents of all
other effects,

    r = M y,   M = I - C (C'C)^-1 C',   C = [nuisance, selected effects, tangents of the others].

A curve with columns X is fitted beside C to blocks of the recordings and scored on other blocks,

    gain = sum_b (2 r_b' X_b beta_-b - |X_b beta_-b|^2) / |r|^2,       X <- M X.

The null distribution of the gain comes from surrogates: the same residual, shifted at random along
each recording. A surrogate has the power and the correlation of the residual, but no relation to
the coordinate.

Source: Arlot & Celisse (2010) on blocks; Phipson & Smyth (2010) on p-values that count
permutations; Theiler et al., Physica D 58 (1992), on surrogates.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.diagnosis.blocked_regression import FOLDS, Null
from piezoid.diagnosis.coordinate_bases import Basis
from piezoid.diagnosis.null_distribution import rank_p_value
from piezoid.diagnosis.residual_view import View
from piezoid.numerics.arrays import Array

SURROGATES = 99
RIDGE = 1e-3  # of a column's squared length
MIN_LENGTH = 1e-3  # of the length of a column: smallest part orthogonal to the null


@dataclass(frozen=True, kw_only=True, eq=False)
class CoordinateScore:
    """Fit of a curve along one coordinate to the residual.

    basis         of the curve
    gain          share of the residual's power explained on left-out blocks
    p_value       of such a gain for a residual that does not depend on the coordinate
    coefficients  (columns,)
    fitted        (rows,)  part of the curve orthogonal to the null
    """

    basis: Basis
    gain: float
    p_value: float
    coefficients: Array
    fitted: Array

    @property
    def coordinate(self) -> str:
        """Return the name of the coordinate."""
        return self.basis.coordinate


@dataclass(frozen=True, kw_only=True, eq=False)
class Residual:
    """Residual of a view, with the null model that it is orthogonal to."""

    view: View
    null: Null

    @classmethod
    def of(cls, view: View, tangents: Sequence[Array] = ()) -> "Residual":
        """Return the residual of a view that is orthogonal to these tangents as well."""
        if not tangents:
            return cls(view=view, null=view.null)
        null = Null(
            columns=view.null.columns,
            response=view.response,
            block=view.block,
            extra=np.hstack([view.selected, *tangents]),
            column_gram=view.nuisance.gram,
        )
        return cls(view=view, null=null)

    @property
    def values(self) -> Array:
        """Return the residual, (rows,)."""
        return self.null.residual

    def score(self, basis: Basis, p_value: float = 1.0) -> CoordinateScore:
        """Fit and cross-validate a curve."""
        score, _ = self._score(basis, np.zeros((len(self.values), 0)), p_value)
        return score

    def score_all(
        self, bases: Sequence[Basis], surrogates: Array
    ) -> tuple[list[CoordinateScore], Array]:
        """Fit and cross-validate curves; their p-values allow for the choice among them.

        Returns the scores, and for each surrogate the largest gain of any curve.
        """
        scored = [self._score(basis, surrogates) for basis in bases]
        largest = np.max([gains for _, gains in scored], axis=0)
        return [replace(s, p_value=rank_p_value(s.gain, largest)) for s, _ in scored], largest

    def _score(
        self, basis: Basis, surrogates: Array, p_value: float = 1.0
    ) -> tuple[CoordinateScore, Array]:
        columns, length = self.unit_columns(basis)
        gains = self.held_out_gains(columns, np.column_stack([self.values, surrogates]))
        ridge = RIDGE * np.eye(columns.shape[1])
        beta = np.linalg.solve(columns.T @ columns + ridge, columns.T @ self.values)
        score = CoordinateScore(
            basis=basis,
            gain=float(gains[0]),
            p_value=p_value,
            coefficients=beta / length,
            fitted=columns @ beta,
        )
        return score, gains[1:]

    def unit_columns(self, basis: Basis) -> tuple[Array, Array]:
        """Project the null out of the columns, and return unit columns and their lengths."""
        full_length = np.sqrt(np.einsum("ij,ij->j", basis.columns, basis.columns))
        columns = self.null.project_out(basis.columns)
        length = np.sqrt(np.einsum("ij,ij->j", columns, columns))
        length = np.where(length > MIN_LENGTH * full_length, length, np.inf)
        return columns / length, length

    def held_out_gains(self, columns: Array, values: Array) -> Array:
        """Return the share of power explained on left-out blocks, for each column of values."""
        null = self.null
        gram = np.array([columns[block].T @ columns[block] for block in null.parts])
        right = np.array([columns[block].T @ values[block] for block in null.parts])
        total_gram, total_right = gram.sum(axis=0), right.sum(axis=0)
        ridge, explained = RIDGE * np.eye(columns.shape[1]), np.zeros(values.shape[1])
        for fold in range(FOLDS):
            is_out = null.fold == fold
            out_gram, out_right = gram[is_out].sum(axis=0), right[is_out].sum(axis=0)
            beta = np.linalg.solve(total_gram - out_gram + ridge, total_right - out_right)
            explained += np.sum((2.0 * out_right - out_gram @ beta) * beta, axis=0)
        return np.asarray(explained / np.maximum(np.sum(values**2, axis=0), 1e-300))

    def surrogates(self, rng: np.random.Generator) -> Array:
        """Return randomly shifted residuals of the same power, (rows, surrogates)."""
        shifted = np.empty((len(self.values), SURROGATES))
        for k in range(len(self.view.tracks)):
            rows = self.view.track_rows(k)
            residual = self.values[rows]
            for j in range(SURROGATES):
                shifted[rows, j] = np.roll(residual, rng.integers(1, max(len(residual), 2)))
        shifted = self.null.project_out(shifted)
        power = np.einsum("ij,ij->j", shifted, shifted)
        return np.asarray(shifted * np.sqrt(np.sum(self.values**2) / power))
