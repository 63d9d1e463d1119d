"""Force curves of JPK (``.jpk-force``): zip archives of segments, each with its own clock.

The drive is read in volts at the output of the controller, the height in metres from the sensor;
heights that a program computed from the drive are not read.
"""

from typing import Any

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.records.readers.archive import check_unpacked_size, members
from piezoid.records.readers.named_arrays import table_of
from piezoid.records.readers.reader import Reader, Source, unreadable
from piezoid.records.table import RawTable


def read(source: Source) -> RawTable:
    """Read drive, measured height and time of all segments, one after the other."""
    if not {"segments/", "index/"} & set(members(source)):
        raise unreadable(
            source.name,
            f"it is a JPK archive of {len(members(source))} parts without its folders of segments",
            needed="the archive as the microscope wrote it",
            remedy="Copy it again; do not unpack it and pack it anew.",
        )
    from afmformats.errors import AFMFileFormatError
    from afmformats.formats.fmt_jpk.jpk_reader import ArchiveCache, JPKReader

    check_unpacked_size(source)
    file = JPKReader(source.path)
    try:
        if len(file) != 1:
            raise unreadable(
                source.name,
                f"it is a JPK archive of {len(file)} curves",
                needed="one curve: each has a separate initial state",
                remedy="Save the curves one by one from the JPK data processing.",
            )
        numbers = file.get_index_segment_numbers(0)
        durations_s = [float(file.get_metadata_jpk_primary(0, n)["duration"]) for n in numbers]
        drives_V, heights_m = (
            [_channel(file, n, column, slot=slot, unit=unit) for n in numbers]
            for column, slot, unit in (
                ("height (piezo)", "volts", "V"),
                ("height (measured)", "nominal", "m"),
            )
        )
    except AFMFileFormatError as error:  # derived from BaseException
        raise ValueError(str(error)) from error
    finally:
        ArchiveCache.open_archives.pop(source.path, None)
    begins_s = np.cumsum([0.0, *durations_s[:-1]])
    times_s = [
        begin_s + np.arange(len(drive_V)) * duration_s / len(drive_V)
        for begin_s, duration_s, drive_V in zip(begins_s, durations_s, drives_V, strict=True)
    ]
    names = ("time", "drive, volts of the height", "measured height")
    arrays = dict(zip(names, map(np.concatenate, (times_s, drives_V, heights_m)), strict=True))
    return table_of(source, arrays, units=dict(zip(names, ("s", "V", "m"), strict=True)))


def _channel(file: Any, number: int, column: str, *, slot: str, unit: str) -> Array:
    """Return a channel of a segment, named as in afmformats, in one of its calibrations."""
    from afmformats.formats.fmt_jpk.jpk_data import find_column_dat, load_dat_unit
    from afmformats.formats.fmt_jpk.jpk_reader import ArchiveCache

    folder = file.get_index_segment_path(0, number)
    names = [name for name in file.files if name.startswith(folder)]
    name, _, part = find_column_dat(names, column)
    properties = file._get_index_segment_properties(0, number)
    with ArchiveCache.get(file.path).open(part) as stream:
        values, unit_of_values, _ = load_dat_unit(stream, name, properties, slot=slot)
    if unit_of_values != unit:
        raise ValueError(f"channel {name} is in {unit_of_values} where {unit} was expected")
    return np.asarray(values, dtype=np.float64)


READER = Reader(
    name="JPK",
    usual_suffixes=(".jpk-force",),
    recognises=lambda source: any(
        name.rsplit("/", 1)[-1] == "header.properties" for name in members(source)
    ),
    read=read,
    library=True,
    extra="afm",
)
