"""Pole placement with fixed parts: S u = T r - R y after Landau & Zito 2006."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piezoid.design.plant import Fraction, Plant, Section
from piezoid.errors import DesignError, UnstableLoopError
from piezoid.numerics.arrays import Array, freeze
from piezoid.numerics.polynomial import (
    Roots,
    from_roots,
    product,
    roots_of,
    solve_bezout,
    spectral_radius,
)

Poles = NDArray[np.complex128]

_OBSERVER_LEAD = 1.05  # ratio of decay rates of the observer's fast poles to the plant's
_WELL_DAMPED = 0.7
LIGHT = 0.5  # damping ratio below which a pair is lightly damped
INTEGRATOR = np.array([1.0, -1.0])
OPEN_AT_NYQUIST = np.array([1.0, 1.0])
_RESIDUAL = 1e-10


@dataclass(frozen=True, kw_only=True, eq=False)
class RstController:
    """A controller S u = T r - R y, coefficients in q^-1, S monic."""

    R: Array
    S: Array
    T: Array

    def __post_init__(self) -> None:
        freeze(self, "R", "S", "T")


def place_poles(
    plant: Plant, P: ArrayLike, *, H_R: ArrayLike = (1.0,), H_S: ArrayLike = (1.0, -1.0)
) -> RstController:
    """Place the closed-loop polynomial P with fixed parts in R and S.

        A H_S S' + B H_R R' = P,   S = H_S S',   R = H_R R',   T = R(1)

    P    monic, stable
    H_R  what R must contain, for example 1 + q^-1: no gain at Nyquist
    H_S  what S must contain; 1 - q^-1 is an integrator

    Raises ``DesignError`` if the fixed parts cancel the plant's poles or zeros, or if the residual
    of the equation exceeds 1e-10, and ``UnstableLoopError`` for an unstable P.
    """
    radius = spectral_radius(np.asarray(P))
    if radius >= 1.0:
        raise UnstableLoopError(
            f"the desired polynomial P has a root of magnitude {radius:.9g}",
            needed="every root inside the unit circle",
            remedy="Ask for faster or fewer poles: many slow ones together cannot be resolved.",
        )
    solution = solve_bezout(product(plant.A, H_S), product(plant.B, H_R), P)
    if not solution.residual <= _RESIDUAL:
        raise DesignError(
            f"the Bezout equation of '{plant.label}' leaves a residual of {solution.residual:.1e}",
            needed=f"at most {_RESIDUAL:g} of the largest coefficient of P",
            remedy="Reduce the model's order or remove fixed parts: roots nearly cancel.",
            residual=solution.residual,
            condition=solution.condition,
        )
    R, S = product(H_R, solution.R), product(H_S, solution.S)
    return RstController(R=R, S=S / S[0], T=np.array([R.sum()]))


def section_poles(section: Section, sampling_rate_Hz: float) -> Roots:
    """Return a section's poles mapped by exp(s Ts); damping above one gives two real ones."""
    w = 2.0 * np.pi * section.frequency_Hz
    if section.damping is None:
        return np.array([np.exp(-w / sampling_rate_Hz)], dtype=np.complex128)
    root = np.sqrt(complex(section.damping**2 - 1.0))
    s = w * np.array([-section.damping + root, -section.damping - root])
    return np.asarray(np.exp(s / sampling_rate_Hz))


def closed_loop_target(
    dominant: Section, sampling_rate_Hz: float, *, auxiliary_root: float, auxiliary_count: int
) -> Array:
    """Return P = P_D P_F: a dominant pair, and (1 - alpha q^-1)^n for the free degrees."""
    auxiliary = from_roots(np.full(auxiliary_count, auxiliary_root)) if auxiliary_count else [1.0]
    return product(from_roots(section_poles(dominant, sampling_rate_Hz)), auxiliary)


def slow_and_fast(plant: Plant) -> tuple[Poles, Poles]:
    """Split a plant's poles into the slowest lag or pair, of smallest |ln z|, and all others."""
    poles = plant.poles[np.argsort(np.abs(np.log(plant.poles)), kind="stable")]
    count = 1 if abs(poles[0].imag) < 1e-9 else 2
    return poles[:count], poles[count:]


@dataclass(frozen=True, kw_only=True)
class Mode:
    """A lightly damped mode: natural frequency, and damping ratio below ``LIGHT``."""

    frequency_Hz: float
    damping: float


def ringing_mode(plant: Fraction) -> Mode | None:
    """Return the lowest resonance of the plant, or None if it has no lightly damped mode."""
    s = np.log(roots_of(plant.A)) * plant.sampling_rate_Hz
    light = s[(s.imag > 0.0) & (-s.real < LIGHT * np.abs(s))]
    if not len(light):
        return None
    lowest = light[np.argmin(np.abs(light))]
    natural = float(np.abs(lowest))
    return Mode(frequency_Hz=natural / (2.0 * np.pi), damping=float(-lowest.real) / natural)


def feedback_poles(plant: Plant, slowest: Section, *, mode_damping: float = 0.0) -> Poles:
    """Return the plant's poles with the slowest lag or pair replaced and higher modes damped.

    mode_damping  smallest damping ratio of the higher modes; 0: they stay
    returned      (n,)
    """
    slow, fast = slow_and_fast(plant)
    replacement = _slow_poles(slowest, len(slow), plant.sampling_rate_Hz)
    return np.concatenate([replacement, _with_min_damping(fast, mode_damping)])


def observer_poles(
    plant: Plant,
    slowest: Section,
    disturbance_Hz: float,
    oscillation_Hz: tuple[float, ...],
    *,
    mode_damping: float = 0.0,
) -> Poles:
    """Return poles of the estimation error, for plant and disturbance states.

    The slowest lag or pair is replaced, fast poles decay 5 % faster than the plant's. One pole
    belongs to the constant disturbance, a damped pair to each oscillator.

    mode_damping  smallest damping ratio of the higher modes; 0: they stay
    returned      (n + w,)
    """
    rate_Hz = plant.sampling_rate_Hz
    slow, fast = slow_and_fast(plant)
    pairs = (
        section_poles(Section(frequency_Hz=f, damping=_WELL_DAMPED), rate_Hz)
        for f in oscillation_Hz
    )
    parts = (
        _slow_poles(slowest, len(slow), rate_Hz),
        _with_min_damping(fast, mode_damping) * np.abs(fast) ** (_OBSERVER_LEAD - 1.0),
        np.array([np.exp(-2.0 * np.pi * disturbance_Hz / rate_Hz)]),
        *pairs,
    )
    return np.concatenate(parts).astype(np.complex128)


def damping_ratios(poles: Poles) -> Array:
    """Return the damping ratio of each pole, -Re ln z / |ln z|; 1 for real poles."""
    s = np.log(poles)
    return np.asarray(-s.real / np.abs(s))


def _with_min_damping(poles: Poles, damping: float) -> Poles:
    """Raise the damping ratio of lightly damped pairs to a minimum, at the same frequency."""
    s = np.log(poles)
    current = damping_ratios(poles)
    light = (current < LIGHT) & (current < damping)
    s_damped = np.abs(s) * (
        -damping + 1j * np.sign(s.imag) * np.sqrt(1.0 - min(damping, 1.0) ** 2)
    )
    return np.asarray(np.where(light, np.exp(s_damped), poles))


def _slow_poles(section: Section, count: int, rate_Hz: float) -> Poles:
    """Return the poles of a section, or of a lag at its frequency if one pole is needed."""
    needed = section if count == 2 else Section(frequency_Hz=section.frequency_Hz)
    return section_poles(needed, rate_Hz)
