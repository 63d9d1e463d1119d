"""Text tables with unusual encodings, line ends, separators, decimal and thousands marks."""

import gzip

from tests.records.messy.writers import (
    EVERY,
    NAMES,
    VOLTAGE_V,
    Messy,
    TIME_s,
    Write,
    columns,
    grouped,
    lines,
    raw,
    text,
    with_rows,
)

LINES = "\n".join(lines()).encode()
SMALL = ("time [s]", "voltage [mV]", "position [nm]")


def rounded_volts(k: int) -> str:
    """Return a voltage without decimals and with thousands marks, such as 950 or 1,234."""
    return f"{round(1e3 * VOLTAGE_V[k] / 40):,}"


def with_thousands(mark: str, decimal: str) -> Write:
    """Write millivolts and nanometres with thousands marks and semicolons."""
    rows = [
        ";".join(
            (
                f"{t:.3f}".replace(".", decimal),
                grouped(1e3 * volts, mark, decimal),
                grouped(1e3 * position_um, mark, decimal),
            )
        )
        for t, volts, position_um in columns()
    ]
    return text([";".join(SMALL), *rows])


def _prefixed(line: str) -> str:
    """Write a displacement below 5 um with the prefix m."""
    *cells, displacement = line.split(",")
    value = float(displacement)
    return ",".join([*cells, f"{1e3 * value:.3f}m" if abs(value) < 5 else displacement])


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
    Messy("blank_lines.csv", "an empty line between all rows", text(lines(), end="\n\n")),
    Messy("packed.csv.gz", "compressed", raw(gzip.compress(LINES, mtime=0))),
    Messy("semicolons.csv", "semicolons and decimal commas", text(lines(";", ","))),
    Messy("tabs.dat", "tabs and decimal commas", text(lines("\t", ","))),
    Messy("bars.txt", "`|` between the fields", text(lines(" | "))),
    Messy(
        "framed.txt",
        "`|` around each row as well",
        with_rows(lambda rows: [f"| {row} |" for row in rows], separator=" | "),
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
        entry='separator = ","\ndecimal = ","\n',
    ),
    Messy(
        "thousands.txt",
        "`1,234.50`: commas mark thousands",
        text(
            lines(
                ";",
                table=columns() * [1, 1e3, 1e3],
                names=SMALL,
                written=lambda v: f"{v:,.3f}",
            )
        ),
    ),
    Messy("tausender.csv", "`1.234,50`: points mark thousands", with_thousands(".", ",")),
    Messy("swiss.csv", "`1'234.50`: apostrophes mark thousands", with_thousands("'", ".")),
    Messy(
        "either.csv",
        "`1,234` beside `950`: decimals or thousands?",
        text(
            [
                "time [ms];voltage [mV];position [um]",
                *(f"{k};{rounded_volts(k)};{k % 7},{k % 5}" for k in EVERY),
            ]
        ),
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
        "strange_mark.csv", "`~` between the fields", text(lines("~")), entry='separator = "~"\n'
    ),
    Messy(
        "zeros.csv",
        "zero bytes in its middle, of a computer that stopped",
        raw(LINES[:3000] + bytes(256) + LINES[3256:]),
    ),
    Messy(
        "prefixes.csv",
        "prefixes in the cells of small displacements",
        text([*lines()[:1], *map(_prefixed, lines()[1:])]),
    ),
    Messy(
        "comma_in_time.csv",
        "decimal commas in the time alone, behind commas as separators",
        text([*lines()[:1], *(line.replace(".", ",", 1) for line in lines()[1:])]),
    ),
    Messy(
        "units_in_cells.csv",
        "a unit in every cell",
        with_rows(
            lambda rows: [rows[0], *(" V,".join(row.split(",")) + " um" for row in rows[1:])]
        ),
    ),
    Messy(
        "sep_line.csv",
        "`sep=;` in front, as Excel writes it, and decimal commas",
        text(["sep=;", *lines(";", ",")]),
    ),
    Messy(
        "hexadecimal.csv",
        "counts in hexadecimal",
        text(["time [s],drive [counts]", *(f"{t:.3f},0x{k:04X}" for k, t in enumerate(TIME_s))]),
    ),
)
