"""Write folders of results without changing files that piezoid did not write.

A folder is written if it is new, empty, or has a manifest: the sealed file ``manifest.json`` lists
each file that piezoid wrote there, with its digest. Without a manifest, only sealed files count as
written by piezoid.

* Only listed files are replaced or removed; edited files only with ``force``.
* Links are not followed. Foreign files, folders, links, pipes and devices are kept, as are modes.
* The root of a disk, a home folder, the working directory and a repository are never written.

If the process is killed, a folder without foreign objects is either unchanged or complete, because
it is exchanged in one step. With foreign objects, or on systems without that step, each file is
either old or new. The manifest lists both until the last file is replaced, and the next run
continues.
"""

import ctypes
import errno
import os
import signal
import stat
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path, PurePosixPath
from secrets import token_hex
from typing import BinaryIO

from piezoid.digests import digest_of_bytes, digest_of_file
from piezoid.errors import OutputFolderError
from piezoid.manifest import (
    MANIFEST,
    Listed,
    files_without_manifest,
    is_regular,
    manifest_in,
    manifest_of,
)

_REPOSITORIES = (".git", ".hg", ".svn")
_UNFINISHED = ".unfinished"
_UNION = f"union{_UNFINISHED}"  # the manifest during an exchange file by file
_AT_FDCWD, _NOREPLACE, _EXCHANGE = -100, 1, 2  # of renameat2

Content = bytes | Callable[[BinaryIO], object]


def check_folder(
    folder: str | Path,
    *,
    force: bool = False,
    new: bool = False,
    names: Iterable[str] | None = None,
    inputs: Iterable[Path] = (),
) -> None:
    """Check whether a folder may be written, before any work is done.

    folder  new, empty, or with files that piezoid wrote
    force   replace these files, including edited files
    new     refuse a folder with results, unless ``force``
    names   files to be written or removed, if known; None: all listed files
    inputs  files that are read, which must not lie in the folder

    Raises ``OutputFolderError`` (exit status 2), and ``PermissionError`` without permission to
    write.
    """
    target = _target_of(folder)
    for file in inputs:
        if Path(os.path.realpath(file)).is_relative_to(target):
            raise refusal(f"{folder} contains {file}, which is read")
    listed = _listed_in(target)
    if listed and new and not force:
        raise OutputFolderError(
            f"{folder} is not empty: it contains results",
            needed="a new or an empty folder",
            remedy="Name another folder, or add --force to replace its results.",
        )
    _check_names(target, listed, listed if names is None else names, force=force)
    parent = next(above for above in target.parents if above.exists())
    if not parent.is_dir():
        raise refusal(f"{parent} is a file")
    for path in (parent, target) if target.exists() else (parent,):
        if not os.access(path, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))


def write_folder(
    folder: str | Path,
    contents: Mapping[str, Content],
    *,
    force: bool = False,
    shared: bool = False,
) -> None:
    """Write a folder of results, replacing earlier results.

    contents  file names, with / for subfolders, and their bytes or a function that writes them
    force     as for ``check_folder``, which is called again
    shared    one of many neighbouring folders, each written by a single process: the parent is not
              locked, and ``remove_unfinished`` deletes the remains of killed runs. Unedited
              results are replaced without ``force``
    """
    with nullcontext() if shared else _exclusive_access(folder):
        listed = _listed_in(_target_of(folder))
        check_folder(folder, force=force, new=not shared, names={*contents, *listed})
        _write(folder, contents, gone=listed, force=force)


def add_to_folder(
    folder: str | Path,
    contents: Mapping[str, Content],
    *,
    gone: Sequence[str] = (),
    force: bool = False,
) -> None:
    """Add files to a folder of results, or replace them there.

    contents  as for ``write_folder``; other files are not changed
    gone      files and subfolders of piezoid to remove, unless ``contents`` has them
    force     replace edited files of piezoid
    """
    with _exclusive_access(folder):
        listed = _listed_in(_target_of(folder))
        stale = [n for n in listed if n in gone or PurePosixPath(n).parts[0] in gone]
        check_folder(folder, force=force, names=(*contents, *stale))
        _write(folder, contents, gone=stale, force=force)


def remove_unfinished(folder: Path, name: str = "") -> None:
    """Remove the unfinished folders in a folder that killed runs left, for one name or for all."""
    for entry in os.listdir(folder) if folder.is_dir() else ():
        written, _, _ = entry.removesuffix(_UNFINISHED).rpartition(".")
        is_unfinished = entry.endswith(_UNFINISHED) and written.startswith(".")
        if is_unfinished and name in ("", written[1:]) and _is_folder(folder / entry):
            _remove_listed(folder / entry, manifest_in(folder / entry) or ())


def write_file(
    path: Path, content: bytes, *, opening: bytes, force: bool = False, only_check: bool = False
) -> None:
    """Write one new file atomically, or with ``force`` replace a file of piezoid.

    opening     first bytes of every file of this type that piezoid writes
    only_check  check whether the file may be written, but do not write it
    """
    with _errors_about(path):
        is_present = os.path.lexists(path)
        if is_present and not is_regular(path):
            raise refusal(f"{path} is not a regular file")
        if is_present:
            with path.open("rb") as stream:
                is_ours = stream.read(len(opening)) == opening
            if not (is_ours and force):
                remedy = "or replace it with --force" if is_ours else "--force does not replace it"
                raise OutputFolderError(
                    f"{path} already exists",
                    needed="the name of a new file",
                    remedy=f"Name another file with --out; {remedy}.",
                )
        if only_check:
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        fresh = _scratch_path(path)
        try:
            _fill(fresh, content)
            _move(fresh, path, is_ours=is_present)
        finally:
            fresh.unlink(missing_ok=True)


def _target_of(folder: str | Path) -> Path:
    """Return the absolute path of a folder; refuse links, files and protected folders."""
    path = Path(folder)
    parent, name = (path, "") if path.name in ("", "..") else (path.parent, path.name)
    target = Path(os.path.realpath(parent)) / name
    if os.path.islink(target):
        raise refusal(f"{folder} is a link to {os.readlink(target)}, which is not followed")
    if os.path.lexists(target) and not target.is_dir():
        raise refusal(f"{folder} is a file")
    homes = [os.path.expanduser("~")]
    with suppress(ImportError, KeyError):  # no pwd on this system, or no entry for this user
        import pwd

        homes.append(pwd.getpwuid(os.getuid()).pw_dir)
    contains_directory = False
    with suppress(FileNotFoundError):
        contains_directory = Path.cwd().is_relative_to(target)
    repository = next((name for name in _REPOSITORIES if os.path.lexists(target / name)), None)
    if os.path.ismount(target):
        raise refusal(f"{folder} is the root of a disk")
    if any(Path(os.path.realpath(home)).is_relative_to(target) for home in homes):
        raise refusal(f"{folder} is or contains a home folder")
    if contains_directory:
        raise refusal(f"{folder} is or contains the working directory")
    if repository is not None:
        raise refusal(f"{folder} is a repository: it contains {repository}")
    return target


def refusal(reason: str) -> OutputFolderError:
    """Return the error about a folder that may not be written."""
    return OutputFolderError(
        reason,
        needed="a folder that is new, empty, or written by piezoid",
        remedy="Name another folder or a subfolder; --force replaces only files of piezoid.",
    )


def _listed_in(target: Path) -> Listed:
    """Return the listed files of a folder; refuse a folder that piezoid did not write."""
    if not target.is_dir():
        return {}
    listed = manifest_in(target)
    if listed is None:
        listed = files_without_manifest(target)
        if not listed and os.listdir(target):
            raise refusal(f"{target} is not empty and has no manifest of piezoid")
    return listed


def _check_names(target: Path, listed: Listed, names: Iterable[str], *, force: bool) -> None:
    """Refuse names of files that may not be replaced."""
    for name in (*names, MANIFEST):
        path = target / name
        for above in _folders_of([name]):
            if os.path.lexists(target / above) and not _is_folder(target / above):
                raise refusal(f"{target / above} is not a folder of piezoid")
        if not os.path.lexists(path) or (name == MANIFEST and manifest_in(target) is not None):
            continue
        if name not in listed or not is_regular(path):
            raise refusal(f"{path} was not written by piezoid")
        if not force and digest_of_file(path) not in listed[name]:
            reason = "was edited since piezoid wrote it" if listed[name] else "is in no manifest"
            raise OutputFolderError(
                f"{path} {reason}",
                needed="the unchanged file",
                remedy="Move the file to keep it, or add --force to replace it.",
            )


def _is_folder(path: Path) -> bool:
    return path.is_dir() and not path.is_symlink()


def _folders_of(names: Iterable[str]) -> list[str]:
    """Return the subfolders in file names, parents first."""
    above = {str(p) for name in names for p in PurePosixPath(name).parents if str(p) != "."}
    return sorted(above, key=lambda folder: (folder.count("/"), folder))


def _write(
    folder: str | Path, contents: Mapping[str, Content], *, gone: Iterable[str], force: bool
) -> None:
    """Write files to a temporary folder, then move them into the target."""
    target = _target_of(folder)
    listed = _listed_in(target)
    gone = [name for name in gone if name not in contents]
    unchanged = [n for n in listed if n not in {*contents, *gone} and is_regular(target / n)]
    fresh = _scratch_path(target)
    with _errors_about(folder):
        target.parent.mkdir(parents=True, exist_ok=True)
        try:
            fresh.mkdir()
            _fill(fresh / MANIFEST, manifest_of(dict.fromkeys((*contents, *unchanged), "")))
            digests = {n: _fill(fresh / n, content) for n, content in contents.items()}
            for name in unchanged:  # the manifest keeps the original digest of an edited file
                recorded = listed[name]
                actual = digest_of_file(target / name) if len(recorded) > 1 else ""
                digests[name] = actual if actual in recorded else min(recorded, default="")
            _fill(fresh / _UNION, manifest_of(digests))
            (fresh / _UNION).replace(fresh / MANIFEST)  # if killed now, the files are listed
            with interrupts_blocked():
                _check_names(target, listed, (*contents, *gone), force=force)
                _put(fresh, target, digests, listed, gone)
        finally:
            _remove_listed(fresh, (*contents, *unchanged, *listed))


def _put(
    fresh: Path, target: Path, digests: Mapping[str, str], listed: Listed, gone: Collection[str]
) -> None:
    """Move a finished folder to its target, in one step if no foreign files are moved."""
    if not os.path.lexists(target):
        fresh.rename(target)
        return
    new = [name for name in digests if is_regular(fresh / name)]
    unchanged = [name for name in digests if name not in new]
    is_exchangeable = _holds_only(target, listed) and _take_over(target, fresh, unchanged)
    if is_exchangeable and _rename(fresh, target, _EXCHANGE):
        _remove_listed(fresh, listed)
        _return_others(fresh, target)
        return
    _fill(fresh / _UNION, manifest_of(digests, previous=listed))
    _move(fresh / _UNION, target / MANIFEST)
    for name in new:
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        _move(fresh / name, target / name, is_ours=name in listed)
    _remove(target, gone)
    _move(fresh / MANIFEST, target / MANIFEST)


def _holds_only(target: Path, listed: Listed) -> bool:
    """Return whether every object in a folder is listed."""
    names, folders = {*listed, MANIFEST}, set(_folders_of(listed))

    def is_ours(path: Path) -> bool:
        name = path.relative_to(target).as_posix()
        if _is_folder(path):
            return name in folders and all(map(is_ours, path.iterdir()))
        return name in names and is_regular(path)

    return all(map(is_ours, target.iterdir()))


def _take_over(target: Path, fresh: Path, unchanged: Iterable[str]) -> bool:
    """Link the unchanged files into the finished folder and copy modes; False if impossible."""
    new, old = fresh.stat(), target.stat()
    if (new.st_uid, new.st_gid) != (old.st_uid, old.st_gid):
        return False
    try:
        for name in unchanged:
            if is_regular(target / name):
                (fresh / name).parent.mkdir(parents=True, exist_ok=True)
                os.link(target / name, fresh / name)
    except OSError:
        return False
    for path in (fresh, *fresh.rglob("*")):
        if (mode := _mode_of(target / path.relative_to(fresh))) is not None:
            path.chmod(stat.S_IMODE(mode))
    return True


def _mode_of(path: Path) -> int | None:
    return path.lstat().st_mode if os.path.lexists(path) else None


def _move(source: Path, path: Path, *, is_ours: bool = True) -> None:
    """Move a file to an unused name, or over a file of piezoid while keeping its mode."""
    mode = _mode_of(path)
    if mode is not None and is_ours and stat.S_ISREG(mode):
        source.chmod(stat.S_IMODE(mode))
        source.replace(path)
    elif not _rename(source, path, _NOREPLACE):
        if os.path.lexists(path):
            raise refusal(f"{path} was not written by piezoid")
        source.rename(path)


def _rename(source: Path, path: Path, flag: int) -> bool:
    """Rename without replacing, or exchange, atomically; return whether it succeeded."""
    try:
        rename = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError):
        return False
    names = os.fsencode(source), os.fsencode(path)
    status: int = rename(_AT_FDCWD, names[0], _AT_FDCWD, names[1], flag)
    return status == 0


def _return_others(source: Path, target: Path) -> None:
    """Move files that appeared during the exchange into the new folder."""
    for name in os.listdir(source) if source.is_dir() else ():
        if _is_folder(source / name) and _is_folder(target / name):
            _return_others(source / name, target / name)
        else:
            _rename(source / name, target / name, _NOREPLACE)
    with suppress(OSError):
        source.rmdir()


def _remove_listed(folder: Path, names: Iterable[str]) -> None:
    """Remove the listed files of a folder, and then the folder if it is empty."""
    _remove(folder, (*names, _UNION, MANIFEST))
    with suppress(OSError):
        folder.rmdir()


def _remove(folder: Path, names: Collection[str]) -> None:
    for name in names:
        if all(_is_folder(folder / above) for above in _folders_of([name])) and is_regular(
            folder / name
        ):
            (folder / name).unlink()
    for above in reversed(_folders_of(names)):
        with suppress(OSError):
            if _is_folder(folder / above):
                (folder / above).rmdir()


def _fill(path: Path, content: Content) -> str:
    """Write a new file, flush it to the disk, and return its digest."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w+b") as stream:
        if isinstance(content, bytes):
            stream.write(content)
        else:
            content(stream)
        stream.flush()
        os.fsync(stream.fileno())
    return digest_of_bytes(content) if isinstance(content, bytes) else digest_of_file(path)


def _scratch_path(target: Path) -> Path:
    return target.with_name(f".{target.name}.{token_hex(4)}{_UNFINISHED}")


@contextmanager
def _errors_about(path: str | Path) -> Iterator[None]:
    """Name this path instead of a temporary file in ``OSError``."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error


@contextmanager
def _exclusive_access(folder: str | Path) -> Iterator[None]:
    """Lock the parent of a folder against other runs; the lock ends with the process.

    On network disks and systems without locks, the later of two simultaneous runs prevails.
    """
    target = _target_of(folder)
    with _errors_about(folder):
        target.parent.mkdir(parents=True, exist_ok=True)
        number = os.open(target.parent, os.O_RDONLY)
    try:
        with suppress(ImportError, OSError):
            import fcntl

            fcntl.flock(number, fcntl.LOCK_EX)
        remove_unfinished(target.parent, target.name)
        yield
    finally:
        os.close(number)


@contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Block Ctrl-C until the end of the block; processes started in it never receive it."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
