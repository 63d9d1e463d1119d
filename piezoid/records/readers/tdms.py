"""LabVIEW ``.tdms``: channels of groups, with unit and clock among their properties."""

from typing import Any

from piezoid.records.readers.foreign import reading, table_of
from piezoid.records.readers.reader import Reader
from piezoid.records.readers.source import Source, check_columns, check_growth, unreadable
from piezoid.records.table import RawTable, rate_of


def read(source: Source) -> RawTable:
    """Read every channel; ``wf_increment`` is the sampling interval in seconds."""
    with reading(source, "TDMS"), source.open() as stream, opened(stream) as file:
        channels = named_channels(file)
        check_growth(source, 8 * sum(len(channel) for channel in channels.values()))
        arrays = {name: channel[:] for name, channel in channels.items()}
        units = {name: unit_of_channel(channel) for name, channel in channels.items()}
        rate_Hz = stated_rate_Hz(source, list(channels.values()))
    return table_of(source, "TDMS", arrays, units=units, sampling_rate_Hz=rate_Hz)


def opened(stream: object) -> Any:
    """Open a file for reading channel by channel."""
    from nptdms import TdmsFile
    from nptdms.log import log_manager

    # It prints warnings with kilobytes of the file in them; what matters comes as an error.
    log_manager.set_level("ERROR")
    return TdmsFile.open(stream)


def named_channels(file: Any) -> dict[str, Any]:
    """Return the channels by name; one that two groups share keeps its group before it."""
    channels = [channel for group in file.groups() for channel in group.channels()]
    check_columns("the file", len(channels))
    names = [channel.name for channel in channels]
    return {
        channel.name if names.count(channel.name) == 1 else _long_name(channel): channel
        for channel in channels
    }


def unit_of_channel(channel: Any) -> str:
    """Return the unit among a channel's properties, empty where there is none."""
    return str(channel.properties.get("unit_string", ""))


def _long_name(channel: Any) -> str:
    return f"{channel.group_name}/{channel.name}"


def stated_rate_Hz(source: Source, channels: list[Any]) -> float | None:
    """Return the sampling rate the channels agree on, None where they state none."""
    intervals = {float(c.properties["wf_increment"]) for c in channels if _is_clocked(c)}
    if len(intervals) > 1:
        raise unreadable(
            source.name,
            f"its channels have different sampling intervals {sorted(intervals)} s",
            needed="one clock for all channels",
            remedy="Write the channels of each rate into a file of their own.",
        )
    return rate_of(intervals.pop()) if intervals else None


def _is_clocked(channel: Any) -> bool:
    return float(channel.properties.get("wf_increment", 0)) > 0 and len(channel) > 0


READER = Reader(
    name="TDMS",
    suffixes=(".tdms",),
    recognises=lambda source: source.head.startswith(b"TDSm"),
    read=read,
)
