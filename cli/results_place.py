"""Where the results of a batch go: a folder, or anything else that fsspec can write to.

A folder is given stages whole or not at all. A store of objects knows no such step: there the
record of a stage is removed first and written last, so that a stage with a record is whole. In
both, only what a manifest lists is replaced; edits are recognised in a folder only.
"""

import os
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from shutil import copyfileobj
from tempfile import TemporaryFile
from typing import Any, BinaryIO, Protocol

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


class ResultsPlace(Protocol):
    """What a batch needs of the place of its results; every worker opens one of its own."""

    @property
    def begun(self) -> bool:
        """Whether stages were written before."""

    def check(self) -> None:
        """Raise ``OutputFolderError`` where the place may not be written."""

    def check_stage(self, stage: str) -> None:
        """Raise ``OutputFolderError`` where the results of a stage may not be written."""

    def begin(self) -> None:
        """Make the place, from where the batch is started."""

    def check_seen(self) -> None:
        """Raise ``OSError`` where a worker does not see what ``begin`` made."""

    def record_of(self, stage: str) -> bytes:
        """Return what is kept of a stage; raises ``OSError`` where nothing is."""

    def write(self, stage: str, files: Mapping[str, bytes]) -> None:
        """Write the files of a stage, its record among them."""

    def put(self, name: str, write: Callable[[BinaryIO], object]) -> None:
        """Write a file about all stages, as ``made`` fills it."""

    def tidy(self, stages: Iterable[str]) -> None:
        """Remove what killed workers left beside these stages."""


def results_place(results: str, *, force: bool = False) -> ResultsPlace:
    """Return the place behind the name of a folder, or behind a URL such as s3://night/results.

    force  replace results in a folder although they were edited

    Raises ``typer.BadParameter`` for a URL nothing here can write to.
    """
    kind, mark, rest = results.partition("://")
    if not mark:
        return Folder(Path(results), force=force)
    if kind == "file":
        return Folder(Path(rest), force=force)
    return _Store(results)


class Folder:
    """A folder that every worker sees under the same name."""

    def __init__(self, folder: Path, *, force: bool = False) -> None:
        """Look at a folder, which need not be there yet."""
        self._folder, self._force = folder.absolute(), force

    @property
    def begun(self) -> bool:
        """Whether stages were written before."""
        return (self._folder / STAGES).is_dir()

    def check(self) -> None:
        """Refuse what is no folder of a batch, a link on the way to its stages included."""
        check_folder(self._folder, force=self._force, names=SUMMARY)
        self.check_stage("")

    def check_stage(self, stage: str) -> None:
        """Refuse a folder of others in the place of a stage, and a link on the way to it."""
        place = self._folder / STAGES / stage
        real = os.path.join(os.path.realpath(self._folder), STAGES, stage)
        if os.path.realpath(place) != os.path.normpath(real):
            raise refusal(f"{place} lies behind a link, which is not followed")
        check_folder(place, force=self._force)

    def begin(self) -> None:
        """Make the folder of the stages; a manifest says from now on whose it is."""
        for folder in (self._folder, self._folder / STAGES):
            if not (folder / MANIFEST).is_file():
                add_to_folder(folder, {})

    def check_seen(self) -> None:
        """Raise ``OSError`` where this machine has no such folder."""
        if not (self._folder / STAGES).is_dir():
            raise FileNotFoundError(
                f"{os.uname().nodename} does not see {self._folder / STAGES}; name a folder that "
                "every worker sees under the same name, or a URL such as s3://night/results"
            )

    def record_of(self, stage: str) -> bytes:
        """Return the record that lies beside a stage's results, if all of them are there."""
        place = self._folder / STAGES / stage
        for name in (RECORD, *missing_files(place)):
            if not (place / name).exists():
                raise FileNotFoundError(str(place / name))
        return content_of(place / RECORD)

    def write(self, stage: str, files: Mapping[str, bytes]) -> None:
        """Write the folder of a stage in the place of what it holds of ours."""
        place = self._folder / STAGES / stage
        for above in reversed(place.relative_to(self._folder / STAGES).parents[:-1]):
            if not (self._folder / STAGES / above).exists():  # a stage too, perhaps, later on
                add_to_folder(self._folder / STAGES / above, {})
        write_folder(place, files, force=self._force, shared=True)

    def put(self, name: str, write: Callable[[BinaryIO], object]) -> None:
        """Write a file, whole or not at all."""
        add_to_folder(self._folder, {name: write}, force=self._force)

    def tidy(self, stages: Iterable[str]) -> None:
        """Remove half-written folders that workers left when they were killed."""
        below = self._folder / STAGES
        for folder in sorted({(below / stage).parent for stage in stages}):
            remove_unfinished(folder)


class _Store:
    """Anything fsspec can write to."""

    def __init__(self, url: str) -> None:
        import fsspec

        try:
            self._files: Any
            self._files, self._root = fsspec.core.url_to_fs(url.rstrip("/"))
        except (ImportError, ValueError) as error:
            raise typer.BadParameter(f"nothing can be written to {url}: {error}") from error

    @property
    def begun(self) -> bool:
        self._files.invalidate_cache()
        return bool(self._files.exists(f"{self._root}/{STAGES}"))

    def check(self) -> None:
        """Refuse a prefix that holds something and no manifest; edits are not seen there."""
        self._files.invalidate_cache()
        self._listed(self._root)

    def check_stage(self, stage: str) -> None:
        """Refuse objects of others in the place of a stage; edits are not seen there."""
        self._listed(f"{self._root}/{STAGES}/{stage}")

    def _listed(self, prefix: str) -> tuple[str, ...]:
        """Return the names of ours below a prefix."""
        with suppress(FileNotFoundError):
            if (listed := read_manifest(self._files.cat_file(f"{prefix}/{MANIFEST}"))) is not None:
                return tuple(listed)
        if self._files.exists(prefix) and self._files.ls(prefix, detail=False):
            raise refusal(f"{prefix} is not empty and bears no manifest of piezoid")
        return ()

    def begin(self) -> None:
        """Write the manifest that says whose the place is; folders appear with what they hold."""
        self._pipe(f"{self._root}/{MANIFEST}", manifest_of(dict.fromkeys(SUMMARY, "")))

    def check_seen(self) -> None:
        """Do nothing: a URL names the same place from everywhere."""

    def record_of(self, stage: str) -> bytes:
        return bytes(self._files.cat_file(self._of(stage, RECORD)))

    def write(self, stage: str, files: Mapping[str, bytes]) -> None:
        listed = self._listed(f"{self._root}/{STAGES}/{stage}")
        manifest = manifest_of({name: digest_of_bytes(text) for name, text in files.items()})
        for name in sorted(listed, key=lambda name: name != RECORD):
            with suppress(FileNotFoundError):
                self._files.rm_file(self._of(stage, name))
        for name, text in sorted({**files, MANIFEST: manifest}.items(), key=_manifest_then_record):
            self._pipe(self._of(stage, name), text)

    def _pipe(self, path: str, content: bytes) -> None:
        self._files.makedirs(path.rpartition("/")[0], exist_ok=True)
        self._files.pipe_file(path, content)

    def put(self, name: str, write: Callable[[BinaryIO], object]) -> None:
        self._files.makedirs(self._root, exist_ok=True)
        with TemporaryFile() as scratch:
            write(scratch)
            scratch.seek(0)
            with self._files.open(f"{self._root}/{name}", "wb") as stream:
                copyfileobj(scratch, stream)

    def tidy(self, stages: Iterable[str]) -> None:
        """Do nothing: an object is there or not, and the next try replaces what lacks a record."""

    def _of(self, stage: str, name: str) -> str:
        return f"{self._root}/{STAGES}/{stage}/{name}"


def _manifest_then_record(file: tuple[str, bytes]) -> tuple[bool, bool]:
    """Order files so that a stage with a record is whole, and one without one is ours."""
    return file[0] == RECORD, file[0] != MANIFEST
