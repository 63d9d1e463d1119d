"""The numbers of a text table: fast where all is in order, with line and column where not."""

import io
import re
import warnings
from dataclasses import dataclass

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.records.readers.source import unreadable
from piezoid.records.recording import Problem

_EMPTY = frozenset({"", "nan", "n/a", "na", "null", "none", "-", "--", "#n/a", "-nan", "inf",
                    "-inf", "+inf", "infinity", "-infinity"})  # fmt: skip
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?")


@dataclass(frozen=True, kw_only=True)
class Layout:
    """How the rows of a text table are written.

    separator  one character, or empty for runs of white space
    decimal    ``.`` or ``,``
    fields     number of fields in a row
    """

    separator: str
    decimal: str
    fields: int


@dataclass(frozen=True, kw_only=True, eq=False)
class Block:
    """The numbers of a table.

    columns   (fields,) arrays of equal length; NaN where a field holds no number
    textual   fields that hold text in most of their rows
    problems  damaged fields and rows, with their lines
    """

    columns: tuple[Array, ...]
    textual: frozenset[int]
    problems: tuple[Problem, ...]


def split(line: str, separator: str) -> list[str]:
    """Cut a row into its fields, without the white space and quotes around them."""
    fields = line.split(separator) if separator else line.split()
    return [field.strip().strip('"').strip() for field in fields]


def number_of(text: str, decimal: str) -> float | None:
    """Return the number a field holds, NaN for an empty one, None for text."""
    if text.lower() in _EMPTY:
        return np.nan
    text = text.replace(",", ".") if decimal == "," else text
    if not _NUMBER.fullmatch(text):
        return None
    value = float(text.replace("D", "e").replace("d", "e"))
    return value if np.isfinite(value) else np.nan


def parse_block(text: str, layout: Layout, name: str, first_line: int) -> Block:
    """Read the rows of a table; ``first_line`` is the line its first row stands on."""
    block = _parse_fast(text, layout)
    return _parse_slowly(text, layout, name, first_line) if block is None else block


def _parse_fast(text: str, layout: Layout) -> Block | None:
    import pandas as pd

    try:
        # The warning says that fields were dropped: that must send us the slow way, not be lost.
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)
            frame = pd.read_csv(
                io.StringIO(text),
                sep=layout.separator or r"\s+",
                decimal=layout.decimal,
                header=None,
                names=list(range(layout.fields)),
                index_col=False,
                dtype=np.float64,
                engine="c",
                na_values=["-", "--"],
            )
    except (ValueError, OverflowError, pd.errors.ParserError, pd.errors.ParserWarning):
        return None
    columns = tuple(frame[k].to_numpy(dtype=np.float64, copy=True) for k in frame.columns)
    return Block(columns=columns, textual=frozenset(), problems=())


def _parse_slowly(text: str, layout: Layout, name: str, first_line: int) -> Block:
    rows, lines, strange = [], [], []
    for line, content in enumerate(text.split("\n"), start=first_line):
        if not content.strip():
            continue
        fields = split(content, layout.separator)
        values = [number_of(field, layout.decimal) for field in fields[: layout.fields]]
        if len([field for field in fields[layout.fields :] if field]) > 0 or len(fields) == 0:
            strange.append((line, len(fields)))
        values += [np.nan] * (layout.fields - len(values))
        rows.append([np.nan if value is None else value for value in values])
        lines.append((line, [k for k, value in enumerate(values) if value is None]))
    return _judge(np.array(rows, dtype=np.float64), lines, strange, name)


def _judge(
    rows: Array, lines: list[tuple[int, list[int]]], strange: list[tuple[int, int]], name: str
) -> Block:
    count, fields = rows.shape
    texts = np.zeros(fields, dtype=int)
    first = [0] * fields
    for line, where in lines:
        for k in where:
            first[k] = first[k] or line
            texts[k] += 1
    textual = frozenset(np.flatnonzero(2 * texts > count).tolist())
    problems = [
        Problem(
            kind="not_a_number",
            place=f"line {first[k]}, column {k + 1}",
            text=f"{texts[k]} fields of column {k + 1} hold text instead of a number",
        )
        for k in range(fields)
        if texts[k] and k not in textual
    ]
    if strange:
        line, found = strange[0]
        rows[[k for k, (at, _) in enumerate(lines) if at in {s for s, _ in strange}]] = np.nan
        problems.append(
            Problem(
                kind="field_count",
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
    return Block(
        columns=tuple(rows[:, k].copy() for k in range(fields)),
        textual=textual,
        problems=tuple(problems),
    )
