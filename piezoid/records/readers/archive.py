"""Archives and containers that are no recording themselves: named for what they are."""

import zipfile

from piezoid.records.readers.reader import Reader
from piezoid.records.readers.source import Source, unreadable
from piezoid.records.table import RawTable

ZIP = b"PK\x03\x04"
_OLE = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"
_EXPORT = "Export the recording as CSV."
_SHOWN = 3


def members(source: Source) -> tuple[str, ...]:
    """Return the names in a zip archive; of a damaged one the first, empty for anything else."""
    if not source.head.startswith(ZIP):
        return ()
    try:
        with source.open() as stream, zipfile.ZipFile(stream) as archive:
            return tuple(archive.namelist())
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError, EOFError):
        length = int.from_bytes(source.head[26:28], "little")
        return (source.head[30 : 30 + length].decode("utf-8", "replace"),)


def recognises(source: Source) -> bool:
    """Take zip archives that no other reader has taken, and containers of Microsoft Office."""
    return source.head.startswith((ZIP, _OLE))


def read(source: Source) -> RawTable:
    """Refuse with the name of what it is."""
    if source.head.startswith(_OLE):
        raise unreadable(
            source.name,
            "it is a workbook of Excel 97 (.xls), or another container of that age",
            needed="an .xlsx workbook or a text table",
            remedy="Save it as .xlsx or CSV.",
        )
    names = members(source)
    if any(name.rsplit("/", 1)[-1] == "header.properties" for name in names):
        raise unreadable(
            source.name,
            f"it is a JPK archive of {len(names)} parts, force curves or maps of segments",
            needed="columns over time: the height as it was driven, and as it was measured",
            remedy="Export the segments as text from the JPK data processing, or write their "
            "columns with the Python package afmformats as CSV.",
        )
    shown = ", ".join(map(repr, names[:_SHOWN])) + (", ..." if len(names) > _SHOWN else "")
    raise unreadable(
        source.name,
        f"it is a zip archive that holds {shown or 'nothing'}",
        needed="the recording itself",
        remedy="Unpack it and name the files inside. " + _EXPORT,
    )


READER = Reader(name="zip archive", suffixes=(".zip",), recognises=recognises, read=read)
