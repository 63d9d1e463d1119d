"""Parse the numbers of a text table: fast if it is whole, else cell by cell with its faults."""

import csv
import io
import re
import warnings
from dataclasses import dataclass, replace
from math import isfinite
from typing import TYPE_CHECKING

import numpy as np

from piezoid.errors import UnreadableFileError
from piezoid.numerics.arrays import Array
from piezoid.records.readers.source import check_columns, unreadable
from piezoid.statement import Statement, finding

if TYPE_CHECKING:
    from pandas import DataFrame, Series

_EMPTY = frozenset({"", "nan", "n/a", "na", "null", "none", "-", "--", "#n/a", "-nan", "inf",
                    "-inf", "+inf", "infinity", "-infinity"})  # fmt: skip
_LONGEST = 400  # characters of a number: 1e308 written out has 309
_COUNT = re.compile(r"[0-9]{1,18}")
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?")
# Thousands in groups of three behind one and the same mark, by the decimal mark they stand beside.
_GROUPED = {
    ".": re.compile(r"[+-]?\d{1,3}(?:([,' \xa0\u2009\u202f])\d{3}(?:\1\d{3})*)?(?:\.\d*)?"),
    ",": re.compile(r"[+-]?\d{1,3}(?:([.' \xa0\u2009\u202f])\d{3}(?:\1\d{3})*)?(?:,\d*)?"),
}
_PREFIXED = re.compile(
    r"[+-]?(?:\d{1,20}(?:[.,]\d{1,20})?|[.,]\d{1,20})\s?[fpnuµμmkKMG][A-Za-z]{0,2}"
)
_COMMENT = re.compile(r"^[ \t]*(?:#|%|//)")
# A time of day, whatever date stands before it: days are told apart by the clock that begins anew.
_TIME_OF_DAY = (
    r"(?:[\d./-]{6,10}[ T])?\s*(?P<h>\d{1,2}):(?P<m>[0-5]\d):(?P<s>[0-5]\d(?:[.,]\d+)?)"
    r"\s*(?P<half>[AaPp])?\.?(?:[Mm]\.?)?"
)
# Without hours, as Excel shows a time with tenths; only the fraction tells it from 14:05 o'clock.
_MINUTES = r"(?P<m>\d{1,4}):(?P<s>[0-5]\d[.,]\d+)"


@dataclass(frozen=True, kw_only=True)
class Layout:
    """How the rows of a text table are written.

    separator  one character, or empty for runs of white space
    decimal    ``.`` or ``,``
    fields     number of fields in a row
    grouped    whether thousands may be marked off, as in ``1,234.5`` or ``1.234,5``
    paired     whether the separator is the decimal comma as well: two fields make one number
    """

    separator: str
    decimal: str
    fields: int
    grouped: bool = False
    paired: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class NumberTable:
    """The numbers of a table.

    columns   (fields,) arrays of equal length; NaN where a field holds no number
    textual   fields that hold text in most of their rows
    stamped   fields that hold times of day, with or without dates, now seconds from the first
    statements  damaged fields and rows, with their lines
    """

    columns: tuple[Array, ...]
    textual: frozenset[int]
    stamped: frozenset[int] = frozenset()
    statements: tuple[Statement, ...]


def split(line: str, separator: str) -> list[str]:
    """Cut a row into its fields, without the white space and quotes around them."""
    fields = _quoted(line, separator) if '"' in line and separator else None
    if fields is None:
        fields = line.split(separator) if separator else line.split()
    return [field.strip().strip('"').strip() for field in fields]


def _quoted(line: str, separator: str) -> list[str] | None:
    """Cut a row some fields of which hold its separator within quotes; None where none does."""
    try:
        fields = next(csv.reader([line], delimiter=separator, skipinitialspace=True), None)
    except csv.Error:
        return None
    return fields if line.count('"') % 2 == 0 else None


def cells_of(line: str, layout: Layout) -> list[str]:
    """Cut a row of numbers into its fields, put together again where the separator parts them."""
    fields = split(line, layout.separator)
    if not layout.paired or len(fields) % 2:
        return fields
    return [",".join(pair) for pair in zip(fields[::2], fields[1::2], strict=True)]


def number_of(text: str, decimal: str, *, grouped: bool = False) -> float | None:
    """Return the number a field holds, NaN for an empty one, None for text."""
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
    """Return the count a field holds, None for anything but up to eighteen digits."""
    return int(text) if _COUNT.fullmatch(text) else None


def parse_numbers(text: str, layout: Layout, name: str, first_line: int) -> NumberTable:
    """Read the rows of a table; ``first_line`` is the line its first row stands on."""
    check_columns(name, layout.fields)
    if not text.strip():
        raise unreadable(
            name,
            f"there is no row from line {first_line} on, where the table should begin",
            needed="rows of numbers",
            remedy="Export the recording again.",
            line=first_line,
        )
    block = None
    if not layout.grouped and not layout.paired:
        block = _parse_fast(text, layout) or _parse_mixed(text, layout, first_line)
    try:
        block = _parse_slowly(text, layout, name, first_line) if block is None else block
    except UnreadableFileError:
        _refuse_prefixes(text, layout, name, first_line, frozenset())  # the better reason
        raise
    if any(statement.quantity == "not_a_number" for statement in block.statements):
        _refuse_prefixes(text, layout, name, first_line, block.textual)
    return block


def _refuse_prefixes(
    text: str, layout: Layout, name: str, first_line: int, textual: frozenset[int]
) -> None:
    for line, content in enumerate(text.split("\n"), start=first_line):
        for k, cell in enumerate(cells_of(content, layout)):
            if k not in textual:
                refuse_prefix(cell, name, line, k + 1)


def lines_are_rows(text: str) -> bool:
    """Tell whether every line of a table is a row, none of them blank or a comment."""
    marked = any(mark in text for mark in ("#", "%", "//"))
    return "\n\n" not in text.rstrip("\n") and not (
        marked and any(map(_COMMENT.match, text.split("\n")))
    )


def without_comments(text: str, first_line: int) -> tuple[str, tuple[Statement, ...]]:
    """Return a table without the comments between its rows, and the statement that says so."""
    if not any(mark in text for mark in ("#", "%", "//")):
        return text, ()
    lines = text.split("\n")
    at = [k for k, line in enumerate(lines) if _COMMENT.match(line)]
    if not at:
        return text, ()
    said = f"{len(at)} comments between the rows are not read; the first is {lines[at[0]][:60]!r}"
    statement = finding(quantity="comment_lines", place=f"line {first_line + at[0]}", text=said)
    return "\n".join(line for line in lines if not _COMMENT.match(line)), (statement,)


def _parse_fast(text: str, layout: Layout) -> NumberTable | None:
    """Read a table in which every field is a number or empty, or return None."""
    frame = _frame(text, layout, np.float64)
    if frame is None:
        return None
    columns = tuple(frame[k].to_numpy(dtype=np.float64) for k in frame.columns)
    return NumberTable(columns=columns, textual=frozenset(), statements=())


def _parse_mixed(text: str, layout: Layout, first_line: int) -> NumberTable | None:
    """Read a table of whole rows in which some fields hold text or dates, or return None."""
    import pandas as pd

    frame = None if "\n\n" in text.rstrip("\n") else _frame(text, layout, str)
    if frame is None:
        return None
    columns, texts, stamped = [], [], set()
    for k in frame.columns:
        held = frame[k].str.strip()
        points = held.str.replace(",", ".") if layout.decimal == "," else held
        numbers = pd.to_numeric(points, errors="coerce")
        wrong_here = held.notna() & numbers.isna() & ~held.str.lower().isin(_EMPTY)
        texts.append(np.array(wrong_here, dtype=bool))
        if 2 * texts[-1].sum() > len(held):
            seconds = _seconds_of(held)
            if seconds is not None:
                numbers = seconds
                texts[-1][:] = False
                stamped.add(int(k))
        columns.append(numbers.to_numpy(dtype=np.float64))
    wrong = np.array(texts)
    textual = frozenset(np.flatnonzero(2 * wrong.sum(axis=1) > len(frame)).tolist())
    if len(textual) == layout.fields or 4 * _max_text_cells(wrong, textual) > len(frame):
        return None
    first = [first_line + int(np.argmax(row)) for row in wrong]
    statements = _text_statements(wrong.sum(axis=1), first, textual)
    return NumberTable(
        columns=tuple(columns), textual=textual, stamped=frozenset(stamped), statements=statements
    )


def _seconds_of(held: "Series[str]") -> "Series[float] | None":
    """Return seconds from the first of a column of times of day, or None where it is none.

    A date in front is not interpreted (day or month first?) unless it is ISO 8601: a clock that
    goes back by more than half a day has passed midnight, and one without hours that goes back by
    more than half an hour a full one.
    """
    import pandas as pd

    stamps = pd.to_datetime(held, format="ISO8601", errors="coerce", utc=True)
    if stamps.notna().all():
        return (stamps - stamps.iloc[0]).dt.total_seconds()
    parts = held.str.strip().str.extract(f"^{_TIME_OF_DAY}$")
    if not parts[["h", "m", "s"]].isna().to_numpy().any():
        hours = parts["h"].astype(float)
        if parts["half"].notna().any():
            hours = hours % 12 + 12 * parts["half"].str.lower().eq("p")
        return _without_wraps(3600 * hours + _seconds_of_hour(parts), 86400.0)
    parts = held.str.strip().str.extract(f"^{_MINUTES}$")
    return (
        None if parts.isna().to_numpy().any() else _without_wraps(_seconds_of_hour(parts), 3600.0)
    )


def _seconds_of_hour(parts: "DataFrame") -> "Series[float]":
    """Return the seconds of minutes ``m`` and seconds ``s``."""
    second = parts["s"].str.replace(",", ".").astype(float)
    return 60 * parts["m"].astype(float) + second


def _without_wraps(seconds: "Series[float]", turn_s: float) -> "Series[float]":
    """Return seconds from the first of a clock that begins anew after each turn."""
    step = seconds.diff()
    turns = step.lt(-turn_s / 2).astype(int).cumsum() - step.gt(turn_s / 2).astype(int).cumsum()
    running: Series[float] = seconds + turn_s * turns
    # Stamps have at most nanoseconds; hours in seconds would leave noise behind their digits.
    return (running - running.iloc[0]).round(9)


def _max_text_cells(wrong: np.ndarray, textual: frozenset[int]) -> int:
    counts = wrong.sum(axis=1)
    return max((int(counts[k]) for k in range(len(counts)) if k not in textual), default=0)


def _text_statements(
    texts: np.ndarray, first: list[int], textual: frozenset[int]
) -> tuple[Statement, ...]:
    return tuple(
        finding(
            quantity="not_a_number",
            place=f"line {first[k]}, column {k + 1}",
            text=f"{texts[k]} fields of column {k + 1} hold text instead of a number",
        )
        for k in range(len(texts))
        if texts[k] and k not in textual
    )


def _frame(text: str, layout: Layout, dtype: type) -> "DataFrame | None":
    import pandas as pd

    try:
        # The warning says that fields were dropped: that must send us the slow way, not be lost.
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)
            return pd.read_csv(
                io.BytesIO(text.encode("utf-8", "replace")),  # a StringIO takes 4 bytes a letter
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


def _parse_slowly(text: str, layout: Layout, name: str, first_line: int) -> NumberTable:
    rows, lines, strange, cells = [], [], [], []
    for line, content in enumerate(text.split("\n"), start=first_line):
        if not content.strip():
            continue
        fields = cells_of(content, layout)
        values = [
            number_of(field, layout.decimal, grouped=layout.grouped)
            for field in fields[: layout.fields]
        ]
        if len([field for field in fields[layout.fields :] if field]) > 0 or len(fields) == 0:
            strange.append((line, len(fields)))
        values += [np.nan] * (layout.fields - len(values))
        rows.append([np.nan if value is None else value for value in values])
        lines.append((line, [k for k, value in enumerate(values) if value is None]))
        cells.append(fields)
    numbers = np.array(rows, dtype=np.float64)
    stamps = _stamps(cells, lines)
    for k, seconds in stamps.items():
        numbers[:, k] = seconds
    lines = [(line, [k for k in where if k not in stamps]) for line, where in lines]
    return replace(_checked_numbers(numbers, lines, strange, name), stamped=frozenset(stamps))


def _stamps(cells: list[list[str]], lines: list[tuple[int, list[int]]]) -> dict[int, Array]:
    """Return the seconds of the fields that hold times of day in every row."""
    import pandas as pd

    found: dict[int, Array] = {}
    for k in sorted(set.intersection(*(set(where) for _, where in lines))):
        seconds = _seconds_of(pd.Series([row[k] for row in cells], dtype=str))
        if seconds is not None:
            found[k] = np.asarray(seconds, dtype=np.float64)
    return found


def _checked_numbers(
    rows: Array, lines: list[tuple[int, list[int]]], strange: list[tuple[int, int]], name: str
) -> NumberTable:
    count, fields = rows.shape
    texts = np.zeros(fields, dtype=int)
    first = [0] * fields
    for line, where in lines:
        for k in where:
            first[k] = first[k] or line
            texts[k] += 1
    textual = frozenset(np.flatnonzero(2 * texts > count).tolist())
    statements = list(_text_statements(texts, first, textual))
    if strange:
        line, found = strange[0]
        wide = {at for at, _ in strange}
        rows[[k for k, (at, _) in enumerate(lines) if at in wide]] = np.nan
        statements.append(
            finding(
                quantity="field_count",
                place=f"line {line}",
                text=f"{len(strange)} rows have more fields than the table ({found} > {fields})",
            )
        )
    damaged = len(strange) + max([0, *(texts[k] for k in range(fields) if k not in textual)])
    if len(textual) == fields or 4 * damaged > count:
        line = strange[0][0] if strange else min(at for at in first if at)
        raise unreadable(
            name,
            f"{damaged} of {count} rows hold text or too many fields, the first on line {line}",
            needed="rows of numbers, as many in each",
            remedy="Export the recording again, or remove the rows that are no data.",
            line=line,
        )
    return NumberTable(
        columns=tuple(rows[:, k].copy() for k in range(fields)),
        textual=textual,
        statements=tuple(statements),
    )
