"""Read recordings larger than memory in chunks, and thin them while they are read.

Every chunk passes the checks of an ordinary reading: ``ingest_table`` makes a recording of it.
This module joins the chunks, and `thinning` bounds the number of rows. The result is an ordinary
``Recording`` for each axis that has a drive and a displacement.
"""

import itertools
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from piezoid.errors import LabFileError, RecordingError
from piezoid.numerics.arrays import Array
from piezoid.records.columns import Assignment, assign_columns
from piezoid.records.ingest import ingest_table, parts_of
from piezoid.records.lab import Lab, RecordingEntry
from piezoid.records.readers import read_table_in_chunks
from piezoid.records.readers.source import Source, open_source
from piezoid.records.recording import Channel, Quantity, Recording
from piezoid.records.table import RawTable
from piezoid.records.thinning import MAX_ROWS, ThinnedRows, Thinning
from piezoid.statement import Statement, finding

CHUNK_ROWS = 1 << 17  # some megabytes a column
_MIN_CHUNK_ROWS = 1024  # fewer stamps with a gap among them do not show their clock
_MIN_NUMBERS = 3  # rows of a chunk that hold numbers; fewer are a gap
_MAX_PIECES = 1000
_SAME_RATE = 1e-3
# Faults that only a whole file can have: a chunk of a healthy file often looks like that.
_THROUGHOUT = frozenset({"dead", "empty", "saturated", "equal_columns", "jitter", "counts"})


def read_thinned(
    paths: Sequence[Path],
    lab: Lab | None = None,
    *,
    max_rows: int = MAX_ROWS,
    chunk_rows: int = CHUNK_ROWS,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[Recording, ...]:
    """Read files of any size in chunks, one thinned recording for each axis of a file.

    lab         what the laboratory declares, as for ``ingest``
    max_rows    samples of a recording at most, a power of two
    chunk_rows  rows that are in memory at one time; the recordings are the same
    progress    told which file is being read

    Raises what ``ingest`` raises, and ``RecordingError`` where the sampling rate or the meaning of
    the columns changes inside a file, or where no axis has a drive and a displacement. A file of
    at most ``max_rows`` samples gives the samples that ``ingest`` gives.
    """
    lab = Lab() if lab is None else lab
    lab.check_files(paths)
    recordings: list[Recording] = []
    for path in paths:
        progress(f"reading {path.name}")
        source = replace(open_source(path, whole=False), text=lab.text_format_of(path))
        for entry in lab.entries_of(path) or (None,):
            recordings += _read_one(source, lab, entry, max_rows, chunk_rows)
    return tuple(recordings)


def _read_one(
    source: Source, lab: Lab, entry: RecordingEntry | None, max_rows: int, chunk_rows: int
) -> Iterator[Recording]:
    """Yield a recording of each axis of one entry of a file."""
    if entry is not None and entry.reverse:
        raise LabFileError(
            f"{lab.place}: reverse of {source.name} is true",
            needed="rows in the order in which they were recorded, where a file is read in chunks",
            remedy="Read it without --stream, or write the file the other way round.",
        )
    join = _Join(source=source, lab=lab, entry=entry)
    thinnings: dict[str, Thinning] = {}
    pieces = 0
    for stretch in join.stretches(read_table_in_chunks(source, max(chunk_rows, _MIN_CHUNK_ROWS))):
        pieces += stretch.begins
        _refuse_many_pieces(source, pieces)
        for axis in _driven_axes(stretch.channels):
            thinnings.setdefault(axis, Thinning(max_rows)).append(
                stretch.channels[Quantity.VOLTAGE, axis],
                stretch.channels[Quantity.DISPLACEMENT, axis],
                begins=stretch.begins,
            )
    first = join.checked_first()
    if not thinnings:
        kinds = sorted({channel.quantity.name.lower() for channel in first.channels})
        raise RecordingError(
            f"{source.name}: only {', '.join(kinds)} is recorded: no axis has a drive and a "
            "displacement",
            needed="both, for a fit in chunks; a tunnelling loop must fit into memory",
            remedy="Name the columns in lab.toml, or fit without --stream.",
        )
    for axis, thinning in sorted(thinnings.items()):
        yield _recording(first, axis, thinning.result(), join.statements())


def _recording(
    first: Recording, axis: str, thinned: ThinnedRows, statements: tuple[Statement, ...]
) -> Recording:
    """Return the thinned rows as a recording with the names of the file's first chunk."""
    channels = [first.find(q, axis) for q in (Quantity.VOLTAGE, Quantity.DISPLACEMENT)]
    rate_Hz = first.sampling_rate_Hz / thinned.stride
    if thinned.stride > 1 or thinned.share < 1.0:
        text = (
            f"read in chunks: {thinned.rows.shape[1]} samples at {rate_Hz:.4g} Hz of axis {axis} "
            f"represent the file, which was sampled at {first.sampling_rate_Hz:.6g} Hz"
        )
        if thinned.share < 1.0:
            text += (
                f"; they cover {100 * thinned.share:.0f} % of it, in {len(thinned.starts)} "
                "stretches, because its drive turns too often for fewer samples"
            )
        statements = (*statements, finding("thinned", text, place=first.name))
    return Recording(
        name=first.name,
        digest=first.digest,
        axis=axis,
        sampling_rate_Hz=rate_Hz,
        channels=tuple(
            Channel(
                quantity=channel.quantity,
                axis=axis,
                values=values,
                label=channel.label,
                is_counted=channel.is_counted,
            )
            for channel, values in zip(channels, thinned.rows, strict=True)
            if channel is not None
        ),
        breaks=thinned.starts[1:],
        statements=statements,
    )


def _driven_axes(channels: dict[tuple[Quantity, str], Array]) -> list[str]:
    return [
        axis
        for quantity, axis in channels
        if quantity is Quantity.VOLTAGE and (Quantity.DISPLACEMENT, axis) in channels
    ]


def _refuse_many_pieces(source: Source, pieces: int) -> None:
    if pieces > _MAX_PIECES:
        raise RecordingError(
            f"{source.name}: the recordings are interrupted more than {_MAX_PIECES} times",
            needed="uninterrupted stretches: each has a memory of its own",
            remedy="Record without losing samples, or state sampling_rate_Hz and name no time "
            "column if the samples are known to be uniform.",
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Stretch:
    """Samples of all channels without a gap among them.

    begins    whether a gap lies in front of them
    channels  (samples,) by quantity and axis, SI units
    """

    begins: bool
    channels: dict[tuple[Quantity, str], Array]


class _Join:
    """Joins the chunks of one entry of a file, and counts their statements."""

    def __init__(self, *, source: Source, lab: Lab, entry: RecordingEntry | None) -> None:
        self._source, self._lab, self._entry = source, lab, entry
        # start_s and stop_s are of the whole file, not of a chunk.
        self._whole = None if entry is None else structs.replace(entry, start_s=None, stop_s=None)
        self._first: Recording | None = None
        self._is_broken = False
        self._read = self._kept = self._chunks = 0
        self._statements: dict[tuple[str, str], tuple[Statement, int]] = {}

    def stretches(self, tables: Iterator[RawTable]) -> Iterator[_Stretch]:
        """Yield what ``ingest`` would make of the file, stretch by stretch."""
        assignment: Assignment | None = None
        for table in tables:
            if assignment is None:
                described = self._whole or RecordingEntry(file=table.name)
                assignment = assign_columns(table, self._lab, described)
            has_numbers = _rows_with_numbers(table, assignment)
            if has_numbers.sum() < _MIN_NUMBERS and self._first is not None:
                self._is_broken = True
                continue
            self._check_one_rate(table)
            recording = ingest_table(table, self._lab, self._whole)
            self._count_statements(recording)
            yield from self._joined(recording, repeats=bool(has_numbers[0]))
            self._is_broken = self._is_broken or not has_numbers[-1]

    def checked_first(self) -> Recording:
        """Return the recording of the first chunk, or refuse a file without samples."""
        if self._first is None or self._kept < 2:
            entry = self._entry
            where = "" if entry is None else f" from {entry.start_s} s to {entry.stop_s} s"
            raise LabFileError(
                f"{self._source.name}{where} holds {self._kept} of {self._read} samples",
                needed="at least two samples",
                remedy="Correct start_s and stop_s, counted from the first sample of the file.",
            )
        return self._first

    def statements(self) -> tuple[Statement, ...]:
        """Return one statement of each kind: the first, and in how many chunks there was one."""
        return tuple(
            statement
            if times == self._chunks or kind in _THROUGHOUT or times == 1
            else replace(
                statement, text=f"{statement.text}; the like in {times} of {self._chunks} chunks"
            )
            for (kind, _), (statement, times) in self._statements.items()
            if kind not in _THROUGHOUT or times == self._chunks
        )

    def _count_statements(self, recording: Recording) -> None:
        self._chunks += 1
        for statement in recording.statements:
            key = (
                statement.quantity,
                statement.place if statement.quantity in _THROUGHOUT else "",
            )
            first, times = self._statements.get(key, (statement, 0))
            self._statements[key] = first, times + 1

    def _joined(self, recording: Recording, *, repeats: bool) -> Iterator[_Stretch]:
        """Yield the stretches of a chunk without the sample that it repeats."""
        self._check_same(recording)
        skip = 1 if self._first is not None and repeats else 0
        begins = self._first is None or self._is_broken or not repeats
        self._first = self._first or recording
        self._is_broken = False
        edges = sorted({skip, *(b for b in recording.breaks if b > skip), recording.samples})
        for start, stop in itertools.pairwise(edges):
            yield from self._cut(
                recording, start, stop, begins=begins or start in recording.breaks
            )
            begins = False

    def _cut(
        self, recording: Recording, start: int, stop: int, *, begins: bool
    ) -> Iterator[_Stretch]:
        """Yield the samples that lie between start_s and stop_s of the whole file."""
        low, high = self._limits(recording.sampling_rate_Hz)
        first, last = max(self._read, low), min(self._read + stop - start, high)
        if first < last:
            part = slice(start + first - self._read, start + last - self._read)
            yield _Stretch(
                begins=begins or self._kept == 0,
                channels={(c.quantity, c.axis): c.values[part] for c in recording.channels},
            )
            self._kept += last - first
        self._read += stop - start

    def _limits(self, rate_Hz: float) -> tuple[int, int]:
        start_s = None if self._entry is None else self._entry.start_s
        stop_s = None if self._entry is None else self._entry.stop_s
        low = 0 if start_s is None else max(0, round(start_s * rate_Hz))
        return low, sys.maxsize if stop_s is None else round(stop_s * rate_Hz) + 1

    def _check_one_rate(self, table: RawTable) -> None:
        """Refuse a chunk within which the rate changes."""
        parts = parts_of(table, self._lab, self._whole)
        if len(parts) > 1:
            before, after = (ingest_table(*part) for part in parts[:2])
            rates = before.sampling_rate_Hz, after.sampling_rate_Hz
            raise self._rate_changes(rates, self._read + before.samples)

    def _rate_changes(self, rates: tuple[float, float], sample: int) -> RecordingError:
        return RecordingError(
            f"{self._source.name}: sampled at {rates[0]:.9g} Hz at its beginning and at "
            f"{rates[1]:.9g} Hz from sample {sample} on",
            needed="one rate throughout, where a file is read in chunks",
            remedy="Read it without --stream, or cut the file where the rate changes.",
        )

    def _check_same(self, recording: Recording) -> None:
        first = self._first or recording
        columns, rates = _labels(recording), (first.sampling_rate_Hz, recording.sampling_rate_Hz)
        if columns != _labels(first):
            raise RecordingError(
                f"{recording.name}: from sample {self._read} on other columns hold numbers than "
                "at its beginning",
                needed="columns that mean the same from the first row to the last",
                remedy="Name the columns to be read in lab.toml.",
            )
        if abs(rates[1] - rates[0]) > _SAME_RATE * rates[0]:
            raise self._rate_changes(rates, self._read)


def _labels(recording: Recording) -> list[tuple[Quantity, str, str]]:
    return [(c.quantity, c.axis, c.label) for c in recording.channels]


def _rows_with_numbers(table: RawTable, assignment: Assignment) -> NDArray[np.bool_]:
    """Tell in which rows every column that is read holds a number."""
    numbers = {assigned.column.number for assigned in assignment.columns}
    finite = [np.isfinite(c.values) for c in table.columns if c.number in numbers]
    return np.asarray(np.logical_and.reduce(finite))
