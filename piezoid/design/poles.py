"""Which poles of a plant a controller moves, and where its search may put them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezoid.design.chain import Section
from piezoid.design.plant import Plant
from piezoid.design.rst import section_poles
from piezoid.numerics.arrays import Array

Poles = NDArray[np.complex128]

_OBSERVER_LEAD = 1.05
"""The observer's share of the fast poles decays this much faster: none is left unobserved."""
_WELL_DAMPED = 0.7
LIGHT = 0.5  # of critical damping: a pair below it rings


@dataclass(frozen=True, kw_only=True, eq=False)
class PoleChoice:
    """The free parameters of an observer design; everything else follows from the plant.

    feedback           the pair (or single lag) that replaces the plant's slowest one
    observer           likewise for the estimation error
    disturbance_Hz     of the disturbance estimate
    mode_damping       least damping that the feedback gives further modes; 0: they stay
    mode_observer_damping  likewise for the estimation error
    """

    feedback: Section
    observer: Section
    disturbance_Hz: float
    mode_damping: float = 0.0
    mode_observer_damping: float = 0.0


def slow_and_fast(plant: Plant) -> tuple[Poles, Poles]:
    """Split a plant's poles into the slowest lag or pair, and the others.

    Slow means small |ln z|; a conjugate pair counts as one.
    """
    poles = plant.poles[np.argsort(np.abs(np.log(plant.poles)), kind="stable")]
    count = 1 if abs(poles[0].imag) < 1e-9 else 2
    return poles[:count], poles[count:]


def light_modes(plant: Plant) -> Poles:
    """Return the lightly damped pairs beside the slowest lag or pair."""
    _, fast = slow_and_fast(plant)
    return fast[_damping(fast) < LIGHT]


def slowest_damping(plant: Plant) -> float:
    """Return the damping of the plant's slowest pair, 1 of a lag."""
    slow, _ = slow_and_fast(plant)
    return float(_damping(slow).min())


def feedback_poles(plant: Plant, choice: PoleChoice) -> Poles:
    """Return the plant's poles with the slowest replaced and further modes damped.

    returned  (n,)
    """
    slow, fast = slow_and_fast(plant)
    replaced = _replacement(choice.feedback, len(slow), plant.sampling_rate_Hz)
    return np.concatenate([replaced, _at_least(fast, choice.mode_damping)])


def observer_poles(plant: Plant, choice: PoleChoice, oscillation_Hz: tuple[float, ...]) -> Poles:
    """Return poles for plant and disturbance states: chosen slow ones, fast ones led by 5 %,
    one for the constant disturbance, a damped pair for each oscillator.

    returned  (n + w,)
    """
    rate_Hz = plant.sampling_rate_Hz
    slow, fast = slow_and_fast(plant)
    parts = [
        _replacement(choice.observer, len(slow), rate_Hz),
        _at_least(fast, choice.mode_observer_damping) * np.abs(fast) ** (_OBSERVER_LEAD - 1.0),
        np.array([np.exp(-2.0 * np.pi * choice.disturbance_Hz / rate_Hz)]),
    ]
    for f in oscillation_Hz:
        pair = Section(frequency_Hz=f, damping=_WELL_DAMPED)
        parts.append(section_poles(pair, rate_Hz))
    return np.concatenate(parts).astype(np.complex128)


def _damping(poles: Poles) -> Array:
    """Return the damping of each pole, -Re ln z / |ln z|; 1 of a real one."""
    s = np.log(poles)
    return np.asarray(-s.real / np.abs(s))


def _at_least(poles: Poles, damping: float) -> Poles:
    """Return poles at the same natural frequencies, lightly damped pairs damped at least so."""
    s = np.log(poles)
    own = _damping(poles)
    light = (own < LIGHT) & (own < damping)
    wanted = np.abs(s) * (-damping + 1j * np.sign(s.imag) * np.sqrt(1.0 - min(damping, 1.0) ** 2))
    return np.asarray(np.where(light, np.exp(wanted), poles))


def _replacement(section: Section, count: int, rate_Hz: float) -> Poles:
    single = section if count == 2 else Section(frequency_Hz=section.frequency_Hz)
    return section_poles(single, rate_Hz)
