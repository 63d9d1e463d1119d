"""Gain change: sudden or gradual change of the sensitivity."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from piezoid.identification.extensions.extension import (
    Extension,
    Free,
    LoopEffect,
    Where,
    free,
)
from piezoid.numerics.arrays import Array


def ramp(time: Array, middle: float, duration: float) -> Array:
    """Return a ramp from 0 to 1 around an instant; a step if its duration is 0."""
    if not duration > 0.0:
        return np.asarray((time >= middle).astype(np.float64))
    return np.clip((time - middle) / duration + 0.5, 0.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class GainChange(Extension):
    """Change of the sensitivity by a ratio at one instant, as by a load or a connector.

        y = m before, ratio m + offset_m after, linear in time during the change

    recording  in which the gain changes
    instant_s  s, middle of the change, from the beginning of that recording
    ratio      1, > 0
    offset_m   m, step of the zero in that recording; later recordings have a zero of their own
    later      later recordings, all at the new gain
    lasts_s    s, >= 0, duration of the change
    """

    kind: ClassVar[str] = "gain_change"
    is_of_recordings: ClassVar[bool] = True
    fitted: ClassVar[tuple[str, ...]] = ("ratio", "offset_m")
    limits: ClassVar[Mapping[str, tuple[str, float, float]]] = {
        "instant_s": ("instant_s", 0.0, 1e9),
        "lasts_s": ("lasts_s", 0.0, 1e9),
        "ratio": ("gain ratio", 0.1, 10.0),
        "offset_m": ("gain offset_m", -1.0, 1.0),
    }

    recording: str
    instant_s: float
    ratio: float
    offset_m: float = 0.0
    later: tuple[str, ...] = ()
    lasts_s: float = 0.0

    def gain(self, where: Where) -> Array | float:
        """Return 1 before and the ratio after the change."""
        if where.recording == self.recording:
            share = ramp(where.time_s, self.instant_s, self.lasts_s)
        elif where.recording in self.later:
            share = np.ones(where.samples)
        else:
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
        return self.offset_m * ramp(where.time_s, self.instant_s, self.lasts_s)

    def loop_effect(self, rate_Hz: float) -> LoopEffect:  # noqa: ARG002
        """Return the ratio, which holds after the recordings."""
        return LoopEffect(gain=self.ratio)

    def free(self) -> Free:
        """Return ratio and offset; the instant is fixed."""
        return free((self.ratio, self.offset_m), (0.1, -1.0), (10.0, 1.0), (1e-4, 1e-10))
