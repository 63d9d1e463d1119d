"""Mains interference in the reading."""

from collections.abc import Sequence
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

HARMONICS = (1, 2, 3, 5)  # odd harmonics of rectifiers, the second of transformers
# With 6 s and 12 knots 30 of 330 nm of hum remained on a simulated stage, with these values 15.
KNOT_DISTANCE_s = 3.0  # of the amplitudes: the phase of the grid is about constant for so long
MAX_KNOTS = 24
ROWS_PER_PERIOD = 2.2  # of a line that is not aliased
MIN_ALIAS = 0.1  # of the sampling rate: motion and aliases below cannot be separated
MIN_DISTANCE = 0.02  # of the sampling rate, between two lines
MAX_AMPLITUDE_m = 1.0
ZERO_WEIGHT = 1e-3  # of amplitude 0 in the prior, relative to equal amplitudes at the next knot


def folded_Hz(frequency_Hz: float, rate_Hz: float) -> float:
    """Return the frequency at which a sampled line appears in the spectrum.

    >>> folded_Hz(60.0, 100.0)
    40.0
    """
    return abs(frequency_Hz - rate_Hz * round(frequency_Hz / rate_Hz))


def visible_harmonics(
    rate_Hz: float, frequency_Hz: float, harmonics: tuple[int, ...] = HARMONICS
) -> tuple[int, ...]:
    """Return the harmonics that appear as separate lines at a sampling rate.

    Lines above half the rate are aliased; no anti-aliasing filter is assumed.

    >>> visible_harmonics(100.0, 60.0), visible_harmonics(100.0, 50.0)
    ((1, 2), (1,))
    """
    visible: dict[int, float] = {}
    for n in harmonics:
        line_Hz = folded_Hz(n * frequency_Hz, rate_Hz)
        is_resolved = rate_Hz > ROWS_PER_PERIOD * n * frequency_Hz
        is_above_motion = line_Hz > MIN_ALIAS * rate_Hz
        is_separate = all(
            abs(line_Hz - other_Hz) > MIN_DISTANCE * rate_Hz for other_Hz in visible.values()
        )
        if is_resolved or (is_above_motion and is_separate):
            visible[n] = line_Hz
    return tuple(visible)


@dataclass(frozen=True, kw_only=True)
class Hum:
    """Mains interference in one piece.

    recording         name of the recording
    first             sample at which the piece begins
    harmonic          (lines,)  multiples of the grid's frequency that are visible at its rate
    cosine_m, sine_m  (lines * knots,)  amplitudes at equidistant instants, line by line
    """

    recording: str
    first: int
    harmonic: tuple[int, ...]
    cosine_m: tuple[float, ...]
    sine_m: tuple[float, ...]

    def __post_init__(self) -> None:
        count = len(self.harmonic)
        if count == 0 or len(self.cosine_m) % count or len(self.cosine_m) != len(self.sine_m):
            raise ValueError(f"{len(self.cosine_m)} amplitudes for {count} lines")
        for amplitude_m in (*self.cosine_m, *self.sine_m):
            within("hum amplitude", amplitude_m, -MAX_AMPLITUDE_m, MAX_AMPLITUDE_m)


@dataclass(frozen=True, kw_only=True)
class MainsLines(Extension):
    """Lines at harmonics of the grid's frequency with varying phases; simulated, not exported.

    frequency_Hz  of the grid
    hums          one for every piece in which a line is visible
    """

    kind: ClassVar[str] = "mains_lines"
    is_prior_in_metres: ClassVar[bool] = True
    is_of_recordings: ClassVar[bool] = True

    frequency_Hz: float
    hums: tuple[Hum, ...]

    def __post_init__(self) -> None:
        within("mains frequency_Hz", self.frequency_Hz, 1.0, 1e4)

    @classmethod
    def of(
        cls, pieces: Sequence[Where], frequency_Hz: float, harmonics: tuple[int, ...] = HARMONICS
    ) -> Self:
        """Return zero amplitudes for every piece in which a line is visible."""
        hums = []
        for piece in pieces:
            visible = visible_harmonics(piece.rate_Hz, frequency_Hz, harmonics)
            if visible:
                knots = min(1 + int(piece.samples / piece.rate_Hz / KNOT_DISTANCE_s), MAX_KNOTS)
                zeros = (0.0,) * (len(visible) * knots)
                hums.append(
                    Hum(
                        recording=piece.recording,
                        first=piece.first,
                        harmonic=visible,
                        cosine_m=zeros,
                        sine_m=zeros,
                    )
                )
        return cls(frequency_Hz=frequency_Hz, hums=tuple(hums))

    def added_by_number(self, where: Where) -> tuple[int, Array] | None:
        """Return the index of the first amplitude of this piece, and a wave for each amplitude."""
        first = 0
        for hum in self.hums:
            if (hum.recording, hum.first) == (where.recording, where.first):
                knots = len(hum.cosine_m) // len(hum.harmonic)
                envelopes = hats(np.linspace(0.0, knots - 1.0, where.samples), knots)
                phase = 2.0 * np.pi * self.frequency_Hz * where.time_s[:, None]
                cosines = [np.cos(n * phase) * envelopes for n in hum.harmonic]
                sines = [np.sin(n * phase) * envelopes for n in hum.harmonic]
                return first, np.hstack(cosines + sines)
            first += 2 * len(hum.cosine_m)
        return None

    def loop_effect(self, rate_Hz: float) -> LoopEffect:  # noqa: ARG002
        """Return the largest hum: a loop converts the error of the reading to motion."""
        largest_m = 0.0
        for hum in self.hums:
            lines = len(hum.harmonic)
            amplitude_m = np.hypot(hum.cosine_m, hum.sine_m).reshape(lines, -1)
            largest_m = max(largest_m, float(amplitude_m.max(axis=1).sum()))
        return LoopEffect(reading_m=largest_m, reading_Hz=self.frequency_Hz)

    def free(self) -> Free:
        """Return all amplitudes."""
        value = [a for hum in self.hums for a in (*hum.cosine_m, *hum.sine_m)]
        return free(value, -MAX_AMPLITUDE_m, MAX_AMPLITUDE_m, 1e-10)

    def moved_to(self, value: Array) -> Self:
        """Return other amplitudes."""
        values, hums = value.tolist(), []
        for hum in self.hums:
            count = len(hum.cosine_m)
            cosine_m, sine_m = tuple(values[:count]), tuple(values[count : 2 * count])
            values = values[2 * count :]
            hums.append(replace(hum, cosine_m=cosine_m, sine_m=sine_m))
        return type(self)(frequency_Hz=self.frequency_Hz, hums=tuple(hums))

    def prior(self) -> Array:
        """Return the differences of amplitudes of neighbouring knots: phases vary slowly.

        The readings do not determine the sine of a line at half the sampling rate; a small weight
        makes its amplitude 0.
        """
        from scipy.linalg import block_diag

        blocks = []
        for hum in self.hums:
            knots = len(hum.cosine_m) // len(hum.harmonic)
            relations = np.vstack([np.diff(np.eye(knots), axis=0), ZERO_WEIGHT * np.eye(knots)])
            blocks += [relations] * (2 * len(hum.harmonic))
        count = sum(2 * len(hum.cosine_m) for hum in self.hums)
        return np.asarray(block_diag(*blocks)).reshape(-1, count)


def hats(position: Array, knots: int) -> Array:
    """Return raised-cosine basis functions centred at 0 .. knots - 1, (samples, knots).

    They sum to 1.

    position  (samples,)  0 to knots - 1, clipped to that range
    """
    distance = np.abs(np.clip(position, 0.0, knots - 1.0)[:, None] - np.arange(knots))
    return np.asarray(np.where(distance < 1.0, 0.5 * (1.0 + np.cos(np.pi * distance)), 0.0))
