"""LabVIEW ``.tdms`` in blocks: as much of every channel as a block needs.

A segment that was written in one call is read as one: what the recorder held, so can the reader.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any

from piezoid.records.readers import tdms
from piezoid.records.readers.foreign import reading
from piezoid.records.readers.source import Source, check_growth
from piezoid.records.streams.format import Arrays, BlockFormat, recut, tables_of
from piezoid.records.table import RawTable


def blocks(source: Source, rows: int) -> Iterator[RawTable]:
    """Yield the channels of most samples, block by block."""
    with reading(source, "TDMS"), source.open() as stream, tdms.opened(stream) as file:
        channels = tdms.named_channels(file)
        lengths = Counter(len(channel) for channel in channels.values() if len(channel) > 1)
        length = max(sorted(lengths), key=lengths.__getitem__, default=0)
        columns = {name: c for name, c in channels.items() if len(c) == length}
        check_growth(source, 8 * length * len(columns), whole=False)
        yield from tables_of(
            source,
            "TDMS",
            recut(_pieces(columns, length, rows), rows),
            units={name: tdms.unit_of_channel(c) for name, c in columns.items()},
            sampling_rate_Hz=tdms.stated_rate_Hz(source, list(channels.values())),
        )


def _pieces(columns: Mapping[str, Any], length: int, rows: int) -> Iterator[Arrays]:
    for first in range(0, length, rows):
        count = min(rows, length - first)
        yield {name: c.read_data(offset=first, length=count) for name, c in columns.items()}


FORMAT = BlockFormat(reader=tdms.READER, blocks=blocks)
