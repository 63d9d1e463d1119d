"""Excel workbooks: the sheet that holds a table, read as the text it shows."""

import math
import zipfile
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING

from piezoid.errors import UnreadableFileError
from piezoid.records.readers.archive import check_unpacked_size, members
from piezoid.records.readers.reader import Reader, Source, unreadable
from piezoid.records.readers.text_layout import HEAD_LINES, find_table
from piezoid.records.readers.text_table import read_text
from piezoid.records.table import RawTable
from piezoid.statement import finding

_TESTED_ROWS = 100  # searched for formulas

if TYPE_CHECKING:
    from pandas import DataFrame


def read(source: Source) -> RawTable:
    """Read the first sheet with rows of numbers; a statement names further ones."""
    import openpyxl  # noqa: F401 -- used by pandas, whose error for a missing package is unclear
    import pandas as pd

    with source.open() as stream:
        if not zipfile.is_zipfile(stream):
            raise unreadable(
                source.name,
                "the workbook is cut short or damaged: the directory at its end is missing",
                needed="a whole workbook",
                remedy="Copy the file again from where it was written, or export it as CSV.",
            )
        check_unpacked_size(source)
        sheets = pd.read_excel(
            stream, sheet_name=None, header=None, dtype=object, engine="openpyxl"
        )
    texts = {}
    for name, frame in sheets.items():
        if frame.size:
            rows = frame.itertuples(index=False, name=None)
            texts[str(name)] = "\n".join("\t".join(map(_cell_text, row)) for row in rows) + "\n"
    if not texts:
        raise unreadable(
            source.name,
            f"its {len(sheets)} sheets are empty",
            needed="a sheet with headings and rows of numbers",
            remedy="Save the workbook again, or export the recording as CSV.",
        )
    with_rows = []
    for name, text in texts.items():
        with suppress(UnreadableFileError):
            find_table(text.split("\n", HEAD_LINES)[:HEAD_LINES], source.name, source.text)
            with_rows.append(name)
    sheet = next(iter(with_rows or texts))
    _refuse_formulas(source, sheet, sheets[sheet])
    table = read_text(source, texts[sheet])
    if len(with_rows) < 2:
        return table
    names = ", ".join(map(repr, with_rows[1:]))
    text = f"sheet {sheet!r} is read; {names} hold rows of numbers as well and are not read"
    statement = finding("other_sheets", text, place=f"sheet {sheet!r}")
    return replace(table, statements=(statement, *table.statements))


def _refuse_formulas(source: Source, sheet: str, frame: "DataFrame") -> None:
    """Refuse a column of formulas without stored values, which would be read as empty."""
    empty = [k for k, count in enumerate(frame.notna().sum()) if count <= 1]
    if not empty:
        return
    import openpyxl

    with source.open() as stream:
        book = openpyxl.load_workbook(stream, read_only=True)
        rows = book[sheet].iter_rows(max_row=_TESTED_ROWS)
        cells = [row[k] for row in rows for k in empty if k < len(row)]
        formula = next((cell for cell in cells if cell.data_type == "f"), None)
        book.close()
    if formula is not None:
        raise unreadable(
            source.name,
            f"cell {formula.coordinate} of sheet {sheet!r} holds the formula "
            f"{str(formula.value)[:60]!r}, whose value was never computed",
            needed="numbers in the cells",
            remedy="Open the workbook in Excel or LibreOffice, save it, and read it again.",
        )


def _cell_text(value: object) -> str:
    """Return the content of a cell as text: a number with all digits, or a time of day."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ""
    if hasattr(value, "total_seconds"):
        seconds = float(value.total_seconds())
        return f"{int(seconds // 3600)}:{int(seconds // 60 % 60):02d}:{seconds % 60:09.6f}"
    if hasattr(value, "isoformat"):
        return str(value.isoformat())
    return repr(value) if isinstance(value, float) else " ".join(str(value).split())


READER = Reader(
    name="Excel",
    usual_suffixes=(".xlsx",),
    # A workbook is recognised by its parts, a damaged archive by its first part or its suffix.
    recognises=lambda source: (
        "xl/workbook.xml" in members(source)
        or (source.suffix in (".xlsx", ".xlsm") and bool(members(source)))
    ),
    read=read,
    library=True,
    extra="io",
    has_text_layout=True,
)
