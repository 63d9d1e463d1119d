"""Reader: the protocol of one file format, and the errors of the libraries that read it."""

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

    name         as `piezoid inspect` shows it
    usual_suffixes  the usual endings of its files, which do not decide; for documentation and
                    messages
    recognises   tells from the first bytes (between similar formats, the suffix) whether a file
                 has this format
    read         returns the table, without the file's name, digest and format; anything wrong
                 with the file is an ``UnreadableFileError``
    read_chunks  yields the table in chunks of about the given number of rows, None where the
                 format is only read whole. Every chunk begins with the last row of the chunk
                 before, so that a gap between two chunks lies inside one of them.
    reads_gzip   whether chunks are also read from a file that gzip compressed: from front to
                 back, without seeking
    library      whether a library reads it, each of whose errors is one of the file
    extra        the extra of the installation that the library comes with, empty for none
    is_written   whether ``separator``, ``decimal`` and ``heading_row`` of lab.toml apply
    """

    name: str
    usual_suffixes: tuple[str, ...]
    recognises: Callable[[Source], bool]
    read: Callable[[Source], RawTable]
    read_chunks: Callable[[Source, int], Iterator[RawTable]] | None = None
    reads_gzip: bool = False
    library: bool = False
    extra: str = ""
    is_written: bool = False


@contextmanager
def reading(source: Source, format_name: str, extra: str = "") -> Iterator[None]:
    """Turn whatever a library raises on a damaged file into ``UnreadableFileError``.

    These libraries document no exceptions for damaged input (KeyError, struct.error, zlib.error,
    MemoryError and others were seen), so every kind is taken.
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
            f"reading {format_name} needs the missing Python package {error.name!r}",
            needed=f"the readers of the extra {extra!r}",
            remedy=f"Run: pip install 'piezoid[{extra}]'",
        ) from error
    except (Exception, MemoryError) as error:
        reason = f": {str(error)[:200]}" if str(error) else ""  # short of memory, it says nothing
        raise unreadable(
            source.name,
            f"the {format_name} reader stopped with {type(error).__name__}{reason}",
            needed=f"a whole {format_name} file",
            remedy="Copy the file again from where it was written, or export it as CSV.",
        ) from error
