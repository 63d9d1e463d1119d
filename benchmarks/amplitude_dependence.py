"""How modes change with the level of the drive, and what they would be at none."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from piezoid.errors import ExcitationError
from piezoid.identification.dynamics.modal import LinearDynamics
from piezoid.numerics.arrays import Array, frozen
from piezoid.numerics.robust import NORMAL_95


@dataclass(frozen=True, kw_only=True)
class Trend:
    """A straight line against the level of the drive.

    at_zero            value extrapolated to no drive
    at_zero_interval   its 95 % interval
    change_per_V       relative change per volt rms
    change_interval    its 95 % interval
    is_significant     whether that interval excludes zero
    """

    at_zero: float
    at_zero_interval: tuple[float, float]
    change_per_V: float
    change_interval: tuple[float, float]

    @property
    def is_significant(self) -> bool:
        """Whether the change with level is more than its uncertainty."""
        low, high = self.change_interval
        return not low <= 0.0 <= high


@dataclass(frozen=True, kw_only=True, eq=False)
class AmplitudeDependence:
    """One mode over several levels.

    drive_rms_V    (levels,)  increasing
    frequency_Hz   (levels,)  the mode's frequency at each
    damping        (levels,)
    frequency      the trend of the frequency: falling means softening
    damping_trend  the trend of the damping: rising with hysteresis
    """

    drive_rms_V: Array
    frequency_Hz: Array
    damping: Array
    frequency: Trend
    damping_trend: Trend

    def __post_init__(self) -> None:
        for name in ("drive_rms_V", "frequency_Hz", "damping"):
            object.__setattr__(self, name, frozen(getattr(self, name), name))


def extrapolate_mode(
    levels: Sequence[LinearDynamics], near_frequency_Hz: float
) -> AmplitudeDependence:
    """Follow the mode nearest to a frequency over the levels, and down to no drive.

        ln f(level) = ln f_0 + b level, by least squares weighted with the fits' own variances

    levels             one model for each drive level, at least two different ones
    near_frequency_Hz  picks the mode in each

    Each level's model is a best linear approximation; the small-signal dynamics are the limit.
    With three levels or more, intervals widen where the points do not lie on a line.
    """
    ordered = sorted(levels, key=lambda model: float(_level_V(model)))
    level_V = np.array([_level_V(model) for model in ordered])
    if len(ordered) < 2 or not np.ptp(level_V) > 0:
        raise ExcitationError(
            f"{len(ordered)} levels between {level_V.min():g} and {level_V.max():g} V rms",
            needed="two different levels or more",
            remedy="Repeat the multisine at half and at double amplitude.",
        )
    place = [int(np.argmin(np.abs(m.mode_frequency_Hz - near_frequency_Hz))) for m in ordered]
    frequency_Hz = np.array([m.mode_frequency_Hz[k] for m, k in zip(ordered, place, strict=True)])
    damping = np.array([m.mode_damping[k] for m, k in zip(ordered, place, strict=True)])
    spread = [np.sqrt(np.diag(m.shape_covariance)) for m in ordered]
    modes = [len(m.mode_frequency_Hz) for m in ordered]
    frequency_std = np.array([s[k] for s, k in zip(spread, place, strict=True)])
    damping_std = np.array([s[n + k] for s, n, k in zip(spread, modes, place, strict=True)])
    return AmplitudeDependence(
        drive_rms_V=level_V,
        frequency_Hz=frequency_Hz,
        damping=damping,
        frequency=_trend(level_V, np.log(frequency_Hz), frequency_std),
        damping_trend=_trend(level_V, np.log(damping), damping_std),
    )


def _level_V(model: LinearDynamics) -> float:
    return float(np.sqrt(np.mean(model.drive_rms_V**2)))


def _trend(level_V: Array, logarithm: Array, std: Array) -> Trend:
    columns = np.stack([np.ones_like(level_V), level_V], axis=1) / std[:, None]
    covariance = np.linalg.inv(columns.T @ columns)
    solution = covariance @ columns.T @ (logarithm / std)
    left = logarithm / std - columns @ solution
    if len(level_V) > 2:
        covariance = covariance * max(1.0, float(left @ left) / (len(level_V) - 2))
    half = NORMAL_95 * np.sqrt(np.diag(covariance))
    zero, slope = float(solution[0]), float(solution[1])
    return Trend(
        at_zero=float(np.exp(zero)),
        at_zero_interval=(float(np.exp(zero - half[0])), float(np.exp(zero + half[0]))),
        change_per_V=slope,
        change_interval=(slope - float(half[1]), slope + float(half[1])),
    )
