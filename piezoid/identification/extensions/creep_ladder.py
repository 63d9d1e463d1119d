"""Creep as a sum of relaxations behind the hysteresis."""

from dataclasses import dataclass
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
from piezoid.numerics.arrays import Array
from piezoid.operators.filters import each_column, ladder
from piezoid.operators.linear import ContinuousSystem

MAX_SHARE = 0.5


@dataclass(frozen=True, kw_only=True)
class CreepLadder(Extension):
    """Creep: displacement that continues after the drive has stopped, in every decade of time.

        y = m + sum_i c_i x_i,   tau_i dx_i/dt = m - x_i            [Jung & Gweon 2000]

    tau_i  time_s  (rungs,)  s, rising
    c_i    share   (rungs,)  1, 0 to 0.5
    even           all shares are equal, one free number: evenly distributed energy barriers

    The state is steady before the first sample. The zero of a recording includes earlier creep.
    """

    kind: ClassVar[str] = "creep_ladder"

    time_s: tuple[float, ...]
    share: tuple[float, ...]
    even: bool = False

    def __post_init__(self) -> None:
        if len(self.time_s) != len(self.share) or not self.time_s:
            raise ValueError(f"creep has {len(self.time_s)} times and {len(self.share)} shares")
        if any(np.diff(self.time_s) <= 0.0):
            raise ValueError(f"creep times are {self.time_s}, expected rising")
        if self.even and len(set(self.share)) > 1:
            raise ValueError(f"even creep has shares {self.share}, expected equal ones")
        for time_s, share in zip(self.time_s, self.share, strict=True):
            within("creep time_s", time_s, 1e-6, 1e9)
            within("creep share", share, 0.0, MAX_SHARE)

    def response(self, displacement: Array, where: Where) -> Array:
        """Add creep to the displacement."""
        return each_column(
            lambda column: column + ladder(column, self.time_s, where.rate_Hz, self.share),
            displacement,
        )

    def slow_response(self, values: Array, time_s: Array) -> Array:
        """Add creep to values that are linear between some times.

        x[k] = d x[k-1] + (r - d) m[k-1] + (1 - r) m[k],   d = exp(-T/tau),  r = tau/T (1 - d)
        """
        share, state = np.array(self.share), np.tile(values[:1], (len(self.share), 1))
        result = np.empty_like(values)
        result[0] = values[0] * (1.0 + share.sum())
        ratio = np.array(self.time_s) / np.diff(time_s)[:, None]
        decay, ramp = np.exp(-1.0 / ratio), -ratio * np.expm1(-1.0 / ratio)
        weights = np.stack([ramp - decay, 1.0 - ramp], axis=2)  # of the old and the new value
        for k in range(1, len(values)):
            state *= decay[k - 1][:, None]
            state += weights[k - 1] @ values[k - 1 : k + 1]
            result[k] = values[k] + share @ state
        return result

    def loop_effect(self, rate_Hz: float) -> LoopEffect:  # noqa: ARG002
        """Return the ladder as a slow linear system."""
        rate_per_s = 1.0 / np.array(self.time_s)
        system = ContinuousSystem(
            A=-np.diag(rate_per_s),
            B=rate_per_s[:, None],
            C=np.array([self.share]),
            D=np.ones((1, 1)),
        )
        return LoopEffect(system=system, is_slow=True)

    def free(self) -> Free:
        """Return the shares, or the common share if they are equal."""
        return free(self.share[:1] if self.even else self.share, 0.0, MAX_SHARE, 1e-3)

    def moved_to(self, value: Array) -> Self:
        """Return the ladder with other shares."""
        shares = value.tolist() * (len(self.time_s) if self.even else 1)
        return type(self)(time_s=self.time_s, share=tuple(shares), even=self.even)

    def prior(self) -> Array:
        """Return the differences of neighbouring shares: energy barriers vary smoothly."""
        return np.diff(np.eye(len(self.free().value)), axis=0)
