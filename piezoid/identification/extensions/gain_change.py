"""From one instant on the stage is more or less sensitive."""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from piezoid.identification.extensions.extension import Extension, Free, Where, free, within
from piezoid.identification.extensions.loop_effect import LoopEffect
from piezoid.numerics.arrays import Array


@dataclass(frozen=True, kw_only=True)
class GainChange(Extension):
    """A load was put on, a connector moved: displacement times a ratio from then on.

        y = m before, ratio m + offset_m after

    recording  in which it happens
    instant_s  s, since that recording began
    ratio      1, > 0
    offset_m   m, step of the zero in that recording; later ones have a zero of their own
    later      recordings made after it, all at the new gain
    """

    kind: ClassVar[str] = "gain_change"

    recording: str
    instant_s: float
    ratio: float
    offset_m: float = 0.0
    later: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        within("instant_s", self.instant_s, 0.0, 1e9)
        within("gain ratio", self.ratio, 0.1, 10.0)
        within("gain offset_m", self.offset_m, -1.0, 1.0)

    def _after(self, where: Where) -> Array | None:
        if where.recording == self.recording:
            return np.asarray((where.time_s >= self.instant_s).astype(np.float64))
        return np.ones(where.samples) if where.recording in self.later else None

    def gain(self, where: Where) -> Array | float:
        """Return 1 before and the ratio after."""
        after = self._after(where)
        if after is None:
            return 1.0
        return np.asarray(1.0 + (self.ratio - 1.0) * after, dtype=np.float64)

    def response(self, moved: Array, where: Where) -> Array:
        """Return the displacement at the gain of its time."""
        gain = self.gain(where)
        if isinstance(gain, float):
            return moved
        return np.asarray(moved * (gain if moved.ndim == 1 else gain[:, None]))

    def added(self, where: Where) -> Array | float:
        """Return the step of the zero."""
        if where.recording != self.recording:
            return 0.0
        return np.asarray(self.offset_m * (where.time_s >= self.instant_s))

    def loop_effect(self, rate_Hz: float) -> LoopEffect:  # noqa: ARG002
        """Return the ratio: it holds from its instant on, so the stage has it now."""
        return LoopEffect(gain=self.ratio)

    def free(self) -> Free:
        """Return ratio and step; the instant stays."""
        return free((self.ratio, self.offset_m), (0.1, -1.0), (10.0, 1.0), (1e-4, 1e-10))

    def moved_to(self, value: Array) -> Self:
        """Return another ratio and step."""
        return type(self)(
            recording=self.recording,
            instant_s=self.instant_s,
            ratio=float(value[0]),
            offset_m=float(value[1]),
            later=self.later,
        )
