"""What a fit knows of its parameters: covariances from the curvature and from the lines."""

from dataclasses import dataclass

import numpy as np

from piezoid.identification.dynamics.modal_basis import Structure, terms_of
from piezoid.numerics.arrays import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class ModalFit:
    """The minimum of sum |G_hat - G|^2 / variance, and its curvature.

    shape             (shapes,)             as in ``modal_basis.basis``
    gains             (outputs, inputs, columns)
    cost              twice the negative log likelihood but for a constant
    shape_covariance  (shapes, shapes)      inflated where the residual is larger than its variance
    mode_worth        (modes,)              rise of the cost if a mode were left out
    gain_std          (outputs, inputs, columns)
    static_std        (outputs, inputs)     of the gain at frequency zero
    values            complex values that counted
    """

    shape: Array
    gains: Array
    cost: float
    shape_covariance: Array
    gain_std: Array
    static_std: Array
    mode_worth: Array
    values: int


@dataclass(frozen=True, kw_only=True, eq=False)
class Point:
    """One evaluation: cost, gradient and curvature with the gains eliminated.

    line_scores  (lines, shapes)  share of each line in the gradient
    gain_roots   for each path, outputs first: K with gain covariance K K^T / 2 at a fixed shape
    gain_slopes  for each path: d gains / d shape
    """

    shape: Array
    cost: float
    gains: Array
    gradient: Array
    curvature: Array
    line_scores: Array
    gain_roots: list[Array]
    gain_slopes: list[Array]


def with_covariance(point: Point, weight: Array, structure: Structure) -> ModalFit:
    """Curvature and the sandwich over lines, whichever is wider for each parameter.

    A complex value of variance one has parts of variance one half, hence the halves. The sandwich
    counts a line as one draw: distortion is shared by all outputs at that line.
    """
    values = int((weight > 0).sum())
    unknowns = structure.shapes + point.gains.size
    spare = max(values - unknowns / 2, 1.0)
    excess = max(1.0, point.cost / spare)
    inverse = _scaled_inverse(point.curvature)
    plain = 0.5 * excess * inverse
    lines = int((weight > 0).any(axis=(1, 2)).sum())
    meat = point.line_scores.T @ point.line_scores * lines / max(lines - unknowns / 2, 1.0)
    sandwich = inverse @ meat @ inverse
    ratio = np.diag(sandwich) / np.maximum(np.diag(plain), np.finfo(float).tiny)
    wider = np.sqrt(np.maximum(ratio, 1.0))
    covariance = plain * np.outer(wider, wider)
    gain_std, static_std = _gain_spread(point, covariance, excess, structure)
    return ModalFit(
        shape=point.shape,
        gains=point.gains,
        cost=point.cost,
        shape_covariance=covariance,
        gain_std=gain_std,
        static_std=static_std,
        mode_worth=_mode_worth(point, structure),
        values=values,
    )


def _scaled_inverse(curvature: Array) -> Array:
    scale = np.sqrt(np.maximum(np.diag(curvature), np.finfo(float).tiny))
    inverse = np.linalg.pinv(curvature / np.outer(scale, scale), rcond=1e-14, hermitian=True)
    return np.asarray(inverse / np.outer(scale, scale))


def _gain_spread(
    point: Point, covariance: Array, excess: float, structure: Structure
) -> tuple[Array, Array]:
    static = structure.static_columns()
    spread, static_spread = [], []
    for root, drag in zip(point.gain_roots, point.gain_slopes, strict=True):
        whole = 0.5 * excess * root @ root.T + drag @ covariance @ drag.T
        spread.append(np.sqrt(np.diag(whole)))
        static_spread.append(np.sqrt(max(float(static @ whole @ static), 0.0)))
    shape = point.gains.shape
    return np.reshape(spread, shape), np.reshape(static_spread, shape[:2])


def _mode_worth(point: Point, structure: Structure) -> Array:
    """g_S^T (K_S K_S^T)^-1 g_S over all paths, S the columns of a mode."""
    gains = point.gains.reshape(len(point.gain_roots), -1)
    worth = np.zeros(structure.modes)
    for m, term in enumerate(terms_of(structure)[: structure.modes]):
        chosen = list(term.columns)
        for g, root in zip(gains, point.gain_roots, strict=True):
            spread = root[chosen] @ root[chosen].T
            worth[m] += float(g[chosen] @ np.linalg.solve(spread, g[chosen]))
    return worth
