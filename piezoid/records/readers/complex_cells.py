"""Complex numbers in the cells of a text table: ``0.2-0.03i``, ``(0.2-0.03j)``, ``0.2+-0.03j``."""

import re
from dataclasses import replace

import numpy as np

from piezoid.records.readers.named_arrays import complex_statement
from piezoid.records.readers.text_layout import HEAD_LINES
from piezoid.records.table import Column, RawTable

TESTED_LINES = 10  # at the end of the head, below comments and headings


def _pattern(digits: str) -> re.Pattern[str]:
    # Possessive quantifiers (++): a run of digits is searched once. The sign has white space on
    # both sides or on neither: "1.0 -0.3i" are two fields.
    return re.compile(
        rf"(?<![\w.])\(?(?P<real>[+-]?{digits})(?:\s{{1,9}}(?P<spaced>[+-])\s{{1,9}}|\+?(?P<sign>[+-]))"
        rf"(?P<imaginary>{digits})\s?\*?[ijIJ](?![a-zA-Z\d])\)?"
    )


_WITH_POINTS = _pattern(r"(?:\d++(?:\.\d*+)?|\.\d++)(?:[eE][+-]?\d++)?")
# A comma marks decimals only if the fields have another separator.
_WITH_COMMAS = _pattern(r"(?:\d++(?:[.,]\d*+)?|[.,]\d++)(?:[eE][+-]?\d++)?")


def real_and_imaginary_text(text: str) -> tuple[str, str] | None:
    """Split a table of complex cells into real and imaginary parts; None if no cell is complex."""
    head = [line for line in text.split("\n", HEAD_LINES)[:HEAD_LINES] if line.strip()][
        -TESTED_LINES:
    ]
    if not head:
        return None
    pattern = _WITH_COMMAS if {";", "\t"} & set(head[-1]) else _WITH_POINTS
    if not all(map(pattern.search, head[1:] or head)):
        return None
    # Only one of the two groups of the sign matches.
    return pattern.sub(r"\g<real>", text), pattern.sub(r"\g<spaced>\g<sign>\g<imaginary>", text)


def join_complex_columns(real: RawTable, imaginary: RawTable) -> RawTable:
    """Join two tables; complex columns become two columns, named like those of MATLAB files."""
    columns: list[Column] = []
    complex_columns: list[Column] = []
    for column, imaginary_column in zip(real.columns, imaginary.columns, strict=True):
        pieces = [column]
        if not np.array_equal(column.values, imaginary_column.values, equal_nan=True):
            complex_columns.append(column)
            label = column.label or str(column.number)
            pieces = [
                replace(column, label=f"real({label})"),
                replace(imaginary_column, label=f"imag({label})"),
            ]
        columns += [replace(piece, number=len(columns) + k + 1) for k, piece in enumerate(pieces)]
    if not complex_columns:
        return real
    locations = ", ".join(column.place for column in complex_columns[:3])
    suffix = ", ..." if len(complex_columns) > 3 else ""
    statement = complex_statement(f"{locations}{suffix}", complex_columns[0].place)
    return replace(real, columns=tuple(columns), statements=(*real.statements, statement))
