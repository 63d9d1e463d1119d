"""Reduce a recording of any length to a bounded number of rows while it is read.

While there are too many rows, every second one is dropped, as long as the fastest branches of the
drive keep ``MIN_BRANCH_ROWS``. Turning points of the drive are never dropped but replace a
neighbouring row: play operators then have the same extremes, and the clock is uniform to within
one row. If branches would become too short, every second of ``SEGMENTS`` segments is dropped
instead; the remaining ones are pieces with separate initial states.
"""

import itertools
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezoid.numerics.arrays import Array
from piezoid.numerics.robust import white_noise_rms
from piezoid.records.reversals import noise_of, reversals_of

# A fit takes about 740 bytes a row: with 2^18 rows it stays below 400 MB.
MAX_ROWS = 1 << 18
SEGMENTS = 16
# At 24 rows a branch, linear interpolation misses 5 % of the effect of a lag shorter than a row.
MIN_BRANCH_ROWS = 24
_BRANCH_QUANTILE = 0.1  # the fastest tenth of the branches may be shorter
_SMALLEST_TURN = 0.02  # of the drive's range
_NOISE_BAND = 4.0  # standard deviations of the drive's noise: smaller maxima are noise
_NOISE_ROWS = 4096


@dataclass(frozen=True, kw_only=True, eq=False)
class _Block:
    """Rows of a fixed number of samples of the file.

    number             index of the block in the file
    rows               (2, samples) V and m
    before_V, after_V  drive of the samples next to the block, NaN at the ends of a piece
    """

    number: int
    rows: Array
    before_V: float
    after_V: float


@dataclass(frozen=True, kw_only=True, eq=False)
class ThinnedRows:
    """Drive and displacement of one axis after thinning.

    rows     (2, samples) V and m
    starts   (pieces,) first sample of each uninterrupted piece, from 0
    stride   number of samples of the file per row
    share    share of the file that the rows cover
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
        """Start without samples; ``max_rows`` is a power of two, at least ``SEGMENTS``."""
        self._max_rows = max_rows
        self._block = max_rows // SEGMENTS  # samples of the file
        self._blocks: list[_Block] = []
        self._before_V = np.nan
        self._pending = np.empty((2, 0))
        self._number = self._samples = self._rows = 0
        self._level = self._skip = 0  # exponents of two: stride, and one segment in 2^skip is kept
        self._noise_V: float | None = None

    def append(self, voltage_V: Array, displacement_m: Array, *, is_new_piece: bool) -> None:
        """Add samples; ``is_new_piece`` is true behind a gap in time."""
        if is_new_piece and self._samples:
            self._end_piece()
        self._samples += len(voltage_V)
        self._pending = np.hstack([self._pending, np.array([voltage_V, displacement_m])])
        while self._pending.shape[1] > self._block:
            after_V = float(self._pending[0, self._block])
            self._add_block(self._pending[:, : self._block].copy(), after_V)
            self._pending = self._pending[:, self._block :]

    def result(self) -> ThinnedRows:
        """Return the thinned rows of all appended samples."""
        self._end_piece()
        lengths = [block.rows.shape[1] for block in self._blocks]
        stops = np.cumsum(lengths)
        numbers = [block.number for block in self._blocks]
        is_joined = [later == earlier + 1 for earlier, later in itertools.pairwise(numbers)]
        starts = [0, *stops[:-1][~np.array(is_joined, dtype=bool)].tolist()]
        rows = np.hstack([block.rows for block in self._blocks]) if lengths else self._pending
        stride = 1 << self._level
        return ThinnedRows(
            rows=rows,
            starts=tuple(starts),
            stride=stride,
            share=1.0 if self._skip == 0 else rows.shape[1] * stride / self._samples,
        )

    def _end_piece(self) -> None:
        """Add pending samples as a shorter block, and skip a number to mark the gap."""
        if self._pending.shape[1] >> self._level:
            self._add_block(self._pending, np.nan)
        self._pending, self._before_V = np.empty((2, 0)), np.nan
        self._number += 1

    def _add_block(self, samples: Array, after_V: float) -> None:
        if self._noise_V is None:
            self._noise_V = white_noise_rms(samples[0, :_NOISE_ROWS])
        block = _Block(number=self._number, rows=samples, before_V=self._before_V, after_V=after_V)
        for _ in range(self._level):
            block = self._halve(block)
        if self._is_kept(block.number) and block.rows.size:
            self._blocks.append(block)
            self._rows += block.rows.shape[1]
        self._before_V = float(samples[0, -1])
        self._number += 1
        while self._rows > self._max_rows:
            can_halve = self._skip == 0 and self._block >> self._level > 1
            if can_halve and self._fastest_branch() >= 2 * MIN_BRANCH_ROWS:
                halved = map(self._halve, self._blocks)
                self._blocks = [block for block in halved if block.rows.size]
                self._level += 1
            else:
                self._skip += 1
                self._blocks = [block for block in self._blocks if self._is_kept(block.number)]
            self._rows = sum(block.rows.shape[1] for block in self._blocks)

    def _is_kept(self, number: int) -> bool:
        return (number >> self._level) % (1 << self._skip) == 0

    def _fastest_branch(self) -> float:
        """Return the number of rows of the fastest tenth of the branches of the drive."""
        drive_V = np.concatenate([block.rows[0] for block in self._blocks])
        smallest_V = max(noise_of(drive_V), _SMALLEST_TURN * float(np.ptp(drive_V)))
        turns = reversals_of(drive_V, smallest_V)
        lengths = np.diff([0, *turns, len(drive_V)])
        return float(np.quantile(lengths, _BRANCH_QUANTILE))

    def _halve(self, block: _Block) -> _Block:
        """Keep the first of every two rows, or the second if the drive turns there."""
        rows = block.rows
        pairs = rows[:, : rows.shape[1] // 2 * 2].reshape(2, -1, 2)
        margin_V = _NOISE_BAND * (self._noise_V or 0.0)
        is_second = _is_maximum(pairs[0], block.before_V, block.after_V, margin_V) | _is_maximum(
            -pairs[0], -block.before_V, -block.after_V, margin_V
        )
        choice = is_second.astype(int)[None, :, None]
        return replace(block, rows=np.take_along_axis(pairs, choice, axis=2)[:, :, 0])


def _is_maximum(
    drive_V: Array, before_V: float, after_V: float, margin_V: float
) -> NDArray[np.bool_]:
    """Return which pairs have a maximum of the drive in their second value.

    before_V, after_V  neighbours of the first and last pair; NaN: no maximum in that pair
    """
    high_V = drive_V.max(axis=1)
    previous = np.concatenate([[before_V], high_V[:-1]])
    following = np.concatenate([high_V[1:], [after_V]])
    is_highest = (high_V > previous) & (high_V > following)
    return np.asarray(is_highest & (drive_V[:, 1] > drive_V[:, 0] + margin_V))
