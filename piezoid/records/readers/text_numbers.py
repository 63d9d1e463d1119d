"""Parse the numbers of a text table: at once if it is regular, else cell by cell."""

import csv
import io
import re
import warnings
from contextlib import suppress
from dataclasses import dataclass
from math import isfinite
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from piezoid.numerics.arrays import Array
from piezoid.records.readers.reader import check_columns, unreadable
from piezoid.statement import Statement, finding

if TYPE_CHECKING:
    from pandas import DataFrame, Series

_EMPTY = frozenset({"", "nan", "n/a", "na", "null", "none", "-", "--", "#n/a", "-nan", "inf",
                    "-inf", "+inf", "infinity", "-infinity"})  # fmt: skip
_LONGEST = 400  # characters of a number: 1e308 written out has 309
_COUNT = re.compile(r"[0-9]{1,18}")
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?")
# Thousands in groups of three with the same mark, by the decimal mark.
_GROUPED = {
    ".": re.compile(r"[+-]?\d{1,3}(?:([,' \xa0\u2009\u202f])\d{3}(?:\1\d{3})*)?(?:\.\d*)?"),
    ",": re.compile(r"[+-]?\d{1,3}(?:([.' \xa0\u2009\u202f])\d{3}(?:\1\d{3})*)?(?:,\d*)?"),
}
_PREFIXED = re.compile(
    r"[+-]?(?:\d{1,20}(?:[.,]\d{1,20})?|[.,]\d{1,20})\s?[fpnuµμmkKMG][A-Za-z]{0,2}"
)
_COMMENT = re.compile(r"^[ \t]*(?:#|%|//)")
# A time of day behind any date: a clock that starts again shows a new day.
_TIME_OF_DAY = (
    r"(?:[\d./-]{6,10}[ T])?\s*(?P<h>\d{1,2}):(?P<m>[0-5]\d):(?P<s>[0-5]\d(?:[.,]\d+)?)"
    r"\s*(?P<half>[AaPp])?\.?(?:[Mm]\.?)?"
)
# Without hours, as Excel shows a time with tenths; only its fraction distinguishes it from 14:05.
_MINUTES = r"(?P<m>\d{1,4}):(?P<s>[0-5]\d[.,]\d+)"


@dataclass(frozen=True, kw_only=True)
class Layout:
    """Layout of the rows of a text table.

    separator  one character, or empty for runs of white space
    decimal    ``.`` or ``,``
    fields     number of fields in a row
    grouped    whether there may be marks of thousands, as in ``1,234.5`` or ``1.234,5``
    paired     whether the separator is also the decimal comma: two fields make one number
    """

    separator: str
    decimal: str
    fields: int
    grouped: bool = False
    paired: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class NumberTable:
    """The numbers of a table.

    columns     (fields,) arrays of equal length; NaN for fields without a number
    textual     indices of the fields with text in most rows
    stamped     indices of the fields with times of day, converted to seconds from the first
    statements  damaged fields and rows, with their lines
    """

    columns: tuple[Array, ...]
    textual: frozenset[int]
    stamped: frozenset[int] = frozenset()
    statements: tuple[Statement, ...]


def split(line: str, separator: str) -> list[str]:
    """Split a row into its fields, without the white space and quotes around them."""
    fields = line.split(separator) if separator else line.split()
    if '"' in line and separator and line.count('"') % 2 == 0:  # for separators inside quotes
        with suppress(csv.Error):
            reader = csv.reader([line], delimiter=separator, skipinitialspace=True)
            fields = next(reader, fields)
    return [field.strip().strip('"').strip() for field in fields]


def cells_of(line: str, layout: Layout) -> list[str]:
    """Split a row of numbers into fields; rejoin numbers that the separator splits."""
    fields = split(line, layout.separator)
    if not layout.paired or len(fields) % 2:
        return fields
    return [",".join(pair) for pair in zip(fields[::2], fields[1::2], strict=True)]


def number_of(text: str, decimal: str, *, grouped: bool = False) -> float | None:
    """Return the number in a field, NaN for an empty one, None for text."""
    if text.lower() in _EMPTY:
        return np.nan
    if grouped and (match := _GROUPED[decimal].fullmatch(text)) and match.group(1):
        text = text.replace(match.group(1), "")
    text = text.replace(",", ".") if decimal == "," else text
    if len(text) > _LONGEST or not _NUMBER.fullmatch(text):
        return None
    value = float(text.replace("D", "e").replace("d", "e"))
    return value if isfinite(value) else np.nan


def refuse_prefix(cell: str, name: str, line: int, column: int) -> None:
    """Refuse a number with a prefix or a unit in its cell: ``987.3m``."""
    if _PREFIXED.fullmatch(cell):
        raise unreadable(
            name,
            f"line {line}, column {column} holds {cell!r}, a number with a prefix or unit",
            needed="plain numbers in the cells, all of one unit",
            remedy="Export the recording without prefixes in the cells, the unit in the heading.",
            line=line,
        )


def count_of(text: str) -> int | None:
    """Return the count in a field; None for anything but up to eighteen digits."""
    return int(text) if _COUNT.fullmatch(text) else None


def parse_numbers(text: str, layout: Layout, name: str, first_line: int) -> NumberTable:
    """Read the rows of a table; ``first_line`` is the line number of its first row."""
    check_columns(name, layout.fields)
    if not text.strip():
        raise unreadable(
            name,
            f"there is no row from line {first_line} on, where the table should begin",
            needed="rows of numbers",
            remedy="Export the recording again.",
            line=first_line,
        )
    frame = _read_regular(text, layout, np.float64)
    if frame is not None:
        columns = tuple(frame[k].to_numpy(dtype=np.float64) for k in frame.columns)
        return NumberTable(columns=columns, textual=frozenset(), statements=())
    return _parse_cells(text, layout, name, first_line)


def without_comments(text: str, first_line: int) -> tuple[str, tuple[Statement, ...]]:
    """Return a table without comments between its rows, and the statement about them."""
    if not any(mark in text for mark in ("#", "%", "//")):
        return text, ()
    lines = text.split("\n")
    at = [k for k, line in enumerate(lines) if _COMMENT.match(line)]
    if not at:
        return text, ()
    text = f"{len(at)} comments between the rows are not read; the first is {lines[at[0]][:60]!r}"
    statement = finding("comment_lines", text, place=f"line {first_line + at[0]}")
    return "\n".join(line for line in lines if not _COMMENT.match(line)), (statement,)


def _parse_cells(text: str, layout: Layout, name: str, first_line: int) -> NumberTable:
    """Read cells as numbers or times of day, and report other cells.

    Raises ``UnreadableFileError`` if more than a quarter of the rows have text or surplus cells,
    and for a number with a prefix.
    """
    import pandas as pd

    rows, lines, fields = _split_rows(text, layout, first_line)
    numbers = np.empty((len(lines), layout.fields))
    is_text = np.zeros(numbers.shape, dtype=bool)
    stamped = set()
    for k in range(layout.fields):
        cells = rows[k].str.strip()
        # At once without marks of thousands, then cell by cell where that gives no number.
        column, contents = np.full(len(cells), np.nan), cells.tolist()
        if not layout.grouped:
            points = cells.str.replace(",", ".") if layout.decimal == "," else cells
            column = pd.to_numeric(points, errors="coerce").to_numpy(dtype=np.float64, copy=True)
        for row in np.flatnonzero(np.isnan(column)).tolist():
            value = number_of(contents[row], layout.decimal, grouped=layout.grouped)
            is_text[row, k] = value is None
            column[row] = np.nan if value is None else value
        numbers[:, k] = column
        if 2 * is_text[:, k].sum() > len(cells) and (seconds := _parse_times(cells)) is not None:
            numbers[:, k], is_text[:, k] = seconds, False
            stamped.add(k)
    counts = is_text.sum(axis=0)
    is_textual = 2 * counts > len(numbers)
    wide = np.flatnonzero(fields > layout.fields)
    damaged = len(wide) + int(counts[~is_textual].max(initial=0))
    is_unreadable = bool(is_textual.all()) or 4 * damaged > len(numbers)
    # The message about a prefix is clearer than that about text.
    texts = rows.to_numpy()
    for row, k in np.argwhere(is_text if is_unreadable else is_text & ~is_textual).tolist():
        refuse_prefix(texts[row, k].strip(), name, int(lines[row]), k + 1)
    if is_unreadable:
        first = wide[0] if len(wide) else is_text.any(axis=1).argmax()
        raise unreadable(
            name,
            f"{damaged} of {len(numbers)} rows hold text or too many fields, the first on line "
            f"{lines[first]}",
            needed="rows of numbers, as many in each",
            remedy="Export the recording again, or remove the rows that are no data.",
            line=int(lines[first]),
        )
    statements = [
        finding(
            "not_a_number",
            f"{counts[k]} fields of column {k + 1} hold text instead of a number",
            place=f"line {lines[is_text[:, k].argmax()]}, column {k + 1}",
        )
        for k in np.flatnonzero((counts > 0) & ~is_textual).tolist()
    ]
    if len(wide):
        numbers[wide] = np.nan
        text = (
            f"{len(wide)} rows have more fields than the table ({fields[wide[0]]} > "
            f"{layout.fields})"
        )
        location = f"line {lines[wide[0]]}"
        statements.append(finding("field_count", text, place=location))
    return NumberTable(
        columns=tuple(numbers[:, k].copy() for k in range(layout.fields)),
        textual=frozenset(np.flatnonzero(is_textual).tolist()),
        stamped=frozenset(stamped),
        statements=tuple(statements),
    )


def _split_rows(
    text: str, layout: Layout, first_line: int
) -> tuple["DataFrame", NDArray[np.intp], NDArray[np.intp]]:
    """Split a table into cells, row by row only if rows are blank or of different lengths.

    Returns:
        A column of text for each field, empty for missing fields; the line of each row; and its
        number of fields if it has surplus ones (otherwise any number up to that of the table).
    """
    import pandas as pd

    frame = None if "\n\n" in text.rstrip("\n") else _read_regular(text, layout, str)
    if frame is not None:
        lines = first_line + np.arange(len(frame))
        return frame.fillna(""), lines, np.full(len(frame), layout.fields)
    rows = [
        (line, cells_of(content, layout))
        for line, content in enumerate(text.split("\n"), start=first_line)
        if content.strip()
    ]
    cells = [row[: layout.fields] + [""] * (layout.fields - len(row)) for _, row in rows]
    return (
        pd.DataFrame(cells, dtype=str),
        np.array([line for line, _ in rows]),
        np.array([len(row) if any(row[layout.fields :]) else 0 for _, row in rows]),
    )


def _parse_times(cells: "Series[str]") -> "Series[float] | None":
    """Convert a column of times of day to seconds from the first; None for other columns.

    Dates in other formats than ISO 8601 are not interpreted (day or month first?): a clock that
    goes back by more than half a day has passed midnight. A clock without hours that goes back by
    more than half an hour has passed a full hour.
    """
    import pandas as pd

    stamps = pd.to_datetime(cells, format="ISO8601", errors="coerce", utc=True)
    if stamps.notna().all():
        return (stamps - stamps.iloc[0]).dt.total_seconds()
    turn_s, parts = 86400.0, cells.str.extract(f"^{_TIME_OF_DAY}$")
    if parts[["h", "m", "s"]].isna().to_numpy().any():
        turn_s, parts = 3600.0, cells.str.extract(f"^{_MINUTES}$")
        if parts.isna().to_numpy().any():
            return None
    second = parts["s"].str.replace(",", ".").astype(float)
    seconds = 60 * parts["m"].astype(float) + second
    if "h" in parts:
        hours = parts["h"].astype(float)
        if parts["half"].notna().any():
            hours = hours % 12 + 12 * parts["half"].str.lower().eq("p")
        seconds = 3600 * hours + seconds
    step = seconds.diff()
    turns = step.lt(-turn_s / 2).astype(int).cumsum() - step.gt(turn_s / 2).astype(int).cumsum()
    running: Series[float] = seconds + turn_s * turns
    # Stamps resolve at most nanoseconds; rounding removes the errors of the conversion.
    return (running - running.iloc[0]).round(9)


def _read_regular(text: str, layout: Layout, dtype: type) -> "DataFrame | None":
    """Read rows of equal length without thousands separators, or return None."""
    import pandas as pd

    if layout.grouped or layout.paired:
        return None
    try:
        # The parser warns if it drops fields; such a table is split row by row.
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)
            return pd.read_csv(
                io.BytesIO(text.encode("utf-8", "replace")),  # StringIO: 4 bytes per letter
                sep=layout.separator or r"\s+",
                decimal=layout.decimal,
                header=None,
                names=list(range(layout.fields)),
                index_col=False,
                dtype=dtype,
                engine="c",
                na_values=["-", "--"],
            )
    except (ValueError, OverflowError, pd.errors.ParserError, pd.errors.ParserWarning):
        return None
