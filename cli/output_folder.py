"""A folder of results appears whole or not at all, whatever happens while it is written."""

import ctypes
import errno
import os
import shutil
import signal
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from secrets import token_hex
from typing import BinaryIO

import typer

_AT_FDCWD = -100
_RENAME_EXCHANGE = 2
# Only what ends like this is ever taken for the remains of a run that was killed.
_UNFINISHED = ".unfinished"


def check_free(folder: Path, *, force: bool, inputs: Iterable[Path] = ()) -> None:
    """Refuse a folder that holds something or cannot be written, before any work is done.

    Raises ``typer.BadParameter`` (exit status 2) unless the folder is absent, empty, or ``force``,
    for one that would take with it what is read (``inputs``) or where we stand, ``force`` or not,
    and ``PermissionError`` where nothing can be put beside it.
    """
    target = Path(os.path.realpath(folder))
    if os.path.ismount(target):  # nothing can be put in its place in one step
        raise typer.BadParameter(f"{folder} is a disk of its own; name a folder below it")
    for given in inputs:
        if Path(os.path.realpath(given)).is_relative_to(target):
            raise typer.BadParameter(
                f"{folder} holds {given}, which is read; name another folder for the results"
            )
    if Path.cwd().is_relative_to(target):  # it would be gone from under the shell
        raise typer.BadParameter(f"{folder} is where this command runs; name a folder below it")
    if folder.exists() and not folder.is_dir():
        raise typer.BadParameter(f"{folder} is a file; name a folder for the results")
    if not force and folder.is_dir() and any(folder.iterdir()):
        raise typer.BadParameter(
            f"{folder} is not empty; name another folder, or add --force to replace its contents"
        )
    place = next(above for above in target.parents if above.exists())
    if not os.access(place, os.W_OK | os.X_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(place))


def check_free_file(place: Path, *, force: bool) -> None:
    """Refuse to replace a file, before any work is done.

    Raises ``typer.BadParameter`` (exit status 2) unless nothing is there, or ``force``.
    """
    if place.is_dir():
        raise typer.BadParameter(f"{place} is a folder; name a file")
    if place.exists() and not force:
        raise typer.BadParameter(
            f"{place} is already there; name another file, or add --force to replace it"
        )


def check_there(files: Iterable[Path]) -> None:
    """Refuse names behind which there is nothing, before a file is written that repeats them.

    Raises ``FileNotFoundError``.
    """
    for place in files:
        if not place.exists():
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(place))


def write_file(place: Path, content: bytes) -> None:
    """Write one file whole or not at all."""
    write_made(place, lambda stream: stream.write(content))


def write_made(place: Path, made: Callable[[BinaryIO], object]) -> None:
    """Write what ``made`` puts into a stream, of any length, whole or not at all."""
    with _named(place):
        place.parent.mkdir(parents=True, exist_ok=True)
        fresh = _fresh(place)
        try:
            with fresh.open("x+b") as stream:
                made(stream)
                stream.flush()
                os.fsync(stream.fileno())
            fresh.chmod(0o644)
            fresh.replace(place)
        finally:
            fresh.unlink(missing_ok=True)


def make_folder(place: Path) -> None:
    """Make a folder that others write into."""
    with _named(place):
        place.mkdir(parents=True, exist_ok=True)


def write_folder(folder: Path, contents: Mapping[str, bytes], *, force: bool = True) -> None:
    """Write all files beside the folder, then put the finished one in its place in one step.

    folder    what is to be written
    contents  file names, with / for sub-folders, and their bytes
    force     replace what the folder holds; without it, raises ``typer.BadParameter`` where
              another run has filled the folder since ``check_free``
    """
    target = Path(os.path.realpath(folder))
    with _named(folder):
        target.parent.mkdir(parents=True, exist_ok=True)
        with _alone_in(target.parent):
            check_free(target, force=force)
            _clear_away(target)
            _write(target, contents)


def write_folder_of_many(folder: Path, contents: Mapping[str, bytes]) -> None:
    """Write a folder as ``write_folder`` does, one of very many that lie beside each other.

    Nobody is waited for, and nothing is looked for beside it, which would take longer the more
    there are: ``clear_away_below`` removes what killed runs left.
    """
    target = Path(os.path.realpath(folder))
    with _named(folder):
        target.parent.mkdir(parents=True, exist_ok=True)
        check_free(target, force=True)
        _write(target, contents)


def clear_away_below(folders: Iterable[Path]) -> None:
    """Remove what killed runs left in these folders; while nobody writes there."""
    for folder in folders:
        for place in folder.iterdir() if folder.is_dir() else ():
            if place.name[0] == "." and place.name.endswith(_UNFINISHED):
                shutil.rmtree(place, ignore_errors=True)


def _write(target: Path, contents: Mapping[str, bytes | Path]) -> None:
    fresh = _fresh(target)
    try:
        fresh.mkdir(mode=0o700)
        for name, content in contents.items():
            place = fresh / name
            place.parent.mkdir(parents=True, exist_ok=True)
            with place.open("wb") as stream:
                _fill(stream, content)
                stream.flush()
                os.fsync(stream.fileno())
        fresh.chmod(0o755)
        with _undisturbed():
            _put(fresh, target)
            shutil.rmtree(fresh, ignore_errors=True)
    finally:
        shutil.rmtree(fresh, ignore_errors=True)


def _fresh(target: Path) -> Path:
    """Return a name beside a target that is free. Nothing is there yet: Ctrl-C may come first."""
    return target.with_name(f".{target.name}.{token_hex(4)}{_UNFINISHED}")


def _clear_away(target: Path) -> None:
    """Remove what killed runs left beside the folder; only while nobody else writes there."""
    start = f".{target.name}."
    for place in target.parent.iterdir():
        if place.name.startswith(start) and place.name.endswith(_UNFINISHED):
            shutil.rmtree(place, ignore_errors=True)


@contextmanager
def _named(place: Path) -> Iterator[None]:
    """Let a failing disk name what was to be written, not a file nobody has heard of."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), str(place)) from error


@contextmanager
def _alone_in(folder: Path) -> Iterator[None]:
    """Let nobody else put results into this folder meanwhile; a killed run lets go by itself.

    Some network disks know no locks, and one system has none: there, two runs at the same moment
    still leave one whole folder, that of the later one.
    """
    try:
        import fcntl
    except ModuleNotFoundError:
        yield
        return
    number = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):
            fcntl.flock(number, fcntl.LOCK_EX)
        yield
    finally:
        os.close(number)


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Let Ctrl-C wait until the exchange is done and what it replaced is gone."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def add_to_folder(
    folder: Path, contents: Mapping[str, bytes], *, gone: Sequence[str] = ()
) -> None:
    """Add or replace files of a folder of results, all of them in one step.

    contents  as for ``write_folder``; every other file stays as it is
    gone      files and sub-folders that do not stay, unless ``contents`` has them
    """
    target = Path(os.path.realpath(folder))
    with _named(folder), _alone_in(target.parent):
        held = {
            place.relative_to(target).as_posix(): place
            for place in sorted(target.rglob("*"))
            if place.is_file()
            and not {place.relative_to(target).as_posix(), place.relative_to(target).parts[0]}
            & set(gone)
        }
        _clear_away(target)
        _write(target, {**held, **contents})


def _fill(stream: BinaryIO, content: bytes | Path) -> None:
    """Write bytes, or what a file holds: recordings among them may not fit into memory."""
    if isinstance(content, bytes):
        stream.write(content)
        return
    with content.open("rb") as held:
        shutil.copyfileobj(held, stream)


def _put(fresh: Path, target: Path) -> None:
    """Move ``fresh`` to ``target``; what was there ends under the name of ``fresh``."""
    if not target.exists():
        fresh.rename(target)
        return
    if not _exchanged(fresh, target):
        old = target.with_name(f"{fresh.name}.old")
        target.rename(old)
        fresh.rename(target)
        shutil.rmtree(old, ignore_errors=True)


def _exchanged(first: Path, second: Path) -> bool:
    """Swap two folders atomically where the system can; tell whether it did."""
    try:
        rename = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError):
        return False
    names = os.fsencode(first), os.fsencode(second)
    status: int = rename(_AT_FDCWD, names[0], _AT_FDCWD, names[1], _RENAME_EXCHANGE)
    return status == 0
