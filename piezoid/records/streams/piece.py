"""Piece: uninterrupted samples of one axis of one recording on disk, and how they get there."""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import IO, Any

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.numerics.noise import white_noise_rms

NOISE_ROWS = 4096  # of a block, by which its noise is known


@dataclass(frozen=True, kw_only=True, eq=False)
class Piece:
    """Uninterrupted samples of one axis of one recording, on disk.

    name, recording   of the file, and its number among those of the fit
    sampling_rate_Hz  > 0
    scratch           holds blocks of drive and displacement, one after the other
    blocks            place in bytes and number of samples of each
    samples           of all blocks
    voltage_V         (low, high)
    displacement_m    (low, high)
    covariance        sum of products about both means, V m
    step_V            largest step of the drive between two samples
    noise_m           white noise of the displacement, median over blocks
    """

    name: str
    recording: int
    sampling_rate_Hz: float
    scratch: IO[bytes]
    blocks: tuple[tuple[int, int], ...]
    samples: int
    voltage_V: tuple[float, float]
    displacement_m: tuple[float, float]
    covariance: float
    step_V: float
    noise_m: float

    def read(
        self, rows: int, begin: int = 0, stop: int | None = None
    ) -> Iterator[tuple[Array, Array]]:
        """Yield drive and displacement in blocks of ``rows`` samples, the last one shorter.

        begin, stop  samples between which they lie
        """
        end = self.samples if stop is None else min(stop, self.samples)
        held = np.empty((2, 0))
        number = self._number()
        first = 0
        for place, count in self.blocks:
            low, high = max(begin - first, 0), min(end - first, count)
            first += count
            if low >= high:
                continue
            # Without a place of its own in the file: pieces may be read side by side.
            content = np.frombuffer(os.pread(number, 16 * count, place)).reshape(2, count)
            content = content[:, low:high]
            held = np.hstack([held, content]) if held.size else content
            whole = held.shape[1] // rows * rows
            for row in range(0, whole, rows):
                yield held[0, row : row + rows], held[1, row : row + rows]
            held = held[:, whole:]
        if held.size:
            yield held[0], held[1]

    def _number(self) -> int:
        if self.scratch.writable():
            self.scratch.flush()
        return self.scratch.fileno()

    def __getstate__(self) -> dict[str, Any]:
        """Return what another process needs; raises ``TypeError`` for a file without a name."""
        if not isinstance(self.scratch.name, str):
            raise TypeError(f"{self.name}: only a scratch file with a name is seen elsewhere")
        self.scratch.flush()
        return {**self.__dict__, "scratch": os.path.abspath(self.scratch.name)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take up a piece where the scratch file is seen under the same name."""
        self.__dict__.update({**state, "scratch": _opened(state["scratch"])})


@lru_cache(maxsize=64)
def _opened(place: str) -> IO[bytes]:
    return open(place, "rb")


class PieceWriter:
    """Writes blocks behind each other and keeps account of them, until the piece is whole."""

    def __init__(
        self, scratch: IO[bytes], *, name: str, recording: int, sampling_rate_Hz: float
    ) -> None:
        """Begin a piece; another may have been written to the same scratch file before."""
        self._scratch = scratch
        self._name, self._recording, self._rate_Hz = name, recording, sampling_rate_Hz
        self._blocks: list[tuple[int, int]] = []
        self._samples = 0
        self._voltage_V = (np.inf, -np.inf)
        self._displacement_m = (np.inf, -np.inf)
        self._step_V = 0.0
        self._mean = np.zeros(2)
        self._covariance = 0.0
        self._last_V: float | None = None
        self._noises: list[float] = []

    def append(self, voltage_V: Array, displacement_m: Array) -> None:
        """Write one more block behind the others, and take account of it."""
        self._scratch.seek(0, 2)
        self._blocks.append((self._scratch.tell(), len(voltage_V)))
        self._scratch.write(np.ascontiguousarray(voltage_V).tobytes())
        self._scratch.write(np.ascontiguousarray(displacement_m).tobytes())
        self._voltage_V = _wider(self._voltage_V, voltage_V)
        self._displacement_m = _wider(self._displacement_m, displacement_m)
        before = voltage_V[:1] if self._last_V is None else np.array([self._last_V])
        steps = np.abs(np.diff(voltage_V, prepend=before))
        self._step_V = max(self._step_V, float(steps.max()))
        self._last_V = float(voltage_V[-1])
        self._noises.append(white_noise_rms(displacement_m[:NOISE_ROWS]))
        self._count(voltage_V, displacement_m)

    def _count(self, voltage_V: Array, displacement_m: Array) -> None:
        """Add a block to mean and covariance without ever forming large sums [Chan 1983]."""
        count = len(voltage_V)
        mean = np.array([voltage_V.mean(), displacement_m.mean()])
        apart = mean - self._mean
        whole = self._samples + count
        own = float((voltage_V - mean[0]) @ (displacement_m - mean[1]))
        self._covariance += own + float(apart[0] * apart[1]) * self._samples * count / whole
        self._mean = self._mean + apart * (count / whole)
        self._samples = whole

    def piece(self) -> Piece:
        """Return what was written."""
        return Piece(
            name=self._name,
            recording=self._recording,
            sampling_rate_Hz=self._rate_Hz,
            scratch=self._scratch,
            blocks=tuple(self._blocks),
            samples=self._samples,
            voltage_V=self._voltage_V,
            displacement_m=self._displacement_m,
            covariance=self._covariance,
            step_V=self._step_V,
            noise_m=float(np.median(self._noises)),
        )


def _wider(limits: tuple[float, float], values: Array) -> tuple[float, float]:
    return min(limits[0], float(values.min())), max(limits[1], float(values.max()))
