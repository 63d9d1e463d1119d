"""A sample file for every registered reader, for the fuzzer, and the table of formats."""

import tempfile
from pathlib import Path

from piezoid.records.readers import READERS, archive
from piezoid.records.readers.reader import Reader, open_source
from tests.records.formats import DESCRIBED, UNDESCRIBED
from tests.records.messy.outcomes import FILES
from tests.records.messy.writers import Write


def samples() -> dict[str, Write]:
    """Return the writers of the known recording, and a messy file for each other reader."""
    writers: dict[str, Write] = {**DESCRIBED, **UNDESCRIBED}
    with tempfile.TemporaryDirectory() as folder:
        covered = {reader_of(Path(folder), name, write).name for name, write in writers.items()}
        for messy in FILES:
            reader = reader_of(Path(folder), messy.name, messy.write)
            if reader.name not in covered:
                covered.add(reader.name)
                writers[messy.name] = messy.write
    return writers


def reader_of(folder: Path, name: str, write: Write) -> Reader:
    """Write a file and return the reader that recognises it."""
    write(folder / name)
    source = open_source(folder / name)
    return next(reader for reader in READERS if reader.recognises(source))


def formats_table() -> str:
    """Return the table of the formats that are read; archives are only recognised."""
    head = "| format | usual endings | needs the extra | with `--stream` |"
    rows = [head, "| --- | --- | --- | --- |"]
    for reader in READERS:
        if reader is not archive.READER:
            endings = ", ".join(f"`{suffix}`" for suffix in reader.usual_suffixes)
            extra = reader.extra and f"`{reader.extra}`"
            chunked = "yes" if reader.read_chunks else ""
            rows.append(f"| {reader.name} | {endings} | {extra} | {chunked} |")
    return "\n".join(rows) + "\n"
