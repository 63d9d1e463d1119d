"""Files that were made after the reader was done, to see it for the first time."""

import numpy as np

from tests.records.messy.writers import (
    EVERY,
    NAMES,
    SAMPLES,
    VOLTAGE_V,
    Messy,
    POSITION_um,
    RATE_Hz,
    TIME_s,
    Write,
    across_noon,
    columns,
    computed_cells,
    dated_array,
    dated_parquet,
    excel,
    lines,
    merged_cells,
    stamped,
    text,
    with_rows,
)

WRAPPED = frozenset({"wrapped_clock"})
MIDDLE = 1 + SAMPLES // 2


def counter(first: int, bits: int, heading: str, ticks: int, low: int = 0) -> Write:
    """Write stamps of a counter of so many bits, ``ticks`` a sample, under its heading."""
    counts = (first + ticks * EVERY - low) % 2**bits + low
    table = np.column_stack([counts, VOLTAGE_V, POSITION_um])
    return text(lines(table=table, names=(heading, *NAMES[1:]), written="{:.10g}".format))


STRANGERS: tuple[Messy, ...] = (
    Messy(
        name="sep_line.csv",
        wrong="`sep=;` in front, as Excel writes it, and decimal commas",
        write=text(["sep=;", *lines(";", ",")]),
        kept=EVERY,
    ),
    Messy(
        name="quoted_headings.csv",
        wrong="headings in quotes with commas in them",
        write=with_rows(lambda rows: ['"time, s","voltage, V","position, um"', *rows[1:]]),
        kept=EVERY,
    ),
    Messy(
        name="filtered.csv",
        wrong="a unit and a word in one bracket, `[um, filtered]`",
        write=text(lines(names=(*NAMES[:2], "position [um, filtered]"))),
        kept=EVERY,
    ),
    Messy(
        name="bursts.csv",
        wrong="bursts of 100 samples, a second between",
        write=text(lines(table=np.column_stack([TIME_s + EVERY // 100, VOLTAGE_V, POSITION_um]))),
        kept=EVERY,
        breaks=3,
        problems=frozenset({"gap"}),
    ),
    Messy(
        name="heading_again.csv",
        wrong="the heading once more in the middle",
        write=with_rows(lambda rows: [*rows[:MIDDLE], rows[0], *rows[MIDDLE:]]),
        kept=EVERY,
        breaks=1,
        problems=frozenset({"repeated_heading"}),
    ),
    Messy(
        name="other_unit.csv",
        wrong="a second heading in the middle, in millivolts",
        write=text(
            [
                *lines()[:MIDDLE],
                *lines(
                    table=columns()[MIDDLE - 1 :] * [1, 1e3, 1],
                    names=("time [s]", "voltage [mV]", "position [um]"),
                ),
            ]
        ),
        refused="line 202 heads the columns anew",
    ),
    Messy(
        name="other_comment.csv",
        wrong="a comment in the middle that heads millivolts",
        write=text(
            [
                *lines()[:MIDDLE],
                *lines(
                    table=columns()[MIDDLE - 1 :] * [1, 1e3, 1],
                    names=("# time [s]", "voltage [mV]", "position [um]"),
                ),
            ]
        ),
        refused="line 202 heads the columns anew",
    ),
    Messy(
        name="put_together.csv",
        wrong="two halves put together, a byte mark and headings in capitals between",
        write=with_rows(
            lambda rows: [
                *rows[:MIDDLE],
                "\ufeffTime [s],Voltage [V],Position [um]",
                *rows[MIDDLE:],
            ]
        ),
        kept=EVERY,
        breaks=1,
        problems=frozenset({"repeated_heading"}),
    ),
    Messy(
        name="other_order.csv",
        wrong="a second heading in the middle, its columns exchanged",
        write=text(
            [
                *lines()[:MIDDLE],
                *lines(
                    table=columns()[MIDDLE - 1 :, [0, 2, 1]], names=[NAMES[k] for k in (0, 2, 1)]
                ),
            ]
        ),
        refused="line 202 heads the columns anew",
    ),
    Messy(
        name="micros.csv",
        wrong="a 32-bit counter of microseconds that begins anew",
        write=counter(2**32 - 150_200, 32, "time [us]", 1000),
        kept=EVERY,
        problems=WRAPPED,
    ),
    Messy(
        name="signed.csv",
        wrong="a 32-bit counter with a sign, which turns negative",
        write=counter(2**31 - 150_200, 32, "time (µs)", 1000, low=-(2**31)),
        kept=EVERY,
        problems=WRAPPED,
    ),
    Messy(
        name="millis.csv",
        wrong="a 16-bit counter of milliseconds",
        write=counter(65_400, 16, "t [ms]", 1),
        kept=EVERY,
        problems=WRAPPED,
    ),
    Messy(
        name="noon.csv",
        wrong="times with AM and PM, across noon",
        write=stamped(across_noon(), heading="Timestamp"),
        kept=EVERY,
    ),
    Messy(
        name="stamps.npy",
        wrong="a structured array with dates and words",
        write=dated_array,
        kept=EVERY,
    ),
    Messy(
        name="dates.parquet",
        wrong="Parquet of a data frame with an index of dates",
        write=dated_parquet,
        kept=EVERY,
    ),
    Messy(
        name="merged.xlsx",
        wrong="a merged title, units below the names, a mean at the end",
        write=excel(merged_cells),
        kept=EVERY,
        problems=frozenset({"not_a_number", "missing_values"}),
    ),
    Messy(
        name="formulas.xlsx",
        wrong="positions as formulas that nobody computed",
        write=excel(computed_cells),
        refused="cell C2 of sheet 'Sheet' holds the formula",
    ),
    Messy(
        name="hexadecimal.csv",
        wrong="counts in hexadecimal",
        write=text(
            ["time [s],drive [counts]", *(f"{t:.3f},0x{k:04X}" for k, t in enumerate(TIME_s))]
        ),
        refused="'0x0000' is a hexadecimal number",
    ),
    Messy(
        name="two_clocks.csv",
        wrong="a clock for each channel, a quarter of a sample apart",
        write=text(
            lines(
                table=np.column_stack([TIME_s, VOLTAGE_V, TIME_s + 0.25 / RATE_Hz, POSITION_um]),
                names=("time drive [s]", NAMES[1], "time sensor [s]", NAMES[2]),
                written="{:.6f}".format,
            )
        ),
        refused="are both a time",
    ),
    Messy(
        name="rate_in_comment.csv",
        wrong="the rate only in a comment",
        write=text(["# fs = 1000 Hz", *lines(table=columns()[:, 1:], names=NAMES[1:])]),
        refused="states no sampling rate",
        lines="sampling_rate_Hz = 1000.0\n",
    ),
    Messy(
        name="statistics.csv",
        wrong="mean and standard deviation below the rows",
        write=with_rows(lambda rows: [*rows, "mean,50.0,9.0", "std,28.3,5.7"]),
        kept=EVERY,
        problems=frozenset({"not_a_number", "missing_values"}),
    ),
)
