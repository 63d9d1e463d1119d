"""Periodic sensor error over the displacement."""

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from piezoid.identification.extensions.extension import (
    Extension,
    Free,
    LoopEffect,
    Where,
    free,
    within,
)
from piezoid.numerics.arrays import Array

MAX_PHASE = 4.0 * np.pi  # rad
PHASE_WEIGHT = 1e-3  # of the prior, per rad
MAX_STEEPNESS = 1.3 / (2.0 * np.pi)  # wavelengths: above 1 / 2 pi a reading is not unique


@dataclass(frozen=True, kw_only=True)
class Phase:
    """Phase of a periodic error in one recording, before which a counter may have been reset.

    angle  rad, of the first order
    """

    recording: str
    angle: float

    def __post_init__(self) -> None:
        within("phase", self.angle, -MAX_PHASE, MAX_PHASE)


@dataclass(frozen=True, kw_only=True)
class PeriodicError(Extension):
    """Periodic error of the sensor, of first and higher orders.

        y = x + sum_n a_n cos n t + b_n sin n t,    t = 2 pi x / wavelength + phase

    wavelength_m     m, > 0
    cosine_m, sine_m (orders,)  m                                     [Heydemann 1981]
    phases           of recordings; the phase of other recordings is 0
    """

    kind: ClassVar[str] = "periodic_error"

    wavelength_m: float
    cosine_m: tuple[float, ...]
    sine_m: tuple[float, ...]
    phases: tuple[Phase, ...] = ()

    def __post_init__(self) -> None:
        within("wavelength_m", self.wavelength_m, 1e-12, 1.0)
        if len(self.cosine_m) != len(self.sine_m) or not self.cosine_m:
            raise ValueError(f"{len(self.cosine_m)} cosines, {len(self.sine_m)} sines")
        steepness_m = float(_orders(self.cosine_m) @ self.amplitude_m)
        within("steepness", steepness_m, 0.0, MAX_STEEPNESS * self.wavelength_m)

    @property
    def amplitude_m(self) -> Array:
        """Amplitudes of all orders, (orders,)."""
        return np.hypot(self.cosine_m, self.sine_m)

    def reading(self, position_m: Array, where: Where) -> Array:
        """Return the reading of the sensor at a position."""
        angle = sum(entry.angle for entry in self.phases if entry.recording == where.recording)
        phase = 2.0 * np.pi / self.wavelength_m * position_m + angle
        # The sum of a cos(n t) + b sin(n t) is the real part of that of (a - i b) exp(i t)^n.
        amplitude_m = np.array(self.cosine_m) - 1j * np.array(self.sine_m)
        wave = np.polyval([*amplitude_m[::-1], 0.0], np.exp(1j * phase))
        return np.asarray(position_m + wave.real)

    def loop_effect(self, rate_Hz: float) -> LoopEffect:  # noqa: ARG002
        """Return the largest error: a loop converts the error of the reading to motion."""
        return LoopEffect(reading_m=float(self.amplitude_m.sum()))

    def free(self) -> Free:
        """Return wavelength, amplitudes and phases, with a bound for each amplitude alone."""
        angles = [phase.angle for phase in self.phases]
        value = (self.wavelength_m, *self.cosine_m, *self.sine_m, *angles)
        bound_m = MAX_STEEPNESS * self.wavelength_m / np.tile(_orders(self.cosine_m), 2)
        max_phases = [MAX_PHASE] * len(angles)
        lower = (0.99 * self.wavelength_m, *-bound_m, *np.negative(max_phases))
        upper = (1.01 * self.wavelength_m, *bound_m, *max_phases)
        steps_m = [1e-5 * self.wavelength_m] * len(bound_m)
        steps = (1e-6 * self.wavelength_m, *steps_m, *[1e-5] * len(angles))
        return free(value, lower, upper, steps)

    def moved_to(self, value: Array) -> Self:
        """Return other numbers, with amplitudes reduced to the largest allowed steepness."""
        wavelength_m, stop = float(value[0]), 1 + 2 * len(self.cosine_m)
        amplitudes_m = value[1:stop].reshape(2, -1)
        steepness_m = float(_orders(self.cosine_m) @ np.hypot(*amplitudes_m))
        allowed_m = (1.0 - 1e-12) * MAX_STEEPNESS * wavelength_m
        cosine_m, sine_m = amplitudes_m * min(1.0, allowed_m / max(steepness_m, 1e-300))
        return type(self)(
            wavelength_m=wavelength_m,
            cosine_m=tuple(cosine_m.tolist()),
            sine_m=tuple(sine_m.tolist()),
            phases=tuple(
                replace(phase, angle=angle)
                for phase, angle in zip(self.phases, value[stop:].tolist(), strict=True)
            ),
        )

    def prior(self) -> Array:
        """Return the phases with a small weight: a recording within one period has none."""
        first = 1 + 2 * len(self.cosine_m)
        return PHASE_WEIGHT * np.eye(first + len(self.phases))[first:]


def _orders(amplitude_m: tuple[float, ...]) -> Array:
    return np.arange(1.0, len(amplitude_m) + 1.0)
