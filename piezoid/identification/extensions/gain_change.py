"""Gain change: another sensitivity from one instant on, or a gradual change."""

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from piezoid.identification.extensions.extension import Extension, Free, Where, free, within
from piezoid.identification.extensions.loop_effect import LoopEffect
from piezoid.numerics.arrays import Array


def turned(time: Array, middle: float, lasts: float) -> Array:
    """Return how much of a change has come about: 0 before, 1 after, a straight line between."""
    if not lasts > 0.0:
        return np.asarray((time >= middle).astype(np.float64))
    return np.clip((time - middle) / lasts + 0.5, 0.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class GainChange(Extension):
    """Change of the sensitivity by a ratio at one instant, as by a load or a connector.

        y = m before, ratio m + offset_m after, in a straight line from one to the other

    recording  in which it happens
    instant_s  s, since that recording began: the middle of the change
    ratio      1, > 0
    offset_m   m, step of the zero in that recording; later ones have a zero of their own
    later      recordings made after it, all at the new gain
    lasts_s    s, >= 0: how long the change takes
    """

    kind: ClassVar[str] = "gain_change"

    recording: str
    instant_s: float
    ratio: float
    offset_m: float = 0.0
    later: tuple[str, ...] = ()
    lasts_s: float = 0.0

    def __post_init__(self) -> None:
        within("instant_s", self.instant_s, 0.0, 1e9)
        within("lasts_s", self.lasts_s, 0.0, 1e9)
        within("gain ratio", self.ratio, 0.1, 10.0)
        within("gain offset_m", self.offset_m, -1.0, 1.0)

    def _share_after(self, where: Where) -> Array | None:
        if where.recording == self.recording:
            return turned(where.time_s, self.instant_s, self.lasts_s)
        return np.ones(where.samples) if where.recording in self.later else None

    def gain(self, where: Where) -> Array | float:
        """Return 1 before and the ratio after."""
        share = self._share_after(where)
        if share is None:
            return 1.0
        return np.asarray(1.0 + (self.ratio - 1.0) * share, dtype=np.float64)

    def response(self, displacement: Array, where: Where) -> Array:
        """Scale the displacement by the gain at each sample."""
        gain = self.gain(where)
        if isinstance(gain, float):
            return displacement
        return np.asarray(displacement * (gain if displacement.ndim == 1 else gain[:, None]))

    def added(self, where: Where) -> Array | float:
        """Return the step of the zero."""
        if where.recording != self.recording:
            return 0.0
        return self.offset_m * turned(where.time_s, self.instant_s, self.lasts_s)

    def loop_effect(self, rate_Hz: float) -> LoopEffect:  # noqa: ARG002
        """Return the ratio: it holds from its instant on, so the stage has it now."""
        return LoopEffect(gain=self.ratio)

    def free(self) -> Free:
        """Return ratio and step; the instant stays."""
        return free((self.ratio, self.offset_m), (0.1, -1.0), (10.0, 1.0), (1e-4, 1e-10))

    def moved_to(self, value: Array) -> Self:
        """Return another ratio and step."""
        return replace(self, ratio=float(value[0]), offset_m=float(value[1]))
