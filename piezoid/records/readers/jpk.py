"""Force curves of JPK (``.jpk-force``): zip archives of segments, each with its own clock.

The piezo's drive is read in volts, as the controller put it out, the height as the sensor showed
it in metres; heights that a program computed from the drive are no measurement.
"""

import zipfile
from typing import Any

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.records.readers.archive import ZIP, members
from piezoid.records.readers.optional_readers import reading, table_of
from piezoid.records.readers.reader import Reader
from piezoid.records.readers.source import Source, check_growth, unreadable
from piezoid.records.table import RawTable

_DRIVE, _MEASURED = "height (piezo)", "height (measured)"  # as afmformats calls them


def recognises(source: Source) -> bool:
    """Tell an archive by the one part that each of JPK's has."""
    return source.head.startswith(ZIP) and any(
        name.rsplit("/", 1)[-1] == "header.properties" for name in members(source)
    )


def read(source: Source) -> RawTable:
    """Read drive, measured height and time of all segments, one after the other."""
    if not {"segments/", "index/"} & set(members(source)):
        raise unreadable(
            source.name,
            f"it is a JPK archive of {len(members(source))} parts without its folders of segments",
            needed="the archive as the microscope wrote it",
            remedy="Copy it again; do not unpack it and pack it anew.",
        )
    with reading(source, "JPK", extra="afm"):
        from afmformats.errors import AFMFileFormatError
        from afmformats.formats.fmt_jpk.jpk_reader import ArchiveCache, JPKReader

        with source.open() as stream, zipfile.ZipFile(stream) as archive:
            check_growth(source, sum(item.file_size for item in archive.infolist()))
        file = JPKReader(source.path)
        try:
            if len(file) != 1:
                raise unreadable(
                    source.name,
                    f"it is a JPK archive of {len(file)} curves",
                    needed="one curve: each begins with a memory of its own",
                    remedy="Save the curves one by one from the JPK data processing.",
                )
            segments = file.get_index_segment_numbers(0)
            parts = [_segment(file, ArchiveCache, number) for number in segments]
        except AFMFileFormatError as error:  # no Exception, by its class
            raise ValueError(str(error)) from error
        finally:
            ArchiveCache.open_archives.pop(source.path, None)
        durations_s = np.array([duration_s for duration_s, _, _ in parts])
        begins_s = np.cumsum(durations_s) - durations_s
        times_s = [
            begin_s + np.arange(len(drive)) * duration_s / len(drive)
            for begin_s, (duration_s, drive, _) in zip(begins_s, parts, strict=True)
        ]
        arrays = {
            "time": np.concatenate(times_s),
            "drive, volts of the height": np.concatenate([drive for _, drive, _ in parts]),
            "measured height": np.concatenate([measured for _, _, measured in parts]),
        }
    units = dict(zip(arrays, ("s", "V", "m"), strict=True))
    return table_of(source, "JPK", arrays, units=units)


def _segment(file: Any, archives: Any, number: int) -> tuple[float, Array, Array]:
    """Return duration, drive and measured height of a segment: s, V, m."""
    there = file.get_index_segment_path(0, number)
    properties = file._get_index_segment_properties(0, number)
    duration_s = float(file.get_metadata_jpk_primary(0, number)["duration"])
    drive = _channel(file, archives, there, properties, _DRIVE, "volts", "V")
    return (
        duration_s,
        drive,
        _channel(file, archives, there, properties, _MEASURED, "nominal", "m"),
    )


def _channel(
    file: Any, archives: Any, there: str, properties: Any, column: str, slot: str, wanted: str
) -> Array:
    """Return a channel of a segment in one of its calibrations, ``slot``."""
    from afmformats.formats.fmt_jpk.jpk_data import find_column_dat, load_dat_unit

    own = [name for name in file.files if name.startswith(there)]
    name, _, place = find_column_dat(own, column)
    with archives.get(file.path).open(place) as stream:
        values, unit, _ = load_dat_unit(stream, name, properties, slot=slot)
    if unit != wanted:
        raise ValueError(f"channel {name} is in {unit} where {wanted} was expected")
    return np.asarray(values, dtype=np.float64)


READER = Reader(
    name="JPK",
    suffixes=(".jpk-force",),
    recognises=recognises,
    read=read,
    extra="afm",
)
