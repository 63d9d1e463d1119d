"""What identified dynamics add to a chain of declared poles: the main mode, and the delay left.

The chain keeps the mode that carries the motion, if the data resolve one. All else is summed up
where it matters to a loop: the delay makes the chain's phase that of the dynamics at a third of
the mode, or of the band, and what then differs in gain widens the family.
"""

from dataclasses import dataclass, replace

import numpy as np

from piezoid.design.chain import Chain, Section
from piezoid.identification.dynamics.confidence import resolved_modes
from piezoid.identification.dynamics.modal import LinearDynamics

MAIN_SHARE = 0.5  # of the gain at rest: a mode with less is not in series with the motion
_BELOW = 3.0  # phases are compared at this part of the mode or of the band


@dataclass(frozen=True, kw_only=True)
class MeasuredChain:
    """A chain that answers as the dynamics do.

    chain       with the main mode and the delay
    mode_half   half the relative 95 % interval of the main mode's frequency, 0 without one
    gain_ratio  magnitude of the dynamics over the chain's where phases were compared
    """

    chain: Chain
    mode_half: float
    gain_ratio: float


def measured_chain(declared: Chain, dynamics: LinearDynamics) -> MeasuredChain:
    """Return the declared chain with the main mode and delay of identified dynamics.

    declared  poles the laboratory declared, with the gain of the axis
    dynamics  of one path, from the hysteresis' output to the displacement
    """
    place = main_mode(dynamics)
    low_Hz, high_Hz = dynamics.band_Hz
    if place is None:
        chain, half, highest_Hz = declared, 0.0, high_Hz
    else:
        frequency_Hz = float(dynamics.mode_frequency_Hz[place])
        mode = Section(frequency_Hz=frequency_Hz, damping=float(dynamics.mode_damping[place]))
        chain = replace(declared, sections=(*declared.sections, mode))
        low_end_Hz, high_end_Hz = dynamics.mode_frequency_interval_Hz()[place]
        half, highest_Hz = float(0.5 * (high_end_Hz - low_end_Hz) / frequency_Hz), frequency_Hz
    at_Hz = max(highest_Hz / _BELOW, low_Hz)
    ratio = complex(dynamics.response([at_Hz])[0, 0, 0] / response_of(chain, at_Hz))
    delay_s = -float(np.angle(ratio)) / (2.0 * np.pi * at_Hz)
    return MeasuredChain(
        chain=replace(chain, delay_s=max(delay_s, 0.0)), mode_half=half, gain_ratio=abs(ratio)
    )


def main_mode(dynamics: LinearDynamics) -> int | None:
    """Return the number of the resolved mode that carries the motion, or None.

    A mode just above the last coherent line counts: its flank determines it, and a loop designed
    without it is not safe.
    """
    share = np.abs(dynamics.mode_gain_m_per_V[:, 0, 0] / dynamics.static_gain_m_per_V[0, 0])
    fit = resolved_modes(dynamics) & (share >= MAIN_SHARE)
    return int(np.where(fit, share, -1.0).argmax()) if fit.any() else None


def response_of(chain: Chain, frequency_Hz: float) -> complex:
    """Return the continuous response of a chain at one frequency, output unit per volt."""
    s = 2j * np.pi * frequency_Hz
    response = complex(chain.gain * np.exp(-s * chain.delay_s))
    for section in chain.sections:
        w = 2.0 * np.pi * section.frequency_Hz
        damping = section.damping
        response *= w / (s + w) if damping is None else w**2 / (s**2 + 2 * damping * w * s + w**2)
    return response
