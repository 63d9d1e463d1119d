"""What is controlled: a sampled linear plant, built from physical numbers, and its family."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from piezoid.numerics.arrays import Array, frozen
from piezoid.numerics.polynomial import spectral_radius, trimmed
from piezoid.numerics.zero_order_hold import SampledSystem, fraction, realised, sample

_INSTANTANEOUS = float(np.finfo(np.float64).eps)


@dataclass(frozen=True, kw_only=True)
class Section:
    """One factor of the analogue chain with unit gain at rest.

        damping None:  w / (s + w);   else  w^2 / (s^2 + 2 zeta w s + w^2),   w = 2 pi f

    frequency_Hz  > 0
    damping       > 0, or None for a first-order lag
    """

    frequency_Hz: float
    damping: float | None = None

    def __post_init__(self) -> None:
        if not self.frequency_Hz > 0 or (self.damping is not None and not self.damping > 0):
            raise ValueError(f"a section needs a positive frequency and damping, found {self}")


@dataclass(frozen=True, kw_only=True)
class Chain:
    """The physical description of a plant: command voltage in, displacement (or neper) out.

    label             the member's name in tables
    sampling_rate_Hz  > 0
    gain              output unit per volt, at rest
    output_unit       ``m``, or ``1`` for the logarithm of a tunnelling current
    sections          amplifier, mechanics, sensor, ... in the order of the signal
    delay_s           >= 0, of converters and computation; need not be whole samples
    """

    label: str
    sampling_rate_Hz: float
    gain: float
    output_unit: str
    sections: tuple[Section, ...]
    delay_s: float = 0.0


class Fraction(Protocol):
    """What a margin is computed from: B/A in q^-1 at a rate, and a name."""

    @property
    def label(self) -> str:
        """The member's name in tables."""

    @property
    def sampling_rate_Hz(self) -> float:
        """Samples per second."""

    @property
    def B(self) -> Array:
        """Numerator, the delay as leading zeros."""

    @property
    def A(self) -> Array:
        """Denominator, monic."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Plant:
    """A sampled plant in state space and as B/A, both of the same thing.

        x[k+1] = A x[k] + sum_j taps[:, j] u[k-j],  y = C x;     A(q^-1) y = B(q^-1) u

    label             the member's name in tables
    sampling_rate_Hz  > 0
    output_unit       ``m`` or ``1``; the input is in volts
    state_matrix      (n, n)
    input_taps        (n, m)  the newest input first; leading zero columns are whole delays
    output_vector     (n,)
    B, A              coefficients in q^-1; A monic, b_0 = 0, the delay stands in B
    """

    label: str
    sampling_rate_Hz: float
    output_unit: str
    state_matrix: Array
    input_taps: Array
    output_vector: Array
    B: Array
    A: Array

    def __post_init__(self) -> None:
        for name, axes in (("state_matrix", 2), ("input_taps", 2), ("output_vector", 1)):
            object.__setattr__(self, name, frozen(getattr(self, name), name, ndim=axes))
        for name in ("B", "A"):
            object.__setattr__(self, name, frozen(getattr(self, name), name))
        if not self.sampling_rate_Hz > 0:
            raise ValueError(f"sampling_rate_Hz is {self.sampling_rate_Hz}, expected > 0")
        if self.B[0] != 0.0 or self.A[0] != 1.0:
            raise ValueError(
                f"B[0] is {self.B[0]} and A[0] is {self.A[0]}, expected 0 and 1: a sampled plant "
                "answers one sample late. Was B given in powers of z, or without its delay?"
            )

    @property
    def gain(self) -> float:
        """Output per volt at rest, B(1)/A(1)."""
        return float(self.B.sum() / self.A.sum())

    @property
    def period_s(self) -> float:
        """The sampling period."""
        return 1.0 / self.sampling_rate_Hz

    @property
    def system(self) -> SampledSystem:
        """The state space with its taps."""
        return SampledSystem(A=self.state_matrix, taps=self.input_taps, C=self.output_vector)

    @property
    def is_stable(self) -> bool:
        """Whether every pole is inside the unit circle."""
        return spectral_radius(self.A) < 1.0

    def realised(self) -> tuple[Array, Array, Array]:
        """Return A, B, C in which past inputs are states."""
        return realised(self.system)


@dataclass(frozen=True, kw_only=True)
class PlantFamily:
    """A nominal plant and what it may really be; the nominal member is first."""

    members: tuple[Plant, ...]

    def __post_init__(self) -> None:
        if not self.members:
            raise ValueError("a family has at least its nominal member")
        rates = {member.sampling_rate_Hz for member in self.members}
        units = {member.output_unit for member in self.members}
        if len(rates) != 1 or len(units) != 1:
            raise ValueError(f"members differ in rate {sorted(rates)} or unit {sorted(units)}")

    @property
    def nominal(self) -> Plant:
        """The member the controller is computed from."""
        return self.members[0]


def plant_from_chain(chain: Chain) -> Plant:
    """Sample a chain behind its zero-order hold.

    A first-order section whose sampled pole exp(-2 pi f / fs) is below the precision of float64
    (f > 5.7 fs) is instantaneous at this rate and leaves no state.
    """
    A, B, C = _continuous(chain)
    system = sample(A, B, C, 1.0 / chain.sampling_rate_Hz, chain.delay_s)
    return _plant(chain.label, chain.sampling_rate_Hz, chain.output_unit, system)


def plant_from_fraction(
    label: str, B: ArrayLike, A: ArrayLike, *, sampling_rate_Hz: float, output_unit: str
) -> Plant:
    """Realise B(q^-1)/A(q^-1) in observer form; coefficients of B beyond deg A become taps.

    B  leading zeros are the delay, b_0 = 0        A  monic, degree >= 1
    """
    b, a = trimmed(B), trimmed(A)
    order = len(a) - 1
    matrix = np.zeros((order, order))
    matrix[:, 0] = -a[1:]
    matrix[:-1, 1:] = np.eye(order - 1)
    output = np.eye(order)[0]
    taps = np.zeros((order, max(len(b) - 1 - order, 0) + 1))
    head = b[1 : order + 1]
    taps[: len(head), 0] = head
    for late, value in enumerate(b[order + 1 :], start=1):
        taps[-1, late] = value
    return Plant(
        label=label,
        sampling_rate_Hz=sampling_rate_Hz,
        output_unit=output_unit,
        state_matrix=matrix,
        input_taps=taps,
        output_vector=output,
        B=b,
        A=a,
    )


def family_from_chains(nominal: Chain, variations: Sequence[Chain]) -> PlantFamily:
    """Sample a nominal chain and its variations."""
    return PlantFamily(members=tuple(plant_from_chain(c) for c in (nominal, *variations)))


def varied(
    chain: Chain,
    *,
    gain_factor: float = 1.0,
    mode_factor: float = 1.0,
    damping_factor: float = 1.0,
    delay_s: float = 0.0,
) -> Chain:
    """Return the chain with its gain and the slowest section's frequency and damping multiplied,
    and a delay added; the label says what was changed.

    The slowest section is the mechanics of a piezo stage: what load and mounting change.
    """
    slowest = min(range(len(chain.sections)), key=lambda k: chain.sections[k].frequency_Hz)
    section = chain.sections[slowest]
    damping = None if section.damping is None else section.damping * damping_factor
    changed = replace(section, frequency_Hz=section.frequency_Hz * mode_factor, damping=damping)
    sections = (*chain.sections[:slowest], changed, *chain.sections[slowest + 1 :])
    factors = (("gain", gain_factor), ("mode", mode_factor), ("damping", damping_factor))
    said = [f"{name} x{factor:g}" for name, factor in factors if factor != 1.0]
    said += [f"delay +{delay_s * 1e6:g} us"] if delay_s else []
    return replace(
        chain,
        label=", ".join(said) or chain.label,
        gain=chain.gain * gain_factor,
        sections=sections,
        delay_s=chain.delay_s + delay_s,
    )


def _plant(label: str, rate_Hz: float, unit: str, system: SampledSystem) -> Plant:
    B, A = fraction(system)
    return Plant(
        label=label,
        sampling_rate_Hz=rate_Hz,
        output_unit=unit,
        state_matrix=system.A,
        input_taps=system.taps,
        output_vector=system.C,
        B=B,
        A=A,
    )


def _continuous(chain: Chain) -> tuple[Array, Array, Array]:
    """Return the chain in state space: each section drives the next, the gain is at the input."""
    kept = [s for s in chain.sections if not _is_instantaneous(s, chain.sampling_rate_Hz)]
    orders = [1 if section.damping is None else 2 for section in kept]
    size = sum(orders)
    if size == 0:
        raise ValueError(f"{chain.label}: no section is slow enough to have a state")
    A, B, C = np.zeros((size, size)), np.zeros(size), np.zeros(size)
    first = np.concatenate([[0], np.cumsum(orders)[:-1]]).astype(int)
    for k, (section, place) in enumerate(zip(kept, first.tolist(), strict=True)):
        w = 2.0 * np.pi * section.frequency_Hz
        last = place + orders[k] - 1
        if section.damping is None:
            A[place, place] = -w
        else:
            A[place, last] = w
            A[last, place], A[last, last] = -w, -2.0 * section.damping * w
        if k == 0:
            B[last] = w * chain.gain
        else:
            A[last, first[k - 1]] = w
    C[first[-1]] = 1.0
    return A, B, C


def _is_instantaneous(section: Section, rate_Hz: float) -> bool:
    decay = np.exp(-2.0 * np.pi * section.frequency_Hz / rate_Hz)
    return section.damping is None and bool(decay < _INSTANTANEOUS)
