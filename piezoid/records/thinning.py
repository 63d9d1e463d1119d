"""Reduce a recording of any length to a bounded number of rows while it is read.

While there are too many rows, every second one is dropped, as long as the fastest branches of the
drive keep ``MIN_BRANCH_ROWS``. A turning point of the drive is never dropped: the row next to it
takes its place, so that the play operators see the extremes they saw before, and the clock stays
uniform to within one row there. Where thinning would leave branches too short, every second of
``STRETCHES`` stretches is dropped instead; each remaining one is a piece with a memory of its own.
"""

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezoid.numerics.arrays import Array
from piezoid.numerics.noise import white_noise_rms
from piezoid.records.reversals import noise_of, reversals_of

# A fit takes about 740 bytes a row: with 2^18 rows it stays below 400 MB.
MAX_ROWS = 1 << 18
STRETCHES = 16
# At 24 rows a branch, straight lines between rows miss 5 % of what a lag shorter than a row does.
MIN_BRANCH_ROWS = 24
_BRANCH_QUANTILE = 0.1  # the fastest tenth of the branches may be shorter
_SMALLEST_TURN = 0.02  # of the drive's range
_NOISE_BAND = 4.0  # standard deviations of the drive's noise: less is no turning point
_NOISE_ROWS = 4096


@dataclass(frozen=True, kw_only=True, eq=False)
class ThinnedRows:
    """Drive and displacement of one axis after thinning.

    rows     (2, samples) V and m
    starts   (pieces,) first sample of each uninterrupted piece, from 0
    stride   samples of the file for one sample here
    share    of the file that the rows cover
    """

    rows: Array
    starts: tuple[int, ...]
    stride: int
    share: float


class Thinning:
    """Rows of one axis, reduced whenever they exceed ``max_rows``.

    The result does not depend on the lengths in which samples are appended.
    """

    def __init__(self, max_rows: int = MAX_ROWS) -> None:
        """Begin without samples; ``max_rows`` is a power of two, at least ``STRETCHES``."""
        self._max_rows = max_rows
        self._block = max_rows // STRETCHES  # samples of the file
        self._blocks: list[tuple[int, Array]] = []  # number of the block in the file, and its rows
        self._pending = np.empty((2, 0))
        self._number = self._samples = self._rows = 0
        self._level = self._skip = 0  # powers of two: stride, and one stretch in so many is kept
        self._noise_V: float | None = None

    def append(self, voltage_V: Array, displacement_m: Array, *, begins: bool) -> None:
        """Add samples; ``begins`` tells whether a gap in time lies in front of them."""
        if begins and self._samples:
            self._end_piece()
        self._samples += len(voltage_V)
        self._pending = np.hstack([self._pending, np.array([voltage_V, displacement_m])])
        while self._pending.shape[1] >= self._block:
            self._add_block(self._pending[:, : self._block].copy())
            self._pending = self._pending[:, self._block :]

    def result(self) -> ThinnedRows:
        """Return the rows of all samples that were appended."""
        self._end_piece()
        lengths = [block.shape[1] for _, block in self._blocks]
        ends = np.cumsum(lengths)
        numbers = [number for number, _ in self._blocks]
        joined = [after == before + 1 for before, after in itertools.pairwise(numbers)]
        starts = [0, *ends[:-1][~np.array(joined, dtype=bool)].tolist()]
        rows = np.hstack([block for _, block in self._blocks]) if lengths else self._pending
        stride = 1 << self._level
        return ThinnedRows(
            rows=rows,
            starts=tuple(starts),
            stride=stride,
            share=1.0 if self._skip == 0 else rows.shape[1] * stride / self._samples,
        )

    def _end_piece(self) -> None:
        """Add what is pending as a shorter block, and leave a number out: a gap follows."""
        if self._pending.shape[1] >> self._level:
            self._add_block(self._pending)
        self._pending = np.empty((2, 0))
        self._number += 1

    def _add_block(self, samples: Array) -> None:
        if self._noise_V is None:
            self._noise_V = white_noise_rms(samples[0, :_NOISE_ROWS])
        rows = samples
        for _ in range(self._level):
            rows = self._halved(rows)
        if self._is_kept(self._number):
            self._blocks.append((self._number, rows))
            self._rows += rows.shape[1]
        self._number += 1
        while self._rows > self._max_rows:
            self._reduce()

    def _is_kept(self, number: int) -> bool:
        return (number >> self._level) % (1 << self._skip) == 0

    def _reduce(self) -> None:
        can_halve = self._skip == 0 and self._block >> self._level > 1
        if can_halve and self._fastest_branch() >= 2 * MIN_BRANCH_ROWS:
            halved = [(number, self._halved(block)) for number, block in self._blocks]
            self._blocks = [(number, block) for number, block in halved if block.size]
            self._level += 1
        else:
            self._skip += 1
            self._blocks = [(n, block) for n, block in self._blocks if self._is_kept(n)]
        self._rows = sum(block.shape[1] for _, block in self._blocks)

    def _fastest_branch(self) -> float:
        """Return the rows of the shorter branches of the drive."""
        drive_V = np.concatenate([block[0] for _, block in self._blocks])
        smallest_V = max(noise_of(drive_V), _SMALLEST_TURN * float(np.ptp(drive_V)))
        turns = reversals_of(drive_V, smallest_V)
        lengths = np.diff([0, *turns, len(drive_V)])
        return float(np.quantile(lengths, _BRANCH_QUANTILE))

    def _halved(self, rows: Array) -> Array:
        """Return the first of every two rows, or the turning point of the drive among them."""
        pairs = rows[:, : rows.shape[1] // 2 * 2].reshape(2, -1, 2)
        margin_V = _NOISE_BAND * (self._noise_V or 0.0)
        choice = np.where(_is_top(pairs[0], margin_V) | _is_top(-pairs[0], margin_V), 1, 0)
        return np.take_along_axis(pairs, choice[None, :, None], axis=2)[:, :, 0]


def _is_top(drive_V: Array, margin_V: float) -> NDArray[np.bool_]:
    """Tell of which pairs the second value is a maximum that the first does not stand for."""
    high_V = drive_V.max(axis=1)
    before = np.concatenate([[-np.inf], high_V[:-1]])
    after = np.concatenate([high_V[1:], [-np.inf]])
    is_highest = (high_V > before) & (high_V > after)
    return np.asarray(is_highest & (drive_V[:, 1] > drive_V[:, 0] + margin_V))
