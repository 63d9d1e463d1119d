"""A folder of stages to do, and the folder of what was done: what is new, finished, changed."""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import typer

from piezoid.errors import PiezoidError, RecordingError
from piezoid.provenance import digest_of_file
from piezoid_cli.output_folder import write_file, write_folder
from piezoid_cli.stage_files import content_of
from piezoid_cli.stage_task import LAB, StageDone, StageTask
from piezoid_reports.fleet.chapters import PLACE
from piezoid_reports.fleet.records import CRASHED, FleetStage, stage_from_json

RECORD = "batch.json"
NO_RECORDING = {".toml", ".md", ".json", ".html"}


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What is to be done, and what is done already.

    waiting   tasks
    finished  of stages whose inputs and version are those of their results
    """

    waiting: tuple[StageTask, ...]
    finished: tuple[FleetStage, ...]


def plan_batch(folder: Path, out: Path, *, force: bool) -> Plan:
    """Find the stages of a folder, and leave out those that are finished.

    Raises ``typer.BadParameter`` where results would be replaced without ``force``.
    """
    tasks = [_task(folder, place.parent) for place in sorted(folder.rglob(LAB)) if place.is_file()]
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
    _check_ours(out, force=force)
    kept = {task.name: _kept(out / PLACE / task.name) for task in tasks}
    finished = [stage for task in tasks if (stage := kept[task.name]) and _is_of(stage, task)]
    done = {stage.name for stage in finished}
    waiting = [task for task in tasks if task.name not in done]
    changed = [t.name for t in waiting if _would_replace(kept[t.name])]
    if changed and not force:
        raise typer.BadParameter(
            f"{len(changed)} stages were done from other files or by another version "
            f"({', '.join(changed[:3])}{', ...' if len(changed) > 3 else ''}); add --force to "
            "replace their results, or name another folder"
        )
    return Plan(waiting=tuple(waiting), finished=tuple(finished))


def keep(out: Path, done: StageDone) -> None:
    """Write the results of one stage, whole or not at all."""
    files = {**done.files, RECORD: done.stage.to_json()}
    write_folder(out / PLACE / done.stage.name, files)


def keep_summary(out: Path, files: dict[str, bytes]) -> None:
    """Write what is said of all stages, the batch's own record last."""
    for name, content in sorted(files.items(), key=lambda item: item[0] == RECORD):
        write_file(out / name, content)


def _task(root: Path, folder: Path) -> StageTask:
    return StageTask(
        name=folder.resolve().relative_to(root.resolve()).as_posix(),
        folder=str(folder.resolve()),
        inputs={name: digest_of_file(folder / name) for name in (LAB, *_recordings(folder))},
        version=version("piezoid"),
    )


def _recordings(folder: Path) -> Sequence[str]:
    """Return the files a lab.toml names, or else every file beside it that may be one."""
    from piezoid.records.lab import read_lab

    try:
        declared = [entry.file for entry in read_lab(folder / LAB).recordings]
    except PiezoidError:
        declared = []  # the worker reads it again, and its refusal becomes the stage's reason
    there = [name for name in dict.fromkeys(declared) if (folder / name).is_file()]
    return there or sorted(
        place.name
        for place in folder.iterdir()
        if place.is_file() and place.suffix not in NO_RECORDING and place.name[0] != "."
    )


def _check_ours(out: Path, *, force: bool) -> None:
    """Refuse a folder of something else, before any work is done."""
    if out.exists() and not out.is_dir():
        raise typer.BadParameter(f"{out} is a file; name a folder for the results")
    if not out.is_dir() or not any(out.iterdir()) or (out / PLACE).is_dir() or force:
        return
    raise typer.BadParameter(
        f"{out} holds something that is no batch; name another folder, or add --force to write "
        "into it"
    )


def _kept(place: Path) -> FleetStage | None:
    """Return what is kept of a stage; None where nothing usable is."""
    try:
        return stage_from_json(content_of(place / RECORD), str(place / RECORD))
    except (OSError, PiezoidError):
        return None


def _is_of(stage: FleetStage, task: StageTask) -> bool:
    same = dict(stage.inputs) == dict(task.inputs) and stage.version == task.version
    return same and stage.state != CRASHED


def _would_replace(stage: FleetStage | None) -> bool:
    return stage is not None and stage.state != CRASHED
