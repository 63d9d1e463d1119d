"""Expected precision of planned drives: separability of effects and their errors.

Every column is first made orthogonal to what a refit of the model could absorb. Of two effects

    separability = 1 - (largest canonical correlation of their columns)^2,

and the strength of one, with the other free, has the standard error

    se^2 = d' S d,   d = c_perp / |c_perp|^2,   S = n^2 I + s^2 exp(-|z_i - z_j|^2 / 2 l^2)

n is the sensor noise. s is the model's own error, a function of the states z of its plays: an
equal cycle repeats this error and adds nothing new. The errors are too small, because shapes
differ from the tangents; their ratios are reliable.

Source: least squares with a known covariance of the errors; Cook & Weisberg (1982).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import cast

import numpy as np
from scipy.linalg import block_diag

from piezoid.diagnosis.drive_response import DriveResponse, null_columns
from piezoid.diagnosis.effect import Tangent
from piezoid.numerics.arrays import Array

CORRELATION_LENGTH = 0.15  # of half the range: distance of states with similar model errors
ENGINE_ROWS = 12_000  # of all recordings together, in a diagnosis
ROUNDING = 1e-9  # of a column


@dataclass(frozen=True, kw_only=True)
class Suspect:
    """An effect that may be present.

    name     of the effect
    tangent  its columns along a drive
    rms_m    its size, rms along the reference drives
    scale    the tangent's scale as diagnosed; None: unknown
    """

    name: str
    tangent: Tangent
    rms_m: float
    scale: float | None = None


@dataclass(frozen=True, kw_only=True)
class SeparationEstimate:
    """Expected precision of effects.

    separability  0 to 1; 1 for a single effect
    errors        relative standard error of each effect's strength, the others free; infinite if
                  the drives do not show it
    """

    separability: float
    errors: tuple[float, ...]

    @property
    def worst(self) -> float:
        """Return the largest of the relative errors."""
        return max(self.errors)


def estimate_separation(
    drives: Sequence[DriveResponse],
    suspects: Sequence[Suspect],
    reference: Sequence[DriveResponse],
    *,
    noise_m: float,
    structure_m: float,
) -> SeparationEstimate:
    """Return the expected precision of suspects on drives.

    drives       all of one model, evaluated together
    reference    along which the suspects have their size
    noise_m      of the sensor
    structure_m  rms of the model error
    """
    scales = [scale_of(suspect, reference) for suspect in suspects]
    # all drives count equally
    weight = np.concatenate([np.full(len(d.rows), len(d.rows) ** -0.5) for d in drives])
    has_lag = any(suspect.tangent.lags for suspect in suspects)
    basis = basis_of(weight[:, None] * null_columns(drives, lag=not has_lag))
    blocks = [
        orthogonal_to(basis, weight[:, None] * block_of(suspect.tangent, scale, drives))
        for suspect, scale in zip(suspects, scales, strict=True)
    ]
    bases = [basis_of(block) for block in blocks]
    errors = []
    for k, (suspect, scale) in enumerate(zip(suspects, scales, strict=True)):
        # a coupling that was never recorded has its size along the drive that excites it most
        unit_rms = _centred_rms(suspect.tangent, scale, reference) or max(
            _centred_rms(suspect.tangent, scale, (drive,)) for drive in drives
        )
        strength = suspect.rms_m / (unit_rms or 1.0)
        column = weight * strength * np.concatenate(_column_sums(suspect.tangent, scale, drives))
        nuisance = np.hstack([basis, *bases[:k], *bases[k + 1 :]])
        errors.append(_relative_error(column, nuisance, weight, drives, noise_m, structure_m))
    separability = 1.0  # the smallest of any pair
    for a, b in combinations(bases, 2):
        of_pair = 0.0
        if a.shape[1] and b.shape[1]:
            correlation = float(np.linalg.svd(a.T @ b, compute_uv=False)[0])
            of_pair = float(np.clip(1.0 - correlation**2, 0.0, 1.0))
        separability = min(separability, of_pair)
    return SeparationEstimate(separability=separability, errors=tuple(errors))


def scale_of(suspect: Suspect, reference: Sequence[DriveResponse]) -> float:
    """Return the scale of a tangent; of a lag, the time at which it has its size."""
    tangent = suspect.tangent
    if suspect.scale is not None:
        return suspect.scale
    if not tangent.lags or tangent.scale >= 1.0:
        return tangent.scale
    speed_m_per_s = _rms(np.concatenate([drive.speed[:, 0] for drive in reference]))
    return suspect.rms_m / max(speed_m_per_s, 1e-30)


def block_of(tangent: Tangent, scale: float, drives: Sequence[DriveResponse]) -> Array:
    """Return an effect's columns at the rows of all drives, (rows, columns)."""
    blocks = [tangent.columns(drive, scale)[drive.rows] for drive in drives]
    if tangent.per_drive:
        return np.asarray(block_diag(*blocks))
    width = max(block.shape[1] for block in blocks)
    return np.vstack([np.pad(b, ((0, 0), (0, width - b.shape[1]))) for b in blocks])


def _column_sums(tangent: Tangent, scale: float, drives: Sequence[DriveResponse]) -> list[Array]:
    return [tangent.columns(drive, scale)[drive.rows].sum(axis=1) for drive in drives]


def _centred_rms(tangent: Tangent, scale: float, drives: Sequence[DriveResponse]) -> float:
    sums = _column_sums(tangent, scale, drives)
    return _rms(np.concatenate([values - values.mean() for values in sums]))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def basis_of(columns: Array) -> Array:
    """Return an orthonormal basis of columns, up to rounding."""
    length = np.linalg.norm(columns, axis=0)
    unit = columns[:, length > 0.0] / length[length > 0.0]
    directions, singular, _ = np.linalg.svd(unit, full_matrices=False)
    if not len(singular):
        return np.zeros((len(columns), 0))
    return np.asarray(directions[:, singular > ROUNDING * singular[0]])


def orthogonal_to(basis: Array, columns: Array) -> Array:
    """Return the part of columns orthogonal to a basis, without columns that are in its span."""
    remainder = columns - basis @ (basis.T @ columns)
    remainder = remainder - basis @ (basis.T @ remainder)
    length = np.linalg.norm(columns, axis=0)
    return np.asarray(remainder[:, np.linalg.norm(remainder, axis=0) > 1e3 * ROUNDING * length])


def _relative_error(
    column: Array,
    nuisance: Array,
    weight: Array,
    drives: Sequence[DriveResponse],
    noise_m: float,
    structure_m: float,
) -> float:
    """Return the standard error of a strength: of white noise, and of errors of similar states."""
    from scipy.spatial.distance import pdist, squareform

    remainder = orthogonal_to(basis_of(nuisance), column[:, None])
    if not remainder.shape[1]:
        return float("inf")
    estimator = weight * remainder[:, 0] / float(remainder[:, 0] @ remainder[:, 0])
    rows, share = [len(drive.rows) for drive in drives], ENGINE_ROWS / len(drives)
    samples_per_row = [
        max(min(len(drive.voltage_V), share) / count, 1.0)
        for drive, count in zip(drives, rows, strict=True)
    ]
    white = noise_m**2 * float(np.sum(estimator**2 / np.repeat(samples_per_row, rows)))
    state = np.vstack([drive.state for drive in drives])
    distance = pdist(state / np.sqrt(state.shape[1]), "sqeuclidean")
    kernel = squareform(np.exp(distance / (-2.0 * CORRELATION_LENGTH**2)))
    np.fill_diagonal(kernel, 1.0)
    correlated = float(cast(float, estimator @ kernel @ estimator))
    return float(np.sqrt(white + structure_m**2 * correlated))
