"""Report columns of a file that are empty, constant, clipped, overflowing or duplicated."""

import hashlib
from collections.abc import Mapping, Sequence

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.records.recording import Quantity
from piezoid.records.sample_statistics import clipped_samples
from piezoid.records.table import Column, RawTable
from piezoid.statement import Statement, finding

# An overflowing counter jumps over nearly its whole range while the drive makes no step. Unlike a
# lost reading it does not jump back within NEIGHBOURS samples on either side, and is not constant
# over MAX_CONSTANT.
MIN_JUMP, MIN_DRIVE_STEP = 0.8, 0.1  # of the range
NEIGHBOURS, MAX_CONSTANT = 5, 500


def check_columns(table: RawTable, quantities: Mapping[int, Quantity]) -> list[Statement]:
    """Report faults of single columns, including columns that are not read.

    quantities  by the number of the column, of columns that become channels; only these are
                tested for clipping
    """
    statements: list[Statement] = []
    first_with_values: dict[bytes, Column] = {}
    drives = [c.values for c in table.columns if quantities.get(c.number) is Quantity.VOLTAGE]
    for column in table.columns:
        numbers = column.values[np.isfinite(column.values)]
        if not len(numbers):
            statements.append(_statement("empty", column, "holds no number"))
            continue
        if np.ptp(numbers) == 0:
            unit = "" if column.heading.unit is None else f" {column.heading.unit.symbol}"
            statements.append(_statement("dead", column, f"is {numbers[0]:.6g}{unit} throughout"))
            continue
        quantity = quantities.get(column.number)
        idle_value = 0.0 if quantity is Quantity.VOLTAGE else None
        is_clipped = clipped_samples(numbers, idle_value=idle_value)
        if quantity is not None and is_clipped.any():
            levels = np.unique(numbers[is_clipped]).tolist()
            text = (
                f"rests on {' and '.join(f'{level:.6g}' for level in levels)} (as in the file) "
                f"for {100 * is_clipped.mean():.2g} % of the samples: clipped?"
            )
            statements.append(_statement("saturated", column, text))
        if quantity is Quantity.DISPLACEMENT and len(numbers) == len(column.values):
            jumps = overflows(numbers, drives)
            if len(jumps):
                text = (
                    f"jumps over its whole range {len(jumps)} times while the drive makes no "
                    f"step, first at row {jumps[0] + 1}: a counter or converter overflows. Add "
                    "its range to the readings beyond."
                )
                statements.append(_statement("wrapped", column, text))
        first = first_with_values.setdefault(
            hashlib.sha256(column.values.tobytes()).digest(), column
        )
        if first is not column:
            text = f"holds the same numbers as {first.place}"
            statements.append(_statement("equal_columns", column, text))
    return statements


def overflows(values: Array, drives: Sequence[Array]) -> Array:
    """Return the samples at which a reading jumps from one end of its range to the other.

    drives  (samples,) each, of any axis, NaN for invalid samples. Jumps near a step or an invalid
            sample of a drive do not count; without a drive the result is empty
    """
    range_ = float(np.ptp(values))
    jump_samples = np.flatnonzero(np.abs(np.diff(values)) > MIN_JUMP * range_) + 1
    steps = [
        ~(np.abs(np.diff(drive)) <= MIN_DRIVE_STEP * (np.nanmax(drive) - np.nanmin(drive)))
        for drive in drives
    ]
    jumps = []
    edges = [0, *jump_samples.tolist(), len(values)]
    for begin, k, end in zip(edges, edges[1:], edges[2:], strict=False):
        first = max(k - NEIGHBOURS, 0)
        if not drives or any(step[first : k + NEIGHBOURS - 1].any() for step in steps):
            continue
        sides = values[max(begin, k - MAX_CONSTANT) : k], values[k : min(end, k + MAX_CONSTANT)]
        is_short = min(map(len, sides)) < NEIGHBOURS
        ranges = np.ptp(sides[0][-NEIGHBOURS:]), np.ptp(sides[1][:NEIGHBOURS])
        if not is_short and max(ranges) < 0.5 * range_ and min(map(np.ptp, sides)) > 0.0:
            jumps.append(k)
    return np.array(jumps, dtype=int)


def _statement(quantity: str, column: Column, text: str) -> Statement:
    return finding(quantity, f"{column.place} {text}", place=column.place)
