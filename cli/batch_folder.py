"""A folder of stages to do, and what of it was done before: new, finished, changed."""

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from importlib.metadata import version
from pathlib import Path

import typer

from piezoid.errors import RecordingError
from piezoid_cli.results_place import results_place
from piezoid_cli.stage_task import LAB, Known, StageTask

Check = Callable[[Sequence[StageTask]], Iterable[Known]]


def stages_of(folder: Path, results: str) -> tuple[StageTask, ...]:
    """Find the stages of a folder by their lab.toml, of which nothing is read here."""
    tasks = tuple(_tasks(folder, results))
    if not folder.is_dir():
        raise RecordingError(
            f"{folder} is {'a file' if folder.exists() else 'not there'}",
            needed=f"a folder of stages, each with its recordings and a {LAB}",
            remedy="Check its name.",
        )
    if not tasks:
        raise RecordingError(
            f"{folder}: no folder below it holds a {LAB}",
            needed=f"one folder for each stage, with its recordings and a {LAB}",
            remedy="Write one with `piezoid init FILES... --out STAGE/lab.toml`.",
        )
    return tasks


def _tasks(folder: Path, results: str) -> Iterator[StageTask]:
    root, now = os.path.realpath(folder), version("piezoid")
    for place, below, files in os.walk(root):
        below.sort()
        if LAB in files and os.path.isfile(os.path.join(place, LAB)):
            name = Path(os.path.relpath(place, root)).as_posix()
            _check_name(name)
            yield StageTask(name=name, folder=place, results=results, version=now)


def _check_name(name: str) -> None:
    try:
        name.encode()
    except UnicodeEncodeError as error:
        raise RecordingError(
            f"the folder {name!r} has a name that is no text in UTF-8",
            needed="names that can be written into the summary",
            remedy="Rename the folder.",
        ) from error


def check_ours(results: str, *, force: bool) -> None:
    """Refuse a place that holds something else, before any work is done."""
    place = results_place(results)
    if force or place.begun or not place.holds_anything:
        return
    raise typer.BadParameter(
        f"{results} holds something that is no batch; name another folder, or add --force to "
        "write into it"
    )


def waiting_of(
    tasks: Sequence[StageTask],
    check: Check,
    *,
    force: bool,
    finished: Callable[[str, bytes], None],
) -> list[StageTask]:
    """Return what is to be done, and tell what is finished.

    check     compares what is kept of stages with their files; done by workers
    finished  given name and packed record of every stage whose inputs and version are the same

    Raises ``typer.BadParameter`` where results would be replaced without ``force``.
    """
    done: set[str] = set()
    changed: list[str] = []
    for known in check(tasks) if results_place(tasks[0].results).begun else ():
        if known.packed is not None:
            done.add(known.name)
            finished(known.name, known.packed)
        elif known.changed:
            changed.append(known.name)
    if changed and not force:
        changed.sort()
        raise typer.BadParameter(
            f"{len(changed)} stages were done from other files or by another version "
            f"({', '.join(changed[:3])}{', ...' if len(changed) > 3 else ''}); add --force to "
            "replace their results, or name another folder"
        )
    return [task for task in tasks if task.name not in done]
