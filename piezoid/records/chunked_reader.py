"""Read recordings larger than memory in chunks, and thin them while they are read.

``ingest_table`` makes a recording of every chunk, with the usual checks. This module joins the
chunks and bounds the number of rows. The result is a ``Recording`` of each axis that has a drive
and a displacement.

While there are too many rows, every second one is dropped, as long as the fastest branches of the
drive keep ``MIN_BRANCH_ROWS``. Turning points of the drive are never dropped but replace a
neighbouring row: play operators then have the same extremes, and the clock is uniform to within
one row. If branches would become too short, every second of ``SEGMENTS`` segments is dropped
instead; the remaining ones are pieces with separate initial states.
"""

import itertools
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from msgspec import structs

from piezoid.errors import LabFileError, RecordingError
from piezoid.numerics.arrays import Array
from piezoid.numerics.robust import white_noise_rms
from piezoid.records.columns import assign_columns
from piezoid.records.drive_signal import noise_of, reversals_of
from piezoid.records.ingest import ingest_table, parts_of
from piezoid.records.lab import Lab, RecordingEntry
from piezoid.records.readers import read_table_in_chunks
from piezoid.records.readers.reader import open_source
from piezoid.records.recording import Quantity, Recording
from piezoid.records.table import RawTable
from piezoid.statement import Statement, finding

# A fit takes about 740 bytes a row: with 2^18 rows it stays below 400 MB.
MAX_ROWS = 1 << 18
SEGMENTS = 16
# At 24 rows a branch, linear interpolation misses 5 % of the effect of a lag shorter than a row.
MIN_BRANCH_ROWS = 24
_BRANCH_QUANTILE = 0.1  # the fastest tenth of the branches may be shorter
_SMALLEST_TURN = 0.02  # of the drive's range
_NOISE_BAND = 4.0  # standard deviations of the drive's noise: smaller maxima are noise
_NOISE_ROWS = 4096
CHUNK_ROWS = 1 << 17  # some megabytes a column
_MIN_CHUNK_ROWS = 1024  # the clock cannot be identified from fewer stamps with a gap
_MIN_NUMBERS = 3  # rows with numbers; a chunk with fewer is a gap
_MAX_PIECES = 1000
_SAME_RATE = 1e-3  # relative difference
# Statements that must hold in every chunk: single chunks of a healthy file often have them.
_WHOLE_FILE = frozenset({"dead", "empty", "saturated", "equal_columns", "jitter", "counts"})


def read_thinned(
    paths: Sequence[Path],
    lab: Lab | None = None,
    *,
    max_rows: int = MAX_ROWS,
    chunk_rows: int = CHUNK_ROWS,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[Recording, ...]:
    """Read files of any size in chunks, into one thinned recording for each axis of a file.

    lab         declarations of lab.toml, as for ``collect``
    max_rows    largest number of samples of a recording, a power of two
    chunk_rows  number of rows in memory; the recordings do not depend on it
    progress    called with a message before each file

    Raises the errors of ``collect``, and ``RecordingError`` if the sampling rate or the meaning of
    the columns changes inside a file, or if no axis has a drive and a displacement. The samples of
    a file of at most ``max_rows`` samples are those of ``collect``.
    """
    lab = Lab() if lab is None else lab
    lab.check_files(paths)
    recordings: list[Recording] = []
    for path in paths:
        progress(f"reading {path.name}")
        source = replace(open_source(path, in_memory=False), text=lab.text_format_of(path))
        for entry in lab.entries_of(path) or (RecordingEntry(file=source.name),):
            file = _ThinnedFile(name=source.name, lab=lab, entry=entry, max_rows=max_rows)
            for table in read_table_in_chunks(source, max(chunk_rows, _MIN_CHUNK_ROWS)):
                file.append(table)
            recordings += file.recordings()
    return tuple(recordings)


class _ThinnedFile:
    """Chunks of one entry of a file: joins them, thins their samples, counts their statements."""

    def __init__(self, *, name: str, lab: Lab, entry: RecordingEntry, max_rows: int) -> None:
        if entry.reverse:
            raise LabFileError(
                f"{lab.place}: reverse of {name} is true",
                needed="rows in the order of recording, if a file is read in chunks",
                remedy="Read it without --stream, or write the file in the order of recording.",
            )
        self._name, self._lab, self._entry, self._max_rows = name, lab, entry, max_rows
        # start_s and stop_s count from the start of the file, not of a chunk.
        self._unbounded_entry = structs.replace(entry, start_s=None, stop_s=None)
        self._numbers: set[int] = set()  # of the columns that are read
        self._first: Recording | None = None
        self._thinnings: dict[str, Thinning] = {}
        self._statements: dict[tuple[str, str], tuple[Statement, int]] = {}
        self._is_broken = True  # whether a break follows the last sample
        self._read = self._selected = self._chunks = self._pieces = 0

    def append(self, table: RawTable) -> None:
        """Ingest the next chunk and add its samples."""
        if not self._numbers:
            assignment = assign_columns(table, self._lab, self._unbounded_entry)
            self._numbers = {assigned.column.number for assigned in assignment.columns}
        has_numbers = np.logical_and.reduce(
            [np.isfinite(c.values) for c in table.columns if c.number in self._numbers]
        )
        if has_numbers.sum() < _MIN_NUMBERS and self._first is not None:
            self._is_broken = True
            return
        parts = parts_of(table, self._lab, self._unbounded_entry)
        if len(parts) > 1:
            earlier, later = (ingest_table(part, self._lab, entry) for part, entry in parts[:2])
            sample = self._read + earlier.samples
            raise self._rate_change_error(earlier.sampling_rate_Hz, later.sampling_rate_Hz, sample)
        recording = ingest_table(table, self._lab, self._unbounded_entry)
        self._chunks += 1
        statements: dict[tuple[str, str], Statement] = {}
        for statement in recording.statements:
            kind = statement.quantity
            # Problems of one kind are those of several columns; their lines differ between chunks.
            number = sum(kind == earlier for earlier, _ in statements)
            location = statement.place if kind in _WHOLE_FILE else str(number)
            statements[kind, location] = statement
        for key, statement in statements.items():
            first_statement, times = self._statements.get(key, (statement, 0))
            self._statements[key] = first_statement, times + 1
        first = self._first or recording
        columns, first_columns = (
            [(c.quantity, c.axis, c.label) for c in r.channels] for r in (recording, first)
        )
        if columns != first_columns:
            raise RecordingError(
                f"{recording.name}: from sample {self._read} on other columns hold numbers than "
                "at its beginning",
                needed="the same columns from the first row to the last",
                remedy="Name the columns to be read in lab.toml.",
            )
        first_Hz, rate_Hz = first.sampling_rate_Hz, recording.sampling_rate_Hz
        if abs(rate_Hz - first_Hz) > _SAME_RATE * first_Hz:
            raise self._rate_change_error(first_Hz, rate_Hz, self._read)
        # A chunk starts with the last row of the previous one.
        is_repeated = self._first is not None and bool(has_numbers[0])
        self._first = self._first or recording
        self._append_pieces(recording, skip=int(is_repeated))
        self._is_broken = not has_numbers[-1]

    def _append_pieces(self, recording: Recording, *, skip: int) -> None:
        """Thin the pieces of a chunk between start_s and stop_s."""
        rate_Hz, entry = recording.sampling_rate_Hz, self._entry
        low = 0 if entry.start_s is None else max(0, round(entry.start_s * rate_Hz))
        high = sys.maxsize if entry.stop_s is None else round(entry.stop_s * rate_Hz) + 1
        edges = sorted({skip, *(b for b in recording.breaks if b > skip), recording.samples})
        for start, stop in pairwise(edges):
            first, stop_sample = max(self._read, low), min(self._read + stop - start, high)
            part = slice(start + first - self._read, start + stop_sample - self._read)
            self._read += stop - start
            if first >= stop_sample:
                continue
            is_new = start in recording.breaks or start == 0 or not self._selected
            is_new |= start == skip and self._is_broken
            self._selected += stop_sample - first
            self._pieces += is_new
            if self._pieces > _MAX_PIECES:
                raise RecordingError(
                    f"{self._name}: the recordings are interrupted more than {_MAX_PIECES} times",
                    needed="longer uninterrupted segments: each has a separate initial state",
                    remedy="Record without losing samples, or state sampling_rate_Hz and name no "
                    "time column if the samples are known to be uniform.",
                )
            for axis in recording.complete_axes:
                self._thinnings.setdefault(axis, Thinning(self._max_rows)).append(
                    recording.voltage_V(axis)[part],
                    recording.displacement_m(axis)[part],
                    is_new_piece=is_new,
                )

    def recordings(self) -> list[Recording]:
        """Return a recording of each axis; refuse a file without samples, drive or response."""
        if self._first is None or self._selected < 2:
            raise LabFileError(
                f"{self._name} from {self._entry.start_s} s to {self._entry.stop_s} s holds "
                f"{self._selected} of {self._read} samples",
                needed="at least two samples",
                remedy="Correct start_s and stop_s, counted from the first sample of the file.",
            )
        if not self._thinnings:
            kinds = sorted({channel.quantity.name.lower() for channel in self._first.channels})
            raise RecordingError(
                f"{self._name}: only {', '.join(kinds)} is recorded: no axis has a drive and a "
                "displacement",
                needed="both, for a fit in chunks; a tunnelling loop is read as a whole",
                remedy="Name the columns in lab.toml, or fit without --stream.",
            )
        statements = []
        for (kind, _), (statement, times) in self._statements.items():
            if times == self._chunks or (times == 1 and kind not in _WHOLE_FILE):
                statements.append(statement)
            elif kind not in _WHOLE_FILE:
                text = f"{statement.text}; similarly in {times} of {self._chunks} chunks"
                statements.append(replace(statement, text=text))
        recordings, file_Hz = [], self._first.sampling_rate_Hz
        for axis, thinning in sorted(self._thinnings.items()):
            rows, starts, stride, share = thinning.result()
            rate_Hz, thinned = file_Hz / stride, []
            if stride > 1 or share < 1.0:
                text = (
                    f"read in chunks: {rows.shape[1]} samples at {rate_Hz:.6g} Hz of axis {axis} "
                    f"represent the file, which was sampled at {file_Hz:.6g} Hz"
                )
                if share < 1.0:
                    text += (
                        f"; they cover {100 * share:.0f} % of it, in {len(starts)} segments, "
                        "because its drive turns too often for fewer samples"
                    )
                thinned = [finding("thinned", text, place=self._first.name)]
            channels = (
                self._first.find(q, axis) for q in (Quantity.VOLTAGE, Quantity.DISPLACEMENT)
            )
            recordings.append(
                replace(
                    self._first,
                    axis=axis,
                    sampling_rate_Hz=rate_Hz,
                    channels=tuple(
                        replace(channel, values=values)
                        for channel, values in zip(channels, rows, strict=True)
                        if channel is not None
                    ),
                    breaks=starts[1:],
                    bridged=(),
                    statements=(*statements, *thinned),
                )
            )
        return recordings

    def _rate_change_error(self, before_Hz: float, after_Hz: float, sample: int) -> RecordingError:
        return RecordingError(
            f"{self._name}: sampled at {before_Hz:.9g} Hz at its beginning and at "
            f"{after_Hz:.9g} Hz from sample {sample} on",
            needed="one rate throughout, if a file is read in chunks",
            remedy="Read it without --stream, or cut the file where the rate changes.",
        )


# Index of a block in the file; its drive and displacement, (2, rows) V and m; the drive of the
# samples next to the block, NaN at the ends of a piece.
_Block = tuple[int, Array, float, float]


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

    def result(self) -> tuple[Array, tuple[int, ...], int, float]:
        """Return the thinned rows of all appended samples.

        Returns:
            Drive and displacement, (2, rows) V and m; the first row of each uninterrupted piece;
            the number of samples of the file per row; the share of the file that the rows cover.
        """
        self._end_piece()
        lengths = [rows.shape[1] for _, rows, _, _ in self._blocks]
        stops = np.cumsum(lengths)
        numbers = [number for number, _, _, _ in self._blocks]
        is_joined = [later == earlier + 1 for earlier, later in itertools.pairwise(numbers)]
        starts = [0, *stops[:-1][~np.array(is_joined, dtype=bool)].tolist()]
        rows = np.hstack([block[1] for block in self._blocks]) if lengths else self._pending
        stride = 1 << self._level
        share = 1.0 if self._skip == 0 else rows.shape[1] * stride / self._samples
        return rows, tuple(starts), stride, share

    def _end_piece(self) -> None:
        """Add pending samples as a shorter block, and skip a number to mark the gap."""
        if self._pending.shape[1] >> self._level:
            self._add_block(self._pending, np.nan)
        self._pending, self._before_V = np.empty((2, 0)), np.nan
        self._number += 1

    def _add_block(self, samples: Array, after_V: float) -> None:
        if self._noise_V is None:
            self._noise_V = white_noise_rms(samples[0, :_NOISE_ROWS])
        block = self._number, samples, self._before_V, after_V
        for _ in range(self._level):
            block = self._halve(block)
        if self._is_kept(block) and block[1].size:
            self._blocks.append(block)
            self._rows += block[1].shape[1]
        self._before_V = float(samples[0, -1])
        self._number += 1
        while self._rows > self._max_rows:
            can_halve = self._skip == 0 and self._block >> self._level > 1
            if can_halve:
                # The fastest tenth of the branches of the drive must keep enough rows.
                drive_V = np.concatenate([rows[0] for _, rows, _, _ in self._blocks])
                smallest_V = max(noise_of(drive_V), _SMALLEST_TURN * float(np.ptp(drive_V)))
                turns = reversals_of(drive_V, smallest_V)
                lengths = np.diff([0, *turns, len(drive_V)])
                can_halve = np.quantile(lengths, _BRANCH_QUANTILE) >= 2 * MIN_BRANCH_ROWS
            if can_halve:
                halved = map(self._halve, self._blocks)
                self._blocks = [block for block in halved if block[1].size]
                self._level += 1
            else:
                self._skip += 1
                self._blocks = [block for block in self._blocks if self._is_kept(block)]
            self._rows = sum(rows.shape[1] for _, rows, _, _ in self._blocks)

    def _is_kept(self, block: _Block) -> bool:
        return (block[0] >> self._level) % (1 << self._skip) == 0

    def _halve(self, block: _Block) -> _Block:
        """Keep the first of every two rows, or the second if the drive turns there."""
        number, rows, before_V, after_V = block
        pairs = rows[:, : rows.shape[1] // 2 * 2].reshape(2, -1, 2)
        margin_V = _NOISE_BAND * (self._noise_V or 0.0)
        is_second = np.zeros(pairs.shape[1], dtype=bool)
        for sign in (1.0, -1.0):
            # A maximum of the drive, or of its negative, in the second row of a pair.
            drive_V = sign * pairs[0]
            highest_V = drive_V.max(axis=1)
            previous_V = np.concatenate([[sign * before_V], highest_V[:-1]])
            following_V = np.concatenate([highest_V[1:], [sign * after_V]])
            is_highest = (highest_V > previous_V) & (highest_V > following_V)
            is_second |= is_highest & (drive_V[:, 1] > drive_V[:, 0] + margin_V)
        choice = is_second.astype(int)[None, :, None]
        return number, np.take_along_axis(pairs, choice, axis=2)[:, :, 0], before_V, after_V
