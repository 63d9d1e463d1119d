"""Where the results of a batch go: a folder, or anything else that fsspec can write to.

A folder is given stages whole or not at all. A store of objects knows no such step: there the
record of a stage is removed first and written last, so that a stage with a record is whole.
"""

import os
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from shutil import copyfileobj
from tempfile import TemporaryFile
from typing import Any, BinaryIO, Protocol

import typer

from piezoid_cli.output_folder import (
    clear_away_below,
    make_folder,
    write_folder_of_many,
    write_made,
)
from piezoid_cli.stage_files import content_of
from piezoid_reports.fleet.records import STAGES

RECORD = "batch.json"


class ResultsPlace(Protocol):
    """What a batch needs of the place of its results; every worker opens one of its own."""

    @property
    def begun(self) -> bool:
        """Whether stages were written before."""

    @property
    def holds_anything(self) -> bool:
        """Whether anything is there at all."""

    def begin(self) -> None:
        """Make the place, from where the batch is started."""

    def check_seen(self) -> None:
        """Raise ``OSError`` where a worker does not see what ``begin`` made."""

    def record_of(self, stage: str) -> bytes:
        """Return what is kept of a stage; raises ``OSError`` where nothing is."""

    def write(self, stage: str, files: Mapping[str, bytes]) -> None:
        """Write the files of a stage, its record among them."""

    def put(self, name: str, made: Callable[[BinaryIO], object]) -> None:
        """Write a file that is said of all stages, as ``made`` fills it."""

    def tidy(self, stages: Iterable[str]) -> None:
        """Remove what killed workers left beside these stages."""


def results_place(results: str) -> ResultsPlace:
    """Return the place behind the name of a folder, or behind a URL such as s3://night/results.

    Raises ``typer.BadParameter`` for a URL nothing here can write to.
    """
    kind, mark, rest = results.partition("://")
    if not mark:
        return Folder(Path(results))
    if kind == "file":
        return Folder(Path(rest))
    return _Store(results)


class Folder:
    """A folder that every worker sees under the same name."""

    def __init__(self, folder: Path) -> None:
        """Look at a folder, which need not be there yet."""
        self._folder = folder.absolute()
        if folder.exists() and not folder.is_dir():
            raise typer.BadParameter(f"{folder} is a file; name a folder for the results")

    @property
    def begun(self) -> bool:
        """Whether stages were written before."""
        stages = self._folder / STAGES
        return stages.is_dir() and any(stages.iterdir())

    @property
    def holds_anything(self) -> bool:
        """Whether anything is there at all."""
        return self._folder.is_dir() and any(self._folder.iterdir())

    def begin(self) -> None:
        """Make the folder of the stages."""
        make_folder(self._folder / STAGES)

    def check_seen(self) -> None:
        """Raise ``OSError`` where this machine has no such folder."""
        if not (self._folder / STAGES).is_dir():
            raise FileNotFoundError(
                f"{os.uname().nodename} does not see {self._folder / STAGES}; name a folder that "
                "every worker sees under the same name, or a URL such as s3://night/results"
            )

    def record_of(self, stage: str) -> bytes:
        """Return the record that lies beside a stage's results."""
        place = self._folder / STAGES / stage / RECORD
        if not place.exists():
            raise FileNotFoundError(str(place))
        return content_of(place)

    def write(self, stage: str, files: Mapping[str, bytes]) -> None:
        """Write the folder of a stage, whole or not at all."""
        write_folder_of_many(self._folder / STAGES / stage, files)

    def put(self, name: str, made: Callable[[BinaryIO], object]) -> None:
        """Write a file, whole or not at all."""
        write_made(self._folder / name, made)

    def tidy(self, stages: Iterable[str]) -> None:
        """Remove half-written folders that workers left when they were killed."""
        below = self._folder / STAGES
        clear_away_below(sorted({(below / stage).parent for stage in stages}))


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

    @property
    def holds_anything(self) -> bool:
        self._files.invalidate_cache()
        return bool(self._files.exists(self._root) and self._files.ls(self._root, detail=False))

    def begin(self) -> None:
        """Do nothing: folders of a store appear with what they hold."""

    def check_seen(self) -> None:
        """Do nothing: a URL names the same place from everywhere."""

    def record_of(self, stage: str) -> bytes:
        return bytes(self._files.cat_file(self._of(stage, RECORD)))

    def write(self, stage: str, files: Mapping[str, bytes]) -> None:
        with suppress(FileNotFoundError):
            self._files.rm_file(self._of(stage, RECORD))
        with suppress(FileNotFoundError):
            self._files.rm(f"{self._root}/{STAGES}/{stage}", recursive=True)
        for name in sorted(files, key=lambda name: name == RECORD):
            place = self._of(stage, name)
            self._files.makedirs(place.rpartition("/")[0], exist_ok=True)
            self._files.pipe_file(place, files[name])

    def put(self, name: str, made: Callable[[BinaryIO], object]) -> None:
        self._files.makedirs(self._root, exist_ok=True)
        with TemporaryFile() as scratch:
            made(scratch)
            scratch.seek(0)
            with self._files.open(f"{self._root}/{name}", "wb") as there:
                copyfileobj(scratch, there)

    def tidy(self, stages: Iterable[str]) -> None:
        """Do nothing: an object is there or not, and the next try replaces what lacks a record."""

    def _of(self, stage: str, name: str) -> str:
        return f"{self._root}/{STAGES}/{stage}/{name}"
