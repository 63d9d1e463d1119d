"""Tables of named arrays, as returned by libraries for binary formats."""

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piezoid.records.readers.reader import Source, check_columns, check_growth, unreadable
from piezoid.records.table import Column, RawTable
from piezoid.statement import Statement, finding

# Ratio of columns to rows above which the rows of a matrix are the channels: recorders have some
# dozen channels, recordings thousands of samples.
MIN_TRANSPOSED_RATIO = 50
MAX_AXES = 3  # of a stage: number of outputs and inputs of its response


def table_of(
    source: Source,
    arrays: Mapping[str, object],
    *,
    units: Mapping[str, str] | None = None,
    sampling_rate_Hz: float | None = None,
) -> RawTable:
    """Make a table of named arrays: each vector and each column of a matrix becomes a column.

    Arrays of another than the commonest length are left out with a statement, scalars and text
    without one. Durations become seconds, dates become seconds from the first date.
    """
    units = dict(units or {})
    vectors: list[tuple[str, str, NDArray[Any]]] = []  # label, name of the array, values
    statements: list[Statement] = []
    shapes = {name: np.asarray(value).shape for name, value in arrays.items()}
    for name, value in arrays.items():
        array = np.asarray(value)
        if array.dtype.kind in "mM" and array.size:
            # Stamps resolve at most nanoseconds; rounding removes the errors of the product.
            elapsed = array - array.reshape(-1)[0] if array.dtype.kind == "M" else array
            seconds = (elapsed / np.timedelta64(1, "ns") * 1e-9).round(9)
            array, units[name] = np.where(np.isnat(elapsed), np.nan, seconds), "s"
        if array.dtype.kind not in "biufc" or array.size <= 1:
            continue
        columns, further = _columns_of(source, name, array, shapes)
        vectors += [(label, name, values) for label, values in columns]
        statements += further
    if not vectors:
        raise unreadable(
            source.name,
            f"no columns of numbers among {', '.join(map(repr, list(arrays)[:8])) or 'nothing'}",
            needed="vectors of equal length, or one matrix with a column for each channel",
            remedy="Save time, voltage and displacement as vectors with names and units.",
        )
    check_columns(source.name, len(vectors))
    check_growth(source, 8 * sum(len(values) for _, _, values in vectors))
    rows = commonest_length(len(values) for _, _, values in vectors)
    for label, _, values in vectors:
        if len(values) != rows:
            text = f"{label!r} has {len(values)} values, most columns {rows}; it is not read"
            statements.append(finding("other_length", text, place=label))
    return RawTable(
        columns=tuple(
            Column(number=k + 1, label=label, declared_unit=units.get(name, ""), values=values)
            for k, (label, name, values) in enumerate(v for v in vectors if len(v[2]) == rows)
        ),
        sampling_rate_Hz=sampling_rate_Hz,
        statements=tuple(statements),
    )


def commonest_length(lengths: Iterable[int]) -> int:
    """Return the commonest of some lengths, and the shortest of several; 0 without any."""
    counts = Counter(lengths)
    return max(sorted(counts), key=counts.__getitem__, default=0)


def _columns_of(
    source: Source, name: str, array: NDArray[Any], shapes: Mapping[str, tuple[int, ...]]
) -> tuple[list[tuple[str, NDArray[Any]]], list[Statement]]:
    """Return the labelled columns of one array, and statements about unusual shapes.

    shapes  of all arrays of the file

    Raises ``UnreadableFileError`` for a matrix whose rows may be samples or channels.
    """
    # Paths of a response of several outputs and inputs, of shape (outputs, inputs, lines) as in
    # MATLAB, or (lines, outputs, inputs) as mostly in NumPy.
    paths: list[tuple[str, NDArray[Any]]] = []
    for by_path in (array, np.moveaxis(array, 0, -1)) if array.ndim == 3 else ():
        size, inputs, lines = by_path.shape
        if not paths and 1 < size == inputs <= MAX_AXES and lines > size:
            pairs = [(i, j) for i in range(size) for j in range(size)]
            paths = [(f"{name}({i + 1},{j + 1})", by_path[i, j]) for i, j in pairs]
    if array.dtype.kind == "c":
        columns = [
            (f"{part}({label})", getattr(path, part))
            for label, path in paths or [(name, array.reshape(-1))]
            for part in ("real", "imag")
        ]
        return columns, [complex_statement(repr(name), name)]
    if paths or max(array.shape) == array.size:
        return paths or [(name, array.reshape(-1))], []
    if array.ndim > 2:
        text = f"{name!r} has {array.ndim} axes {array.shape}: which is time, which channel?"
        return [], [finding("axes", text, place=name)]
    statements = []
    rows, columns_count = array.shape
    # Other vectors, or else the shape, show whether the rows of a matrix are its channels.
    lengths = {max(s) for k, s in shapes.items() if k != name and s and max(s) == np.prod(s) > 1}
    if rows > columns_count and not (columns_count in lengths and rows not in lengths):
        is_transposed = False
    elif columns_count in lengths - {rows} or columns_count >= MIN_TRANSPOSED_RATIO * rows:
        is_transposed = True
    elif rows in lengths - {columns_count}:
        is_transposed = False
    else:
        raise unreadable(
            source.name,
            f"{name or 'the array'} has {rows} rows and {columns_count} columns",
            needed="a row for each sample and a column for each channel, so more rows",
            remedy="Transpose the array before saving it.",
        )
    if is_transposed:
        array = array.T
        text = (
            f"{name or 'the array'} has {rows} rows and {columns_count} columns: read as {rows} "
            f"channels of {columns_count} samples"
        )
        location = name or "the array"
        statements.append(finding("transposed", text, place=location))
    labels = [f"{name}(:,{k + 1})" if name else "" for k in range(array.shape[1])]
    return list(zip(labels, array.T, strict=True)), statements


def complex_statement(subject: str, place: str) -> Statement:
    """Return the statement about complex numbers in an array or in columns."""
    text = (
        f"{subject} holds complex numbers: real and imaginary part are the columns of a frequency "
        "response, and of no recording over time"
    )
    return finding("complex", text, place=place)
