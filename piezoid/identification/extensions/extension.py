"""Interface of the extensions of an axis model for simulation, fit and design.

    command -> drive -> reversible + irreversible part -> dead zones -> response -> + added
            -> reading

An extension overrides the method of one or more of these stages: ``drive``, ``irreversible``,
``response``, ``added``, ``reading``. All numbers are in SI units.

``response`` is linear: if ``is_fast``, the derivatives by the hysteresis pass through it. If it is
a factor at each sample, ``gain`` returns that factor for these derivatives. A nonlinear effect
behind the hysteresis, with or without memory, is a ``reading``; the derivatives ignore its slope.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Self

import numpy as np

from piezoid.numerics.arrays import Array, freeze
from piezoid.operators.linear import ContinuousSystem


@dataclass(frozen=True, kw_only=True, eq=False)
class Where:
    """Location of one uninterrupted piece of a recording, with the data that extensions need.

    recording  name of the recording
    rate_Hz    > 0
    first      sample of the recording at which the piece begins
    samples    number of samples
    others_V   drives of other axes by axis, (samples,)
    """

    recording: str
    rate_Hz: float
    first: int = 0
    samples: int = 0
    others_V: Mapping[str, Array] = field(default_factory=dict)

    @property
    def time_s(self) -> Array:
        """Time of every sample since the beginning of the recording, (samples,)."""
        return (self.first + np.arange(self.samples)) / self.rate_Hz


@dataclass(frozen=True, kw_only=True, eq=False)
class Free:
    """Free numbers of an extension, with bounds and steps of finite differences.

    value, lower, upper  (numbers,)
    step                 (numbers,)  small, but large enough to change the reading
    """

    value: Array
    lower: Array
    upper: Array
    step: Array

    def __post_init__(self) -> None:
        freeze(self, "value", "step")  # bounds may be infinite


def free(value: Any, lower: Any, upper: Any, step: Any) -> Free:
    """Broadcast bounds and steps to the numbers and return them as ``Free``."""
    values = np.atleast_1d(np.asarray(value, dtype=np.float64))
    shape = values.shape
    return Free(
        value=values,
        lower=np.broadcast_to(np.asarray(lower, dtype=np.float64), shape),
        upper=np.broadcast_to(np.asarray(upper, dtype=np.float64), shape),
        step=np.broadcast_to(np.asarray(step, dtype=np.float64), shape),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopEffect:
    """Effect of one extension on a closed loop around the axis; by default none.

    system         linear system in series behind the hysteresis, or None
    is_slow        whether the system relaxes over seconds: within the bandwidth of a loop it is a
                   gain between 1, at high frequency, and its static gain
    dead_time_s    pure delay
    gain           factor of the displacement after the recordings
    low_V, high_V  range of the drive that reaches the ceramic
    slew_V_per_s   fastest change of the drive that reaches the ceramic
    activation_s   time constant of the irreversible part; 0: no delay
    activation_m   lag of the irreversible part beyond which it relaxes faster; 0: at no lag
    motion_m       half the range of motion that the drive does not cause
    motion_m_per_s fastest change of that motion
    reading_m      largest error of the reading, which a loop converts to motion
    reading_Hz     frequency of that error; 0 if it is a function of position
    """

    system: ContinuousSystem | None = None
    is_slow: bool = False
    dead_time_s: float = 0.0
    gain: float = 1.0
    low_V: float = -np.inf
    high_V: float = np.inf
    slew_V_per_s: float = np.inf
    activation_s: float = 0.0
    activation_m: float = 0.0
    motion_m: float = 0.0
    motion_m_per_s: float = 0.0
    reading_m: float = 0.0
    reading_Hz: float = 0.0


NOTHING = LoopEffect()


@dataclass(frozen=True, kw_only=True)
class Extension:
    """Effect that a diagnosis adds to an axis model; this base class adds nothing.

    Design and verification use only the ``loop_effect`` of an extension, which each must define.

    kind                name in model.json
    is_fast             whether ``response`` acts within samples: derivatives are then filtered by
                        it as well
    is_prior_in_metres  whether the relations of ``prior`` are in metres
    is_of_recordings    whether the effect belongs to the recordings of the fit, not to the stage;
                        a comparison with other recordings leaves it out
    fitted              names of the fields that hold the numbers of ``free``, each one number
    limits              name in messages, lowest and highest value of fields, which are checked
    std                 standard errors of the numbers of ``free`` from the fit; empty: not fitted
    """

    kind: ClassVar[str] = ""
    is_fast: ClassVar[bool] = False
    is_prior_in_metres: ClassVar[bool] = False
    is_of_recordings: ClassVar[bool] = False
    fitted: ClassVar[tuple[str, ...]] = ()
    limits: ClassVar[Mapping[str, tuple[str, float, float]]] = {}

    std: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        for field_name, (name, low, high) in self.limits.items():
            within(name, getattr(self, field_name), low, high)

    def drive(self, voltage_V: Array, rate_Hz: float) -> Array:  # noqa: ARG002
        """Return the voltage that reaches the ceramic."""
        return voltage_V

    def irreversible(self, part_m: Array, rate_Hz: float) -> Array:  # noqa: ARG002
        """Return the irreversible part of the static displacement with its delay, (samples,)."""
        return part_m

    def response(self, displacement: Array, where: Where) -> Array:  # noqa: ARG002
        """Return the linear response to the output of the hysteresis, at rest before sample 0.

        displacement  (samples,) or (samples, columns)
        """
        return displacement

    def slow_response(self, values: Array, time_s: Array) -> Array:  # noqa: ARG002
        """Return the linear response to values that are linear between some times, at these.

        values  (times, columns)
        time_s  (times,)  rising; at rest before the first
        """
        return values

    def added(self, where: Where) -> Array | float:
        """Return displacement that does not depend on the drive, (samples,) in m, or 0."""
        of_piece = self.added_by_number(where)
        if of_piece is None:
            return 0.0
        first, columns = of_piece
        return np.asarray(columns @ self.free().value[first : first + columns.shape[1]])

    def added_by_number(self, where: Where) -> tuple[int, Array] | None:  # noqa: ARG002
        """Return the derivatives of ``added`` by the numbers of a piece; None if it is constant.

        returned  index of the first number of this piece, and (samples, numbers of this piece)
        """
        return None

    def reading(self, position_m: Array, where: Where) -> Array:  # noqa: ARG002
        """Return the reading of the sensor along positions, (samples,), with or without memory."""
        return position_m

    def group_delay_s(self, rate_Hz: float) -> float:  # noqa: ARG002
        """Return the group delay at low frequency."""
        return 0.0

    def gain(self, where: Where) -> Array | float:  # noqa: ARG002
        """Return the factor of the displacement, (samples,) or one number."""
        return 1.0

    def loop_effect(self, rate_Hz: float) -> LoopEffect:
        """Return the effect on a control loop of this sampling rate, or ``NOTHING``."""
        raise NotImplementedError(self.kind)

    def at_corner(self, slower: float, sharper: float) -> "Extension":  # noqa: ARG002
        """Return the extension at an end of its 95 % interval, for a family of plants.

        slower   +1: longest delay within the interval; -1: shortest
        sharper  +1: least damping of modes within the interval; -1: most
        """
        return self

    def free(self) -> Free:
        """Return the numbers that a fit may change."""
        raise NotImplementedError(self.kind)

    def moved_to(self, value: Array) -> Self:
        """Return the extension with other numbers and no standard errors."""
        numbers = zip(self.fitted, value.tolist(), strict=True)
        return replace(self, **dict(numbers), std=())

    def prior(self) -> Array:
        """Return the rows R of a prior R numbers = 0, (rows, numbers), each with weight 1.

        Without a prior the result is (0, 0), which saves computing the numbers at every step.
        """
        return np.zeros((0, 0))


def within(name: str, value: float, low: float, high: float) -> None:
    """Raise ``ValueError`` if a number is outside [low, high] or not finite."""
    if not low <= value <= high or not np.isfinite(value):
        raise ValueError(f"{name} is {value!r}, expected {low:g} to {high:g}")
