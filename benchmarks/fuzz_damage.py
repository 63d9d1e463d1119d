"""Mutations of files: random bytes, extreme tokens, JSON values and nesting, archive members.

Sealed files get a new digest and archives are packed again, so that readers reach their content.
"""

import gzip
import hashlib
import io
import json
import re
import zipfile
import zlib
from collections.abc import Callable
from copy import deepcopy
from typing import Any

import numpy as np

from piezoid.digests import seal

Damage = Callable[[bytes, np.random.Generator], bytes]
TOKENS = (
    *(b"1e308 -1e308 1e-320 nan inf -inf 1e999 0 -0 99999999999999999999 1,5 0x10".split()),
    *(b"\n \r \t , ; : = \" ' # [ ] { } [[ ]] [[recording]]".split(b" ")),
    *(b"\\ % \x00 \xff\xfe \xef\xbb\xbf".split(b" ")),
    *(b"\x00\x00\x00\x00 \xff\xff\xff\xff \x7f\xff\xff\xff \xff\xff\xff\x7f".split(b" ")),
    b"<script>alert(1)</script>",
    b"*/ int main(void) {",
    "µ m°²".encode(),
)  # fmt: skip
HARD: tuple[Any, ...] = (
    None, True, 0, -1, 1, 2**63, 10**400, 1e308, -1e308, 5e-324, "", "x", "NaN", [], [[]], [0], {},
    [1e308] * 3, {"x": {}}, "\x00", "</script><b>", 10**5, 0.5,
)  # fmt: skip


def mutated_bytes(content: bytes, rng: np.random.Generator) -> bytes:
    """Mutate bytes: flip, cut, repeat, replace, insert extreme tokens and numbers."""
    damaged = bytearray(content)
    for _ in range(1 + int(rng.integers(4))):
        size = max(len(damaged), 1)
        # Half of the mutations are in the first 600 bytes, which contain the header.
        is_header = rng.random() < 0.5
        start = int(rng.integers(min(size, 600) if is_header else size))
        stop = start + int(rng.integers(1, 80))
        match int(rng.integers(7)):
            case 0:
                damaged[start:stop] = bytes(rng.integers(256, size=stop - start, dtype=np.uint8))
            case 1 if rng.random() < 0.3:
                del damaged[start:]
            case 2:
                del damaged[start:stop]
            case 3:
                damaged[start:start] = damaged[start:stop] * int(rng.integers(1, 9))
            case 4:
                token = TOKENS[int(rng.integers(len(TOKENS)))]
                damaged[start : start + len(token) * int(rng.integers(2))] = token
            case 5:
                numbers = list(re.finditer(rb"\d+", bytes(damaged[start : start + 4000])))
                if numbers:
                    begin, end = numbers[int(rng.integers(len(numbers)))].span()
                    damaged[start + begin : start + end] = TOKENS[int(rng.integers(12))]
            case _ if start < len(damaged):
                damaged[start] = int(rng.choice([0, 1, 2, 4, 8, 16, 32, 64, 127, 128, 255]))
    return bytes(damaged[: 1 << 20])


def mutated_json(content: bytes, rng: np.random.Generator) -> bytes:
    """Mutate values, names and nesting of a sealed file, or its text; then seal the result."""
    try:
        record = None if rng.random() < 0.1 else json.loads(content)
    except (ValueError, RecursionError):
        record = None
    if not isinstance(record, dict) or not record.keys() - {"digest"}:
        return resealed(mutated_bytes(content, rng))
    for _ in range(1 + int(rng.integers(2))):
        if not record.keys() - {"digest"}:
            break
        holder, key = _random_entry(record, rng)
        match int(rng.integers(4)):
            case 0:
                del holder[key]
            case 1 if isinstance(holder, list):
                holder.append(holder[key])
            case 2 if isinstance(holder, dict):
                holder[f"{key}_"] = holder.pop(key)
            case _:
                holder[key] = deepcopy(HARD[int(rng.integers(len(HARD)))])
    schema = record.pop("schema", "")
    record.pop("digest", None)
    try:
        return seal(schema, record) if isinstance(schema, str) and record else content
    except ValueError:  # infinity, or a lone surrogate
        return resealed(mutated_bytes(content, rng))


def _random_entry(record: Any, rng: np.random.Generator) -> tuple[Any, Any]:
    """Return a container inside the record and a key or index of it."""
    holder, key = record, str(rng.choice([k for k in record if k != "digest"]))
    while isinstance(holder[key], (dict, list)) and holder[key] and rng.random() < 0.9:
        holder = holder[key]
        names = list(holder) if isinstance(holder, dict) else range(len(holder))
        key = names[int(rng.integers(len(names)))]
    return holder, key


def resealed(content: bytes) -> bytes:
    """Update the digest of the mutated bytes, if they contain one."""
    match = re.search(rb'"digest": "sha256:([0-9a-f]{64})"', content)
    if match is None:
        return content
    blank = content[: match.start(1)] + b"0" * 64 + content[match.end(1) :]
    digest = hashlib.sha256(blank).hexdigest().encode()
    return blank[: match.start(1)] + digest + blank[match.start(1) + 64 :]


def repacked(content: bytes, rng: np.random.Generator, damage: Damage) -> bytes | None:
    """Mutate a member of an archive and pack it again; return None if there is no archive."""
    try:
        if content.startswith(b"\x1f\x8b"):
            return gzip.compress(damage(zlib.decompress(content, 31), rng), 1, mtime=0)
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
    except (zlib.error, zipfile.BadZipFile, OSError, ValueError, RuntimeError, EOFError):
        return None
    if not members:
        return None
    mutated = str(rng.choice(list(members)))
    members[mutated] = damage(members[mutated], rng)
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, member in members.items():
            archive.writestr(zipfile.ZipInfo(name), member)
    return buffer.getvalue()
