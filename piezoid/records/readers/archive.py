"""Refuse archives and files of other formats that are not read, with the name of the format."""

import re
import zipfile

from piezoid.records.readers.reader import Reader, Source, check_growth, unreadable
from piezoid.records.table import RawTable

ZIP = b"PK\x03\x04"
_EXPORT = "Export the recording as CSV."
_AFM = (
    "Export it as text from the microscope's program, the drive in volts beside the measured "
    "height."
)
_MAX_NAMES = 3
# Formats by their first bytes, and by the suffix if the bytes are not distinctive.
_OTHER_FORMATS: tuple[tuple[re.Pattern[bytes], str, str, str], ...] = (
    (re.compile(rb'\s*(?:\{\s*"|\[\s*[\[{])'), "", "it is JSON", "Write its arrays as columns "
     "of a CSV file, with pandas.DataFrame(json.load(...)).to_csv(...), say."),
    (re.compile(rb"\s*<(?:\?xml|!DOCTYPE|html|table)", re.IGNORECASE), "",
     "it is a page of HTML or XML, whatever its suffix", _EXPORT),
    (re.compile(rb"%PDF-"), "", "it is a PDF", "Ask for the numbers behind the plot."),
    (re.compile(rb"\{\\rtf"), "", "it is a text with formats (RTF)", "Save it as plain text."),
    (re.compile(rb"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"), "", "it is a workbook of Excel 97 (.xls), "
     "or another container of that age", "Save it as .xlsx or CSV."),
    (re.compile(rb"SQLite format 3\x00"), "", "it is an SQLite data base", _EXPORT),
    (re.compile(rb"\x01\xb0\x93\xff"), "", "it is an image or curve of NT-MDT", _AFM),
    (re.compile(rb".", re.DOTALL), ".wfm", "it is a waveform as an oscilloscope stores it",
     "Store the waveform as CSV on the oscilloscope."),
)  # fmt: skip


def members(source: Source) -> tuple[str, ...]:
    """Return the names in a zip archive, only the first if damaged; empty for other files."""
    if not source.head.startswith(ZIP):
        return ()
    try:
        with source.open() as stream, zipfile.ZipFile(stream) as archive:
            return tuple(archive.namelist())
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError, EOFError):
        length = int.from_bytes(source.head[26:28], "little")
        return (source.head[30 : 30 + length].decode("utf-8", "replace"),)


def check_unpacked_size(source: Source) -> None:
    """Refuse a zip archive with parts of implausible size, by the sizes that it declares."""
    with source.open() as stream, zipfile.ZipFile(stream) as archive:
        check_growth(source, sum(item.file_size for item in archive.infolist()))


def _other_format(source: Source) -> tuple[str, str] | None:
    """Return the format of a file and how to convert it; None if it is unknown."""
    for signature, suffix, kind, remedy in _OTHER_FORMATS:
        if suffix in ("", source.suffix) and signature.match(source.head):
            return kind, remedy
    return None


def read(source: Source) -> RawTable:
    """Refuse the file; the message names its format."""
    names = members(source)
    listed = ", ".join(map(repr, names[:_MAX_NAMES])) + (
        ", ..." if len(names) > _MAX_NAMES else ""
    )
    kind, remedy = _other_format(source) or (
        f"it is a zip archive that holds {listed or 'nothing'}",
        f"Unpack it and name the files inside. {_EXPORT}",
    )
    raise unreadable(source.name, kind, needed="a table with a row for each sample", remedy=remedy)


# Zip archives that no other reader recognises, and other formats.
READER = Reader(
    name="zip archive",
    usual_suffixes=(".zip",),
    recognises=lambda source: source.head.startswith(ZIP) or bool(_other_format(source)),
    read=read,
)
