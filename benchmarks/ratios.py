"""Relative processor times of all stages within one run, and their growth.

    python -m benchmarks.ratios [FOLDER] [--samples N] [--parts kernels programs chain campaigns]

Prints the table of docs/measured/speed.md, which explains the columns, and writes growth.svg and
growth.png into FOLDER. Alternatives of kernels and programs must give the same result, that of the
fit of one shape no better one. The model has 16 plays and 12 dead zones. The chain uses the
bundled axis, the campaigns simulated recordings of its stage.

numba is installed by `pip install piezoid[benchmarks]`; its figures are missing otherwise. Times
include child processes. On a busy machine the figures scatter by a third.
"""

import argparse
import os
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

# Waiting threads use processor time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from benchmarks.speed.campaign import bundled_axis
from benchmarks.speed.chain_rows import chain_of, chain_rows, loop_growths, step_growths
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
Result = tuple[list[Row], list[Growth]]


def kernels(watch: Stopwatch, samples: int) -> Result:
    """Time play bank, model and inverse."""
    return kernel_rows(watch, samples), kernel_growths(watch, samples)


def programs(watch: Stopwatch, samples: int) -> Result:
    """Time weights, Kuhnen's program and the fit of one shape."""
    rows = [row(watch, samples) for row in (weights_row, triangle_row, program_row)]
    rows.append(shape_row(watch, samples // 8))
    return rows, program_growths(watch, samples // 4)


def chain(watch: Stopwatch, _: int) -> Result:
    """Time every step of the bundled axis from its recordings to the report."""
    steps = chain_of(watch, bundled_axis(), TICKS)
    return chain_rows(watch, steps), loop_growths(watch, steps.loop)


def campaigns(watch: Stopwatch, _: int) -> Result:
    """Time the steps on simulated recordings of several lengths."""
    return [], step_growths(watch, LENGTHS, NUMBERS)


PARTS = {part.__name__: part for part in (kernels, programs, chain, campaigns)}


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table and draw the figure."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", nargs="?", type=Path, default=Path("build/benchmarks"))
    parser.add_argument("--samples", type=int, default=200_000)
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--patience", type=float, default=0.3, help="seconds for each function")
    options = parser.parse_args(arguments)
    if not find_spec("numba"):
        print(NO_NUMBA)
    if not has_compiler():
        print(NO_COMPILER)
    watch = Stopwatch(patience_s=options.patience)
    results = [PARTS[part](watch, options.samples) for part in options.parts]
    growths = [growth for _, part_growths in results for growth in part_growths]
    options.folder.mkdir(parents=True, exist_ok=True)
    print("figure:", *draw(growths, options.folder))
    print(table([row for rows, _ in results for row in rows], growths))


if __name__ == "__main__":
    main()
