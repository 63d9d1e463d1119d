"""How well drives tell effects apart and how narrow an interval they give, before being played.

Every column is first freed from what a refit of the model could take up. Of two effects then

    separability = 1 - (largest canonical correlation of their columns)^2

is left, and the strength of one, with the other free beside it, has the standard error

    se^2 = d' S d,   d = c_perp / |c_perp|^2,   S = n^2 I + s^2 exp(-|z_i - z_j|^2 / 2 l^2)

n is the sensor's noise. s is what the model gets wrong for good: an error that is a function of
the plays' states z, so that an equal cycle brings the same error again and nothing new. The
errors are rather too small, as shapes are never quite those of the tangents: trust their ratios.

Source: least squares with a known covariance of the errors; Cook & Weisberg (1982).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from piezoid.diagnosis.drive_response import Driven, null_columns, side_by_side
from piezoid.diagnosis.effect import Tangent
from piezoid.numerics.arrays import Array

ALIKE = 0.15  # of half the range: how far states may differ for the error to be the same
ENGINE_ROWS = 12_000  # of all recordings together that a diagnosis compares
NOTHING = 1e-9  # of a column: what the null may leave of it by rounding


@dataclass(frozen=True, kw_only=True)
class Suspect:
    """An effect that may be there.

    name     of the effect
    tangent  what it adds
    rms_m    how large it is, rms along the reference drives
    scale    the tangent's scale where a diagnosis found it; None: not found
    """

    name: str
    tangent: Tangent
    rms_m: float
    scale: float | None = None


@dataclass(frozen=True, kw_only=True)
class Errors:
    """What is left when the model is right: white noise, and structure the model lacks."""

    noise_m: float
    structure_m: float


@dataclass(frozen=True, kw_only=True)
class SeparationEstimate:
    """How well effects can be told apart.

    separability  0 to 1; 1 where there is only one
    errors        standard error of each effect's strength over that strength, others free;
                  infinite where these drives do not show it at all
    """

    separability: float
    errors: tuple[float, ...]

    @property
    def worst(self) -> float:
        """Return the largest of the relative errors."""
        return max(self.errors)


def estimate_separation(
    drives: Sequence[Driven],
    suspects: Sequence[Suspect],
    reference: Sequence[Driven],
    errors: Errors,
) -> SeparationEstimate:
    """Return how well drives tell suspects apart.

    drives     all of one model, to be evaluated together
    reference  along which the suspects have the size that was found
    """
    scales = [scale_of(suspect, reference) for suspect in suspects]
    weight = row_weights(drives)
    lag = not any(suspect.tangent.lags for suspect in suspects)
    basis = basis_of(weight[:, None] * null_columns(drives, lag=lag))
    blocks = [
        freed(weight[:, None] * block_of(suspect.tangent, scale, drives), basis)
        for suspect, scale in zip(suspects, scales, strict=True)
    ]
    found = []
    for k, (suspect, scale) in enumerate(zip(suspects, scales, strict=True)):
        strength = suspect.rms_m / _moved(suspect.tangent, scale, reference, drives)
        whole = weight * strength * _sum(suspect.tangent, scale, drives)
        beside = [basis, *(basis_of(b) for j, b in enumerate(blocks) if j != k)]
        found.append(_relative_error(whole, np.hstack(beside), weight, drives, errors))
    return SeparationEstimate(separability=_separability(blocks), errors=tuple(found))


def scale_of(suspect: Suspect, reference: Sequence[Driven]) -> float:
    """Return the time at which a lag is as large as was found; other scales stay as they are."""
    tangent = suspect.tangent
    if suspect.scale is not None:
        return suspect.scale
    if not tangent.lags or tangent.scale >= 1.0:
        return tangent.scale
    speed_m_per_s = _rms(np.concatenate([one.speed[:, 0] for one in reference]))
    return suspect.rms_m / max(speed_m_per_s, 1e-30)


def row_weights(drives: Sequence[Driven]) -> Array:
    """Return a weight for every row, so that drives count the same whatever their length."""
    return np.concatenate([np.full(len(one.rows), len(one.rows) ** -0.5) for one in drives])


def block_of(tangent: Tangent, scale: float, drives: Sequence[Driven]) -> Array:
    """Return an effect's columns at the rows of all drives, (rows, columns)."""
    parts = [tangent.columns(one, scale)[one.rows] for one in drives]
    if tangent.own:
        return side_by_side(parts)
    widest = max(part.shape[1] for part in parts)
    return np.vstack([np.pad(part, ((0, 0), (0, widest - part.shape[1]))) for part in parts])


def _sum(tangent: Tangent, scale: float, drives: Sequence[Driven]) -> Array:
    return np.concatenate([tangent.columns(one, scale)[one.rows].sum(axis=1) for one in drives])


def _moved(
    tangent: Tangent, scale: float, reference: Sequence[Driven], drives: Sequence[Driven]
) -> float:
    """Return the rms that a size is given along: of the reference, where the effect moves it at
    all; else of the drive in which it moves most, as of a coupling that no recording excites.
    """
    there = _moves(tangent, scale, reference)
    return there or max(_moves(tangent, scale, (one,)) for one in drives) or 1.0


def _moves(tangent: Tangent, scale: float, drives: Sequence[Driven]) -> float:
    """Return the rms of what an effect of strength one adds, each drive about its own mean."""
    parts = [tangent.columns(one, scale)[one.rows].sum(axis=1) for one in drives]
    return _rms(np.concatenate([part - part.mean() for part in parts]))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def basis_of(columns: Array) -> Array:
    """Return an orthonormal basis of columns, those that rounding made left out."""
    size = np.linalg.norm(columns, axis=0)
    kept = columns[:, size > 0.0] / size[size > 0.0]
    left, strength, _ = np.linalg.svd(kept, full_matrices=False)
    if not len(strength):
        return np.zeros((len(columns), 0))
    return np.asarray(left[:, strength > NOTHING * strength[0]])


def freed(columns: Array, basis: Array) -> Array:
    """Return columns without what the basis explains, exactly zero where nothing is left."""
    left = columns - basis @ (basis.T @ columns)
    left = left - basis @ (basis.T @ left)
    there = np.linalg.norm(left, axis=0) > 1e3 * NOTHING * np.linalg.norm(columns, axis=0)
    return np.asarray(left[:, there])


def _separability(blocks: Sequence[Array]) -> float:
    """Return the least over all pairs."""
    pairs = [(a, b) for k, a in enumerate(blocks) for b in blocks[k + 1 :]]
    return min((_is_separable(basis_of(a), basis_of(b)) for a, b in pairs), default=1.0)


def _is_separable(one: Array, other: Array) -> float:
    if not one.shape[1] or not other.shape[1]:
        return 0.0
    largest = float(np.linalg.svd(one.T @ other, compute_uv=False)[0])
    return float(np.clip(1.0 - largest**2, 0.0, 1.0))


def _relative_error(
    whole: Array, beside: Array, weight: Array, drives: Sequence[Driven], errors: Errors
) -> float:
    left = freed(whole[:, None], basis_of(beside))
    if not left.shape[1]:
        return float("inf")
    column = left[:, 0]
    estimator = weight * column / float(column @ column)
    rows = [len(one.rows) for one in drives]
    share = ENGINE_ROWS / len(drives)
    stands_for = [
        max(min(len(one.voltage_V), share) / n, 1.0) for one, n in zip(drives, rows, strict=True)
    ]
    white = errors.noise_m**2 * float(np.sum(estimator**2 / np.repeat(stands_for, rows)))
    structure = errors.structure_m**2 * _alike(drives, estimator)
    return float(np.sqrt(white + structure))


def _alike(drives: Sequence[Driven], estimator: Array) -> float:
    """Return d' K d with the kernel of equal states."""
    from scipy.spatial.distance import pdist, squareform

    state = np.vstack([one.state for one in drives])
    apart = pdist(state / np.sqrt(state.shape[1]), "sqeuclidean")
    kernel = squareform(np.exp(apart / (-2.0 * ALIKE**2)))
    np.fill_diagonal(kernel, 1.0)
    return float(cast(float, estimator @ kernel @ estimator))
