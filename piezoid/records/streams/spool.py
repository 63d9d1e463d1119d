"""Spool: a recording larger than memory, read once with every check, then as often as needed.

Reading a file costs more than fitting it, so its drive and displacement go in SI units into an
unnamed scratch file, 16 bytes a sample, which is gone when the process is.
"""

import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

import numpy as np

from piezoid.errors import RecordingError
from piezoid.numerics.arrays import Array
from piezoid.numerics.noise import white_noise_rms
from piezoid.records.lab import Lab
from piezoid.records.readers.source import Source, open_source
from piezoid.records.recording import Problem, Quantity
from piezoid.records.streams.stretches import ROWS, Heard, Stretch, stretches

_MOST_PIECES = 1000
_NOISE_ROWS = 4096


@dataclass
class Piece:
    """Uninterrupted samples of one axis of one recording, on disk.

    name, recording   of the file, and its number among those of the fit
    scratch           holds blocks of drive and displacement, one after the other
    blocks            place in bytes and number of samples of each
    voltage_V         (low, high)
    displacement_m    (low, high)
    covariance        sum of products about both means, V m
    step_V            largest step of the drive between two samples
    noise_m           white noise of the displacement, median over blocks
    """

    name: str
    recording: int
    sampling_rate_Hz: float
    scratch: IO[bytes]
    blocks: list[tuple[int, int]] = field(default_factory=list)
    samples: int = 0
    voltage_V: tuple[float, float] = (np.inf, -np.inf)
    displacement_m: tuple[float, float] = (np.inf, -np.inf)
    step_V: float = 0.0
    _mean: Array = field(default_factory=lambda: np.zeros(2))
    covariance: float = 0.0
    _last_V: float | None = None
    _noises: list[float] = field(default_factory=list)

    def append(self, voltage_V: Array, displacement_m: Array) -> None:
        """Write one more block behind the others, and take account of it."""
        self.scratch.seek(0, 2)
        self.blocks.append((self.scratch.tell(), len(voltage_V)))
        self.scratch.write(np.ascontiguousarray(voltage_V).tobytes())
        self.scratch.write(np.ascontiguousarray(displacement_m).tobytes())
        self.voltage_V = _wider(self.voltage_V, voltage_V)
        self.displacement_m = _wider(self.displacement_m, displacement_m)
        before = voltage_V[:1] if self._last_V is None else np.array([self._last_V])
        steps = np.abs(np.diff(voltage_V, prepend=before))
        self.step_V = max(self.step_V, float(steps.max()))
        self._last_V = float(voltage_V[-1])
        self._noises.append(white_noise_rms(displacement_m[:_NOISE_ROWS]))
        self._count(voltage_V, displacement_m)

    def _count(self, voltage_V: Array, displacement_m: Array) -> None:
        """Add a block to mean and covariance without ever forming large sums [Chan 1983]."""
        count = len(voltage_V)
        mean = np.array([voltage_V.mean(), displacement_m.mean()])
        apart = mean - self._mean
        whole = self.samples + count
        own = float((voltage_V - mean[0]) @ (displacement_m - mean[1]))
        self.covariance += own + float(apart[0] * apart[1]) * self.samples * count / whole
        self._mean = self._mean + apart * (count / whole)
        self.samples = whole

    @property
    def noise_m(self) -> float:
        """White noise of the displacement."""
        return float(np.median(self._noises))

    def read(self, rows: int) -> Iterator[tuple[Array, Array]]:
        """Yield drive and displacement in blocks of ``rows`` samples, the last one shorter."""
        held = np.empty((2, 0))
        self.scratch.flush()
        number = self.scratch.fileno()
        for place, count in self.blocks:
            # Without a place of its own in the file: pieces may be read side by side.
            content = np.frombuffer(os.pread(number, 16 * count, place)).reshape(2, count)
            held = np.hstack([held, content]) if held.size else content
            whole = held.shape[1] // rows * rows
            for first in range(0, whole, rows):
                yield held[0, first : first + rows], held[1, first : first + rows]
            held = held[:, whole:]
        if held.size:
            yield held[0], held[1]


@dataclass(frozen=True, kw_only=True, eq=False)
class Spool:
    """All axes of all recordings of a stage, on disk.

    pieces    by axis; only axes with a drive and a displacement
    sources   digest by file
    problems  of all files
    """

    pieces: dict[str, tuple[Piece, ...]]
    sources: dict[str, str]
    problems: tuple[tuple[str, Problem], ...]


@contextmanager
def spooled(
    paths: Sequence[Path],
    lab: Lab | None = None,
    *,
    folder: Path | None = None,
    rows: int = ROWS,
    progress: Callable[[str], None] = lambda _: None,
) -> Iterator[Spool]:
    """Read files of any size, each once; what is on disk is there until the context ends.

    folder  where the scratch files go, 16 bytes for each sample and axis; None: the system's own
    rows    of a block: what is in memory at one time

    Raises what ``ingest`` raises.
    """
    lab = Lab() if lab is None else lab
    held: dict[str, list[Piece]] = {}
    problems: list[tuple[str, Problem]] = []
    sources: dict[str, str] = {}
    number = 0
    with ExitStack() as files:
        for path in paths:
            progress(f"reading {path.name}")
            source = open_source(path, whole=False)
            _refuse_twice(source, sources)
            for entry in lab.entries_of(path) or (None,):
                heard = Heard()
                passing = stretches(source, lab, entry, heard, rows=rows)
                for axis, found in _written(passing, source, number, folder, files).items():
                    held.setdefault(axis, []).extend(found)
                    _refuse_many(source, len(held[axis]))
                number += 1
                problems += [(source.name, problem) for problem in heard.problems]
        yield Spool(
            pieces={axis: tuple(held[axis]) for axis in sorted(held)},
            sources=sources,
            problems=tuple(problems),
        )


def _written(
    passing: Iterator[Stretch],
    source: Source,
    number: int,
    folder: Path | None,
    files: ExitStack,
) -> dict[str, list[Piece]]:
    """Write the stretches of one recording to disk, one scratch file for each axis."""
    found: dict[str, list[Piece]] = {}
    scratch: dict[str, IO[bytes]] = {}
    for stretch in passing:
        for axis in _axes(stretch):
            if axis not in scratch:
                unnamed = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 -- the stack closes it
                scratch[axis] = files.enter_context(unnamed)
            pieces = found.setdefault(axis, [])
            if stretch.begins or not pieces:
                _refuse_many(source, len(pieces))
                pieces.append(
                    Piece(
                        name=source.name,
                        recording=number,
                        sampling_rate_Hz=stretch.sampling_rate_Hz,
                        scratch=scratch[axis],
                    )
                )
            pieces[-1].append(
                stretch.channels[Quantity.VOLTAGE, axis],
                stretch.channels[Quantity.DISPLACEMENT, axis],
            )
    return found


def _axes(stretch: Stretch) -> tuple[str, ...]:
    held = set(stretch.channels)
    axes = {axis for _, axis in held}
    return tuple(
        sorted(a for a in axes if {(Quantity.VOLTAGE, a), (Quantity.DISPLACEMENT, a)} <= held)
    )


def _wider(limits: tuple[float, float], values: Array) -> tuple[float, float]:
    return min(limits[0], float(values.min())), max(limits[1], float(values.max()))


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
