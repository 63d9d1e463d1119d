"""Read recordings larger than memory in chunks, and thin them while they are read.

``ingest_table`` makes a recording of every chunk, with the usual checks. This module joins the
chunks, and `thinning` bounds the number of rows. The result is a ``Recording`` of each axis that
has a drive and a displacement.
"""

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from msgspec import structs

from piezoid.errors import LabFileError, RecordingError
from piezoid.records.columns import Assignment, assign_columns
from piezoid.records.ingest import ingest_table, parts_of
from piezoid.records.lab import Lab, RecordingEntry
from piezoid.records.readers import read_table_in_chunks
from piezoid.records.readers.source import open_source
from piezoid.records.recording import Quantity, Recording
from piezoid.records.table import RawTable
from piezoid.records.thinning import MAX_ROWS, ThinnedRows, Thinning
from piezoid.statement import Statement, finding

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
        self._assignment: Assignment | None = None
        self._first: Recording | None = None
        self._thinnings: dict[str, Thinning] = {}
        self._statements: dict[tuple[str, str], tuple[Statement, int]] = {}
        self._is_broken = True  # whether a break follows the last sample
        self._read = self._selected = self._chunks = self._pieces = 0

    def append(self, table: RawTable) -> None:
        """Ingest the next chunk and add its samples."""
        if self._assignment is None:
            self._assignment = assign_columns(table, self._lab, self._unbounded_entry)
        numbers = {assigned.column.number for assigned in self._assignment.columns}
        has_numbers = np.logical_and.reduce(
            [np.isfinite(column.values) for column in table.columns if column.number in numbers]
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
        for statement in recording.statements:
            location = statement.place if statement.quantity in _WHOLE_FILE else ""
            key = (statement.quantity, location)
            first, times = self._statements.get(key, (statement, 0))
            self._statements[key] = first, times + 1
        self._check_unchanged(recording)
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
        return [
            _thinned_recording(self._first, axis, thinning.result(), statements)
            for axis, thinning in sorted(self._thinnings.items())
        ]

    def _check_unchanged(self, recording: Recording) -> None:
        """Refuse a chunk with other columns or another rate than the first one."""
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

    def _rate_change_error(self, before_Hz: float, after_Hz: float, sample: int) -> RecordingError:
        return RecordingError(
            f"{self._name}: sampled at {before_Hz:.9g} Hz at its beginning and at "
            f"{after_Hz:.9g} Hz from sample {sample} on",
            needed="one rate throughout, if a file is read in chunks",
            remedy="Read it without --stream, or cut the file where the rate changes.",
        )


def _thinned_recording(
    first: Recording, axis: str, thinned: ThinnedRows, statements: Sequence[Statement]
) -> Recording:
    """Return the thinned rows as a recording with the names of the file's first chunk."""
    channels = [first.find(q, axis) for q in (Quantity.VOLTAGE, Quantity.DISPLACEMENT)]
    rate_Hz = first.sampling_rate_Hz / thinned.stride
    if thinned.stride > 1 or thinned.share < 1.0:
        text = (
            f"read in chunks: {thinned.rows.shape[1]} samples at {rate_Hz:.6g} Hz of axis {axis} "
            f"represent the file, which was sampled at {first.sampling_rate_Hz:.6g} Hz"
        )
        if thinned.share < 1.0:
            text += (
                f"; they cover {100 * thinned.share:.0f} % of it, in {len(thinned.starts)} "
                "segments, because its drive turns too often for fewer samples"
            )
        statements = (*statements, finding("thinned", text, place=first.name))
    return Recording(
        name=first.name,
        digest=first.digest,
        axis=axis,
        sampling_rate_Hz=rate_Hz,
        channels=tuple(
            replace(channel, values=values)
            for channel, values in zip(channels, thinned.rows, strict=True)
            if channel is not None
        ),
        breaks=thinned.starts[1:],
        statements=tuple(statements),
    )
