"""The lines above a text table: where it starts, how its rows are written, what heads them."""

import re
from collections import Counter
from dataclasses import dataclass, replace

from piezoid.records.readers.block import Layout, number_of, split
from piezoid.records.readers.source import check_columns, unreadable
from piezoid.records.units import unit_of

# Longer preambles than this have their own formats.
HEAD_LINES = 1000
# Every layout is tried on every line: what is longer is no row, and so much text decides.
_LONGEST_LINE = 1 << 18
_ENOUGH_TEXT = 1 << 20
_LAYOUTS = (("\t", "."), ("\t", ","), (";", "."), (";", ","), (",", "."), ("", "."), ("", ","))
_COMMENT = re.compile(r"^\s*(?:#|%|//)+\s?")
# No opening bracket inside: a line of those alone would be searched to its end from each of them.
_NAME_AND_BRACKET = re.compile(r"[^\s\[(]+(?:\s*(?:\[[^\[\]]*\]|\([^()]*\)))?")


@dataclass(frozen=True, kw_only=True)
class Start:
    """Where a table starts.

    layout   how its rows are written
    row      index of its first line, from 0
    labels   one for each field, empty where there is none
    units    from a row of units of its own, empty where there is none
    above    lines before the headings
    strays   lines (from 1) of numbers above the table that have another number of fields
    """

    layout: Layout
    row: int
    labels: tuple[str, ...]
    units: tuple[str, ...]
    above: tuple[str, ...]
    strays: tuple[int, ...] = ()


def find_start(lines: list[str], name: str) -> Start:
    """Find the table among the first lines of a text, trying every layout.

    The layout with the most rows of numbers wins; among equals the one whose headings fit, then
    the earlier one in the list (a tab is never an accident, a blank often is).
    """
    # Rows of nothing but numbers first; only where there are none, rows with texts among them.
    tried = _first_text(lines)
    best = _best_start(tried, share=1.0) or _best_start(tried, share=0.5)
    if best is None:
        check_columns(name, max((_widest(x) for x in tried if len(x) > _LONGEST_LINE), default=0))
        raise unreadable(
            name,
            f"its first {len(lines)} lines hold no row of numbers; line 1 is {lines[0][:60]!r}",
            needed="a table of numbers separated by tabs, semicolons, commas or blanks",
            remedy="Export the recording as CSV.",
            line=1,
        )
    if not any(best.labels) and best.above and not _COMMENT.match(best.above[-1]):
        check_columns(name, _widest(best.above[-1]))
    return best


def _first_text(lines: list[str]) -> list[str]:
    """Return the first lines, those that may be rows no more than a megabyte together."""
    size = 0
    for row, line in enumerate(lines):
        size += len(line) if len(line) <= _LONGEST_LINE else 0
        if row and size > _ENOUGH_TEXT:
            return lines[:row]
    return lines


def _widest(line: str) -> int:
    """Return how many columns a line has by the separator it holds most of."""
    return 1 + max(line.count(separator) for separator in "\t;, ")


def _best_start(lines: list[str], share: float) -> Start | None:
    best: Start | None = None
    best_score = (0, False)
    for separator, decimal in _LAYOUTS:
        rows = _numeric_rows(lines, separator, decimal, share)
        if not rows:
            continue
        fields = Counter(rows.values()).most_common(1)[0][0]
        first = min(row for row, count in rows.items() if count == fields)
        start = replace(
            _headed(lines, first, Layout(separator=separator, decimal=decimal, fields=fields)),
            strays=tuple(row + 1 for row in rows if row < first),
        )
        score = (sum(count == fields for count in rows.values()), any(start.labels))
        if score > best_score:
            best, best_score = start, score
    return best


def _numeric_rows(lines: list[str], separator: str, decimal: str, share: float) -> dict[int, int]:
    """Return the fields of each row in which at least a share of the filled ones are numbers."""
    found = {}
    for row, line in enumerate(lines):
        if len(line) > _LONGEST_LINE or not line.strip():
            continue
        if separator and separator not in line and separator != ",":
            continue
        fields = split(line, separator)
        values = [number_of(field, decimal) for field in fields if field]
        numbers = sum(value is not None for value in values)
        is_whole = numbers == len(values) if share == 1 else numbers > 1
        if numbers and is_whole and numbers >= share * len(values) and any(map(_is_digit, fields)):
            found[row] = len(fields)
    return found


def _is_digit(field: str) -> bool:
    return any(character.isdigit() for character in field)


def _headed(lines: list[str], first: int, layout: Layout) -> Start:
    above = [row for row in range(first) if lines[row].strip()]
    none = ("",) * layout.fields
    if not above:
        return Start(layout=layout, row=first, labels=none, units=none, above=())
    last = _cells(lines[above[-1]], layout)
    names = _cells(lines[above[-2]], layout) if len(above) > 1 else None
    if last and names and _are_units(last) and not _are_units(names):
        return Start(
            layout=layout, row=first, labels=names, units=last,
            above=tuple(lines[row] for row in above[:-2]),
        )  # fmt: skip
    if last and any(re.search(r"[^\W\d_]", cell) for cell in last):
        kept = tuple(lines[row] for row in above[:-1])
        return Start(layout=layout, row=first, labels=last, units=none, above=kept)
    kept = tuple(lines[row] for row in above)
    return Start(layout=layout, row=first, labels=none, units=none, above=kept)


def names_but_first(start: Start) -> tuple[str, ...] | None:
    """Return the headings of a line that has one name less than the rows have fields.

    Programs that write row numbers leave them without a name: whether the numbers of the first
    column are row numbers is for the caller to see.
    """
    if any(start.labels) or not start.above or start.layout.fields < 3:
        return None
    layout = replace(start.layout, fields=start.layout.fields - 1)
    cells = _cells(start.above[-1], layout)
    return None if cells is None or not all(cells) else ("", *cells)


def _cells(line: str, layout: Layout) -> tuple[str, ...] | None:
    """Cut a heading line into as many cells as the rows have, or return None."""
    if len(line) > _LONGEST_LINE:
        return None
    bare = _COMMENT.sub("", line)
    cuts = [split(bare, layout.separator)]
    if not layout.separator:
        cuts += [_NAME_AND_BRACKET.findall(bare), re.split(r"\s{2,}|\t", bare.strip())]
    cuts += [split(bare, separator) for separator in ("\t", ";", ",")]
    for cells in cuts:
        cells = [cell.strip().strip('"').strip() for cell in cells]
        if len(cells) > layout.fields and not any(cells[layout.fields :]):
            cells = cells[: layout.fields]
        if len(cells) == layout.fields:
            return tuple(cells)
    return None


def _are_units(cells: tuple[str, ...]) -> bool:
    bare = [cell.strip("[]() ") for cell in cells]
    known = [unit_of(cell) is not None for cell in bare if cell]
    return bool(known) and all(known)


def unit_cell(cell: str) -> str:
    """Return a cell of a row of units without its brackets."""
    return cell.strip("[]() ")
