"""Collect the files of a stage: recordings over time, frequency responses, sweeps over height."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from piezoid.errors import RecordingError, UnitError
from piezoid.records.column_refusals import with_axis
from piezoid.records.frequency_response import FrequencyResponseRecord
from piezoid.records.ingest import ingest_parts
from piezoid.records.lab import Lab, RecordingEntry
from piezoid.records.readers import read_table
from piezoid.records.recording import Recording
from piezoid.records.response_columns import is_response
from piezoid.records.response_ingest import ingest_response
from piezoid.records.table import RawTable
from piezoid.records.units import Dimension
from piezoid.summary import Summarised, Summary


@dataclass(frozen=True, kw_only=True, repr=False)
class Collection(Summarised):
    """Contents of the files of one stage; iterates and indexes over its recordings.

    recordings  samples over time
    sweeps      tables over a height without a clock, such as a Z spectroscopy
    responses   frequency responses
    """

    recordings: tuple[Recording, ...]
    sweeps: tuple[RawTable, ...] = ()
    responses: tuple[FrequencyResponseRecord, ...] = ()

    @property
    def files(self) -> tuple[Recording | RawTable | FrequencyResponseRecord, ...]:
        """Recordings, sweeps and frequency responses."""
        return (*self.recordings, *self.sweeps, *self.responses)

    def __iter__(self) -> Iterator[Recording]:
        return iter(self.recordings)

    def __len__(self) -> int:
        return len(self.recordings)

    def __getitem__(self, key: int | str) -> Recording:
        """Return a recording by its index or its name; an error lists the names."""
        if isinstance(key, int):
            return self.recordings[key]
        for recording in self.recordings:
            if recording.name == key:
                return recording
        raise RecordingError(
            f"no recording is called {key!r}",
            needed=f"one of {', '.join(recording.name for recording in self.recordings)}",
            remedy="Name one of those, or read its file as well.",
        )

    def summary(self) -> Summary:
        """Return a table with one row per recording, sweep and frequency response.

        >>> print(recordings.summary())
        Recordings of one stage
        ...
        """
        rows = [(r.name, f"{r.samples} samples, axis {r.axis}") for r in self.recordings]
        rows += [(sweep.name, f"{sweep.rows} rows over height") for sweep in self.sweeps]
        rows += [(r.name, "frequency response") for r in self.responses]
        return Summary(title="Recordings of one stage", rows=rows)


def collection_of(source: object) -> Collection:
    """Convert recordings to a collection, or raise ``RecordingError``.

    source  a Collection, a Recording, or several recordings
    """
    if isinstance(source, Collection):
        return source
    items = (
        [source] if isinstance(source, Recording) or not isinstance(source, Iterable) else source
    )
    recordings: list[Recording] = []
    for recording in items:
        if not isinstance(recording, Recording):
            raise RecordingError(
                f"{type(recording).__name__} given as a recording",
                needed="a Recording, a result of piezoid.read, or several of them",
                remedy="Read files with piezoid.read, arrays with piezoid.from_arrays, a data "
                "frame with piezoid.from_frame.",
            )
        recordings.append(recording)
    return Collection(recordings=tuple(recordings))


def collect(paths: Iterable[Path], lab: Lab | None = None) -> Collection:
    """Read recordings, frequency responses and sweeps from files of any format.

    A table whose columns are named in lab.toml is a recording. Raises ``UnreadableFileError``,
    ``UnitError``, ``RecordingError`` or ``LabFileError``; minor problems of a recording are in its
    ``statements``.
    """
    declared, paths = Lab() if lab is None else lab, tuple(paths)
    declared.check_files(paths)
    recordings: list[Recording] = []
    sweeps: list[RawTable] = []
    responses: list[FrequencyResponseRecord] = []
    for path in paths:
        table = read_table(path, declared.text_format_of(path))
        entries = declared.entries_of(path) or (RecordingEntry(file=path.name),)
        if is_over_height(table) and not any(entry.columns for entry in entries):
            sweeps.append(table)
        else:
            for entry in entries:
                if is_response(table, entry):
                    responses.append(ingest_response(table, declared, entry))
                else:
                    try:
                        recordings += ingest_parts(table, declared, entry)
                    except UnitError as error:
                        remedy = with_axis(error.remedy, [r.axis for r in recordings])
                        raise UnitError(
                            error.found, needed=error.needed, remedy=remedy, **error.numbers
                        ) from None
    return Collection(
        recordings=tuple(recordings), sweeps=tuple(sweeps), responses=tuple(responses)
    )


def is_over_height(table: RawTable) -> bool:
    """Return whether a table is swept over a length instead of time."""
    swept = table.find(table.independent) if table.independent else None
    unit = None if swept is None else swept.heading.unit
    return unit is not None and unit.dimension is Dimension.LENGTH
