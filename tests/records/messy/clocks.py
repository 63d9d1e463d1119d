"""Text tables with unusual clocks: repeated rows, gaps, times of day, wrapping counters."""

import numpy as np

from tests.records.messy.writers import (
    EVERY,
    FULL_HOUR,
    NAMES,
    SAMPLES,
    VOLTAGE_V,
    Messy,
    POSITION_um,
    RATE_Hz,
    TIME_s,
    Write,
    across_midnight,
    across_noon,
    all_rows_but,
    clock_of_day,
    clocked,
    columns,
    iso,
    lines,
    repeat_rows,
    stamped,
    text,
    two_rates,
    with_rows,
)


def counter(first: int, bits: int, heading: str, ticks: int, low: int = 0) -> Write:
    """Write stamps of a counter of ``bits`` bits with ``ticks`` per sample."""
    counts = (first + ticks * EVERY - low) % 2**bits + low
    table = np.column_stack([counts, VOLTAGE_V, POSITION_um])
    return text(lines(table=table, names=(heading, *NAMES[1:]), written="{:.10g}".format))


FILES: tuple[Messy, ...] = (
    Messy(
        "newest_first.csv",
        "the newest row first",
        with_rows(lambda rows: [rows[0], *rows[:0:-1]]),
        entry="reverse = true\n",
    ),
    Messy("rows_twice.csv", "60 rows written twice", with_rows(repeat_rows)),
    Messy(
        "jitter.csv",
        "stamps that scatter by 5 %",
        clocked(TIME_s + np.random.default_rng(3).normal(0, 5e-5, SAMPLES), "{:.6f}".format),
    ),
    Messy(
        "gap.csv",
        "40 samples lost",
        text(lines(table=columns(all_rows_but(*range(150, 190))))),
        true_rows=all_rows_but(*range(150, 190)),
        breaks=1,
    ),
    Messy(
        "stall.csv",
        "a clock that stands and catches up",
        clocked(np.where((EVERY > 99) & (EVERY < 110), TIME_s[100], TIME_s)),
    ),
    Messy(
        "coarse_clock.csv",
        "stamps printed to a hundredth of a second",
        clocked(np.floor(TIME_s * 100) / 100),
    ),
    Messy(
        "clock_time.csv",
        "times as `14:05:03.250`",
        stamped([clock_of_day(k) for k in range(SAMPLES)]),
    ),
    Messy(
        "clock_comma.txt",
        "times as `14:05:03,250` between tabs",
        stamped([clock_of_day(k, ",") for k in range(SAMPLES)], "\t"),
    ),
    Messy(
        "clock_thousands.txt",
        "times of day under `clock`, beside `1,234.500`",
        with_rows(
            lambda rows: [
                rows[0],
                *(f"{clock_of_day(k)}|{row.split('|', 1)[1]}" for k, row in enumerate(rows[1:])),
            ],
            separator="|",
            table=columns() * [1, 1e3, 1e3],
            names=("clock", "voltage [mV]", "position [nm]"),
            written=lambda v: f"{v:,.3f}",
        ),
    ),
    Messy(
        "minutes.csv",
        "times as `59:59.800`, without hours, across a full one",
        stamped([clock_of_day(k, start=FULL_HOUR)[3:] for k in range(SAMPLES)]),
    ),
    Messy(
        "midnight.csv", "dates, day or month first, across midnight", stamped(across_midnight())
    ),
    Messy("iso.csv", "dates of ISO 8601", stamped(iso(), heading="timestamp")),
    Messy(
        "random_clock.csv",
        "no uniform clock",
        clocked(np.cumsum(np.random.default_rng(4).uniform(0, 2e-3, SAMPLES)), "{:.6f}".format),
    ),
    Messy("two_rates.csv", "256 Hz, then 2048 Hz", two_rates, true_rows=np.zeros(0, dtype=int)),
    Messy(
        "bursts.csv",
        "bursts of 100 samples, a second between",
        clocked(TIME_s + EVERY // 100),
        breaks=3,
    ),
    Messy(
        "signed.csv",
        "a 32-bit counter with a sign, which turns negative",
        counter(2**31 - 150_200, 32, "time (µs)", 1000, low=-(2**31)),
    ),
    Messy("millis.csv", "a 16-bit counter of milliseconds", counter(65_400, 16, "t [ms]", 1)),
    Messy(
        "noon.csv",
        "times with AM and PM, across noon",
        stamped(across_noon(), heading="Timestamp"),
    ),
    Messy(
        "two_clocks.csv",
        "a clock for each channel, a quarter of a sample apart",
        text(
            lines(
                table=np.column_stack([TIME_s, VOLTAGE_V, TIME_s + 0.25 / RATE_Hz, POSITION_um]),
                names=("time drive [s]", NAMES[1], "time sensor [s]", NAMES[2]),
                written="{:.6f}".format,
            )
        ),
    ),
    Messy(
        "rate_in_comment.csv",
        "the rate only in a comment",
        text(["# fs = 1000 Hz", *lines(table=columns()[:, 1:], names=NAMES[1:])]),
        entry="sampling_rate_Hz = 1000.0\n",
    ),
)
