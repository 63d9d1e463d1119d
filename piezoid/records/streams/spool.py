"""Spool: a recording larger than memory, read once with every check, then as often as needed.

Reading a file costs more than fitting it, so its drive and displacement go in SI units into an
unnamed scratch file, 16 bytes a sample, which is gone when the process is.
"""

import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import IO, Any

from piezoid.errors import RecordingError
from piezoid.records.lab import Lab
from piezoid.records.readers.source import Source, open_source
from piezoid.records.recording import Problem, Quantity
from piezoid.records.streams.piece import Piece, PieceWriter
from piezoid.records.streams.stretches import ROWS, Heard, Stretch, stretches

_MOST_PIECES = 1000


@dataclass(frozen=True, kw_only=True, eq=False)
class Spool:
    """All axes of all recordings of a stage, on disk.

    pieces    by axis; only axes with a drive and a displacement
    sources   digest by file
    problems  of all files
    counted   what is in counts of a converter in all of them, as ``Recording.counted``
    """

    pieces: dict[str, tuple[Piece, ...]]
    sources: dict[str, str]
    problems: tuple[tuple[str, Problem], ...]
    counted: tuple[str, ...] = ()


@contextmanager
def spooled(
    paths: Sequence[Path],
    lab: Lab | None = None,
    *,
    folder: Path | None = None,
    rows: int = ROWS,
    workers: int = 2,
    named: bool = False,
    progress: Callable[[str], None] = lambda _: None,
) -> Iterator[Spool]:
    """Read files of any size, each once; what is on disk is there until the context ends.

    folder  where the scratch files go, 16 bytes for each sample and axis, made where it is not
            there; None: the system's own
    rows    of a block, of which a few are in memory at one time
    workers blocks that are judged side by side; what is written is the same
    named   whether the scratch files have names, so that processes elsewhere can read them; they
            are removed at the end, unless this process is killed

    Raises what ``ingest`` raises.
    """
    lab = Lab() if lab is None else lab
    lab.check_files(paths)
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    held: dict[str, list[Piece]] = {}
    problems: list[tuple[str, Problem]] = []
    sources: dict[str, str] = {}
    counted: dict[str, tuple[str, ...]] = {}
    number = 0
    make = tempfile.NamedTemporaryFile if named else tempfile.TemporaryFile
    scratch = partial(make, dir=folder)
    with ExitStack() as files:
        for path in paths:
            progress(f"reading {path.name}")
            source = replace(open_source(path, whole=False), text=lab.text_format_of(path))
            _refuse_twice(source, sources)
            for entry in lab.entries_of(path) or (None,):
                heard = Heard()
                passing = stretches(source, lab, entry, heard, rows=rows, workers=workers)
                for axis, found in _written(passing, source, number, scratch, files).items():
                    held.setdefault(axis, []).extend(found)
                    _refuse_many(source, len(held[axis]))
                number += 1
                counted[source.name] = heard.counted
                problems += [(source.name, problem) for problem in heard.problems]
        yield Spool(
            pieces={axis: tuple(held[axis]) for axis in sorted(held)},
            sources=sources,
            problems=tuple(problems),
            counted=_same_counted(counted),
        )


def _written(
    passing: Iterator[Stretch],
    source: Source,
    number: int,
    fresh: Callable[[], Any],
    files: ExitStack,
) -> dict[str, list[Piece]]:
    """Write the stretches of one recording to disk, one scratch file for each axis."""
    found: dict[str, list[PieceWriter]] = {}
    scratch: dict[str, IO[bytes]] = {}
    for stretch in passing:
        for axis in _axes(stretch):
            if axis not in scratch:
                scratch[axis] = files.enter_context(fresh())
            pieces = found.setdefault(axis, [])
            if stretch.begins or not pieces:
                _refuse_many(source, len(pieces))
                pieces.append(
                    PieceWriter(
                        scratch[axis],
                        name=source.name,
                        recording=number,
                        sampling_rate_Hz=stretch.sampling_rate_Hz,
                    )
                )
            pieces[-1].append(
                stretch.channels[Quantity.VOLTAGE, axis],
                stretch.channels[Quantity.DISPLACEMENT, axis],
            )
    return {axis: [writer.piece() for writer in pieces] for axis, pieces in found.items()}


def _axes(stretch: Stretch) -> tuple[str, ...]:
    held = set(stretch.channels)
    axes = {axis for _, axis in held}
    return tuple(
        sorted(a for a in axes if {(Quantity.VOLTAGE, a), (Quantity.DISPLACEMENT, a)} <= held)
    )


def _same_counted(counted: dict[str, tuple[str, ...]]) -> tuple[str, ...]:
    """Return what is in counts in every file, or refuse files of which some are in counts."""
    found = set(counted.values())
    if len(found) > 1:
        told = "; ".join(f"{name}: {' and '.join(c) or 'neither'}" for name, c in counted.items())
        raise RecordingError(
            f"drive or displacement are in counts in some files alone ({told})",
            needed="one unit in all recordings of a stage",
            remedy="Write scale = { ... } for those in counts into lab.toml.",
        )
    return found.pop() if found else ()


def _refuse_twice(source: Source, sources: dict[str, str]) -> None:
    if source.name in sources:
        raise RecordingError(
            f"more than one recording is named {source.name}",
            needed="a name of its own for each recording: results are kept by name",
            remedy="Rename one of the files, or leave out what is there twice.",
        )
    sources[source.name] = source.digest


def _refuse_many(source: Source, count: int) -> None:
    if count > _MOST_PIECES:
        raise RecordingError(
            f"{source.name}: the recordings are interrupted more than {_MOST_PIECES} times",
            needed="uninterrupted stretches: each has a memory of its own",
            remedy="Record without losing samples, or state sampling_rate_Hz and name no time "
            "column if the samples are known to be uniform.",
        )
