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
    Messy(
        name="bom.csv",
        wrong="a byte mark in front",
        write=text(lines(), encoding="utf-8-sig"),
        kept=EVERY,
    ),
    Messy(
        name="utf16.csv",
        wrong="UTF-16 with its mark",
        write=text(lines(), encoding="utf-16"),
        kept=EVERY,
    ),
    Messy(
        name="utf16le.csv",
        wrong="UTF-16 without its mark",
        write=text(lines(), encoding="utf-16-le"),
        kept=EVERY,
    ),
    Messy(
        name="utf16be.txt",
        wrong="UTF-16, the other order, no mark",
        write=text(lines("\t"), encoding="utf-16-be"),
        kept=EVERY,
    ),
    Messy(
        name="latin1.csv",
        wrong="`µm` in Western European bytes",
        write=text(lines(names=(*NAMES[:2], "Position [µm]")), encoding="latin-1"),
        kept=EVERY,
    ),
    Messy(
        name="greek.csv",
        wrong="`μm` with a Greek mu",
        write=text(lines(names=(*NAMES[:2], "Position (μm)"))),
        kept=EVERY,
    ),
    Messy(
        name="crlf.csv", wrong="line ends of Windows", write=text(lines(), end="\r\n"), kept=EVERY
    ),
    Messy(
        name="mac.csv", wrong="line ends of an old Mac", write=text(lines(), end="\r"), kept=EVERY
    ),
    Messy(
        name="mixed_ends.csv",
        wrong="three kinds of line end in one file",
        write=with_rows(
            lambda rows: [row + ("\r" if k % 3 else "") for k, row in enumerate(rows)]
        ),
        kept=EVERY,
    ),
    Messy(
        name="blank_lines.csv",
        wrong="an empty line between all rows",
        write=text(lines(), end="\n\n"),
        kept=EVERY,
    ),
    Messy(
        name="packed.csv.gz",
        wrong="compressed",
        write=lambda path: (
            path.write_bytes(gzip.compress("\n".join(lines()).encode(), mtime=0)) and None
        ),
        kept=EVERY,
    ),
    Messy(
        name="semicolons.csv",
        wrong="semicolons and decimal commas",
        write=text(lines(";", ",")),
        kept=EVERY,
    ),
    Messy(
        name="tabs.dat", wrong="tabs and decimal commas", write=text(lines("\t", ",")), kept=EVERY
    ),
    Messy(name="bars.txt", wrong="`|` between the fields", write=text(lines(" | ")), kept=EVERY),
    Messy(
        name="framed.txt",
        wrong="`|` around each row as well",
        write=with_rows(lambda rows: [f"| {row} |" for row in rows], separator=" | "),
        kept=EVERY,
        problems=frozenset({"empty"}),
    ),
    Messy(
        name="blanks.txt",
        wrong="columns set with blanks",
        write=with_rows(
            lambda rows: ["   ".join(f"{cell:>12}" for cell in row.split(",")) for row in rows]
        ),
        kept=EVERY,
    ),
    Messy(
        name="trailing.csv",
        wrong="a separator at the end of every row, none behind the headings",
        write=with_rows(lambda rows: [rows[0], *(row + "," for row in rows[1:])]),
        kept=EVERY,
        problems=frozenset({"empty"}),
    ),
    Messy(
        name="quoted.csv",
        wrong="decimal commas in quotes, commas between",
        write=with_rows(
            lambda rows: [
                rows[0].replace(";", ","),
                *(",".join(f'"{cell}"' for cell in row.split(";")) for row in rows[1:]),
            ],
            separator=";",
            decimal=",",
        ),
        kept=EVERY,
    ),
    Messy(
        name="all_commas.csv",
        wrong="commas between the numbers and inside them",
        write=with_rows(
            lambda rows: [rows[0], *(row.replace(";", ",") for row in rows[1:])],
            separator=",",
            decimal=",",
        ),
        refused="line 1 heads 3 columns, and the rows from line 2 on have 6 fields",
        lines='separator = ","\ndecimal = ","\n',
    ),
    Messy(
        name="thousands.txt",
        wrong="`1,234.50`: commas mark thousands",
        write=text(
            lines(
                ";",
                table=columns() * [1, 1e3, 1e3],
                names=("time [s]", "voltage [mV]", "position [nm]"),
                written=lambda v: f"{v:,.3f}",
            )
        ),
        kept=EVERY,
    ),
    Messy(
        name="tausender.csv",
        wrong="`1.234,50`: points mark thousands",
        write=with_rows(
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
        kept=EVERY,
    ),
    Messy(
        name="swiss.csv",
        wrong="`1'234.50`: apostrophes mark thousands",
        write=with_rows(
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
        kept=EVERY,
    ),
    Messy(
        name="either.csv",
        wrong="`1,234` beside `950`: decimals or thousands?",
        write=text(
            [
                "time [ms];voltage [mV];position [um]",
                *(f"{k};{whole_volts(k)};{k % 7},{k % 5}" for k in EVERY),
            ]
        ),
        refused="does the comma mark decimals or thousands?",
    ),
    Messy(
        name="true_minus.csv",
        wrong="the minus of typesetters, `1.0e\u22123`",
        write=text(lines(written=lambda value: f"{value:.6e}".replace("-", "\u2212"))),
        kept=EVERY,
    ),
    Messy(
        name="en_dash.csv",
        wrong="an en dash for the minus, as word processors set it",
        write=text(lines(written=lambda value: f"{value:.6e}".replace("-", "\u2013"))),
        kept=EVERY,
    ),
    Messy(
        name="fortran.txt",
        wrong="exponents with D",
        write=text(lines("  ", written=lambda v: f"{v:.8E}".replace("E", "D"))),
        kept=EVERY,
    ),
    Messy(
        name="strange_mark.csv",
        wrong="`~` between the fields",
        write=text(lines("~")),
        refused="hold no row of numbers",
        lines='separator = "~"\n',
    ),
    Messy(
        name="preamble.csv",
        wrong="a preamble of key and value",
        write=with_rows(lambda rows: ["Operator: Ada", "Date, 2026-03-01", "", *rows]),
        kept=EVERY,
    ),
    Messy(
        name="two_line_heading.csv",
        wrong="names and units on two lines",
        write=with_rows(lambda rows: ["Time,Voltage,Position", "s,V,µm", *rows[1:]]),
        kept=EVERY,
    ),
    Messy(
        name="row_numbers.csv",
        wrong="row numbers without a heading",
        write=with_rows(lambda rows: [rows[0], *(f"{k},{row}" for k, row in enumerate(rows[1:]))]),
        kept=EVERY,
    ),
    Messy(
        name="no_heading.csv",
        wrong="no headings at all",
        write=with_rows(lambda rows: rows[1:]),
        refused="no column is a drive voltage or a displacement",
        lines=BY_NUMBER,
    ),
    Messy(
        name="far_heading.csv",
        wrong="headings above other words",
        write=with_rows(lambda rows: [rows[0], "first run", "after lunch", *rows[1:]]),
        refused="no column is a drive voltage or a displacement",
        lines="heading_row = 1\n",
    ),
    Messy(
        name="no_units.csv",
        wrong="headings without units",
        write=text(lines(names=("t", "U", "position"))),
        refused="is a time without a unit",
        lines='columns = { time = "t", voltage = "U", displacement = "position" }\n' + UNITS,
    ),
    Messy(
        name="two_positions.csv",
        wrong="two columns of position",
        write=with_rows(
            lambda rows: [
                rows[0] + ",position B [um]",
                *(f"{row},{k}" for k, row in enumerate(rows[1:])),
            ]
        ),
        refused="both claim to be the displacement",
        lines="columns = { time = 1, voltage = 2, displacement = 3 }\n",
    ),
    Messy(
        name="noise_density.csv",
        wrong="a noise in `A/sqrt(Hz)` and a force in `nN` beside",
        write=with_rows(
            lambda rows: [
                rows[0] + ",noise (A/sqrt(Hz)),force [nN]",
                *(f"{row},{k}.5,{2 * k}" for k, row in enumerate(rows[1:])),
            ]
        ),
        kept=EVERY,
    ),
    Messy(
        name="comments.csv",
        wrong="comments between the rows",
        write=with_rows(lambda rows: [*rows[:200], "# paused to drink coffee", *rows[200:]]),
        kept=EVERY,
        problems=frozenset({"comment_lines"}),
    ),
    Messy(
        name="footer.csv",
        wrong="words behind the last row",
        write=with_rows(lambda rows: [*rows, "", "end of data"]),
        kept=EVERY,
        problems=frozenset({"not_a_number", "missing_values"}),
    ),
    Messy(
        name="cut_row.csv",
        wrong="the last row cut in its middle",
        write=with_rows(lambda rows: [*rows[:-1], rows[-1][:8]]),
        kept=EVERY[:-1],
        problems=frozenset({"missing_values"}),
    ),
    Messy(
        name="words.csv",
        wrong="`OVERLOAD` in place of three numbers",
        write=with_rows(
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
        name="holes.csv",
        wrong="empty cells in two rows",
        write=with_rows(
            lambda rows: [
                row if k not in (50, 300) else row.rsplit(",", 1)[0] + ","
                for k, row in enumerate(rows)
            ]
        ),
        kept=at(49, 299),
        breaks=2,
        problems=frozenset({"missing_values"}),
    ),
    Messy(
        name="run_twice.csv",
        wrong="a whole run pasted twice, heading and all",
        write=with_rows(lambda rows: [*rows, *rows]),
        kept=EVERY,
        problems=frozenset({"repeated_heading", "repeated_rows"}),
    ),
    Messy(
        name="two_runs.csv",
        wrong="two runs in one file, each with its heading",
        write=text([*lines(), *lines(table=np.column_stack([TIME_s[:300], columns()[100:, 1:]]))]),
        kept=np.concatenate([EVERY, EVERY[100:]]),
        breaks=1,
        problems=frozenset({"repeated_heading", "time_reversed"}),
    ),
    Messy(
        name="zeros.csv",
        wrong="zero bytes in its middle, of a computer that stopped",
        write=lambda path: (
            path.write_bytes(_with_zeros("\n".join(lines()).encode(), 3000, 256)) and None
        ),
        refused="line 132 holds a zero byte",
    ),
    Messy(
        name="prefixes.csv",
        wrong="prefixes in the cells of small displacements",
        write=text([*lines()[:1], *map(_prefixed, lines()[1:])]),
        refused=r"line \d+, column 3 holds '[\d.]+m', a number with a prefix or unit",
    ),
    Messy(
        name="comma_in_time.csv",
        wrong="decimal commas in the time alone, behind commas as separators",
        write=text([*lines()[:1], *(line.replace(".", ",", 1) for line in lines()[1:])]),
        refused="line 1 heads 3 columns, and the rows from line 2 on have 4 fields",
    ),
    Messy(
        name="run.json",
        wrong="JSON",
        write=lambda path: (
            path.write_text(json.dumps(dict(zip(NAMES, columns().T.tolist(), strict=True))))
            and None
        ),
        refused="it is JSON",
    ),
    Messy(
        name="web.xls",
        wrong="a page of HTML that calls itself a workbook",
        write=text(["<html><table><tr><td>0.001</td></tr></table></html>"]),
        refused="it is a page of HTML or XML",
    ),
    Messy(
        name="units_in_cells.csv",
        wrong="a unit in every cell",
        write=with_rows(
            lambda rows: [rows[0], *(" V,".join(row.split(",")) + " um" for row in rows[1:])]
        ),
        refused="hold no row of numbers",
    ),
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
        wrong="positions as formulas without stored values",
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
