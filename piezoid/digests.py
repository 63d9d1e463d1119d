"""Digests of records and files, for provenance and to detect changes.

A sealed file is JSON text that contains the SHA-256 of its own bytes, computed with zeros in place
of the digest. Any change, even of white space, invalidates the digest.
"""

import hashlib
import json
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, BinaryIO

from piezoid.errors import ParameterFileError

_ZEROS = "0" * 64
_MAX_DIGITS = 20  # of 64 bits
_DIGEST = re.compile(rb'"digest": "sha256:([0-9a-f]{64})"')


def digest_of_bytes(content: bytes) -> str:
    """Return ``sha256:`` and the hexadecimal digest of ``content``."""
    return "sha256:" + hashlib.sha256(content).hexdigest()


def digest_of_json(value: object) -> str:
    """Return the digest of the canonical text of a JSON value."""
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return digest_of_bytes(text.encode())


def seal(schema: str, content: Mapping[str, Any]) -> bytes:
    """Return ``content`` as sealed JSON of a schema such as ``piezoid.model/1``.

    Numbers are printed with enough digits to be read back exactly. Raises ``ValueError`` for NaN
    and infinity.
    """
    record = {"schema": schema, "digest": f"sha256:{_ZEROS}", **content}
    text = json.dumps(record, indent=1, allow_nan=False, ensure_ascii=False) + "\n"
    digest = hashlib.sha256(text.encode()).hexdigest()
    return text.replace(_ZEROS, digest, 1).encode()


def seal_stream(
    schema: str, content: Mapping[str, Any], lines: Iterable[bytes], stream: BinaryIO
) -> None:
    """Write sealed JSON whose last entry, a list, may exceed the memory.

    content  its last value is an empty list, to be filled with ``lines``
    lines    one JSON value each, without line breaks
    stream   empty, binary, seekable
    """
    record = {"schema": schema, "digest": f"sha256:{_ZEROS}", **content}
    head = json.dumps(record, indent=1, allow_nan=False, ensure_ascii=False).encode()
    head, tail = head.removesuffix(b"]\n}"), b"\n ]\n}\n"
    digest_offset = head.index(_ZEROS.encode())
    hasher = hashlib.sha256()

    def write(part: bytes) -> None:
        hasher.update(part)
        stream.write(part)

    write(head)
    for number, line in enumerate(lines):
        write((b"" if number == 0 else b",") + b"\n  " + line)
    write(tail)
    stream.seek(digest_offset)
    stream.write(hasher.hexdigest().encode())
    stream.seek(0, 2)


def unseal(content: bytes, schema: str, file: str) -> dict[str, Any]:
    """Return the content of sealed JSON; raise for another schema or a wrong digest.

    content  bytes  the file
    schema   str    expected schema, ``piezoid.<name>/<version>``
    file     str    name of the file in messages
    """
    match = _DIGEST.search(content)
    if match is None:
        raise ParameterFileError(
            f"{file}: no digest found",
            needed=f"the digest of a sealed file of schema {schema}",
            remedy="Write the file again with piezoid; it cannot be edited by hand.",
        )
    blank = content[: match.start(1)] + _ZEROS.encode() + content[match.end(1) :]
    expected = hashlib.sha256(blank).hexdigest()
    if expected != match.group(1).decode():
        raise ParameterFileError(
            f"{file}: the digest of the content is {expected[:12]}..., but the file states "
            f"{match.group(1).decode()[:12]}...",
            needed="the file, byte for byte as piezoid wrote it",
            remedy="Use the original, or run the command that wrote it again.",
        )
    try:
        record = json.loads(content, parse_int=_integer)
        # Refuse NaN, infinities and lone surrogates, which ``seal`` does not write.
        json.dumps(record, allow_nan=False, ensure_ascii=False).encode()
    except (ValueError, RecursionError) as error:  # sealed by another program
        raise ParameterFileError(
            f"{file}: {type(error).__name__}: {error}",
            needed="JSON text in UTF-8",
            remedy="Write the file again from the recordings.",
        ) from error
    stated = record.get("schema") if isinstance(record, dict) else None
    if stated != schema:
        raise ParameterFileError(
            f"{file}: the schema is {stated!r}",
            needed=f"schema {schema!r}, which this version of piezoid reads",
            remedy="Write the file again from the recordings with this version.",
        )
    return dict(record)


def digest_in(content: bytes) -> str:
    """Return the digest that a sealed file states, without checking it."""
    return str(json.loads(content).get("digest"))


def _integer(digits: str) -> int:
    """Return an integer; raise ``ValueError`` for more digits than a float can represent."""
    if len(digits) > _MAX_DIGITS:
        raise ValueError(f"a whole number of {len(digits)} digits")
    return int(digits)


def digest_of_file(path: Path) -> str:
    """Return the digest of a file, which may exceed the memory."""
    with path.open("rb") as stream:
        return "sha256:" + hashlib.file_digest(stream, "sha256").hexdigest()
