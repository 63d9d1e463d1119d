"""Cross coupling: response of this axis to the drive of another axis."""

from dataclasses import dataclass, replace
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
from piezoid.operators.play import play_columns

MAX_GAIN = 1e3


@dataclass(frozen=True, kw_only=True)
class CrossAxis(Extension):
    """Static and hysteretic response to the drive of another axis.

        added = a v + b v^2 + sum_i w_i F_(r_i)[v],   v = u_other - centre

    a    gain_m_per_V        m/V
    b    curvature_m_per_V_per_V  m/V^2
    reach_V                  V, >= 0, largest distance of the other drive from the centre
    r_i  play_threshold_V    (plays,)  V, > 0
    w_i  play_weight_m_per_V (plays,)  m/V

    If a recording does not contain the drive of the other axis, that axis is assumed at rest.
    """

    kind: ClassVar[str] = "cross_axis"

    axis: str
    centre_V: float
    gain_m_per_V: float
    curvature_m_per_V_per_V: float
    reach_V: float = 0.0
    play_threshold_V: tuple[float, ...] = ()
    play_weight_m_per_V: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if len(self.play_threshold_V) != len(self.play_weight_m_per_V):
            raise ValueError(
                f"{len(self.play_threshold_V)} thresholds, {len(self.play_weight_m_per_V)} weights"
            )
        for threshold_V in self.play_threshold_V:
            within("play_threshold_V", threshold_V, 1e-12, 1e6)
        within("centre_V", self.centre_V, -1e6, 1e6)
        within("reach_V", self.reach_V, 0.0, 1e6)
        for value in self.free().value:
            within("cross-axis gain", float(value), -MAX_GAIN, MAX_GAIN)

    def added_by_number(self, where: Where) -> tuple[int, Array] | None:
        """Return index 0 and the columns v, v^2, plays of v; None if the other axis is at rest."""
        if self.axis not in where.others_V:
            return None
        v = np.ascontiguousarray(where.others_V[self.axis] - self.centre_V)
        threshold = np.array(self.play_threshold_V)
        plays, _ = play_columns(v, threshold, np.full(len(threshold), v[:1].sum()))
        return 0, np.column_stack([v, v**2, plays])

    def loop_effect(self, rate_Hz: float) -> LoopEffect:  # noqa: ARG002
        """Return the largest response to the other axis over its recorded range."""
        max_slope = abs(self.gain_m_per_V) + float(np.abs(self.play_weight_m_per_V).sum())
        max_slope += 2.0 * abs(self.curvature_m_per_V_per_V) * self.reach_V
        return LoopEffect(motion_m=max_slope * self.reach_V)

    def free(self) -> Free:
        """Return all gains."""
        value = (self.gain_m_per_V, self.curvature_m_per_V_per_V, *self.play_weight_m_per_V)
        return free(value, -MAX_GAIN, MAX_GAIN, 1e-12)

    def moved_to(self, value: Array) -> Self:
        """Return other gains."""
        gain, curvature, *weight = value.tolist()
        return replace(
            self,
            gain_m_per_V=gain,
            curvature_m_per_V_per_V=curvature,
            play_weight_m_per_V=tuple(weight),
            std=(),
        )
