"""Damage to files: bytes at random and hard on purpose, values and depth of JSON, archives within.

A sealed file is sealed again and an archive packed again: only then is what is inside read at all.
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
    """Damage bytes: flips, cuts, repeats, swaps, hard tokens, numbers made hard."""
    damaged = bytearray(content)
    for _ in range(1 + int(rng.integers(4))):
        size = max(len(damaged), 1)
        # Headers stand at the beginning, and much depends on them.
        near = int(rng.integers(min(size, 600))) if rng.random() < 0.5 else int(rng.integers(size))
        far = near + int(rng.integers(1, 80))
        match int(rng.integers(7)):
            case 0:
                damaged[near:far] = bytes(rng.integers(256, size=far - near, dtype=np.uint8))
            case 1 if rng.random() < 0.3:
                del damaged[near:]
            case 2:
                del damaged[near:far]
            case 3:
                damaged[near:near] = damaged[near:far] * int(rng.integers(1, 9))
            case 4:
                token = TOKENS[int(rng.integers(len(TOKENS)))]
                damaged[near : near + len(token) * int(rng.integers(2))] = token
            case 5:
                numbers = list(re.finditer(rb"\d+", bytes(damaged[near : near + 4000])))
                if numbers:
                    begin, end = numbers[int(rng.integers(len(numbers)))].span()
                    damaged[near + begin : near + end] = TOKENS[int(rng.integers(12))]
            case _ if near < len(damaged):
                damaged[near] = int(rng.choice([0, 1, 2, 4, 8, 16, 32, 64, 127, 128, 255]))
    return bytes(damaged[: 1 << 20])


def mutated_json(content: bytes, rng: np.random.Generator) -> bytes:
    """Damage a sealed file's values, names and depth, or its text; then seal it."""
    try:
        record = None if rng.random() < 0.1 else json.loads(content)
    except (ValueError, RecursionError):
        record = None
    if not isinstance(record, dict) or not record.keys() - {"digest"}:
        return resealed(mutated_bytes(content, rng))
    for _ in range(1 + int(rng.integers(2))):
        if not record.keys() - {"digest"}:
            break
        holder, key = _place_in(record, rng)
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
    except ValueError:  # what was read as infinity, or half a character
        return resealed(mutated_bytes(content, rng))


def _place_in(record: Any, rng: np.random.Generator) -> tuple[Any, Any]:
    holder, key = record, str(rng.choice([k for k in record if k not in ("digest",)]))
    while isinstance(holder[key], (dict, list)) and holder[key] and rng.random() < 0.9:
        holder = holder[key]
        names = list(holder) if isinstance(holder, dict) else range(len(holder))
        key = names[int(rng.integers(len(names)))]
    return holder, key


def resealed(content: bytes) -> bytes:
    """Write the digest that the damaged bytes need; the bytes as they are where there is none."""
    match = re.search(rb'"digest": "sha256:([0-9a-f]{64})"', content)
    if match is None:
        return content
    blank = content[: match.start(1)] + b"0" * 64 + content[match.end(1) :]
    digest = hashlib.sha256(blank).hexdigest().encode()
    return blank[: match.start(1)] + digest + blank[match.start(1) + 64 :]


def repacked(content: bytes, rng: np.random.Generator, damage: Damage) -> bytes | None:
    """Damage what an archive holds instead of the archive; None where it is none."""
    try:
        if content.startswith(b"\x1f\x8b"):
            return gzip.compress(damage(zlib.decompress(content, 31), rng), 1, mtime=0)
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            held = {name: archive.read(name) for name in archive.namelist()}
    except (zlib.error, zipfile.BadZipFile, OSError, ValueError, RuntimeError, EOFError):
        return None
    if not held:
        return None
    chosen = str(rng.choice(list(held)))
    held[chosen] = damage(held[chosen], rng)
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, member in held.items():
            archive.writestr(zipfile.ZipInfo(name), member)
    return buffer.getvalue()
