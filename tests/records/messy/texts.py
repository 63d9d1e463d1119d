"""Encodings, line ends, separators, decimals, headings and rows that are messy."""

import gzip
import json

import numpy as np

from tests.records.messy.writers import (
    BY_NUMBER,
    EVERY,
    NAMES,
    UNITS,
    VOLTAGE_V,
    Messy,
    POSITION_um,
    TIME_s,
    at,
    columns,
    grouped,
    lines,
    text,
    with_rows,
)


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


TEXTS: tuple[Messy, ...] = (
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
)
