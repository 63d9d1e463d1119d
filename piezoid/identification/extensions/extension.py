"""Interface of the extensions of an axis model for simulation, fit and design.

    command -> drive -> reversible + irreversible part -> dead zones -> response -> + added
            -> reading

An extension acts at one of these places and leaves the others alone. All numbers are in SI units.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Self

import numpy as np

from piezoid.identification.extensions.loop_effect import LoopEffect
from piezoid.numerics.arrays import Array, frozen


@dataclass(frozen=True, kw_only=True, eq=False)
class Where:
    """Location of one uninterrupted piece of a recording, with the data that extensions need.

    recording  its name
    rate_Hz    > 0
    first      sample of the recording at which the piece begins
    samples    how many it has
    others_V   drives of other axes by axis, (samples,)
    """

    recording: str
    rate_Hz: float
    first: int = 0
    samples: int = 0
    others_V: Mapping[str, Array] = field(default_factory=dict)

    @property
    def time_s(self) -> Array:
        """Return the time of every sample since the recording began, (samples,)."""
        return (self.first + np.arange(self.samples)) / self.rate_Hz


@dataclass(frozen=True, kw_only=True, eq=False)
class Free:
    """The numbers of an extension that a fit may move.

    value, lower, upper  (numbers,)
    step                 (numbers,)  a change that is felt and still small
    """

    value: Array
    lower: Array
    upper: Array
    step: Array

    def __post_init__(self) -> None:
        for name in ("value", "lower", "upper", "step"):
            values = np.atleast_1d(np.asarray(getattr(self, name), dtype=np.float64))
            object.__setattr__(self, name, frozen(np.where(np.isinf(values), 0.0, values), name))
            if name in ("lower", "upper"):
                object.__setattr__(self, name, values)


def free(value: Any, lower: Any, upper: Any, step: Any) -> Free:
    """Return the numbers with bounds and steps of one each, or one for all."""
    values = np.atleast_1d(np.asarray(value, dtype=np.float64))
    shape = values.shape
    return Free(
        value=values,
        lower=np.broadcast_to(np.asarray(lower, dtype=np.float64), shape),
        upper=np.broadcast_to(np.asarray(upper, dtype=np.float64), shape),
        step=np.broadcast_to(np.asarray(step, dtype=np.float64), shape),
    )


@dataclass(frozen=True, kw_only=True)
class Extension:
    """Effect that a diagnosis adds to an axis model; this base class adds nothing.

    Design and verification know an extension by its ``loop_effect`` alone, which each must state.

    kind       its name in model.json
    instant    whether ``response`` follows within samples: then tangents pass it as well
    in_metres  whether what ``prior`` compares are metres
    std        standard errors of the numbers of ``free`` from the fit; empty: not fitted
    """

    kind: ClassVar[str] = ""
    instant: ClassVar[bool] = False
    in_metres: ClassVar[bool] = False

    std: tuple[float, ...] = ()

    def drive(self, voltage_V: Array, rate_Hz: float) -> Array:  # noqa: ARG002
        """Return the voltage that reaches the ceramic."""
        return voltage_V

    def irreversible(self, part_m: Array, rate_Hz: float) -> Array:  # noqa: ARG002
        """Return the part of the displacement that is not reversible, as it comes about."""
        return part_m

    def response(self, displacement: Array, where: Where) -> Array:  # noqa: ARG002
        """Return the linear response to the output of the hysteresis, at rest before sample 0.

        displacement  (samples,) or (samples, columns)
        """
        return displacement

    def added(self, where: Where) -> Array | float:
        """Return displacement that does not depend on the drive, (samples,) in m, or 0."""
        of_piece = self.added_by_number(where)
        if of_piece is None:
            return 0.0
        first, columns = of_piece
        return np.asarray(columns @ self.free().value[first : first + columns.shape[1]])

    def added_by_number(self, where: Where) -> tuple[int, Array] | None:  # noqa: ARG002
        """Return d added / d numbers of this piece; None where nothing is added.

        They are the index of the first of its numbers and (samples, numbers of this piece).
        """
        return None

    def reading(self, position_m: Array, where: Where) -> Array:  # noqa: ARG002
        """Return the reading of the sensor at a position."""
        return position_m

    def late_s(self, rate_Hz: float) -> float:  # noqa: ARG002
        """Return by how much slow motion comes later."""
        return 0.0

    def gain(self, where: Where) -> Array | float:  # noqa: ARG002
        """Return the factor by which motion is larger, (samples,) or one number."""
        return 1.0

    def loop_effect(self, rate_Hz: float) -> LoopEffect:
        """Return what a loop of this sampling rate feels of it, ``NOTHING`` if that is so."""
        raise NotImplementedError(self.kind)

    def at_corner(self, slower: float, sharper: float) -> "Extension":  # noqa: ARG002
        """Return the extension at an end of its interval, for a family of plants.

        slower   +1: everything as late as the 95 % interval allows; -1: as early
        sharper  +1: modes as little damped as it allows; -1: as much
        """
        return self

    def free(self) -> Free:
        """Return the numbers a fit may move."""
        raise NotImplementedError(self.kind)

    def moved_to(self, value: Array) -> Self:
        """Return the extension with other numbers."""
        raise NotImplementedError(self.kind)

    def prior(self) -> Array:
        """Return rows whose product with the numbers is near 0 beforehand, (rows, numbers).

        Where there are none, nobody asks for columns: a fit comes here at every step.
        """
        return np.zeros((0, 0))


def within(name: str, value: float, low: float, high: float) -> None:
    """Refuse a number outside [low, high] or not finite."""
    if not low <= value <= high or not np.isfinite(value):
        raise ValueError(f"{name} is {value!r}, expected {low:g} to {high:g}")
