"""Physical description of a plant, section by section, and its sampling."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from piezoid.design.plant import Plant, PlantFamily
from piezoid.numerics.arrays import Array
from piezoid.numerics.zero_order_hold import fraction, sample

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


def plant_from_chain(chain: Chain) -> Plant:
    """Sample a chain behind its zero-order hold.

    A first-order section whose sampled pole exp(-2 pi f / fs) is below the precision of float64
    (f > 5.7 fs) is instantaneous at this rate and leaves no state.
    """
    rate_Hz = chain.sampling_rate_Hz
    slow = [section for section in chain.sections if not _is_instantaneous(section, rate_Hz)]
    if not slow:
        raise ValueError(f"{chain.label}: no section is slow enough to have a state")
    A, B, outputs = cascade(slow)
    C = np.eye(len(A))[outputs[-1]]
    system = sample(A, chain.gain * B, C, 1.0 / rate_Hz, chain.delay_s)
    numerator, denominator = fraction(system)
    return Plant(
        label=chain.label,
        sampling_rate_Hz=rate_Hz,
        output_unit=chain.output_unit,
        state_matrix=system.A,
        input_taps=system.taps,
        output_vector=system.C,
        B=numerator,
        A=denominator,
    )


def family_from_chains(nominal: Chain, variations: Sequence[Chain]) -> PlantFamily:
    """Sample a nominal chain and its variations."""
    return PlantFamily(members=tuple(plant_from_chain(c) for c in (nominal, *variations)))


def cascade(sections: Sequence[Section]) -> tuple[Array, Array, list[int]]:
    """Return A and B of sections of unit gain one behind the other, and the output state of each.

    A first-order section is one state; one with damping two, of which the first is its output.
    """
    orders = [1 if section.damping is None else 2 for section in sections]
    A, B = np.zeros((sum(orders), sum(orders))), np.zeros(sum(orders))
    outputs: list[int] = []
    index = 0
    for section, order in zip(sections, orders, strict=True):
        w = 2.0 * np.pi * section.frequency_Hz
        driven = index + order - 1
        if section.damping is None:
            A[index, index] = -w
        else:
            A[index, driven] = w
            A[driven, index], A[driven, driven] = -w, -2.0 * section.damping * w
        if outputs:
            A[driven, outputs[-1]] = w
        else:
            B[driven] = w
        outputs.append(index)
        index += order
    return A, B, outputs


def _is_instantaneous(section: Section, rate_Hz: float) -> bool:
    decay = np.exp(-2.0 * np.pi * section.frequency_Hz / rate_Hz)
    return section.damping is None and bool(decay < _INSTANTANEOUS)
