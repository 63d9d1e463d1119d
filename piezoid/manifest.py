"""Manifests: the files of a folder that piezoid wrote, with their digests.

A manifest is sealed JSON. While files are replaced one by one, it lists both the new and the
previous digests of each file.
"""

import os
import stat
from collections.abc import Collection, Mapping
from contextlib import suppress
from json import loads
from pathlib import Path, PurePosixPath

from piezoid.digests import digest_of_bytes, digest_of_file, seal, unseal
from piezoid.errors import PiezoidError

MANIFEST = "manifest.json"
SCHEMA = "piezoid.manifest/1"
# Unsealed files of versions without a manifest; replaced only with ``force``.
UNSEALED = (
    *("report.html", "diagnosis.html", "design.html", "summary.html", "parameters.parquet"),
    *("drive.csv", "bundle/piezo_params.h", "bundle/piezoid_runtime.h"),
    *("bundle/piezoid_runtime.c", "bundle/example_main.c", "bundle/golden.csv"),
    "bundle/README.md",
)
_MAX_SEALED_bytes = 1 << 27

Listed = Mapping[str, Collection[str]]  # file names, each with its valid digests


def is_as_written(path: Path) -> bool:
    """Return whether a file is unchanged since piezoid wrote it; True without a manifest."""
    listed = manifest_in(path.parent)
    return listed is None or digest_of_file(path) in listed.get(path.name, ())


def missing_files(folder: Path) -> list[str]:
    """Return the files in the manifest of a folder that do not exist."""
    return [n for n in manifest_in(folder) or () if not is_regular(folder / n)]


def lists_results(folder: str | Path) -> bool:
    """Return whether a folder has the manifest of a calibrated stage or of a batch."""
    listed = manifest_in(Path(folder)) or ()
    return "model.json" in listed or "batch.json" in listed


def manifest_in(folder: Path) -> dict[str, set[str]] | None:
    """Return the files listed in the manifest of a folder; None without a manifest."""
    return read_manifest(_read_small(folder / MANIFEST))


def read_manifest(content: bytes) -> dict[str, set[str]] | None:
    """Return the listed names with their digests, or None for other content."""
    try:
        record = unseal(content, SCHEMA, MANIFEST)
        listed = {name: set(digests) for name, digests in record.get("previous", {}).items()}
        for name, digest in record["files"].items():
            listed.setdefault(name, set()).add(digest)
    except (PiezoidError, KeyError, AttributeError, TypeError):
        return None
    parts = [PurePosixPath(name).parts for name in listed]
    return listed if all(p and p[0] != "/" and ".." not in p for p in parts) else None


def files_without_manifest(target: Path) -> dict[str, set[str]]:
    """Return files of piezoid in a folder without a manifest: sealed files and companions."""
    listed = {}
    for name in os.listdir(target):
        if not name.endswith(".json") or name == MANIFEST:
            continue
        content = _read_small(target / name)
        with suppress(PiezoidError, ValueError, KeyError, TypeError, RecursionError):
            schema = str(loads(content)["schema"])
            unseal(content, schema, "")  # raises if the file is not sealed
            if schema.startswith("piezoid."):
                listed[name] = {digest_of_bytes(content)}
    unknown: dict[str, set[str]] = {n: set() for n in UNSEALED if is_regular(target / n)}
    return listed | unknown if listed else {}


def _read_small(path: Path) -> bytes:
    """Return the content of a regular file; empty for links, pipes and large files."""
    with suppress(OSError):
        if is_regular(path) and path.lstat().st_size <= _MAX_SEALED_bytes:
            return path.read_bytes()
    return b""


def is_regular(path: Path) -> bool:
    """Return whether a path is a regular file and not a link."""
    return os.path.lexists(path) and stat.S_ISREG(path.lstat().st_mode)


def manifest_of(files: Mapping[str, str], *, previous: Listed | None = None) -> bytes:
    """Return the manifest of files with their digests, and with the previous digests."""
    record: dict[str, object] = {"files": dict(sorted(files.items()))}
    if previous is not None:
        record["previous"] = {name: sorted(digests) for name, digests in sorted(previous.items())}
    return seal(SCHEMA, record)
