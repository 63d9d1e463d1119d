"""Layout of a text table: its first row, separator and decimal mark, headings and units."""

import re
from collections import Counter
from dataclasses import dataclass, replace
from itertools import accumulate

import numpy as np

from piezoid.errors import LabFileError
from piezoid.numerics.arrays import Array
from piezoid.records.column_roles import meaning_of
from piezoid.records.lab_tables import entry_text
from piezoid.records.readers.reader import TextFormat, check_columns, unreadable
from piezoid.records.readers.text_numbers import Layout, cells_of, number_of, refuse_prefix, split
from piezoid.records.units import heading_of, unit_of

# Longer preambles than this have their own formats.
HEAD_LINES = 1000
# Characters of a row, and of the text on which every layout is tried.
MAX_LINE = 1 << 18
MAX_TRIED_TEXT = 1 << 20
_SEPARATORS = ("\t", ";", "|", ",", "")
# A comma that may mark decimals or thousands: ``1,234``.
_THOUSAND = re.compile(r"[+-]?[1-9]\d{0,2}(?:,\d{3})+")
_SPLIT_NUMBER = re.compile(r"[+-]?\d{1,9},\d{3,9}(?=,)")
_BELOW_THOUSAND = re.compile(r"[+-]?[1-9]\d{0,2}")
_BRACKETS = frozenset("[](){}")
UNIT_BRACKETS = "[]() "  # around a unit in a row of units
_HEXADECIMAL = re.compile(r"\b0[xX][0-9a-fA-F]{1,16}\b")
_COMMENT = re.compile(r"^\s*(?:#|%|//)+\s?")
# No opening bracket inside: a line of opening brackets would take quadratic time.
_NAME_AND_BRACKET = re.compile(r"[^\s\[(]+(?:\s*(?:\[[^\[\]]*\]|\([^()]*\)))?")


@dataclass(frozen=True, kw_only=True)
class TableStart:
    """Start and layout of a table in a text.

    layout   of its rows
    row      index of its first line, from 0
    labels   heading of each field, empty without one
    units    unit of each field in a separate row of units, empty without one
    above    lines before the headings
    strays   lines (from 1) above the table with another number of numeric fields
    """

    layout: Layout
    row: int
    labels: tuple[str, ...]
    units: tuple[str, ...]
    above: tuple[str, ...]
    strays: tuple[int, ...] = ()


def find_table(lines: list[str], name: str, declared: TextFormat) -> TableStart:
    """Find the table among the first lines of a text, trying every layout.

    declared  layout as declared in lab.toml

    The layout with the most rows of numbers is selected; among equals the first one with headings,
    else the first one in the list (a tab always separates, a blank often does not).
    """
    # At most MAX_TRIED_TEXT characters in possible rows.
    sizes = accumulate(len(line) if len(line) <= MAX_LINE else 0 for line in lines)
    line_count = max(sum(size <= MAX_TRIED_TEXT for size in sizes), 1)
    lines, count = lines[:line_count], len(lines)
    if declared.heading_row is not None and declared.heading_row >= len(lines):
        raise LabFileError(
            f"lab.toml: heading_row of {name} is {declared.heading_row}, the headings of this "
            f"file are within its first {len(lines)} lines",
            needed="the number of the line that holds the headings, from 1, with rows below it",
            remedy="Correct heading_row of the entry.",
        )
    # Rows of only numbers; if there are none, rows that also contain text.
    best = _find_best_start(lines, 1.0, declared) or _find_best_start(lines, 0.5, declared)
    if best is None:
        check_columns(name, max((_column_count(x) for x in lines if len(x) > MAX_LINE), default=0))
        entries = ", ".join(f"{key} = {value!r}" for key, value in declared.entries.items())
        stated = f" with {entries} of lab.toml" if entries else ""
        numbers = (match[0] for line in lines if (match := _HEXADECIMAL.search(line)))
        hint = next((f", and {number!r} is a hexadecimal number" for number in numbers), "")
        raise unreadable(
            name,
            f"its first {count} lines hold no row of numbers{stated}; line 1 is "
            f"{lines[0][:60]!r}{hint}",
            needed="a table of numbers separated by tabs, semicolons, bars, commas or blanks",
            remedy="Export the recording as CSV, in decimal numbers, without units or words in "
            "the cells.",
            line=1,
        )
    for row, line in enumerate(lines[: best.row], start=1):
        # A row of numbers above the table may contain a prefix in a cell.
        cells = cells_of(line, best.layout) if len(line) <= MAX_LINE else []
        numbers_of_row = [number_of(cell, best.layout.decimal) for cell in cells if cell]
        if len(cells) == best.layout.fields and set(numbers_of_row) - {None}:
            for column, cell in enumerate(cells, start=1):
                refuse_prefix(cell, name, row, column)
    if not any(best.labels) and best.above and not _COMMENT.match(best.above[-1]):
        check_columns(name, _column_count(best.above[-1]))
        if not declared.decimal:
            _refuse_other_fields_than_headings(lines, best, name)
    if not declared.decimal:
        _refuse_possible_thousands(lines, best, name)
    return best


def _refuse_other_fields_than_headings(lines: list[str], start: TableStart, name: str) -> None:
    """Refuse rows with another number of fields than the line of headings."""
    layout = start.layout
    for row in reversed(range(start.row)):
        heading = _COMMENT.sub("", lines[row])
        marks = dict.fromkeys((layout.separator or "\t", "\t", ";", ","))
        cuts = [split(heading, mark) for mark in marks]
        cells = next((cut for cut in cuts if len(cut) > 1), [])
        heading_count = len([cell for cell in cells if cell])
        # ``rig, stage 42`` is not a line of headings; ``time [s], voltage`` is.
        if heading_count > 1 and any(meaning_of(heading_of(cell)).is_read for cell in cells):
            break
    else:
        return
    if heading_count == layout.fields:
        return
    rows = [line for line in lines[start.row :] if line.strip() and not _COMMENT.match(line)]
    first_cells = [cells_of(line, layout)[0] for line in rows[:3]]
    counts = [[str(first + k) for k in range(len(first_cells))] for first in (0, 1)]
    if heading_count == layout.fields - 1 and first_cells in counts:
        return  # a column of row numbers without a heading
    explanation, entry = "", 'decimal = "."'
    if heading_count < layout.fields and layout.separator == ",":
        explanation = ", as if commas stood between the numbers and inside them"
        matches = (match[0] for x in lines[start.row :] if (match := _SPLIT_NUMBER.match(x)))
        example = next(matches, "")
        explanation += f" ({example})" if example else ""
    if layout.separator == "," and layout.fields == 2 * heading_count:
        entry = 'separator = ","\ndecimal = ","'
    remedy = "Export with decimal points, or with semicolons between the columns"
    if heading_count < layout.fields - 1:
        remedy += (
            f"; or declare the layout of the rows in lab.toml:\n\n{entry_text(name, entry)}\n"
        )
    raise unreadable(
        name,
        f"line {row + 1} heads {heading_count} columns, and the rows from line {start.row + 1} on "
        f"have {layout.fields} fields{explanation}",
        needed="as many fields in a row as there are headings",
        remedy=remedy if remedy.endswith("\n") else f"{remedy}.",
        line=start.row + 1,
    )


def _refuse_possible_thousands(lines: list[str], start: TableStart, name: str) -> None:
    """Refuse numbers in which a comma may mark thousands or decimals.

    The meaning of 1,234 is unknown if there are three digits behind every comma, and if all other
    numbers are whole and below a thousand.
    """
    if start.layout.decimal != "," or start.layout.grouped:
        return
    for k in range(start.layout.fields):
        rows = (cells_of(line, start.layout) for line in lines[start.row :] if line.strip())
        cells = [row[k] for row in rows if len(row) > k and any(map(str.isdigit, row[k]))]
        marked = sum(_THOUSAND.fullmatch(cell) is not None for cell in cells)
        unmarked = sum(_BELOW_THOUSAND.fullmatch(cell) is not None for cell in cells)
        if marked and unmarked and marked + unmarked == len(cells):
            example = next(cell for cell in cells if _THOUSAND.fullmatch(cell))
            raise unreadable(
                name,
                f"column {k + 1} holds {example!r} beside whole numbers below a thousand: does "
                "the comma mark decimals or thousands?",
                needed="one meaning of the comma",
                remedy="Write into lab.toml which character marks decimals:\n\n"
                + entry_text(name, 'decimal = "."\n'),
            )


def _column_count(line: str) -> int:
    """Return the number of columns of a line by its most frequent separator."""
    return 1 + max(line.count(separator) for separator in "\t;, ")


def _find_best_start(lines: list[str], share: float, declared: TextFormat) -> TableStart | None:
    # Marks of thousands are tried last, so that they are not assumed unnecessarily.
    separators = _SEPARATORS if declared.separator is None else (declared.separator,)
    decimals = (".", ",") if declared.decimal is None else (declared.decimal,)
    layouts = [
        Layout(separator=separator, decimal=decimal, fields=0, grouped=grouped)
        for grouped in (False, True)
        for separator in separators
        for decimal in decimals
    ]
    # Commas separate and mark decimals if the numbers are in quotes.
    if declared.separator == declared.decimal == ",":
        layouts = [Layout(separator=",", decimal=",", fields=0, paired=True)]
    possible_rows = {
        row: line
        for row, line in enumerate(lines)
        if row >= (declared.heading_row or 0)
        and len(line) <= MAX_LINE
        and any(map(str.isdigit, line))
        and not _COMMENT.match(line)
    }
    best: TableStart | None = None
    best_score = (0, False)
    for layout in layouts:
        if best_score == (len(possible_rows), True):  # no other layout can have more rows
            break
        rows = _numeric_rows(possible_rows, layout, share)
        if not rows:
            continue
        fields = Counter(rows.values()).most_common(1)[0][0]
        first = min(row for row, count in rows.items() if count == fields)
        layout = replace(layout, fields=fields)
        is_open = bool(layout.separator) and all(
            split(line, layout.separator)[-1:] == [""] for line in lines[first : first + 20]
        )
        above = [lines[k] for k in range(declared.heading_row or first) if lines[k].strip()]
        labels = units = ("",) * fields
        lowest = _heading_fields(above[-1], layout, is_open) if above else None
        names = _heading_fields(above[-2], layout, is_open) if len(above) > 1 else None
        if lowest and names and _is_unit_row(lowest) and not _is_unit_row(names):
            labels, units, above = names, lowest, above[:-2]
        elif lowest and any(re.search(r"[^\W\d_]", cell) for cell in lowest):
            labels, above = lowest, above[:-1]
        start = TableStart(
            layout=layout,
            row=first,
            labels=labels,
            units=units,
            above=tuple(above),
            strays=tuple(row + 1 for row in rows if row < first),
        )
        score = (sum(count == fields for count in rows.values()), any(start.labels))
        if score > best_score:
            best, best_score = start, score
    return best


def _numeric_rows(lines: dict[int, str], layout: Layout, share: float) -> dict[int, int]:
    """Return the number of fields of each row with at least a share of numeric fields."""
    separator, fields_of_row = layout.separator, {}
    for row, line in lines.items():
        if separator and separator not in line and separator != ",":
            continue
        fields = cells_of(line, layout)
        values = [number_of(f, layout.decimal, grouped=layout.grouped) for f in fields if f]
        numbers = sum(value is not None for value in values)
        is_whole = numbers == len(values) if share == 1 else numbers > 1
        if numbers and is_whole and numbers >= share * len(values):
            fields_of_row[row] = len(fields)
    return fields_of_row


def with_headings_beside_row_numbers(start: TableStart, first_column: Array) -> TableStart:
    """Return the start with headings if only a column of row numbers has none.

    Programs write row numbers without a heading: the line of headings then has one name less than
    the rows have fields.
    """
    if any(start.labels) or not start.above or start.layout.fields < 3:
        return start
    layout = replace(start.layout, fields=start.layout.fields - 1)
    cells = _heading_fields(start.above[-1], layout)
    if cells is None or not all(cells):
        return start
    if first_column[0] not in (0, 1) or not (np.diff(first_column) == 1).all():
        return start
    return replace(start, labels=("", *cells), above=start.above[:-1])


def _heading_fields(line: str, layout: Layout, is_open: bool = False) -> tuple[str, ...] | None:
    """Split a line of headings into as many cells as the rows have, or return None.

    is_open  whether the rows end with a separator without a column behind it
    """
    if len(line) > MAX_LINE:
        return None
    heading = _COMMENT.sub("", line)
    cuts = [split(heading, layout.separator)]
    if not layout.separator:
        cuts += [_NAME_AND_BRACKET.findall(heading), re.split(r"\s{2,}|\t", heading.strip())]
    cuts += [split(heading, separator) for separator in ("\t", ";", ",")]
    if layout.separator and layout.separator in heading and not _BRACKETS.isdisjoint(heading):
        # ``position [um, filtered]`` is split outside its brackets.
        outside, depth = [""], 0
        for part in re.split(rf"([\[\](){{}}]|{re.escape(layout.separator)})", heading):
            depth = max(depth + (part in tuple("[({")) - (part in tuple("])}")), 0)
            if part == layout.separator and depth == 0:
                outside.append("")
            else:
                outside[-1] += part
        cuts.append(outside)
    for cells in cuts:
        cells = [cell.strip().strip('"').strip() for cell in cells]
        if len(cells) > layout.fields and not any(cells[layout.fields :]):
            cells = cells[: layout.fields]
        if len(cells) == layout.fields:
            return tuple(cells)
        if is_open and len(cells) + 1 == layout.fields:
            return (*cells, "")
    return None


def drop_repeated_headings(
    text: str, start: TableStart, name: str, line: int
) -> tuple[str, tuple[int, ...], tuple[int, ...]]:
    """Drop rows that repeat the heading.

    line      of the first row
    returned  the rows, the indices of rows behind a repeated heading, the lines of these headings

    Raises ``UnreadableFileError`` for other headings among the rows.
    """
    row_lines: list[str] = []
    segment_starts: list[int] = []
    heading_lines: list[int] = []
    rows = 0
    labels = [(heading.stem.lower(), heading.unit) for heading in map(heading_of, start.labels)]
    for number, content in enumerate(text.split("\n"), start=line):
        # A heading has as many words as there are columns, and no number.
        cells: tuple[str, ...] = ()
        if len(content) <= MAX_LINE and re.search(r"[^\W\d_]", content):
            cells = _heading_fields(content.lstrip("\ufeff"), start.layout) or ()
        if not any(cells) or any(
            number_of(cell, start.layout.decimal) is not None for cell in cells if cell
        ):
            cells = ()
        headings = [heading_of(cell) for cell in cells]
        if cells and cells == start.units:
            continue
        if cells and labels == [(heading.stem.lower(), heading.unit) for heading in headings]:
            heading_lines.append(number)
            segment_starts.append(rows)
            continue
        # Two names with units are a heading; other words may belong to a damaged row.
        if sum(heading.unit is not None and bool(heading.stem) for heading in headings) > 1:
            raise unreadable(
                name,
                f"line {number} heads the columns anew, {' | '.join(cells)[:200]!r}, which were "
                f"{' | '.join(start.labels)[:200]!r} above",
                needed="columns that mean the same from the first row to the last",
                remedy="Cut the file in front of that line.",
                line=number,
            )
        row_lines.append(content)
        rows += bool(content.strip()) and not _COMMENT.match(content)
    return (
        "\n".join(row_lines),
        tuple(row for row in segment_starts if row),
        tuple(heading_lines),
    )


def _is_unit_row(cells: tuple[str, ...]) -> bool:
    units = [cell.strip(UNIT_BRACKETS) for cell in cells]
    is_unit = [unit_of(unit) is not None for unit in units if unit]
    return bool(is_unit) and all(is_unit)
