"""Relative processor times of all stages within one run, and their growth.

    python -m benchmarks.ratios [--samples N] [--parts kernels programs loop]

Prints the table of docs/measured/speed.md, which explains the columns. Alternatives of kernels and
programs must give the same result, that of the fit of one shape no better one. The model has 16
plays and 12 dead zones. The closed loop is that of the bundled axis x.

numba is installed by `pip install piezoid[benchmarks]`; its figures are missing otherwise. Times
include child processes. On a busy machine the figures scatter by a third.
"""

import argparse
import os
from collections.abc import Sequence
from importlib.util import find_spec

# Waiting threads use processor time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from benchmarks.speed.closed_loop import bundled_loop, loop_growths, loop_row
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
Result = tuple[list[Row], list[Growth]]


def kernels(watch: Stopwatch, samples: int) -> Result:
    """Time play bank, model and inverse."""
    return kernel_rows(watch, samples), kernel_growths(watch, samples)


def programs(watch: Stopwatch, samples: int) -> Result:
    """Time weights, Kuhnen's program and the fit of one shape."""
    rows = [row(watch, samples) for row in (weights_row, triangle_row, program_row)]
    rows.append(shape_row(watch, samples // 8))
    return rows, program_growths(watch, samples // 4)


def loop(watch: Stopwatch, _: int) -> Result:
    """Time the closed loop of the bundled axis."""
    bundled = bundled_loop(TICKS)
    return [loop_row(watch, bundled)], loop_growths(watch, bundled)


PARTS = {part.__name__: part for part in (kernels, programs, loop)}


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
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
    print(table([row for rows, _ in results for row in rows], growths))


if __name__ == "__main__":
    main()
