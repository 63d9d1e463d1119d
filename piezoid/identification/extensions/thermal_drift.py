"""Thermal drift: slow motion independent of the drive."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, Self

import numpy as np

from piezoid.identification.extensions.extension import Extension, Free, Where, free, within
from piezoid.identification.extensions.loop_effect import LoopEffect
from piezoid.numerics.arrays import Array, frozen

KNOTS = 6
LEAST_s = 5.0
FARTHEST_m = 1.0
STEADY = 0.03  # weight of a slope beside that of its change


@dataclass(frozen=True, kw_only=True)
class DriftCurve:
    """The drift of one piece, against its beginning.

    recording  its name
    first      sample at which the piece begins
    level_m    (knots - 1,)  m, at even instants of the piece; at its beginning it is 0
    """

    recording: str
    first: int
    level_m: tuple[float, ...]

    def __post_init__(self) -> None:
        for level_m in self.level_m:
            within("drift level_m", level_m, -FARTHEST_m, FARTHEST_m)


@dataclass(frozen=True, kw_only=True)
class ThermalDrift(Extension):
    """A smooth zero for every recording; simulated, not shipped: an observer takes it away."""

    kind: ClassVar[str] = "thermal_drift"
    in_metres: ClassVar[bool] = True

    curves: tuple[DriftCurve, ...]

    @classmethod
    def of(cls, pieces: Sequence[Where]) -> Self:
        """Return zero drift for every piece that is long enough to show one."""
        curves = tuple(
            DriftCurve(recording=p.recording, first=p.first, level_m=(0.0,) * (KNOTS - 1))
            for p in pieces
            if p.samples >= LEAST_s * p.rate_Hz
        )
        return cls(curves=curves)

    def added_by_number(self, where: Where) -> tuple[int, Array] | None:
        """Return the index of this piece's first level, and a spline for each of its levels."""
        first = 0
        for curve in self.curves:
            count = len(curve.level_m)
            if (curve.recording, curve.first) == (where.recording, where.first):
                return first, _splines(count + 1, where.samples)[:, 1:]
            first += count
        return None

    def loop_effect(self, rate_Hz: float) -> LoopEffect:  # noqa: ARG002
        """Return range and speed of the drift; knots are at least a second apart."""
        levels = [np.array([0.0, *curve.level_m]) for curve in self.curves]
        return LoopEffect(
            motion_m=max((0.5 * float(np.ptp(level)) for level in levels), default=0.0),
            motion_m_per_s=max((float(np.abs(np.diff(v)).max()) for v in levels), default=0.0)
            * ((KNOTS - 1) / LEAST_s),
        )

    def free(self) -> Free:
        """Return all levels."""
        value = [level for curve in self.curves for level in curve.level_m]
        return free(value, -FARTHEST_m, FARTHEST_m, 1e-9)

    def moved_to(self, value: Array) -> Self:
        """Return other levels."""
        values, curves = value.tolist(), []
        for curve in self.curves:
            count = len(curve.level_m)
            level_m, values = tuple(values[:count]), values[count:]
            curves.append(
                DriftCurve(recording=curve.recording, first=curve.first, level_m=level_m)
            )
        return type(self)(curves=tuple(curves))

    def prior(self) -> Array:
        """Return changes of slope from knot to knot, and slopes, weakly: heat is slow."""
        count = len(self.curves[0].level_m) if self.curves else 0
        steps = np.eye(count) - np.eye(count, k=-1)
        rows = np.vstack([np.diff(steps, axis=0), STEADY * steps])
        return np.asarray(np.kron(np.eye(len(self.curves)), rows), dtype=np.float64)


@lru_cache(maxsize=16)
def _splines(knots: int, samples: int) -> Array:
    """Return natural cubic splines that are 1 at one knot each, (samples, knots)."""
    from scipy.interpolate import CubicSpline

    spline = CubicSpline(np.arange(knots), np.eye(knots), bc_type="natural")
    return frozen(spline(np.linspace(0.0, knots - 1.0, samples)), "splines", ndim=2)
