"""Text tables of unusual shape: headings, comments, truncated rows, several runs in a file."""

from collections.abc import Sequence

import numpy as np

from tests.records.messy.writers import (
    BY_NUMBER,
    EVERY,
    NAMES,
    SAMPLES,
    UNITS,
    Messy,
    TIME_s,
    Write,
    all_rows_but,
    columns,
    lines,
    text,
    with_rows,
)

MIDDLE = 1 + SAMPLES // 2


def headed_anew(table: np.ndarray, names: Sequence[str]) -> Write:
    """Write the first half, and the second half of another table below its heading."""
    return text([*lines()[:MIDDLE], *lines(table=table[MIDDLE - 1 :], names=names)])


def with_last_cells(cell: str, *line_numbers: int) -> Write:
    """Write the recording with another text in the last column of some lines."""
    return with_rows(
        lambda rows: [
            row if k not in line_numbers else f"{row.rsplit(',', 1)[0]},{cell}"
            for k, row in enumerate(rows)
        ]
    )


FILES: tuple[Messy, ...] = (
    Messy(
        "preamble.csv",
        "a preamble of key and value",
        with_rows(lambda rows: ["Operator: Ada", "Date, 2026-03-01", "", *rows]),
    ),
    Messy(
        "two_line_heading.csv",
        "names and units on two lines",
        with_rows(lambda rows: ["Time,Voltage,Position", "s,V,µm", *rows[1:]]),
    ),
    Messy(
        "row_numbers.csv",
        "row numbers without a heading",
        with_rows(lambda rows: [rows[0], *(f"{k},{row}" for k, row in enumerate(rows[1:]))]),
    ),
    Messy(
        "no_heading.csv", "no headings at all", with_rows(lambda rows: rows[1:]), entry=BY_NUMBER
    ),
    Messy(
        "far_heading.csv",
        "headings above other words",
        with_rows(lambda rows: [rows[0], "first run", "after lunch", *rows[1:]]),
        entry="heading_row = 1\n",
    ),
    Messy(
        "no_units.csv",
        "headings without units",
        text(lines(names=("t", "U", "position"))),
        entry='columns = { time = "t", voltage = "U", displacement = "position" }\n' + UNITS,
    ),
    Messy(
        "two_positions.csv",
        "two columns of position",
        with_rows(
            lambda rows: [
                rows[0] + ",position B [um]",
                *(f"{row},{k}" for k, row in enumerate(rows[1:])),
            ]
        ),
        entry="columns = { time = 1, voltage = 2, displacement = 3 }\n",
    ),
    Messy(
        "noise_density.csv",
        "a noise in `A/sqrt(Hz)` and a force in `nN` beside",
        with_rows(
            lambda rows: [
                rows[0] + ",noise (A/sqrt(Hz)),force [nN]",
                *(f"{row},{k}.5,{2 * k}" for k, row in enumerate(rows[1:])),
            ]
        ),
    ),
    Messy(
        "comments.csv",
        "comments between the rows",
        with_rows(lambda rows: [*rows[:200], "# paused to drink coffee", *rows[200:]]),
    ),
    Messy(
        "footer.csv",
        "words behind the last row",
        with_rows(lambda rows: [*rows, "", "end of data"]),
    ),
    Messy(
        "cut_row.csv",
        "the last row cut in its middle",
        with_rows(lambda rows: [*rows[:-1], rows[-1][:8]]),
        true_rows=EVERY[:-1],
    ),
    Messy(
        "words.csv",
        "`OVERLOAD` in place of three numbers",
        with_last_cells("OVERLOAD", 50, 51, 52),
        true_rows=all_rows_but(49, 50, 51),
        breaks=1,
    ),
    Messy(
        "holes.csv",
        "empty cells in two pairs of rows",
        with_last_cells("", 50, 51, 300, 301),
        true_rows=all_rows_but(49, 50, 299, 300),
        breaks=2,
    ),
    Messy(
        "run_twice.csv",
        "a whole run pasted twice, heading and all",
        with_rows(lambda rows: [*rows, *rows]),
    ),
    Messy(
        "two_runs.csv",
        "two runs in one file, each with its heading",
        text([*lines(), *lines(table=np.column_stack([TIME_s[:300], columns()[100:, 1:]]))]),
        true_rows=np.concatenate([EVERY, EVERY[100:]]),
        breaks=1,
    ),
    Messy(
        "quoted_headings.csv",
        "headings in quotes with commas in them",
        with_rows(lambda rows: ['"time, s","voltage, V","position, um"', *rows[1:]]),
    ),
    Messy(
        "filtered.csv",
        "a unit and a word in one bracket, `[um, filtered]`",
        text(lines(names=(*NAMES[:2], "position [um, filtered]"))),
    ),
    Messy(
        "heading_again.csv",
        "the heading once more in the middle",
        with_rows(lambda rows: [*rows[:MIDDLE], rows[0], *rows[MIDDLE:]]),
        breaks=1,
    ),
    Messy(
        "other_unit.csv",
        "a second heading in the middle, in millivolts",
        headed_anew(columns() * [1, 1e3, 1], ("time [s]", "voltage [mV]", "position [um]")),
    ),
    Messy(
        "other_comment.csv",
        "a comment in the middle that heads millivolts",
        headed_anew(columns() * [1, 1e3, 1], ("# time [s]", "voltage [mV]", "position [um]")),
    ),
    Messy(
        "put_together.csv",
        "two halves put together, a byte mark and headings in capitals between",
        with_rows(
            lambda rows: [
                *rows[:MIDDLE],
                "\ufeffTime [s],Voltage [V],Position [um]",
                *rows[MIDDLE:],
            ]
        ),
        breaks=1,
    ),
    Messy(
        "other_order.csv",
        "a second heading in the middle, its columns exchanged",
        headed_anew(columns()[:, [0, 2, 1]], [NAMES[k] for k in (0, 2, 1)]),
    ),
)
