"""LabVIEW ``.tdms``: channels of groups, with unit and clock among their properties."""

from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any

from piezoid.records.readers.optional_readers import chunk_tables, reading, table_of
from piezoid.records.readers.reader import Arrays, Reader, overlapping_chunks
from piezoid.records.readers.source import Source, check_columns, check_growth, unreadable
from piezoid.records.table import RawTable, rate_of


def read(source: Source) -> RawTable:
    """Read every channel; ``wf_increment`` is the sampling interval in seconds."""
    with reading(source, "TDMS"), source.open() as stream, _opened(stream) as file:
        channels = _named_channels(file)
        check_growth(source, 8 * sum(len(channel) for channel in channels.values()))
        arrays = {name: channel[:] for name, channel in channels.items()}
        units = _units(channels)
        rate_Hz = _stated_rate_Hz(source, list(channels.values()))
    return table_of(source, "TDMS", arrays, units=units, sampling_rate_Hz=rate_Hz)


def read_chunks(source: Source, rows: int) -> Iterator[RawTable]:
    """Yield the channels of the commonest length in chunks.

    A segment that was written in one call is read as one: what the recorder held in memory, the
    reader can hold as well.
    """
    with reading(source, "TDMS"), source.open() as stream, _opened(stream) as file:
        channels = _named_channels(file)
        lengths = Counter(len(channel) for channel in channels.values() if len(channel) > 1)
        length = max(sorted(lengths), key=lengths.__getitem__, default=0)
        columns = {name: c for name, c in channels.items() if len(c) == length}
        check_growth(source, 8 * length * len(columns), whole=False)
        yield from chunk_tables(
            source,
            "TDMS",
            overlapping_chunks(_slices(columns, length, rows), rows),
            units=_units(columns),
            sampling_rate_Hz=_stated_rate_Hz(source, list(channels.values())),
        )


def _slices(columns: Mapping[str, Any], length: int, rows: int) -> Iterator[Arrays]:
    for first in range(0, length, rows):
        count = min(rows, length - first)
        yield {name: c.read_data(offset=first, length=count) for name, c in columns.items()}


def _opened(stream: object) -> Any:
    """Open a file for reading channel by channel."""
    from nptdms import TdmsFile
    from nptdms.log import log_manager

    # It prints warnings with kilobytes of the file in them; what matters comes as an error.
    log_manager.set_level("ERROR")
    return TdmsFile.open(stream)


def _named_channels(file: Any) -> dict[str, Any]:
    """Return the channels by name; a name that two groups share has its group in front."""
    channels = [channel for group in file.groups() for channel in group.channels()]
    check_columns("the file", len(channels))
    names = [channel.name for channel in channels]
    return {
        channel.name
        if names.count(channel.name) == 1
        else f"{channel.group_name}/{channel.name}": channel
        for channel in channels
    }


def _units(channels: Mapping[str, Any]) -> dict[str, str]:
    return {name: str(c.properties.get("unit_string", "")) for name, c in channels.items()}


def _stated_rate_Hz(source: Source, channels: list[Any]) -> float | None:
    """Return the sampling rate the channels agree on, None where they state none."""
    stated = [float(c.properties.get("wf_increment", 0)) for c in channels if len(c)]
    intervals = {interval_s for interval_s in stated if interval_s > 0}
    if len(intervals) > 1:
        raise unreadable(
            source.name,
            f"its channels have different sampling intervals {sorted(intervals)} s",
            needed="one clock for all channels",
            remedy="Write the channels of each rate into a file of their own.",
        )
    return rate_of(intervals.pop()) if intervals else None


READER = Reader(
    name="TDMS",
    suffixes=(".tdms",),
    recognises=lambda source: source.head.startswith(b"TDSm"),
    read=read,
    read_chunks=read_chunks,
    extra="io",
)
