"""What hysteresis at each actuator leaves: distortion that reaches every mode in its own way.

    Y += e^(-s delay) sum_t sum_c b_c(s, l) W_ct F_t(u, s)

F_t are plays and products of all drives and elongations, b_c the columns of the linear part. A
term at an actuator reaches the modes as its drive does; polarisation, contacts and what is bent
in the mechanics do not. W is linear, and ridge regression of what the fit left finds it at fixed
poles. On the mirror, realisation 1 left out, it takes 4.2 % at 100 mV and 2.8 % at 300 mV to 3.7
and 2.4 %; the same terms at their own actuators alone leave 4.4 and 2.95 %.
"""

from collections.abc import Sequence
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from piezoid.identification.coupled.hysteresis_terms import plays
from piezoid.identification.coupled.modal_sum import gram_of_residues, products_with_residues
from piezoid.numerics.arrays import Array, ComplexArray

# Half-widths of plays of drive, elongation, and of drive with and against half the elongation,
# each over the rms of its signal at the largest level.
OF_DRIVE = np.array([0.02, 0.06, 0.15, 0.4, 1.0])
OF_ELONGATION = np.array([0.03, 0.12, 0.4, 1.2])
OF_BOTH = np.array([0.05, 0.2, 0.7])
# Of the curvature of each coefficient: 1e-3 and 3e-3 leave 3.72 and 3.78 % at 100 mV, 2.37 and
# 2.34 % at 300 mV of the mirror's realisation 1.
RIDGE = 2e-3
ROWS_EACH = 8  # of data for each coefficient, or noise is fitted
MOST = 6000  # coefficients: the matrix of all takes 300 MB


def distortion_terms(drive: Array, elongation: Array, *, periodic: bool) -> Array:
    """Return the terms of all actuators together.

    drive, elongation  (samples, inputs)  over their rms at the largest level
    periodic           as of ``hysteresis_terms``
    returned           (samples, terms)
    """
    u, s = drive, elongation
    found = []
    for a, b in zip(u.T, s.T, strict=True):
        found += [
            plays(a, OF_DRIVE, periodic=periodic),
            plays(b, OF_ELONGATION, periodic=periodic),
        ]
        found += [plays(a + sign * 0.5 * b, OF_BOTH, periodic=periodic) for sign in (-1.0, 1.0)]
        found.append(np.stack([a**3, a**2 * b, a * b**2], axis=1))
    found.append(_products(np.concatenate([s, u], axis=1), 2))
    found.append(_products(s, 3))
    return np.concatenate(found, axis=1)


def _products(signals: Array, order: int) -> Array:
    chosen = combinations_with_replacement(range(signals.shape[1]), order)
    return np.stack([signals[:, list(k)].prod(axis=1) for k in chosen], axis=1)


def is_determined(columns: int, terms: int, rows: int) -> bool:
    """Whether so many rows of data tell the coefficients of a fit of this size."""
    return columns * terms <= min(MOST, rows / ROWS_EACH)


def fitted_distortion(
    columns: Sequence[ComplexArray],
    terms: Sequence[ComplexArray],
    left: Sequence[ComplexArray],
    groups: Sequence[NDArray[np.int64]],
) -> tuple[Array, list[Array]]:
    """Return W of all realisations, and of all but each group of them.

    columns   of each level, (lines, columns)
    terms     of each level, (lines, terms, realisations)
    left      of each level, what the rest of the model leaves, (lines, outputs, realisations)
    groups    of realisations
    returned  (columns, terms, outputs) each
    """
    grams: list[Array] = []
    targets: list[Array] = []
    for group in groups:
        gram, target = np.zeros(()), np.zeros(())
        for b, acting, rest in zip(columns, terms, left, strict=True):
            weight = 1.0 / np.sqrt((np.abs(rest) ** 2).sum(axis=(0, 1)))[group]
            driven = np.ascontiguousarray(acting[..., group] * weight)
            gram = gram + gram_of_residues(b, driven)
            rows = rest[..., group] * weight
            target = target + products_with_residues(b, driven, rows[None])[..., 0]
        grams.append(gram)
        targets.append(target)
    whole_gram, whole_target = np.sum(grams, axis=0), np.sum(targets, axis=0)
    shape = (columns[0].shape[1], terms[0].shape[1], left[0].shape[1])
    whole = _solved(whole_gram, whole_target).reshape(shape)
    return whole, [
        _solved(whole_gram - gram, whole_target - target).reshape(shape)
        for gram, target in zip(grams, targets, strict=True)
    ]


def _solved(gram: Array, target: Array) -> Array:
    """Solve with a ridge in units of each coefficient's own curvature."""
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-12 * np.diag(gram).max()))
    stiff = gram / np.outer(scale, scale) + RIDGE * np.eye(len(gram))
    return np.asarray(cho_solve(cho_factor(stiff), target / scale[:, None]) / scale[:, None])
