"""A chain with gain, slowest mode, damping and delay changed: the families of the examples."""

from dataclasses import replace

from piezoid.design.plant import Chain


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
