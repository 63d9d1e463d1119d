"""LabVIEW ``.tdms``: channels of groups, with unit and clock among their properties."""

from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Any

from piezoid.records.readers.named_arrays import commonest_length, table_of
from piezoid.records.readers.reader import Reader, Source, check_columns, check_growth, unreadable
from piezoid.records.table import RawTable, rate_of


def read(source: Source) -> RawTable:
    """Read every channel; ``wf_increment`` is the sampling interval in seconds."""
    with source.open() as stream, _open_file(stream) as file:
        channels = _named_channels(source, file)
        check_growth(source, 8 * sum(len(channel) for channel in channels.values()))
        arrays = {name: channel[:] for name, channel in channels.items()}
        units, rate_Hz = _units_and_rate_Hz(source, channels)
        return table_of(source, arrays, units=units, sampling_rate_Hz=rate_Hz)


def read_chunks(source: Source, rows: int) -> Iterator[RawTable]:
    """Yield the channels of the commonest length in chunks.

    A segment that was written in one call is read as a whole, since it fitted into memory.
    """
    with source.open() as stream, _open_file(stream) as file:
        channels = _named_channels(source, file)
        length = commonest_length(len(c) for c in channels.values() if len(c) > 1)
        columns = {name: c for name, c in channels.items() if len(c) == length}
        check_growth(source, 8 * length * len(columns))
        units, rate_Hz = _units_and_rate_Hz(source, channels)
        for first, stop in pairwise([*range(0, max(length - rows, 1), rows), length]):
            count = stop - first
            arrays = {n: c.read_data(offset=first, length=count) for n, c in columns.items()}
            yield table_of(source, arrays, units=units, sampling_rate_Hz=rate_Hz)


def _open_file(stream: object) -> Any:
    """Open a file for reading channel by channel."""
    from nptdms import TdmsFile
    from nptdms.log import log_manager

    # The warnings of the library contain kilobytes of the file.
    log_manager.set_level("ERROR")
    return TdmsFile.open(stream)


def _named_channels(source: Source, file: Any) -> dict[str, Any]:
    """Return the channels by name; ambiguous names are prefixed by their group."""
    channels = [channel for group in file.groups() for channel in group.channels()]
    check_columns(source.name, len(channels))
    names = [channel.name for channel in channels]
    return {
        c.name if names.count(c.name) == 1 else f"{c.group_name}/{c.name}": c for c in channels
    }


def _units_and_rate_Hz(
    source: Source, channels: Mapping[str, Any]
) -> tuple[dict[str, str], float | None]:
    """Return the units of the channels, and their common sampling rate; None if not stated."""
    units = {name: str(c.properties.get("unit_string", "")) for name, c in channels.items()}
    stated_s = [float(c.properties.get("wf_increment", 0)) for c in channels.values() if len(c)]
    intervals_s = {interval_s for interval_s in stated_s if interval_s > 0}
    if len(intervals_s) > 1:
        raise unreadable(
            source.name,
            f"its channels have different sampling intervals {sorted(intervals_s)} s",
            needed="one clock for all channels",
            remedy="Write the channels of each rate into a separate file.",
        )
    return units, rate_of(intervals_s.pop()) if intervals_s else None


READER = Reader(
    name="TDMS",
    usual_suffixes=(".tdms",),
    recognises=lambda source: source.head.startswith(b"TDSm"),
    read=read,
    read_chunks=read_chunks,
    library=True,
    extra="io",
)
