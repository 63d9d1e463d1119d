"""Files as laboratories leave them, each with what is wrong and what must come of it."""

import gzip
import json

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
    UNITS,
    VOLTAGE_V,
    Messy,
    POSITION_um,
    RATE_Hz,
    TIME_s,
    Write,
    across_midnight,
    across_noon,
    at,
    clock_of_day,
    columns,
    computed_cells,
    cut_excel,
    dated_array,
    dated_parquet,
    empty_jpk,
    excel,
    grouped,
    held,
    igor,
    iso,
    jpk,
    lines,
    matlab,
    matlab_table,
    merged_cells,
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

WRAPPED = frozenset({"wrapped_clock"})
MIDDLE = 1 + SAMPLES // 2


def whole_volts(k: int) -> str:
    """Return 950 or 1,234: no decimals, thousands marked off."""
    return f"{round(1e3 * VOLTAGE_V[k] / 40):,}"


def _prefixed(line: str) -> str:
    """Write a displacement below 5 um as thousandths with a prefix."""
    *cells, displacement = line.split(",")
    value = float(displacement)
    return ",".join([*cells, f"{1e3 * value:.3f}m" if abs(value) < 5 else displacement])


def _with_zeros(content: bytes, at: int, count: int) -> bytes:
    return content[:at] + bytes(count) + content[at + count :]


def counter(first: int, bits: int, heading: str, ticks: int, low: int = 0) -> Write:
    """Write stamps of a counter of so many bits, ``ticks`` a sample, under its heading."""
    counts = (first + ticks * EVERY - low) % 2**bits + low
    table = np.column_stack([counts, VOLTAGE_V, POSITION_um])
    return text(lines(table=table, names=(heading, *NAMES[1:]), written="{:.10g}".format))


FILES: tuple[Messy, ...] = (
    Messy("bom.csv", "a byte mark in front", text(lines(), encoding="utf-8-sig")),
    Messy("utf16.csv", "UTF-16 with its mark", text(lines(), encoding="utf-16")),
    Messy("utf16le.csv", "UTF-16 without its mark", text(lines(), encoding="utf-16-le")),
    Messy(
        "utf16be.txt", "UTF-16, the other order, no mark", text(lines("\t"), encoding="utf-16-be")
    ),
    Messy(
        "latin1.csv",
        "`µm` in Western European bytes",
        text(lines(names=(*NAMES[:2], "Position [µm]")), encoding="latin-1"),
    ),
    Messy("greek.csv", "`μm` with a Greek mu", text(lines(names=(*NAMES[:2], "Position (μm)")))),
    Messy("crlf.csv", "line ends of Windows", text(lines(), end="\r\n")),
    Messy("mac.csv", "line ends of an old Mac", text(lines(), end="\r")),
    Messy(
        "mixed_ends.csv",
        "three kinds of line end in one file",
        with_rows(lambda rows: [row + ("\r" if k % 3 else "") for k, row in enumerate(rows)]),
    ),
    Messy("blank_lines.csv", "an empty line between all rows", text(lines(), end="\n\n")),
    Messy(
        "packed.csv.gz",
        "compressed",
        lambda path: (
            path.write_bytes(gzip.compress("\n".join(lines()).encode(), mtime=0)) and None
        ),
    ),
    Messy("semicolons.csv", "semicolons and decimal commas", text(lines(";", ","))),
    Messy("tabs.dat", "tabs and decimal commas", text(lines("\t", ","))),
    Messy("bars.txt", "`|` between the fields", text(lines(" | "))),
    Messy(
        "framed.txt",
        "`|` around each row as well",
        with_rows(lambda rows: [f"| {row} |" for row in rows], separator=" | "),
        problems=frozenset({"empty"}),
    ),
    Messy(
        "blanks.txt",
        "columns set with blanks",
        with_rows(
            lambda rows: ["   ".join(f"{cell:>12}" for cell in row.split(",")) for row in rows]
        ),
    ),
    Messy(
        "trailing.csv",
        "a separator at the end of every row, none behind the headings",
        with_rows(lambda rows: [rows[0], *(row + "," for row in rows[1:])]),
        problems=frozenset({"empty"}),
    ),
    Messy(
        "quoted.csv",
        "decimal commas in quotes, commas between",
        with_rows(
            lambda rows: [
                rows[0].replace(";", ","),
                *(",".join(f'"{cell}"' for cell in row.split(";")) for row in rows[1:]),
            ],
            separator=";",
            decimal=",",
        ),
    ),
    Messy(
        "all_commas.csv",
        "commas between the numbers and inside them",
        with_rows(
            lambda rows: [rows[0], *(row.replace(";", ",") for row in rows[1:])],
            separator=",",
            decimal=",",
        ),
        refused="line 1 heads 3 columns, and the rows from line 2 on have 6 fields",
        lines='separator = ","\ndecimal = ","\n',
    ),
    Messy(
        "thousands.txt",
        "`1,234.50`: commas mark thousands",
        text(
            lines(
                ";",
                table=columns() * [1, 1e3, 1e3],
                names=("time [s]", "voltage [mV]", "position [nm]"),
                written=lambda v: f"{v:,.3f}",
            )
        ),
    ),
    Messy(
        "tausender.csv",
        "`1.234,50`: points mark thousands",
        with_rows(
            lambda rows: [
                rows[0],
                *(
                    ";".join(
                        (
                            f"{TIME_s[k]:.3f}".replace(".", ","),
                            grouped(1e3 * VOLTAGE_V[k], ".", ","),
                            grouped(1e3 * POSITION_um[k], ".", ","),
                        )
                    )
                    for k in EVERY
                ),
            ],
            separator=";",
            names=("time [s]", "voltage [mV]", "position [nm]"),
        ),
    ),
    Messy(
        "swiss.csv",
        "`1'234.50`: apostrophes mark thousands",
        with_rows(
            lambda rows: [
                rows[0],
                *(
                    ";".join(
                        (
                            f"{TIME_s[k]:.3f}",
                            grouped(1e3 * VOLTAGE_V[k], "'", "."),
                            grouped(1e3 * POSITION_um[k], "'", "."),
                        )
                    )
                    for k in EVERY
                ),
            ],
            separator=";",
            names=("time [s]", "voltage [mV]", "position [nm]"),
        ),
    ),
    Messy(
        "either.csv",
        "`1,234` beside `950`: decimals or thousands?",
        text(
            [
                "time [ms];voltage [mV];position [um]",
                *(f"{k};{whole_volts(k)};{k % 7},{k % 5}" for k in EVERY),
            ]
        ),
        refused="does the comma mark decimals or thousands?",
    ),
    Messy(
        "true_minus.csv",
        "the minus of typesetters, `1.0e\u22123`",
        text(lines(written=lambda value: f"{value:.6e}".replace("-", "\u2212"))),
    ),
    Messy(
        "en_dash.csv",
        "an en dash for the minus, as word processors set it",
        text(lines(written=lambda value: f"{value:.6e}".replace("-", "\u2013"))),
    ),
    Messy(
        "fortran.txt",
        "exponents with D",
        text(lines("  ", written=lambda v: f"{v:.8E}".replace("E", "D"))),
    ),
    Messy(
        "strange_mark.csv",
        "`~` between the fields",
        text(lines("~")),
        refused="hold no row of numbers",
        lines='separator = "~"\n',
    ),
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
        "no_heading.csv",
        "no headings at all",
        with_rows(lambda rows: rows[1:]),
        refused="no column is a drive voltage or a displacement",
        lines=BY_NUMBER,
    ),
    Messy(
        "far_heading.csv",
        "headings above other words",
        with_rows(lambda rows: [rows[0], "first run", "after lunch", *rows[1:]]),
        refused="no column is a drive voltage or a displacement",
        lines="heading_row = 1\n",
    ),
    Messy(
        "no_units.csv",
        "headings without units",
        text(lines(names=("t", "U", "position"))),
        refused="is a time without a unit",
        lines='columns = { time = "t", voltage = "U", displacement = "position" }\n' + UNITS,
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
        refused="both claim to be the displacement",
        lines="columns = { time = 1, voltage = 2, displacement = 3 }\n",
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
        problems=frozenset({"comment_lines"}),
    ),
    Messy(
        "footer.csv",
        "words behind the last row",
        with_rows(lambda rows: [*rows, "", "end of data"]),
        problems=frozenset({"not_a_number", "missing_values"}),
    ),
    Messy(
        "cut_row.csv",
        "the last row cut in its middle",
        with_rows(lambda rows: [*rows[:-1], rows[-1][:8]]),
        kept=EVERY[:-1],
        problems=frozenset({"missing_values"}),
    ),
    Messy(
        "words.csv",
        "`OVERLOAD` in place of three numbers",
        with_rows(
            lambda rows: [
                row if k not in (50, 51, 52) else row.rsplit(",", 1)[0] + ",OVERLOAD"
                for k, row in enumerate(rows)
            ]
        ),
        kept=at(49, 50, 51),
        breaks=1,
        problems=frozenset({"not_a_number", "missing_values"}),
    ),
    Messy(
        "holes.csv",
        "empty cells in two pairs of rows",
        with_rows(
            lambda rows: [
                row if k not in (50, 51, 300, 301) else row.rsplit(",", 1)[0] + ","
                for k, row in enumerate(rows)
            ]
        ),
        kept=at(49, 50, 299, 300),
        breaks=2,
        problems=frozenset({"missing_values"}),
    ),
    Messy(
        "run_twice.csv",
        "a whole run pasted twice, heading and all",
        with_rows(lambda rows: [*rows, *rows]),
        problems=frozenset({"repeated_heading", "repeated_rows"}),
    ),
    Messy(
        "two_runs.csv",
        "two runs in one file, each with its heading",
        text([*lines(), *lines(table=np.column_stack([TIME_s[:300], columns()[100:, 1:]]))]),
        kept=np.concatenate([EVERY, EVERY[100:]]),
        breaks=1,
        problems=frozenset({"repeated_heading", "time_reversed"}),
    ),
    Messy(
        "zeros.csv",
        "zero bytes in its middle, of a computer that stopped",
        lambda path: (
            path.write_bytes(_with_zeros("\n".join(lines()).encode(), 3000, 256)) and None
        ),
        refused="line 132 holds a zero byte",
    ),
    Messy(
        "prefixes.csv",
        "prefixes in the cells of small displacements",
        text([*lines()[:1], *map(_prefixed, lines()[1:])]),
        refused=r"line \d+, column 3 holds '[\d.]+m', a number with a prefix or unit",
    ),
    Messy(
        "comma_in_time.csv",
        "decimal commas in the time alone, behind commas as separators",
        text([*lines()[:1], *(line.replace(".", ",", 1) for line in lines()[1:])]),
        refused="line 1 heads 3 columns, and the rows from line 2 on have 4 fields",
    ),
    Messy(
        "run.json",
        "JSON",
        lambda path: (
            path.write_text(json.dumps(dict(zip(NAMES, columns().T.tolist(), strict=True))))
            and None
        ),
        refused="it is JSON",
    ),
    Messy(
        "web.xls",
        "a page of HTML that calls itself a workbook",
        text(["<html><table><tr><td>0.001</td></tr></table></html>"]),
        refused="it is a page of HTML or XML",
    ),
    Messy(
        "units_in_cells.csv",
        "a unit in every cell",
        with_rows(
            lambda rows: [rows[0], *(" V,".join(row.split(",")) + " um" for row in rows[1:])]
        ),
        refused="hold no row of numbers",
    ),
    Messy(
        "newest_first.csv",
        "the newest row first",
        with_rows(lambda rows: [rows[0], *rows[:0:-1]]),
        refused="the newest row is the first",
        lines="reverse = true\n",
    ),
    Messy(
        "rows_twice.csv",
        "60 rows written twice",
        with_rows(twice),
        problems=frozenset({"repeated_rows"}),
    ),
    Messy(
        "block_twice.csv",
        "a block of 60 rows written again",
        with_rows(lambda rows: [*rows[:161], *rows[101:161], *rows[161:]]),
        problems=frozenset({"repeated_rows"}),
    ),
    Messy(
        "jitter.csv",
        "stamps that scatter by 5 %",
        text(
            lines(
                table=columns()
                + np.outer(np.random.default_rng(3).normal(0, 5e-5, SAMPLES), [1, 0, 0]),
                written="{:.6f}".format,
            )
        ),
        problems=frozenset({"jitter"}),
    ),
    Messy(
        "gap.csv",
        "40 samples lost",
        text(lines(table=columns(at(*range(150, 190))))),
        kept=at(*range(150, 190)),
        breaks=1,
        problems=frozenset({"gap"}),
    ),
    Messy(
        "stall.csv",
        "a clock that stands and catches up",
        text(
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
        problems=frozenset({"duplicate_time"}),
    ),
    Messy(
        "coarse_clock.csv",
        "stamps printed to a hundredth of a second",
        text(lines(table=np.column_stack([np.floor(TIME_s * 100) / 100, VOLTAGE_V, POSITION_um]))),
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
        text(
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
    Messy("sheet.xlsx", "an Excel workbook", excel(plain_sheet)),
    Messy(
        "second_sheet.xlsx",
        "the run on the second sheet, a summary on the third",
        excel(second_sheet),
        problems=frozenset({"other_sheets"}),
    ),
    Messy("cut.xlsx", "an Excel workbook cut short", cut_excel, refused="cut short or damaged"),
    Messy(
        "old.xls",
        "a workbook of Excel 97",
        lambda path: path.write_bytes(b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(600)) and None,
        refused="a workbook of Excel 97",
    ),
    Messy(
        "curve.jpk-force",
        "a force curve of JPK, which is a zip archive",
        jpk,
        kept=np.zeros(0, dtype=int),
    ),
    Messy(
        "empty.jpk-force",
        "a JPK archive of which most parts are missing",
        empty_jpk,
        refused="without its folders of segments",
    ),
    Messy(
        "run.zip",
        "a CSV file in a zip archive",
        zipped_csv,
        refused="it is a zip archive that holds 'run.csv'",
    ),
    Messy("structured.npy", "an array with named fields", structured),
    Messy(
        "on_its_side.mat",
        "a 3 x 400 matrix",
        matlab(data=columns().T),
        refused="no column is a drive voltage or a displacement",
        lines=BY_NUMBER,
        mended=frozenset({"transposed"}),
    ),
    Messy("wave.ibw", "a wave of Igor, with its labels and its clock", igor),
    Messy(
        "one_quantity.ibw",
        "a wave of Igor that holds the position alone",
        lambda path: write_ibw(path, POSITION_um, unit="um", step=1e-3, step_unit="s"),
        refused="one quantity, an image or text",
    ),
    Messy(
        "scope.wfm",
        "a waveform as a Rigol oscilloscope stores it",
        lambda path: path.write_bytes(b"\xa5\xa5\x00\x00" + bytes(380)) and None,
        refused="it is a waveform as an oscilloscope stores it",
    ),
    Messy(
        "complex.mat",
        "a complex response, and a vector of another length",
        matlab(
            time_s=TIME_s,
            voltage_V=VOLTAGE_V,
            position_um=POSITION_um,
            response=np.exp(1j * TIME_s),
            window=np.ones(77),
        ),
        problems=frozenset({"complex", "other_length"}),
    ),
    Messy(
        "timetable.mat",
        "a MATLAB timetable",
        matlab_table,
        refused="objects that only MATLAB can open: 'run' \\(timetable\\)",
    ),
    Messy(
        "counts.csv",
        "a sensor in counts",
        text(lines(table=columns() * [1, 1, 1e4], names=(*NAMES[:2], "position [counts]"))),
        lines=COUNTS,
        kept=np.zeros(0, dtype=int),
        problems=frozenset({"counts"}),
    ),
    Messy(
        "codes.csv",
        "counts of both converters under their own names",
        text(
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
    ),
    Messy(
        "dac.csv",
        "a drive in counts of the converter",
        text(
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
        "tube.csv",
        "150 mV that move 16 um",
        text(
            lines(
                table=columns() * [1, 3.75, 1], names=("time [s]", "voltage [mV]", "position [um]")
            )
        ),
        lines="scale = { voltage = 266.6666666666667 }\n",
        problems=frozenset({"implausible_gain"}),
    ),
    Messy(
        "kilovolts.csv",
        "kilovolts under a heading of volts, beside a clean file",
        text(lines(table=columns() * [1, 1e-3, 1], written="{:.7f}".format)),
        problems=FIT | COPY | {"implausible_gain"},
        lines="scale = { voltage = 1000 }\n",
        mended=COPY,
        beside=True,
    ),
    Messy(
        "monitor.csv",
        "the 1/15 monitor of the drive, beside a clean file",
        text(lines(table=columns() * [1, 1 / 15, 1], written="{:.7f}".format)),
        problems=FIT | COPY,
        lines="scale = { voltage = 15 }\n",
        mended=COPY,
        beside=True,
    ),
    Messy(
        "polarity.csv",
        "the other polarity, beside a clean file",
        text(lines(table=columns() * [1, -1, 1])),
        problems=FIT,
        lines="scale = { voltage = -1 }\n",
        mended=COPY,
        beside=True,
    ),
    Messy(
        "exchanged.csv",
        "the headings of drive and displacement exchanged",
        text(lines(names=("time [s]", "position [um]", "voltage [V]"))),
        problems=frozenset({"leads"}),
        lines="columns = { time = 1, voltage = 2, displacement = 3 }\n"
        'units = { time = "s", voltage = "V", displacement = "um" }\n',
    ),
    Messy(
        "nanometres.csv",
        "the same run in nanometres, beside the clean file",
        text(lines(table=columns() * [1, 1, 1e3], names=(*NAMES[:2], "position [nm]"))),
        problems=COPY,
        beside=True,
    ),
    Messy(
        "two_rates.csv",
        "256 Hz, then 2048 Hz",
        two_rates,
        problems=frozenset({"several_rates"}),
        kept=np.zeros(0, dtype=int),
    ),
    Messy(
        "held.csv",
        "the sensor held by a feedback while the drive creeps",
        held,
        problems=frozenset({"closed_loop"}),
        kept=np.zeros(0, dtype=int),
    ),
    Messy(
        "sep_line.csv",
        "`sep=;` in front, as Excel writes it, and decimal commas",
        text(["sep=;", *lines(";", ",")]),
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
        "bursts.csv",
        "bursts of 100 samples, a second between",
        text(lines(table=np.column_stack([TIME_s + EVERY // 100, VOLTAGE_V, POSITION_um]))),
        breaks=3,
        problems=frozenset({"gap"}),
    ),
    Messy(
        "heading_again.csv",
        "the heading once more in the middle",
        with_rows(lambda rows: [*rows[:MIDDLE], rows[0], *rows[MIDDLE:]]),
        breaks=1,
        problems=frozenset({"repeated_heading"}),
    ),
    Messy(
        "other_unit.csv",
        "a second heading in the middle, in millivolts",
        text(
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
        "other_comment.csv",
        "a comment in the middle that heads millivolts",
        text(
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
        problems=frozenset({"repeated_heading"}),
    ),
    Messy(
        "other_order.csv",
        "a second heading in the middle, its columns exchanged",
        text(
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
        "micros.csv",
        "a 32-bit counter of microseconds that begins anew",
        counter(2**32 - 150_200, 32, "time [us]", 1000),
        problems=WRAPPED,
    ),
    Messy(
        "signed.csv",
        "a 32-bit counter with a sign, which turns negative",
        counter(2**31 - 150_200, 32, "time (µs)", 1000, low=-(2**31)),
        problems=WRAPPED,
    ),
    Messy(
        "millis.csv",
        "a 16-bit counter of milliseconds",
        counter(65_400, 16, "t [ms]", 1),
        problems=WRAPPED,
    ),
    Messy(
        "noon.csv",
        "times with AM and PM, across noon",
        stamped(across_noon(), heading="Timestamp"),
    ),
    Messy("stamps.npy", "a structured array with dates and words", dated_array),
    Messy("dates.parquet", "Parquet of a data frame with an index of dates", dated_parquet),
    Messy(
        "merged.xlsx",
        "a merged title, units below the names, a mean at the end",
        excel(merged_cells),
        problems=frozenset({"not_a_number", "missing_values"}),
    ),
    Messy(
        "formulas.xlsx",
        "positions as formulas without stored values",
        excel(computed_cells),
        refused="cell C2 of sheet 'Sheet' holds the formula",
    ),
    Messy(
        "hexadecimal.csv",
        "counts in hexadecimal",
        text(["time [s],drive [counts]", *(f"{t:.3f},0x{k:04X}" for k, t in enumerate(TIME_s))]),
        refused="'0x0000' is a hexadecimal number",
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
        refused="are both a time",
    ),
    Messy(
        "rate_in_comment.csv",
        "the rate only in a comment",
        text(["# fs = 1000 Hz", *lines(table=columns()[:, 1:], names=NAMES[1:])]),
        refused="states no sampling rate",
        lines="sampling_rate_Hz = 1000.0\n",
    ),
    Messy(
        "statistics.csv",
        "mean and standard deviation below the rows",
        with_rows(lambda rows: [*rows, "mean,50.0,9.0", "std,28.3,5.7"]),
        problems=frozenset({"not_a_number", "missing_values"}),
    ),
)
