"""From a file to stretches in SI units: every block goes the whole way of `ingest`.

The units, clocks, gaps and missing numbers of a block are judged by the very functions that judge
a whole file; what is new here is only how blocks are joined.
"""

import itertools
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from msgspec import structs

from piezoid.errors import LabFileError, RecordingError
from piezoid.numerics.arrays import Array
from piezoid.records.assignment import Assignment, assign
from piezoid.records.ingest import ingest_table, parts_of
from piezoid.records.lab import Lab, RecordingEntry
from piezoid.records.readers import READERS
from piezoid.records.readers.source import Source, unreadable
from piezoid.records.recording import Problem, Quantity, Recording
from piezoid.records.streams import FORMATS
from piezoid.records.streams.format import BlockFormat
from piezoid.records.table import RawTable

ROWS = 1 << 17  # of a block: some megabytes a column
_LEAST_ROWS = 1024  # fewer stamps with a gap among them do not tell their clock
_LEAST_NUMBERS = 3  # rows of a block that hold numbers; fewer are a gap
_SAME_RATE = 1e-3
# What a whole file must be to be called so; a block of it often is.
_THROUGHOUT = frozenset({"dead", "empty", "saturated", "equal_columns", "jitter", "counts"})


@dataclass(frozen=True, kw_only=True, eq=False)
class Stretch:
    """Samples of all channels without a break among them.

    begins            whether memory of what came before is lost in front of it
    sampling_rate_Hz  > 0
    channels          (samples,) by quantity and axis, SI units
    """

    begins: bool
    sampling_rate_Hz: float
    channels: dict[tuple[Quantity, str], Array]


class Heard:
    """What was odd about a file's blocks, gathered while they pass."""

    def __init__(self) -> None:
        """Begin with nothing heard."""
        self._blocks = 0
        self.counted: tuple[str, ...] = ()
        self._found: dict[tuple[str, str], tuple[Problem, int]] = {}

    def hear(self, recording: Recording) -> None:
        """Take in the problems of one more block."""
        self._blocks += 1
        self.counted = tuple(sorted({*self.counted, *recording.counted}))
        for problem in recording.problems:
            key = (problem.kind, problem.place if problem.kind in _THROUGHOUT else "")
            first, times = self._found.get(key, (problem, 0))
            self._found[key] = first, times + 1

    @property
    def problems(self) -> tuple[Problem, ...]:
        """Return one problem of a kind: the first, and in how many blocks there was one."""
        return tuple(
            problem if times == 1 or kind in _THROUGHOUT else _told(problem, times, self._blocks)
            for (kind, _), (problem, times) in self._found.items()
            if kind not in _THROUGHOUT or times == self._blocks
        )


def _told(problem: Problem, times: int, blocks: int) -> Problem:
    if times == blocks:
        return problem
    return replace(problem, text=f"{problem.text}; the like in {times} of {blocks} blocks")


def stretches(
    source: Source,
    lab: Lab,
    entry: RecordingEntry | None,
    heard: Heard,
    *,
    rows: int = ROWS,
    workers: int = 1,
) -> Iterator[Stretch]:
    """Yield what ``ingest`` would make of a file, stretch by stretch.

    workers  blocks that are judged side by side, while the next are read; the stretches are the
             same

    Raises what ``ingest`` raises; also ``RecordingError`` where the clock or the meaning of the
    columns changes on the way.
    """
    whole = None if entry is None else structs.replace(entry, start_s=None, stop_s=None)
    join = _Join(source=source, entry=entry)
    if entry is not None and entry.reverse:
        raise LabFileError(
            f"{lab.place}: reverse of {source.name} is true",
            needed="rows in the order in which they were recorded, where a file is read in blocks",
            remedy="Read it without --stream, or write the file the other way round.",
        )
    for block in _judged(source, lab, whole, join, rows, workers):
        if block.numbers.sum() < _LEAST_NUMBERS and join.first is not None:
            join.broken = True
            continue
        join.check_one_rate(block.parts)
        recording = block.recording or ingest_table(block.table, lab, whole)
        heard.hear(recording)
        yield from join.joined(recording, repeats=bool(block.numbers[0]))
        join.broken = join.broken or not block.numbers[-1]
    join.check_length()


@dataclass(frozen=True)
class _Block:
    table: RawTable
    numbers: np.ndarray
    parts: Sequence[tuple[RawTable, Lab, RecordingEntry | None]]
    recording: Recording | None


def _judged(
    source: Source,
    lab: Lab,
    whole: RecordingEntry | None,
    join: "_Join",
    rows: int,
    workers: int,
) -> Iterator[_Block]:
    """Yield the blocks of a file in their order; some are judged while others are read."""
    ahead: deque[Future[_Block]] = deque()
    with ThreadPoolExecutor(workers) as pool:
        try:
            for table in _tables(source, rows):
                assignment = join.meaning(table, lab, whole)
                ahead.append(pool.submit(_judge, table, assignment, lab, whole))
                if len(ahead) > workers:
                    yield ahead.popleft().result()
        except Exception:
            while ahead:  # what is wrong earlier in the file is said first
                yield ahead.popleft().result()
            raise
        while ahead:
            yield ahead.popleft().result()


def _judge(
    table: RawTable, assignment: Assignment, lab: Lab, whole: RecordingEntry | None
) -> _Block:
    numbers, parts = _rows_with_numbers(table, assignment), parts_of(table, lab, whole)
    fit = numbers.sum() >= _LEAST_NUMBERS and len(parts) == 1
    return _Block(table, numbers, parts, ingest_table(table, lab, whole) if fit else None)


def _tables(source: Source, rows: int) -> Iterator[RawTable]:
    reader = next((reader for reader in READERS if reader.recognises(source)), None)
    for known in FORMATS:
        if known.reader is reader:
            _refuse_packed(source, known)
            return known.blocks(source, max(rows, _LEAST_ROWS))
    raise unreadable(
        source.name,
        f"it is {'of no known format' if reader is None else reader.name}",
        needed=f"one of {', '.join(known.reader.name for known in FORMATS)}, to be read in blocks",
        remedy="Export the recording in one of these formats, or cut it into files that fit into "
        "memory.",
    )


def _refuse_packed(source: Source, known: BlockFormat) -> None:
    if source.packed and not known.unpacks:
        raise unreadable(
            source.name,
            f"it is {known.reader.name} packed by gzip, which can only be read from front to back",
            needed="the file itself, to be read in blocks",
            remedy="Unpack it with gunzip; or read it whole where it fits into memory.",
        )


def _rows_with_numbers(table: RawTable, assignment: Assignment) -> np.ndarray:
    read = [*assignment.channels, *([assignment.time] if assignment.time else [])]
    wanted = {assigned.column.number for assigned in read}
    finite = [np.isfinite(c.values) for c in table.columns if c.number in wanted]
    return np.asarray(np.logical_and.reduce(finite))


@dataclass
class _Join:
    """How the next block goes on from those before."""

    source: Source
    entry: RecordingEntry | None
    first: Recording | None = None
    assignment: Assignment | None = None
    broken: bool = False
    seen: int = 0
    kept: int = 0

    def meaning(self, table: RawTable, lab: Lab, entry: RecordingEntry | None) -> Assignment:
        """Return what the columns are, as the first block says."""
        if self.assignment is None:
            described = RecordingEntry(file=table.name) if entry is None else entry
            self.assignment = assign(table, lab, described)
        return self.assignment

    def joined(self, recording: Recording, *, repeats: bool) -> Iterator[Stretch]:
        """Yield the stretches of a block without the sample it repeats."""
        self._check_same(recording)
        skip = 1 if self.first is not None and repeats else 0
        begins = self.first is None or self.broken or not repeats
        if self.first is None:
            self.first = recording
        self.broken = False
        edges = sorted({skip, *(b for b in recording.breaks if b > skip), recording.samples})
        for start, stop in itertools.pairwise(edges):
            fresh = begins or start in recording.breaks
            begins = False
            yield from self._cut(recording, start, stop, begins=fresh)

    def _cut(
        self, recording: Recording, start: int, stop: int, *, begins: bool
    ) -> Iterator[Stretch]:
        """Yield the part of a stretch that lies between start_s and stop_s of the whole file."""
        low, high = self._limits(recording.sampling_rate_Hz)
        first, last = max(self.seen, low), min(self.seen + stop - start, high)
        if first < last:
            part = slice(start + first - self.seen, start + last - self.seen)
            yield Stretch(
                begins=begins or self.kept == 0,
                sampling_rate_Hz=recording.sampling_rate_Hz,
                channels={(c.quantity, c.axis): c.values[part] for c in recording.channels},
            )
            self.kept += last - first
        self.seen += stop - start

    def _limits(self, rate_Hz: float) -> tuple[int, int]:
        start_s = None if self.entry is None else self.entry.start_s
        stop_s = None if self.entry is None else self.entry.stop_s
        low = 0 if start_s is None else max(0, round(start_s * rate_Hz))
        high = 2**62 if stop_s is None else round(stop_s * rate_Hz) + 1
        return low, high

    def check_one_rate(self, parts: Sequence[tuple[RawTable, Lab, RecordingEntry | None]]) -> None:
        """Refuse a block within which the rate changes."""
        if len(parts) > 1:
            before, after = (ingest_table(*part) for part in parts[:2])
            rates = before.sampling_rate_Hz, after.sampling_rate_Hz
            raise self._other_rate(self.source.name, rates, self.seen + before.samples)

    def _other_rate(self, name: str, rates: tuple[float, float], sample: int) -> RecordingError:
        return RecordingError(
            f"{name}: sampled at {rates[0]:.9g} Hz at its beginning and at {rates[1]:.9g} Hz from "
            f"sample {sample} on",
            needed="one rate throughout, where a file is read in blocks",
            remedy="Read it without --stream, or cut the file where the rate changes.",
        )

    def _check_same(self, recording: Recording) -> None:
        first = self.first or recording
        ours = [(c.quantity, c.axis, c.label) for c in recording.channels]
        rates = first.sampling_rate_Hz, recording.sampling_rate_Hz
        if ours != [(c.quantity, c.axis, c.label) for c in first.channels]:
            raise RecordingError(
                f"{recording.name}: from sample {self.seen} on other columns hold numbers than at "
                "its beginning",
                needed="columns that mean the same from the first row to the last",
                remedy="Name the columns to be read in lab.toml.",
            )
        if abs(rates[1] - rates[0]) > _SAME_RATE * rates[0]:
            raise self._other_rate(recording.name, rates, self.seen)

    def check_length(self) -> None:
        """Refuse a file of which nothing is left."""
        if self.kept >= 2:
            return
        entry = self.entry
        where = "" if entry is None else f" from {entry.start_s} s to {entry.stop_s} s"
        raise LabFileError(
            f"{self.source.name}{where} holds {self.kept} of {self.seen} samples",
            needed="at least two samples",
            remedy="Correct start_s and stop_s, counted from the first sample of the file.",
        )
