"""Reader: the contract of one file format."""

from collections.abc import Callable
from dataclasses import dataclass

from piezoid.records.readers.source import Source
from piezoid.records.table import RawTable


@dataclass(frozen=True, kw_only=True)
class Reader:
    """One format.

    name        as `piezoid inspect` shows it
    suffixes    the usual endings of its files, for the documentation and for messages
    recognises  tells from the first bytes (between cousins, the suffix) whether it is this one
    read        reads it; anything wrong with the file is an ``UnreadableFileError``
    """

    name: str
    suffixes: tuple[str, ...]
    recognises: Callable[[Source], bool]
    read: Callable[[Source], RawTable]
