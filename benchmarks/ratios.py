"""How fast every stage is, as ratios of processor time within one run, and how it grows.

    python -m benchmarks.ratios [FOLDER] [--samples N] [--parts kernels programs chain campaigns]

Prints the table of docs/measured/speed.md and writes growth.svg and growth.png into FOLDER.
Rivals: how many times as long they take; itself: in multiples of what bounds it; growth: the power
of the size. Rivals of kernels and programs have to come to the same result, that of the fit of one
shape to no better one. 16 plays and 12 dead zones; chain: the bundled axis; campaigns: recordings
made of its stage.
numba comes with `pip install piezoid[benchmarks]`; without it its figures are missing. Times are
of the processor and include child processes; on a machine that works for others as well, figures
scatter by a third.
"""

import argparse
import os
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

# Threads that wait for each other would count as work.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from benchmarks.speed.campaign import bundled_axis
from benchmarks.speed.chain_rows import chain_rows, loop_growths, step_growths, walk_of
from benchmarks.speed.growth_figure import draw
from benchmarks.speed.kernel_rows import kernel_growths, kernel_rows
from benchmarks.speed.loops import NO_NUMBA
from benchmarks.speed.machine import NO_COMPILER, has_compiler
from benchmarks.speed.program_rows import (
    program_growths,
    program_row,
    shape_row,
    triangle_row,
    weights_row,
)
from benchmarks.speed.stopwatch import Growth, Stopwatch
from benchmarks.speed.table import Row, table

TICKS = 20_000  # a second of the closed loop
LENGTHS, NUMBERS = (2000, 4000, 8000), (1, 2, 4)
Measured = tuple[list[Row], list[Growth]]


def kernels(watch: Stopwatch, samples: int) -> Measured:
    """Return play bank, model and inverse."""
    return kernel_rows(watch, samples), kernel_growths(watch, samples)


def programs(watch: Stopwatch, samples: int) -> Measured:
    """Return weights, Kuhnen's program and the search for one shape."""
    rows = [row(watch, samples) for row in (weights_row, triangle_row, program_row)]
    rows.append(shape_row(watch, samples // 8))
    return rows, program_growths(watch, samples // 4)


def chain(watch: Stopwatch, _: int) -> Measured:
    """Return every step of the bundled axis from its recordings to the report."""
    walk = walk_of(watch, bundled_axis(), TICKS)
    return chain_rows(watch, walk), loop_growths(watch, walk.loop)


def campaigns(watch: Stopwatch, _: int) -> Measured:
    """Return how the steps grow with made recordings."""
    return [], step_growths(watch, LENGTHS, NUMBERS)


PARTS = {one.__name__: one for one in (kernels, programs, chain, campaigns)}


def missing() -> list[str]:
    """Return what cannot be compared on this machine, a sentence each."""
    numba = [] if find_spec("numba") else [NO_NUMBA]
    return numba if has_compiler() else [*numba, NO_COMPILER]


def main(words: Sequence[str] | None = None) -> None:
    """Print the table and draw the figure."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", nargs="?", type=Path, default=Path("build/benchmarks"))
    parser.add_argument("--samples", type=int, default=200_000)
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--patience", type=float, default=0.3, help="seconds for each time")
    asked = parser.parse_args(words)
    for sentence in missing():
        print(sentence)
    watch = Stopwatch(patience_s=asked.patience)
    measured = [PARTS[part](watch, asked.samples) for part in asked.parts]
    growths = [one for _, grown in measured for one in grown]
    asked.folder.mkdir(parents=True, exist_ok=True)
    print("drawn:", *draw(growths, asked.folder))
    print(table([row for rows, _ in measured for row in rows], growths))


if __name__ == "__main__":
    main()
