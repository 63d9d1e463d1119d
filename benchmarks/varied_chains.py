"""Plants of sections in series, and variations of gain, slowest mode, damping or delay."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.design.plant import Plant, PlantFamily, Section, sampled_plant
from piezoid.operators.linear import cascade, first_order, resonance


@dataclass(frozen=True, kw_only=True)
class Chain:
    """Sections in series with a delay, from volts to metres or nepers.

    gain  static gain, output unit per volt
    """

    label: str
    sampling_rate_Hz: float
    gain: float
    output_unit: str
    sections: tuple[Section, ...]
    delay_s: float = 0.0


def plant_from_chain(chain: Chain) -> Plant:
    """Sample a chain without the first-order sections whose sampled pole is below 2^-52."""
    systems = [
        first_order(f) if damping is None else resonance(f, damping)
        for f, damping in ((s.frequency_Hz, s.damping) for s in chain.sections)
        if damping is not None or np.exp(-2.0 * np.pi * f / chain.sampling_rate_Hz) >= 2.0**-52
    ]
    system = cascade(*systems)
    return sampled_plant(
        chain.label,
        replace(system, B=chain.gain * system.B, delay_s=chain.delay_s),
        chain.sampling_rate_Hz,
        output_unit=chain.output_unit,
    )


def family_from_chains(nominal: Chain, variations: Sequence[Chain]) -> PlantFamily:
    """Sample a nominal chain and its variations."""
    return PlantFamily(members=tuple(map(plant_from_chain, (nominal, *variations))))


def varied(
    chain: Chain,
    *,
    gain_factor: float = 1.0,
    mode_factor: float = 1.0,
    damping_factor: float = 1.0,
    delay_s: float = 0.0,
) -> Chain:
    """Return a variation of a chain, whose label states the changes.

    mode_factor and damping_factor apply to the slowest section, which is the mechanics of a piezo
    stage. Load and mounting change it.
    """
    slowest = min(range(len(chain.sections)), key=lambda k: chain.sections[k].frequency_Hz)
    section = chain.sections[slowest]
    damping = None if section.damping is None else section.damping * damping_factor
    changed = replace(section, frequency_Hz=section.frequency_Hz * mode_factor, damping=damping)
    sections = (*chain.sections[:slowest], changed, *chain.sections[slowest + 1 :])
    factors = (("gain", gain_factor), ("mode", mode_factor), ("damping", damping_factor))
    changes = [f"{name} x{factor:g}" for name, factor in factors if factor != 1.0]
    changes += [f"delay +{delay_s * 1e6:g} us"] if delay_s else []
    return replace(
        chain,
        label=", ".join(changes) or chain.label,
        gain=chain.gain * gain_factor,
        sections=sections,
        delay_s=chain.delay_s + delay_s,
    )
