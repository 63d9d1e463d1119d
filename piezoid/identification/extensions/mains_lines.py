"""Mains interference in the reading."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from piezoid.identification.extensions.extension import Extension, Free, Where, free, within
from piezoid.identification.extensions.loop_effect import LoopEffect
from piezoid.numerics.arrays import Array

HARMONICS = (1, 2, 3, 5)  # of rectifiers the odd ones, of transformers the second
# With 6 s and 12 knots a stage of the laboratory kept 30 of 330 nm of hum, with these 15.
WANDER_s = 3.0  # how long the grid keeps a phase
MOST_KNOTS = 24
ROWS_PER_PERIOD = 2.2  # of a line that is not folded
FOLDED = 0.1  # of the sampling rate: below it motion and a folded line look alike
APART = 0.02  # of the sampling rate, between two lines
LOUDEST_m = 1.0
SILENT = 1e-3  # weight of no hum, relative to that of the same hum at the next knot


def folded_Hz(frequency_Hz: float, rate_Hz: float) -> float:
    """Return where a line appears in the spectrum of readings at a rate.

    >>> folded_Hz(60.0, 100.0)
    40.0
    """
    return abs(frequency_Hz - rate_Hz * round(frequency_Hz / rate_Hz))


def visible_harmonics(
    rate_Hz: float, frequency_Hz: float, harmonics: tuple[int, ...] = HARMONICS
) -> tuple[int, ...]:
    """Return the harmonics that readings at a rate show as lines of their own.

    Lines above half the rate are folded; no filter against that is assumed.

    >>> visible_harmonics(100.0, 60.0), visible_harmonics(100.0, 50.0)
    ((1, 2), (1,))
    """
    visible: dict[int, float] = {}
    for n in harmonics:
        line_Hz = folded_Hz(n * frequency_Hz, rate_Hz)
        is_plain = rate_Hz > ROWS_PER_PERIOD * n * frequency_Hz
        is_told = line_Hz > FOLDED * rate_Hz
        is_apart = all(abs(line_Hz - other) > APART * rate_Hz for other in visible.values())
        if is_plain or (is_told and is_apart):
            visible[n] = line_Hz
    return tuple(visible)


@dataclass(frozen=True, kw_only=True)
class Hum:
    """The hum of one piece.

    recording       its name
    first           sample at which the piece begins
    harmonic        (lines,)  multiples of the grid's frequency its rate can show
    cosine_m, sine_m  (lines * knots,)  amplitudes at even instants, line by line
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
            within("hum amplitude", amplitude_m, -LOUDEST_m, LOUDEST_m)

    @property
    def amplitude_m(self) -> float:
        """Rms over the knots of the amplitude of the first line."""
        knots = len(self.cosine_m) // len(self.harmonic)
        first = np.hypot(self.cosine_m[:knots], self.sine_m[:knots])
        return float(np.sqrt(np.mean(first**2)))


@dataclass(frozen=True, kw_only=True)
class MainsLines(Extension):
    """Lines at the grid's frequency with phases that wander; simulated, not shipped.

    frequency_Hz  of the grid
    hums          one for every piece
    """

    kind: ClassVar[str] = "mains_lines"
    in_metres: ClassVar[bool] = True

    frequency_Hz: float
    hums: tuple[Hum, ...]

    def __post_init__(self) -> None:
        within("mains frequency_Hz", self.frequency_Hz, 1.0, 1e4)

    @classmethod
    def of(
        cls, pieces: Sequence[Where], frequency_Hz: float, harmonics: tuple[int, ...] = HARMONICS
    ) -> Self:
        """Return zero amplitudes for every piece whose rate shows a line."""
        hums: list[Hum] = []
        for piece in pieces:
            audible = visible_harmonics(piece.rate_Hz, frequency_Hz, harmonics)
        hums = []
        for piece in pieces:
            audible = visible_harmonics(piece.rate_Hz, frequency_Hz, harmonics)
            if audible:
                knots = min(1 + int(piece.samples / piece.rate_Hz / WANDER_s), MOST_KNOTS)
                silent = (0.0,) * (len(audible) * knots)
                hums.append(
                    Hum(
                        recording=piece.recording,
                        first=piece.first,
                        harmonic=audible,
                        cosine_m=silent,
                        sine_m=silent,
                    )
                )
        return cls(frequency_Hz=frequency_Hz, hums=tuple(hums))

    def added_by_number(self, where: Where) -> tuple[int, Array] | None:
        """Return the index of this piece's first amplitude, and cosines and sines under hats."""
        first = 0
        for hum in self.hums:
            if (hum.recording, hum.first) == (where.recording, where.first):
                return first, self._waves(hum, where)
            first += 2 * len(hum.cosine_m)
        return None

    def _waves(self, hum: Hum, where: Where) -> Array:
        knots = len(hum.cosine_m) // len(hum.harmonic)
        position = np.linspace(0.0, knots - 1.0, where.samples)
        under = hats(position, knots)
        turn = 2.0 * np.pi * self.frequency_Hz * where.time_s[:, None]
        parts = [np.cos(n * turn) * under for n in hum.harmonic]
        return np.hstack(parts + [np.sin(n * turn) * under for n in hum.harmonic])

    def loop_effect(self, rate_Hz: float) -> LoopEffect:  # noqa: ARG002
        """Return the largest hum: the sensor measures it, so a loop moves the stage by it."""
        loudest_m = 0.0
        for hum in self.hums:
            lines = len(hum.harmonic)
            amplitude_m = np.hypot(hum.cosine_m, hum.sine_m).reshape(lines, -1)
            loudest_m = max(loudest_m, float(amplitude_m.max(axis=1).sum()))
        return LoopEffect(reading_m=loudest_m, reading_Hz=self.frequency_Hz)

    def free(self) -> Free:
        """Return all amplitudes."""
        value = [a for hum in self.hums for a in (*hum.cosine_m, *hum.sine_m)]
        return free(value, -LOUDEST_m, LOUDEST_m, 1e-10)

    def moved_to(self, value: Array) -> Self:
        """Return other amplitudes."""
        values, hums = value.tolist(), []
        for hum in self.hums:
            count = len(hum.cosine_m)
            cosine_m, sine_m = tuple(values[:count]), tuple(values[count : 2 * count])
            values = values[2 * count :]
            hums.append(
                Hum(
                    recording=hum.recording,
                    first=hum.first,
                    harmonic=hum.harmonic,
                    cosine_m=cosine_m,
                    sine_m=sine_m,
                )
            )
        return type(self)(frequency_Hz=self.frequency_Hz, hums=tuple(hums))

    def prior(self) -> Array:
        """Return the change of every amplitude from knot to knot: a phase wanders slowly.

        Of a line at half the sampling rate the sine shows in no reading: its amplitude is 0.
        """
        from scipy.linalg import block_diag

        parts = []
        for hum in self.hums:
            knots = len(hum.cosine_m) // len(hum.harmonic)
            relations = np.vstack([np.diff(np.eye(knots), axis=0), SILENT * np.eye(knots)])
            parts += [relations] * (2 * len(hum.harmonic))
        wide = sum(2 * len(hum.cosine_m) for hum in self.hums)
        return np.asarray(block_diag(*parts)).reshape(-1, wide)


def hats(position: Array, knots: int) -> Array:
    """Return raised-cosine basis functions centred at 0 .. knots - 1, (samples, knots).

    They sum to 1.

    position  (samples,)  0 to knots - 1, clipped to that range
    """
    distance = np.abs(np.clip(position, 0.0, knots - 1.0)[:, None] - np.arange(knots))
    return np.asarray(np.where(distance < 1.0, 0.5 * (1.0 + np.cos(np.pi * distance)), 0.0))
