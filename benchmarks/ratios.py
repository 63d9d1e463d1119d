"""How fast every stage is, as ratios of processor time within one run, and how it grows.

    python -m benchmarks.ratios [FOLDER] [--samples N] [--parts kernels programs chain growth]

Prints the README's table and writes growth.svg and growth.png into FOLDER. A comparison counts
only where both results are the same. Kernels: 16 plays, 12 dead zones; chain: the bundled axis.
numba comes with `pip install piezoid[benchmarks]`; without it its column is empty. Processor time
includes that of child processes; on a machine that works for others as well, figures scatter by
a third.
"""

import argparse
import os
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

# Threads that wait for each other would count as work.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from benchmarks.speed.campaign import bundled_axis
from benchmarks.speed.chain_rows import Walk, chain_rows, loop_growths, step_growths, walk_of
from benchmarks.speed.growth_figure import draw
from benchmarks.speed.kernel_rows import kernel_growths, kernel_rows
from benchmarks.speed.loops import NO_NUMBA
from benchmarks.speed.machine import NO_COMPILER, has_compiler
from benchmarks.speed.program_rows import program_growths, program_row, shape_row, weights_row
from benchmarks.speed.stopwatch import Growth, Stopwatch
from benchmarks.speed.table import Row, table

PARTS = ("kernels", "programs", "chain", "growth")
TICKS = 20_000  # a second of the closed loop
LENGTHS, NUMBERS = (2000, 4000, 8000), (1, 2, 4)


def rows_of(watch: Stopwatch, parts: Sequence[str], samples: int, walk: Walk | None) -> list[Row]:
    """Return the rows of the parts that are asked for."""
    rows = kernel_rows(watch, samples) if "kernels" in parts else []
    if "programs" in parts:
        rows += [weights_row(watch, samples), program_row(watch, samples)]
        rows.append(shape_row(watch, samples // 8))
    return rows + ([] if walk is None else chain_rows(watch, walk))


def growths_of(
    watch: Stopwatch, parts: Sequence[str], samples: int, walk: Walk | None
) -> list[Growth]:
    """Return how the steps of a fit grow, and the stages of the parts that are asked for."""
    found = kernel_growths(watch, samples) if "kernels" in parts else []
    if "programs" in parts:
        found += program_growths(watch, samples // 4)
    if walk is not None:
        found += loop_growths(watch, walk.loop)
    return found + step_growths(watch, LENGTHS, NUMBERS)


def missing() -> list[str]:
    """Return what cannot be compared on this machine, a sentence each."""
    numba = [] if find_spec("numba") else [NO_NUMBA]
    return numba if has_compiler() else [*numba, NO_COMPILER]


def main(words: Sequence[str] | None = None) -> None:
    """Print the table and draw the figure."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", nargs="?", type=Path, default=Path("build/benchmarks"))
    parser.add_argument("--samples", type=int, default=200_000)
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS)
    parser.add_argument("--patience", type=float, default=0.3, help="seconds for each time")
    asked = parser.parse_args(words)
    for sentence in missing():
        print(sentence)
    watch = Stopwatch(patience_s=asked.patience)
    walk = walk_of(watch, bundled_axis(), TICKS) if "chain" in asked.parts else None
    rows = rows_of(watch, asked.parts, asked.samples, walk)
    growths = []
    if "growth" in asked.parts:
        growths = growths_of(watch, asked.parts, asked.samples, walk)
        asked.folder.mkdir(parents=True, exist_ok=True)
        print("drawn:", *draw(growths, asked.folder))
    print(table(rows, growths))


if __name__ == "__main__":
    main()
