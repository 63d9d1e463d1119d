"""Thermal drift: slow motion independent of the drive."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import ClassVar, Self

import numpy as np

from piezoid.identification.extensions.extension import (
    Extension,
    Free,
    LoopEffect,
    Where,
    free,
    within,
)
from piezoid.numerics.arrays import Array, frozen

KNOTS = 6
MIN_DURATION_s = 5.0
MAX_LEVEL_m = 1.0
SLOPE_WEIGHT = 0.03  # of a slope in the prior, relative to a change of slope


@dataclass(frozen=True, kw_only=True)
class DriftCurve:
    """Drift of one piece, relative to its beginning.

    recording  name of the recording
    first      sample at which the piece begins
    level_m    (knots - 1,)  m, at equidistant instants of the piece; 0 at its beginning
    """

    recording: str
    first: int
    level_m: tuple[float, ...]

    def __post_init__(self) -> None:
        for level_m in self.level_m:
            within("drift level_m", level_m, -MAX_LEVEL_m, MAX_LEVEL_m)


@dataclass(frozen=True, kw_only=True)
class ThermalDrift(Extension):
    """Smooth zero of every piece; simulated, not exported: an observer compensates it."""

    kind: ClassVar[str] = "thermal_drift"
    is_prior_in_metres: ClassVar[bool] = True
    is_of_recordings: ClassVar[bool] = True

    curves: tuple[DriftCurve, ...]

    @classmethod
    def of(cls, pieces: Sequence[Where]) -> Self:
        """Return zero drift for every piece that is long enough for drift."""
        curves = tuple(
            DriftCurve(recording=p.recording, first=p.first, level_m=(0.0,) * (KNOTS - 1))
            for p in pieces
            if p.samples >= MIN_DURATION_s * p.rate_Hz
        )
        return cls(curves=curves)

    def added_by_number(self, where: Where) -> tuple[int, Array] | None:
        """Return the index of the first level of this piece, and a spline for each level."""
        first = 0
        for curve in self.curves:
            count = len(curve.level_m)
            if (curve.recording, curve.first) == (where.recording, where.first):
                return first, _splines(count + 1, where.samples)[:, 1:]
            first += count
        return None

    def loop_effect(self, rate_Hz: float) -> LoopEffect:  # noqa: ARG002
        """Return range and speed of the drift, with knots at their smallest distance in time."""
        levels_m = [np.array([0.0, *curve.level_m]) for curve in self.curves]
        range_m = max((0.5 * float(np.ptp(level_m)) for level_m in levels_m), default=0.0)
        step_m = max((float(np.abs(np.diff(level_m)).max()) for level_m in levels_m), default=0.0)
        return LoopEffect(motion_m=range_m, motion_m_per_s=step_m * ((KNOTS - 1) / MIN_DURATION_s))

    def free(self) -> Free:
        """Return all levels."""
        value = [level for curve in self.curves for level in curve.level_m]
        return free(value, -MAX_LEVEL_m, MAX_LEVEL_m, 1e-9)

    def moved_to(self, value: Array) -> Self:
        """Return other levels."""
        values, curves = value.tolist(), []
        for curve in self.curves:
            count = len(curve.level_m)
            level_m, values = tuple(values[:count]), values[count:]
            curves.append(replace(curve, level_m=level_m))
        return type(self)(curves=tuple(curves))

    def prior(self) -> Array:
        """Return the changes of slope and, with a small weight, the slopes: drift is smooth."""
        count = len(self.curves[0].level_m) if self.curves else 0
        slopes = np.eye(count) - np.eye(count, k=-1)
        rows = np.vstack([np.diff(slopes, axis=0), SLOPE_WEIGHT * slopes])
        return np.asarray(np.kron(np.eye(len(self.curves)), rows), dtype=np.float64)


@lru_cache(maxsize=16)
def _splines(knots: int, samples: int) -> Array:
    """Return natural cubic splines that are 1 at one knot each, (samples, knots)."""
    from scipy.interpolate import CubicSpline

    spline = CubicSpline(np.arange(knots), np.eye(knots), bc_type="natural")
    return frozen(spline(np.linspace(0.0, knots - 1.0, samples)), "splines", ndim=2)
