"""Clocks, containers, units and scales that are messy."""

import numpy as np

from tests.records.messy.writers import (
    BY_NUMBER,
    COPY,
    COUNTS,
    EVERY,
    FIT,
    FULL_HOUR,
    NAMES,
    SAMPLES,
    VOLTAGE_V,
    Messy,
    POSITION_um,
    TIME_s,
    across_midnight,
    at,
    clock_of_day,
    columns,
    cut_excel,
    empty_jpk,
    excel,
    held,
    igor,
    iso,
    jpk,
    lines,
    matlab,
    matlab_table,
    plain_sheet,
    second_sheet,
    stamped,
    structured,
    text,
    twice,
    two_rates,
    with_rows,
    zipped_csv,
)
from tests.records.microscopes import write_ibw

MEANINGS: tuple[Messy, ...] = (
    Messy(
        name="newest_first.csv",
        wrong="the newest row first",
        write=with_rows(lambda rows: [rows[0], *rows[:0:-1]]),
        refused="the newest row is the first",
        lines="reverse = true\n",
    ),
    Messy(
        name="rows_twice.csv",
        wrong="60 rows written twice",
        write=with_rows(twice),
        kept=EVERY,
        problems=frozenset({"repeated_rows"}),
    ),
    Messy(
        name="block_twice.csv",
        wrong="a block of 60 rows written again",
        write=with_rows(lambda rows: [*rows[:161], *rows[101:161], *rows[161:]]),
        kept=EVERY,
        problems=frozenset({"repeated_rows"}),
    ),
    Messy(
        name="jitter.csv",
        wrong="stamps that scatter by 5 %",
        write=text(
            lines(
                table=columns()
                + np.outer(np.random.default_rng(3).normal(0, 5e-5, SAMPLES), [1, 0, 0]),
                written="{:.6f}".format,
            )
        ),
        kept=EVERY,
        problems=frozenset({"jitter"}),
    ),
    Messy(
        name="gap.csv",
        wrong="40 samples lost",
        write=text(lines(table=columns(at(*range(150, 190))))),
        kept=at(*range(150, 190)),
        breaks=1,
        problems=frozenset({"gap"}),
    ),
    Messy(
        name="stall.csv",
        wrong="a clock that stands and catches up",
        write=text(
            lines(
                table=np.column_stack(
                    [
                        np.where((EVERY > 99) & (EVERY < 110), TIME_s[100], TIME_s),
                        VOLTAGE_V,
                        POSITION_um,
                    ]
                )
            )
        ),
        kept=EVERY,
        problems=frozenset({"duplicate_time"}),
    ),
    Messy(
        name="coarse_clock.csv",
        wrong="stamps printed to a hundredth of a second",
        write=text(
            lines(table=np.column_stack([np.floor(TIME_s * 100) / 100, VOLTAGE_V, POSITION_um]))
        ),
        kept=EVERY,
    ),
    Messy(
        name="clock_time.csv",
        wrong="times as `14:05:03.250`",
        write=stamped([clock_of_day(k) for k in range(SAMPLES)]),
        kept=EVERY,
    ),
    Messy(
        name="clock_comma.txt",
        wrong="times as `14:05:03,250` between tabs",
        write=stamped([clock_of_day(k, ",") for k in range(SAMPLES)], "\t"),
        kept=EVERY,
    ),
    Messy(
        name="clock_thousands.txt",
        wrong="times of day under `clock`, beside `1,234.500`",
        write=with_rows(
            lambda rows: [
                rows[0],
                *(f"{clock_of_day(k)}|{row.split('|', 1)[1]}" for k, row in enumerate(rows[1:])),
            ],
            separator="|",
            table=columns() * [1, 1e3, 1e3],
            names=("clock", "voltage [mV]", "position [nm]"),
            written=lambda v: f"{v:,.3f}",
        ),
        kept=EVERY,
    ),
    Messy(
        name="minutes.csv",
        wrong="times as `59:59.800`, without hours, across a full one",
        write=stamped([clock_of_day(k, start=FULL_HOUR)[3:] for k in range(SAMPLES)]),
        kept=EVERY,
    ),
    Messy(
        name="midnight.csv",
        wrong="dates, day or month first, across midnight",
        write=stamped(across_midnight()),
        kept=EVERY,
    ),
    Messy(
        name="iso.csv",
        wrong="dates of ISO 8601",
        write=stamped(iso(), heading="timestamp"),
        kept=EVERY,
    ),
    Messy(
        name="random_clock.csv",
        wrong="no uniform clock",
        write=text(
            lines(
                table=np.column_stack(
                    [
                        np.cumsum(np.random.default_rng(4).uniform(0, 2e-3, SAMPLES)),
                        VOLTAGE_V,
                        POSITION_um,
                    ]
                ),
                written="{:.6f}".format,
            )
        ),
        refused="Needed: samples at a uniform rate",
    ),
    Messy(name="sheet.xlsx", wrong="an Excel workbook", write=excel(plain_sheet), kept=EVERY),
    Messy(
        name="second_sheet.xlsx",
        wrong="the run on the second sheet, a summary on the third",
        write=excel(second_sheet),
        kept=EVERY,
        problems=frozenset({"other_sheets"}),
    ),
    Messy(
        name="cut.xlsx",
        wrong="an Excel workbook cut short",
        write=cut_excel,
        refused="cut short or damaged",
    ),
    Messy(
        name="old.xls",
        wrong="a workbook of Excel 97",
        write=lambda path: (
            path.write_bytes(b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(600)) and None
        ),
        refused="a workbook of Excel 97",
    ),
    Messy(
        name="curve.jpk-force",
        wrong="a force curve of JPK, which is a zip archive",
        write=jpk,
        kept=np.zeros(0, dtype=int),
    ),
    Messy(
        name="empty.jpk-force",
        wrong="a JPK archive of which most parts are missing",
        write=empty_jpk,
        refused="without its folders of segments",
    ),
    Messy(
        name="run.zip",
        wrong="a CSV file in a zip archive",
        write=zipped_csv,
        refused="it is a zip archive that holds 'run.csv'",
    ),
    Messy(name="structured.npy", wrong="an array with named fields", write=structured, kept=EVERY),
    Messy(
        name="on_its_side.mat",
        wrong="a 3 x 400 matrix",
        write=matlab(data=columns().T),
        refused="no column is a drive voltage or a displacement",
        lines=BY_NUMBER,
        mended=frozenset({"transposed"}),
    ),
    Messy(
        name="wave.ibw",
        wrong="a wave of Igor, with its labels and its clock",
        write=igor,
        kept=EVERY,
    ),
    Messy(
        name="one_quantity.ibw",
        wrong="a wave of Igor that holds the position alone",
        write=lambda path: write_ibw(path, POSITION_um, unit="um", step=1e-3, step_unit="s"),
        refused="one quantity, an image or text",
    ),
    Messy(
        name="scope.wfm",
        wrong="a waveform as a Rigol oscilloscope stores it",
        write=lambda path: path.write_bytes(b"\xa5\xa5\x00\x00" + bytes(380)) and None,
        refused="it is a waveform as an oscilloscope stores it",
    ),
    Messy(
        name="complex.mat",
        wrong="a complex response, and a vector of another length",
        write=matlab(
            time_s=TIME_s,
            voltage_V=VOLTAGE_V,
            position_um=POSITION_um,
            response=np.exp(1j * TIME_s),
            window=np.ones(77),
        ),
        kept=EVERY,
        problems=frozenset({"complex", "other_length"}),
    ),
    Messy(
        name="timetable.mat",
        wrong="a MATLAB timetable",
        write=matlab_table,
        refused="objects that only MATLAB can open: 'run' \\(timetable\\)",
    ),
    Messy(
        name="counts.csv",
        wrong="a sensor in counts",
        write=text(lines(table=columns() * [1, 1, 1e4], names=(*NAMES[:2], "position [counts]"))),
        lines=COUNTS,
        kept=np.zeros(0, dtype=int),
        problems=frozenset({"counts"}),
    ),
    Messy(
        name="codes.csv",
        wrong="counts of both converters under their own names",
        write=text(
            lines(
                table=columns() * [1, 1e3, 1e4],
                names=("time [s]", "DAC [codes]", "ADC [codes]"),
                written="{:.6g}".format,
            )
        ),
        refused="no column is a drive voltage or a displacement",
        lines='columns = { time = 1, voltage = "DAC [codes]", displacement = "ADC [codes]" }\n'
        'units = { voltage = "codes", displacement = "codes" }\n'
        "scale = { voltage = 0.001, displacement = 1e-10 }\n",
        kept=EVERY,
    ),
    Messy(
        name="dac.csv",
        wrong="a drive in counts of the converter",
        write=text(
            lines(
                table=columns() * [1, 1000, 1],
                names=("time [s]", "drive [counts]", "position [um]"),
            )
        ),
        lines="scale = { voltage = 0.001 }\n",
        kept=np.zeros(0, dtype=int),
        problems=frozenset({"counts"}),
    ),
    Messy(
        name="tube.csv",
        wrong="150 mV that move 16 um",
        write=text(
            lines(
                table=columns() * [1, 3.75, 1], names=("time [s]", "voltage [mV]", "position [um]")
            )
        ),
        lines="scale = { voltage = 266.6666666666667 }\n",
        kept=EVERY,
        problems=frozenset({"implausible_gain"}),
    ),
    Messy(
        name="kilovolts.csv",
        wrong="kilovolts under a heading of volts, beside a clean file",
        write=text(lines(table=columns() * [1, 1e-3, 1], written="{:.7f}".format)),
        problems=FIT | COPY | {"implausible_gain"},
        lines="scale = { voltage = 1000 }\n",
        mended=COPY,
        beside=True,
        kept=EVERY,
    ),
    Messy(
        name="monitor.csv",
        wrong="the 1/15 monitor of the drive, beside a clean file",
        write=text(lines(table=columns() * [1, 1 / 15, 1], written="{:.7f}".format)),
        problems=FIT | COPY,
        lines="scale = { voltage = 15 }\n",
        mended=COPY,
        beside=True,
        kept=EVERY,
    ),
    Messy(
        name="polarity.csv",
        wrong="the other polarity, beside a clean file",
        write=text(lines(table=columns() * [1, -1, 1])),
        problems=FIT,
        lines="scale = { voltage = -1 }\n",
        mended=COPY,
        beside=True,
        kept=EVERY,
    ),
    Messy(
        name="exchanged.csv",
        wrong="the headings of drive and displacement exchanged",
        write=text(lines(names=("time [s]", "position [um]", "voltage [V]"))),
        problems=frozenset({"leads"}),
        lines="columns = { time = 1, voltage = 2, displacement = 3 }\n"
        'units = { time = "s", voltage = "V", displacement = "um" }\n',
        kept=EVERY,
    ),
    Messy(
        name="nanometres.csv",
        wrong="the same run in nanometres, beside the clean file",
        write=text(lines(table=columns() * [1, 1, 1e3], names=(*NAMES[:2], "position [nm]"))),
        problems=COPY,
        beside=True,
        kept=EVERY,
    ),
    Messy(
        name="two_rates.csv",
        wrong="256 Hz, then 2048 Hz",
        write=two_rates,
        problems=frozenset({"several_rates"}),
        kept=np.zeros(0, dtype=int),
    ),
    Messy(
        name="held.csv",
        wrong="the sensor held by a feedback while the drive creeps",
        write=held,
        problems=frozenset({"closed_loop"}),
        kept=np.zeros(0, dtype=int),
    ),
)
