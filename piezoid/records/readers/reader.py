"""Reader: the interface of one file format, and the opened files that readers get.

Files are bounded, decompressed and decoded, with an error for every failure. Errors of libraries
are converted.
"""

import contextlib
import errno
import gzip
import io
import os
import re
import stat
import warnings
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from piezoid.digests import digest_of_file
from piezoid.errors import PiezoidError, UnreadableFileError
from piezoid.records.table import RawTable

# An hour at 20 kHz with six doubles per row is 3.5 GB; usual recordings are much shorter. A
# hostile archive of a few kilobytes must not fill the memory.
SIZE_LIMIT = 1 << 31
# Half the bits of measured numbers are noise, which cannot be compressed. Up to 64 MB are always
# accepted.
MAX_GROWTH = 200
FREE_SIZE = 1 << 26
HEAD_SIZE = 1 << 16
# Reading and checking five million rows of three columns (123 MB of text) took 1,140 MB.
MEMORY_PER_BYTE = 9
# The time of the checks is proportional to the number of columns; recorders have some hundred.
MAX_COLUMNS = 4096
_PIECE = 1 << 20
# An en dash before a number or an exponent is a sign; between two numbers it is a range.
_DASH_AS_MINUS = re.compile(r"(?:(?<![\w.])|(?<=\d[eEdD]))\u2013(?=[\d.,])")
_REMEDY_TOO_LARGE = (
    "Fit it with --stream, cut the recording into several files, or keep only the columns that "
    "matter."
)
_REMEDY_TOO_DENSE = (
    f"Measured numbers are not compressed by a factor of {MAX_GROWTH}; if these are measured, "
    "write the file without compression."
)


def unreadable(
    file: str, problem: str, *, needed: str, remedy: str, **numbers: object
) -> UnreadableFileError:
    """Return the error of readers; the message begins with the name of the file."""
    return UnreadableFileError(f"{file}: {problem}", needed=needed, remedy=remedy, **numbers)


@dataclass(frozen=True, kw_only=True)
class TextFormat:
    """Layout of a text table as declared in lab.toml; None if undeclared.

    separator    between the fields; empty for runs of white space
    decimal      ``.`` or ``,``
    heading_row  line of the headings, from 1
    """

    separator: str | None = None
    decimal: str | None = None
    heading_row: int | None = None

    @property
    def entries(self) -> dict[str, str | int]:
        """The declared values by key."""
        return {key: value for key, value in vars(self).items() if value is not None}


@dataclass(frozen=True, kw_only=True, eq=False)
class Source:
    """An opened file of unknown format.

    path          of the file
    suffix        of the name in lower case, without ``.gz``
    digest        of the file's bytes
    head          the first bytes of the content, decompressed
    is_gzip       whether the file as a whole is compressed by gzip
    decompressed  the content of a compressed file if it is in memory, else None
    in_memory     whether the file is read as a whole; otherwise in chunks, of any size
    text          layout of a text table, as declared in lab.toml
    """

    path: Path
    suffix: str
    digest: str
    head: bytes
    is_gzip: bool
    decompressed: bytes | None
    in_memory: bool = True
    text: TextFormat = TextFormat()

    @property
    def name(self) -> str:
        """The file's name without its folder; undecodable bytes as ``\\xff``."""
        return os.fsencode(self.path.name).decode("utf-8", "backslashreplace")

    def open(self) -> BinaryIO:
        """Open the content as a binary stream."""
        content = self.decompressed
        return self.path.open("rb") if content is None else io.BytesIO(content)

    def size(self) -> int:
        """Return the number of bytes of the content."""
        content = self.decompressed
        return self.path.stat().st_size if content is None else len(content)


def open_source(path: Path, *, in_memory: bool = True) -> Source:
    """Open a file and decompress it if it is gzip, refusing more than ``SIZE_LIMIT`` bytes.

    in_memory  False: a file of any size, of which only the beginning is decompressed
    """
    try:
        size = regular_size(path)
        if in_memory:
            check_size(path.name, size, SIZE_LIMIT)
        with path.open("rb") as stream:
            # Files of /proc have size 0 and may never end.
            head = stream.read(min(size, HEAD_SIZE))
        digest = digest_of_file(path) if head else ""
    except OSError as error:
        if path.is_dir():
            raise unreadable(
                str(path),
                "it is a folder",
                needed="a recording",
                remedy=f"Name its files, as in {path / '*.csv'}; piezoid batch takes folders.",
            ) from error
        raise unreadable(
            str(path),
            error.strerror or str(error),
            needed="a file that can be read",
            remedy="Check the name and the permissions.",
        ) from error
    decompressed, is_gzip = None, head.startswith(b"\x1f\x8b")
    if is_gzip:
        limit, content = growth_limit(size) if in_memory else HEAD_SIZE, bytearray()
        try:
            # Read in pieces until the limit is exceeded; a single read would ignore the limit.
            with gzip.open(path, "rb") as unpacked:
                while len(content) <= limit and (piece := unpacked.read(_PIECE)):
                    content += piece
        except (OSError, EOFError, zlib.error) as error:
            raise unreadable(
                path.name,
                f"the gzip archive is damaged ({error})",
                needed="an archive that unpacks",
                remedy="Copy the file again from where it was written.",
            ) from error
        if in_memory:
            check_size(path.name, len(content), limit)
        decompressed = bytes(content)
        head = decompressed[:HEAD_SIZE]
    if not head:
        raise unreadable(
            path.name,
            "the file is empty",
            needed="a table of numbers",
            remedy="Export the recording again.",
        )
    inner = path.name[:-3] if path.name.lower().endswith(".gz") else path.name
    return Source(
        path=path,
        suffix=Path(inner).suffix.lower(),
        digest=digest,
        head=head,
        is_gzip=is_gzip,
        decompressed=decompressed if in_memory else None,
        in_memory=in_memory,
    )


def regular_size(path: Path) -> int:
    """Return the size of a file; ``OSError`` for a pipe or a device, which may never end."""
    status = path.stat()
    if not stat.S_ISREG(status.st_mode):
        kind = errno.EISDIR if stat.S_ISDIR(status.st_mode) else errno.EINVAL
        reason = "Is a directory" if kind == errno.EISDIR else "It is a pipe or a device"
        raise OSError(kind, reason, str(path))
    return status.st_size


def growth_limit(size: int, *, in_memory: bool = True) -> int:
    """Return the largest number of decompressed bytes of a file of some size.

    in_memory  False: without a limit by memory, for reading in chunks
    """
    grown = max(FREE_SIZE, MAX_GROWTH * size)
    return min(SIZE_LIMIT, grown) if in_memory else grown


def check_growth(source: Source, size: int) -> None:
    """Refuse content of ``size`` bytes that grew implausibly or does not fit into memory."""
    limit = growth_limit(source.path.stat().st_size, in_memory=source.in_memory)
    check_size(source.name, size, limit)
    if source.in_memory:
        check_memory(source.name, size)


def check_memory(file: str, size: int) -> None:
    """Refuse a recording that does not fit into memory, before it is read.

    size  bytes of its numbers as doubles, or of its text, which takes about as much
    """
    free = available_bytes()
    needed = MEMORY_PER_BYTE * size
    if free is not None and needed > free:
        raise unreadable(
            file,
            f"reading it takes about {needed / 1e9:.1f} GB of memory, and {free / 1e9:.1f} GB are "
            "free",
            needed="a recording that fits into memory",
            remedy="Fit it with --stream, which reads in chunks; or cut the recording into "
            "several files.",
            size=size,
        )


def available_bytes() -> int | None:
    """Return the free memory of this process in bytes; None if unknown."""
    limits = []
    with contextlib.suppress(OSError, ValueError, IndexError):
        sizes = dict(line.split(":") for line in Path("/proc/meminfo").read_text().splitlines())
        # "kB" means 1024 bytes here.
        limits.append(
            1024 * sum(int(sizes[key].split()[0]) for key in ("MemAvailable", "SwapFree"))
        )
    with contextlib.suppress(ImportError, OSError, ValueError):
        import resource

        limit = resource.getrlimit(resource.RLIMIT_AS)[0]
        if limit != resource.RLIM_INFINITY:
            pages = int(Path("/proc/self/statm").read_text().split()[0])
            limits.append(max(limit - pages * resource.getpagesize(), 0))
    return min(limits, default=None)


def check_size(file: str, size: int, limit: int) -> None:
    """Refuse content of more than ``limit`` decompressed bytes."""
    if size > limit:
        raise unreadable(
            file,
            f"it holds {size} bytes once unpacked",
            needed=f"at most {limit} bytes",
            remedy=_REMEDY_TOO_LARGE if limit == SIZE_LIMIT else _REMEDY_TOO_DENSE,
            size=size,
        )


def check_columns(file: str, columns: int) -> None:
    """Refuse a table with too many columns: a file without line breaks, or a hostile heading."""
    if columns > MAX_COLUMNS:
        raise unreadable(
            file,
            f"it has {columns} columns",
            needed=f"at most {MAX_COLUMNS}, a row for each sample",
            remedy="Keep only the columns that matter, or transpose the table.",
            columns=columns,
        )


def text_of(source: Source) -> str:
    """Decode text as UTF-8, UTF-16 with or without byte order mark, or else as Latin-1."""
    check_memory(source.name, source.size())
    encoding = encoding_of(source.head)
    if not encoding.startswith("utf-16"):
        refuse_zero_bytes(source)
    with source.open() as stream:
        content = stream.read()
    try:
        text = content.decode(encoding, errors="strict" if encoding == "utf-8-sig" else "replace")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    return with_hyphens(text.replace("\r\n", "\n").replace("\r", "\n"))


def refuse_zero_bytes(source: Source) -> None:
    """Refuse a text with a zero byte, naming its line, before it is loaded into memory."""
    line, first = 1, 0
    with source.open() as stream:
        while piece := stream.read(_PIECE):
            position = piece.find(b"\x00")
            if position >= 0:
                line += piece.count(b"\n", 0, position)
                raise unreadable(
                    source.name,
                    f"line {line} holds a zero byte (byte {first + position + 1} of the file), as "
                    "a computer leaves that stopped while it wrote",
                    needed="a text table to its end",
                    remedy="Copy the file again from where it was written, or remove the zero "
                    "bytes and the rows that they cut; an empty cell is read as a lost sample.",
                    line=line,
                )
            line += piece.count(b"\n")
            first += len(piece)


def with_hyphens(text: str) -> str:
    """Replace the minus signs and en dashes of word processors and some locales by hyphens."""
    text = text.replace("\u2212", "-")
    return _DASH_AS_MINUS.sub("-", text) if "\u2013" in text else text


def encoding_of(head: bytes) -> str:
    """Return the encoding of a text from its first bytes: UTF-16, UTF-8 or Latin-1.

    Every second byte of Latin letters and digits in UTF-16 is zero, with or without a mark.
    """
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    pairs = len(head) // 2
    zeros = [head[first : 2 * pairs : 2].count(0) for first in (0, 1)]
    if pairs > 1 and min(zeros) == 0 and max(zeros) > 0.9 * pairs:
        return "utf-16-be" if zeros[0] else "utf-16-le"
    try:
        head.decode("utf-8")
    except UnicodeDecodeError as error:
        # The last letter of the head may be incomplete.
        return "utf-8-sig" if error.start > len(head) - 4 else "latin-1"
    return "utf-8-sig"


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
