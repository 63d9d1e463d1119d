"""Converter hold: each value is held for a period of the converter clock."""

from dataclasses import dataclass
from typing import ClassVar, Self

from piezoid.identification.extensions.extension import Extension, Free, Where, free, within
from piezoid.identification.extensions.loop_effect import NOTHING, LoopEffect
from piezoid.numerics.arrays import Array
from piezoid.operators.filters import later


@dataclass(frozen=True, kw_only=True)
class ConverterHold(Extension):
    """Hold of the converter: half a declared clock period of delay, which is not fitted.

    hold_s  s, >= 0, half a period of the converter's clock

    It describes the recordings only: the converter of the controller has a hold of its own.
    """

    kind: ClassVar[str] = "converter_hold"
    is_fast: ClassVar[bool] = True

    hold_s: float

    def __post_init__(self) -> None:
        within("hold_s", self.hold_s, 0.0, 1.0)

    def group_delay_s(self, rate_Hz: float) -> float:  # noqa: ARG002
        """Return the delay."""
        return self.hold_s

    def response(self, displacement: Array, where: Where) -> Array:
        """Delay the displacement, which is equivalent to a delay of the drive."""
        return later(displacement, self.hold_s * where.rate_Hz)

    def loop_effect(self, rate_Hz: float) -> LoopEffect:  # noqa: ARG002
        """Return no effect: the delay of the controller's own converter is part of its loop."""
        return NOTHING

    def free(self) -> Free:
        """Return no free numbers."""
        return free((), 0.0, 0.0, 1.0)

    def moved_to(self, value: Array) -> Self:  # noqa: ARG002
        """Return the extension itself: it has no free numbers."""
        return self
