"""Results of a batch: a folder, or an object store that fsspec can write to.

A folder receives the files of a stage in one atomic step. In an object store, the record of a
stage is deleted first and written last, so that a stage with a record is complete. In both, only
files that a manifest lists are replaced; edited files are only recognised in a folder.
"""

import os
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from shutil import copyfileobj
from tempfile import TemporaryFile
from typing import Any, BinaryIO

import typer

from piezoid.digests import digest_of_bytes
from piezoid.manifest import MANIFEST, manifest_of, missing_files, read_manifest
from piezoid.output_folder import (
    add_to_folder,
    check_folder,
    refusal,
    remove_unfinished,
    write_folder,
)
from piezoid_cli.stage_files import content_of
from piezoid_reports.fleet.records import STAGES

RECORD = "batch.json"
SUMMARY = ("summary.html", "parameters.parquet", RECORD)


def result_store(results: str, *, force: bool = False) -> "FolderStore | ObjectStore":
    """Return the store for a folder, or for a URL such as s3://night/results.

    force  replace edited results in a folder

    Raises ``typer.BadParameter`` for a URL that fsspec cannot write to.
    """
    scheme, separator, path = results.partition("://")
    if separator and scheme != "file":
        return ObjectStore(results)
    return FolderStore(Path(path if separator else results), force=force)


class FolderStore:
    """A folder that every worker sees under the same name."""

    def __init__(self, folder: Path, *, force: bool = False) -> None:
        """Set the folder, which need not exist yet."""
        self._folder, self._force = folder.absolute(), force
        self._stages = self._folder / STAGES

    def check(self) -> None:
        """Raise ``OutputFolderError`` if the folder may not be written."""
        check_folder(self._folder, force=self._force, names=SUMMARY)
        self.check_stage("")

    def check_stage(self, stage: str) -> None:
        """Raise ``OutputFolderError`` if the folder of a stage may not be written."""
        path = self._stages / stage
        expected = os.path.join(os.path.realpath(self._folder), STAGES, stage)
        if os.path.realpath(path) != os.path.normpath(expected):
            raise refusal(f"{path} is reached through a link, which is not followed")
        check_folder(path, force=self._force)

    def create(self) -> None:
        """Create the folders, each with a manifest of piezoid."""
        for folder in (self._folder, self._stages):
            if not (folder / MANIFEST).is_file():
                add_to_folder(folder, {})

    def check_visible(self) -> None:
        """Raise ``OSError`` if this machine does not see the folder from ``create``."""
        if not self._stages.is_dir():
            raise FileNotFoundError(
                f"{os.uname().nodename} does not see {self._stages}; name a folder that every "
                "worker sees under the same name, or a URL such as s3://night/results"
            )

    def read_record(self, stage: str) -> bytes:
        """Return the record of a stage; raise ``OSError`` if any of its files is missing."""
        folder = self._stages / stage
        for name in (RECORD, *missing_files(folder)):
            if not (folder / name).exists():
                raise FileNotFoundError(str(folder / name))
        return content_of(folder / RECORD)

    def write_stage(self, stage: str, files: Mapping[str, bytes]) -> None:
        """Write the files of a stage, replacing those of an earlier run."""
        folder = self._stages / stage
        for parent in reversed(folder.relative_to(self._stages).parents[:-1]):
            if not (self._stages / parent).exists():  # the parent may become a stage itself
                add_to_folder(self._stages / parent, {})
        write_folder(folder, files, force=self._force, shared=True)

    def write_file(self, name: str, write: Callable[[BinaryIO], object]) -> None:
        """Write a file about all stages; ``write`` fills a stream."""
        add_to_folder(self._folder, {name: write}, force=self._force)

    def remove_unfinished(self, stages: Iterable[str]) -> None:
        """Delete half-written folders of killed workers next to these stages."""
        for folder in sorted({(self._stages / stage).parent for stage in stages}):
            remove_unfinished(folder)


class ObjectStore:
    """Objects under a URL that is the same for every worker."""

    def __init__(self, url: str) -> None:
        """Open the store; raise ``typer.BadParameter`` if fsspec cannot write to it."""
        import fsspec

        try:
            self._files: Any
            self._files, self._root = fsspec.core.url_to_fs(url.rstrip("/"))
        except (ImportError, ValueError) as error:
            raise typer.BadParameter(f"cannot write to {url}: {error}") from error

    def check(self) -> None:
        """Raise ``OutputFolderError`` if the URL contains objects without a manifest."""
        self._files.invalidate_cache()
        self._listed(self._root)

    def check_stage(self, stage: str) -> None:
        """Raise ``OutputFolderError`` if a stage contains objects without a manifest."""
        self._listed(self._path(stage))

    def create(self) -> None:
        """Write the manifest of piezoid."""
        self._write(f"{self._root}/{MANIFEST}", manifest_of(dict.fromkeys(SUMMARY, "")))

    def check_visible(self) -> None:
        """Do nothing: a URL is the same on every machine."""

    def read_record(self, stage: str) -> bytes:
        """Return the record of a stage; raise ``OSError`` if it does not exist."""
        return bytes(self._files.cat_file(self._path(stage, RECORD)))

    def write_stage(self, stage: str, files: Mapping[str, bytes]) -> None:
        """Write the objects of a stage: the manifest first, the record last."""
        listed = self._listed(self._path(stage))
        for name in (RECORD, *sorted(listed)):
            with suppress(FileNotFoundError):
                self._files.rm_file(self._path(stage, name))
        manifest = manifest_of({name: digest_of_bytes(text) for name, text in files.items()})
        self._write(self._path(stage, MANIFEST), manifest)
        for name in sorted(files, key=lambda name: (name == RECORD, name)):
            self._write(self._path(stage, name), files[name])

    def write_file(self, name: str, write: Callable[[BinaryIO], object]) -> None:
        """Write an object about all stages; ``write`` fills a stream."""
        self._files.makedirs(self._root, exist_ok=True)
        with TemporaryFile() as scratch:
            write(scratch)
            scratch.seek(0)
            with self._files.open(f"{self._root}/{name}", "wb") as stream:
                copyfileobj(scratch, stream)

    def remove_unfinished(self, stages: Iterable[str]) -> None:
        """Do nothing: the next run replaces stages without a record."""

    def _listed(self, prefix: str) -> tuple[str, ...]:
        """Return the names in the manifest under a prefix; refuse objects without a manifest."""
        with suppress(FileNotFoundError):
            if (listed := read_manifest(self._files.cat_file(f"{prefix}/{MANIFEST}"))) is not None:
                return tuple(listed)
        if self._files.exists(prefix) and self._files.ls(prefix, detail=False):
            raise refusal(f"{prefix} is not empty and has no manifest of piezoid")
        return ()

    def _write(self, path: str, content: bytes) -> None:
        self._files.makedirs(path.rpartition("/")[0], exist_ok=True)
        self._files.pipe_file(path, content)

    def _path(self, *names: str) -> str:
        return "/".join((self._root, STAGES, *names))
