"""What one pass over a piece tells: its lag, how often it turns, where its cycles begin.

All lags share one triangle. The rows [z(u) | u^2 u^3 1 | y advanced by 0, 1, 2, 3, 4, 6, ...] are
gathered once; the error of each lag is then a small problem in the columns of R.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from piezoid.identification.streamed.stream import Stream
from piezoid.numerics.arrays import Array
from piezoid.numerics.triangle import empty_triangle, gather
from piezoid.operators.play import play_columns

QUICK = np.linspace(0.0, 0.9, 10)  # thresholds of the quick model
SHIFTS = (0, 1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512, 768, 1024)
TURN = 0.02  # half the smallest turning back that counts
ROWS = 100_000


@dataclass(frozen=True, kw_only=True, eq=False)
class Survey:
    """One piece, looked over.

    triangle  of [quick model | displacement at every shift]
    turns     how often the drive turns back
    crossings first samples at which it passes its middle upwards, one behind each wanted edge
    cycles    how often it does
    """

    triangle: Array
    turns: int
    crossings: tuple[int, ...]
    cycles: int


def survey(stream: Stream, edges: Sequence[int]) -> Survey:
    """Look over a piece once.

    edges  samples behind which the next cycle's beginning is wanted
    """
    triangle = empty_triangle(len(QUICK) + 3 + len(SHIFTS))
    stride = max(1, stream.samples // ROWS)
    held_u, held_y = np.empty(0), np.empty(0)
    memory: Array | None = None
    watch = _Watch(edges)
    first = 0
    for drive, response in stream.chunks():
        watch.see(drive)
        held_u, held_y = np.concatenate([held_u, drive]), np.concatenate([held_y, response])
        rows = len(held_u) - SHIFTS[-1]
        if rows <= 0 and watch.seen < stream.samples:
            continue
        rows = rows if rows > 0 else max(len(held_u) // 2, 1)
        memory = np.full(len(QUICK), held_u[0]) if memory is None else memory
        states, memory = play_columns(held_u[:rows], QUICK, memory)
        place = np.arange(-first % stride, rows, stride)
        triangle = gather(triangle, _rows(held_u, held_y, states, place))
        first += rows
        held_u, held_y = held_u[rows:], held_y[rows:]
    return Survey(
        triangle=triangle, turns=watch.turns, crossings=tuple(watch.found), cycles=watch.cycles
    )


def _rows(drive: Array, response: Array, states: Array, place: NDArray[np.int_]) -> Array:
    u = drive[place]
    quick = np.column_stack([states[place], u**2, u**3, np.ones(len(place))])
    last = len(response) - 1
    shifted = [response[np.minimum(place + shift, last)] for shift in SHIFTS]
    return np.column_stack([quick, *shifted])


class _Watch:
    """Counts turns and finds the beginnings of cycles while the drive passes."""

    def __init__(self, edges: Sequence[int]) -> None:
        self.wanted = list(edges)
        self.found: list[int] = []
        self.turns = self.cycles = self.seen = 0
        self.memory: Array | None = None
        self.direction = 0.0
        self.above = True

    def see(self, drive: Array) -> None:
        """Take in the next samples."""
        start = drive[:1] if self.memory is None else self.memory
        states, self.memory = play_columns(drive, np.array([TURN]), start)
        signs = np.sign(np.diff(states[:, 0], prepend=start[0]))
        signs = np.concatenate([[self.direction], signs[signs != 0.0]])
        self.turns += int(np.count_nonzero(signs[1:] * signs[:-1] < 0))
        self.direction = float(signs[-1])
        above = np.concatenate([[self.above], drive > 0.0])
        starts = self.seen + np.flatnonzero(~above[:-1] & above[1:])
        self.above = bool(above[-1])
        self.cycles += len(starts)
        while self.wanted and len(starts) and starts[-1] >= self.wanted[0]:
            self.found.append(int(starts[np.searchsorted(starts, self.wanted.pop(0))]))
        self.seen += len(drive)


def longest_lag_s(streams: Sequence[Stream], surveys: Sequence[Survey]) -> float:
    """Return the longest lag worth searching: a quarter of a mean branch of the drive."""
    duration_s = sum(stream.samples / stream.rate_Hz for stream in streams)
    branches = sum(found.turns + 1 for found in surveys)
    return max(10.0 / min(s.rate_Hz for s in streams), 0.25 * duration_s / branches)


def tried_lags_s(streams: Sequence[Stream], longest_s: float) -> list[float]:
    """Return the lags that are tried: the shifts of the fastest piece."""
    fastest_Hz = max(stream.rate_Hz for stream in streams)
    return [shift / fastest_Hz for shift in SHIFTS if shift / fastest_Hz <= longest_s]


def lag_s_of(streams: Sequence[Stream], surveys: Sequence[Survey], longest_s: float) -> float:
    """Return the lag, of those that were tried, at which the quick model leaves least."""
    tried_s = tried_lags_s(streams, longest_s)
    errors = [
        sum(_error(s, found, tau_s) for s, found in zip(streams, surveys, strict=True))
        for tau_s in tried_s
    ]
    return tried_s[int(np.argmin(errors))]


def _error(stream: Stream, found: Survey, tau_s: float) -> float:
    """Return the squared error a row of the quick model against the displacement tau_s later."""
    count = len(QUICK) + 3
    quick, shifted = found.triangle[:, :count], found.triangle[:, count:]
    samples = tau_s * stream.rate_Hz
    below = int(np.searchsorted(SHIFTS, samples, side="right")) - 1
    part = 0.0
    if below + 1 < len(SHIFTS):
        part = (samples - SHIFTS[below]) / (SHIFTS[below + 1] - SHIFTS[below])
    target = (1 - part) * shifted[:, below] + part * shifted[:, min(below + 1, len(SHIFTS) - 1)]
    free = quick[:, len(QUICK) :]
    size = float(np.sum(target**2)) or 1.0
    return float(nnls(np.hstack([quick, -free]), target)[1] ** 2 / size)
