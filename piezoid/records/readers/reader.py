"""Reader: the interface of one file format, and the conversion of errors of libraries."""

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from piezoid.errors import PiezoidError
from piezoid.records.readers.source import Source, unreadable
from piezoid.records.table import RawTable


@dataclass(frozen=True, kw_only=True)
class Reader:
    """One file format.

    name             shown by `piezoid inspect`
    usual_suffixes   usual endings of its files, for documentation and messages only
    recognises       whether a file has this format, by its first bytes (and by the suffix if
                     formats are similar)
    read             returns the table, without the file's name, digest and format; a damaged file
                     raises ``UnreadableFileError``
    read_chunks      yields the table in chunks of at most about the given number of rows; None if
                     the format is only read as a whole
    library          whether a library reads the format; its errors then mean a damaged file
    extra            the extra of the installation that contains the library, empty for none
    has_text_layout  whether ``separator``, ``decimal`` and ``heading_row`` of lab.toml apply;
                     ``read_chunks`` then also reads files compressed by gzip, front to back
    """

    name: str
    usual_suffixes: tuple[str, ...]
    recognises: Callable[[Source], bool]
    read: Callable[[Source], RawTable]
    read_chunks: Callable[[Source, int], Iterator[RawTable]] | None = None
    library: bool = False
    extra: str = ""
    has_text_layout: bool = False


@contextmanager
def library_errors(source: Source, reader: Reader) -> Iterator[None]:
    """Convert all errors of a library into ``UnreadableFileError``.

    The libraries document no exceptions for damaged files; KeyError, struct.error, zlib.error and
    MemoryError occur, among others.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except PiezoidError:
        raise
    except ModuleNotFoundError as error:
        raise unreadable(
            source.name,
            f"reading {reader.name} needs the missing Python package {error.name!r}",
            needed=f"the readers of the extra {reader.extra!r}",
            remedy=f"Run: pip install 'piezoid[{reader.extra}]'",
        ) from error
    except Exception as error:
        reason = f": {str(error)[:200]}" if str(error) else ""  # empty for a MemoryError
        raise unreadable(
            source.name,
            f"the {reader.name} reader stopped with {type(error).__name__}{reason}",
            needed=f"a whole {reader.name} file",
            remedy="Copy the file again from where it was written, or export it as CSV.",
        ) from error
