"""Sampled linear plants and their families."""

from dataclasses import dataclass, field, fields, replace
from functools import cached_property

import numpy as np

from piezoid.numerics.arrays import Array, freeze
from piezoid.numerics.polynomial import Roots, roots_of
from piezoid.operators.linear import ContinuousSystem, hold_matrices, split_delay


@dataclass(frozen=True, kw_only=True)
class Section:
    """One factor of the analogue chain with unit gain at rest.

        damping None:  w / (s + w);   else  w^2 / (s^2 + 2 zeta w s + w^2),   w = 2 pi f

    frequency_Hz  > 0
    damping       > 0, or None for a first-order lag
    """

    frequency_Hz: float
    damping: float | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Fraction:
    """A sampled plant as B/A in q^-1, from which every margin is computed.

    label             the member's name in tables
    sampling_rate_Hz  > 0
    B, A              from the command to the reading; A monic, b_0 = 0, B includes the delay
    B_position        the same to the position in front of the sensor; empty: equal to B
    """

    label: str
    sampling_rate_Hz: float
    B: Array
    A: Array
    B_position: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        if not len(self.B_position):
            object.__setattr__(self, "B_position", self.B)
        freeze(self, "B", "A", "B_position")

    @property
    def rest_delay_s(self) -> float:
        """Phase delay as the frequency goes to zero, B'(1)/B(1) - A'(1)/A(1)."""
        delays = [float(p @ np.arange(len(p)) / p.sum()) for p in (self.B, self.A)]
        return (delays[0] - delays[1]) * (1.0 / self.sampling_rate_Hz)


@dataclass(frozen=True, kw_only=True, eq=False)
class Plant(Fraction):
    """A sampled plant, in state space and as B/A.

        x[k+1] = A x[k] + sum_j taps[:, j] u[k-j],  y = C x;     A(q^-1) y = B(q^-1) u

    output_unit       ``m`` or ``1``; the input is in volts
    state_matrix      (n, n)
    input_taps        (n, m)  the newest input first; leading zero columns are whole delays
    output_vector     (n,)
    """

    output_unit: str
    state_matrix: Array
    input_taps: Array
    output_vector: Array

    def __post_init__(self) -> None:
        super().__post_init__()
        freeze(self, "state_matrix", "input_taps", ndim=2)
        freeze(self, "output_vector")

    @property
    def gain(self) -> float:
        """Output per volt at rest, B(1)/A(1)."""
        return float(self.B.sum() / self.A.sum())

    @cached_property
    def poles(self) -> Roots:
        """Roots of A in z, without the roots at z = 0."""
        return roots_of(self.A)

    @property
    def delay_samples(self) -> int:
        """Whole samples of delay: leading taps that are zero."""
        return int(np.argmax(np.append(self.input_taps.any(axis=0), True)))

    def with_delay_pole(self, samples: int) -> "Plant":
        """Replace samples of the delay by one pole of the same mean delay, with d - 1 states less.

            q^-d  ->  (1 - p) q^-1 / (1 - p q^-1),   p = 1 - 1/d

        The responses agree at frequencies well below 1/d of the sampling rate.
        """
        if not 1 <= samples <= self.delay_samples:
            raise ValueError(f"{samples} of {self.delay_samples} samples of delay")
        pole = 1.0 - 1.0 / samples
        order = len(self.state_matrix)
        transition = np.zeros((order + 1, order + 1))
        transition[:order, :order] = self.state_matrix
        transition[order, :order] = (1.0 - pole) * self.output_vector
        transition[order, order] = pole
        taps = np.zeros((order + 1, self.input_taps.shape[1] - samples))
        taps[:order] = self.input_taps[:, samples:]
        numerator = [0.0, 1.0 - pole]
        return replace(
            self,
            state_matrix=transition,
            input_taps=taps,
            output_vector=np.append(np.zeros(order), 1.0),
            B=np.convolve(self.B[samples:], numerator),
            A=np.convolve(self.A, [1.0, -pole]),
            B_position=np.convolve(self.B_position[samples:], numerator),
        )

    def realised(self) -> tuple[Array, Array, Array]:
        """Return A, B, C in which past inputs are states, the newest first."""
        return _realised(self.state_matrix, self.input_taps, self.output_vector)


@dataclass(frozen=True, kw_only=True)
class PlantFamily:
    """A nominal plant and its possible variations; the nominal member is first."""

    members: tuple[Plant, ...]

    @property
    def nominal(self) -> Plant:
        """The member from which the controller is computed."""
        return self.members[0]

    @property
    def fractions(self) -> tuple[Fraction, ...]:
        """The members without their state space."""
        names = [entry.name for entry in fields(Fraction)]
        return tuple(
            Fraction(**{name: getattr(member, name) for name in names}) for member in self.members
        )


def sampled_plant(
    label: str,
    system: ContinuousSystem,
    sampling_rate_Hz: float,
    *,
    output_unit: str,
    position_row: Array | None = None,
) -> Plant:
    """Sample a system of one input and one output exactly behind its zero-order hold.

        x[k+1] = A x[k] + sum_j taps[:, j] u[k - j],   y[k] = C x[k]

    A delay of d + f periods (0 <= f < 1) splits each period: its first f has the input
    u[k - d - 1], the remainder u[k - d].

    system        from the command to the reading, without direct term
    position_row  (states,)  the position in front of the sensor; None: it equals the reading
    """
    A, B, output_vector = system.A, system.B[:, 0], system.C[0]
    period_s = 1.0 / sampling_rate_Hz
    delay_samples, remainder_s = split_delay(system.delay_s, period_s)
    state_matrix, _ = hold_matrices(A, B, period_s)
    following, newest = hold_matrices(A, B, period_s - remainder_s)
    columns = [np.zeros(len(B))] * delay_samples + [newest]
    if remainder_s > 0.0:
        columns.append(following @ hold_matrices(A, B, remainder_s)[1])
    input_taps = np.stack(columns, axis=1)
    numerator, denominator = _fraction(state_matrix, input_taps, output_vector)
    position = numerator
    if position_row is not None:
        position, _ = _fraction(state_matrix, input_taps, position_row)
    return Plant(
        label=label,
        sampling_rate_Hz=sampling_rate_Hz,
        output_unit=output_unit,
        state_matrix=state_matrix,
        input_taps=input_taps,
        output_vector=output_vector,
        B=numerator,
        A=denominator,
        B_position=position,
    )


def _realised(A: Array, taps: Array, C: Array) -> tuple[Array, Array, Array]:
    """Return A, B, C of a state-space model with past inputs as states, the newest first.

    returned  (n + m - 1, n + m - 1), (n + m - 1,), (n + m - 1,)
    """
    order, count = taps.shape
    size = order + count - 1
    transition, drive, output = np.zeros((size, size)), np.zeros(size), np.zeros(size)
    transition[:order, :order], transition[:order, order:] = A, taps[:, 1:]
    drive[:order], output[:order] = taps[:, 0], C
    if count > 1:
        drive[order] = 1.0
        transition[order + 1 :, order:-1] = np.eye(count - 2)
    return transition, drive, output


def _fraction(A: Array, taps: Array, C: Array) -> tuple[Array, Array]:
    """Return the transfer function B/A in q^-1; the delay is leading zeros of B.

    A is the characteristic polynomial. B follows from A and the first samples of the impulse
    response.
    """
    order, count = taps.shape
    denominator = np.ascontiguousarray(np.poly(A).real)
    transition, state, output = _realised(A, taps, C)
    impulse = np.zeros(order + count)
    for k in range(1, order + count):
        impulse[k] = output @ state
        state = transition @ state
    return np.convolve(impulse, denominator)[: order + count], denominator
