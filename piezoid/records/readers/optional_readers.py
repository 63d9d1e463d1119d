"""Calls of optional reader libraries: name a missing one, explain a failing one, make tables."""

import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from piezoid.errors import PiezoidError
from piezoid.records.readers.reader import Arrays
from piezoid.records.readers.source import Source, check_columns, check_growth, unreadable
from piezoid.records.table import Column, RawTable
from piezoid.statement import Statement, finding

# Columns over rows of a matrix above which its rows are the channels: recorders have some dozen
# channels, recordings thousands of samples.
MIN_TRANSPOSED_RATIO = 50
MAX_AXES = 3  # of a stage: outputs and inputs of its response


@contextmanager
def reading(source: Source, format_name: str, *, extra: str = "io") -> Iterator[None]:
    """Turn whatever a reader raises on a damaged file into ``UnreadableFileError``.

    These libraries document no exceptions for damaged input (KeyError, struct.error, zlib.error,
    MemoryError and others were seen), so every kind is taken.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except PiezoidError:
        raise
    except ModuleNotFoundError as error:
        raise unreadable(
            source.name,
            f"reading {format_name} needs the missing Python package {error.name!r}",
            needed=f"the readers of the extra {extra!r}",
            remedy=f"Run: pip install 'piezoid[{extra}]'",
        ) from error
    except (Exception, MemoryError) as error:
        reason = f": {str(error)[:200]}" if str(error) else ""  # short of memory, it says nothing
        raise unreadable(
            source.name,
            f"the {format_name} reader stopped with {type(error).__name__}{reason}",
            needed=f"a whole {format_name} file",
            remedy="Copy the file again from where it was written, or export it as CSV.",
        ) from error


def table_of(
    source: Source,
    format_name: str,
    arrays: Mapping[str, object],
    *,
    units: Mapping[str, str] | None = None,
    sampling_rate_Hz: float | None = None,
) -> RawTable:
    """Make a table of named arrays: vectors are columns, matrices of few columns are several.

    Arrays of another length than most are left out and named in a statement; scalars and text
    become metadata.
    """
    arrays, units = _in_seconds(arrays, units or {})
    vectors, metadata, statements = _vectors_of(source, arrays)
    if not vectors:
        raise unreadable(
            source.name,
            f"no columns of numbers among {', '.join(map(repr, list(arrays)[:8])) or 'nothing'}",
            needed="vectors of equal length, or one matrix with a column for each channel",
            remedy="Save time, voltage and displacement as vectors with names and units.",
        )
    check_columns(source.name, len(vectors))
    check_growth(source, 8 * sum(len(values) for _, _, values in vectors))
    lengths = [len(values) for _, _, values in vectors]
    rows = max(sorted(set(lengths)), key=lengths.count)
    for label, _, values in vectors:
        if len(values) != rows:
            text = f"{label!r} has {len(values)} values, most columns {rows}; it is not read"
            statements.append(finding(quantity="other_length", place=label, text=text))
    columns = tuple(
        Column(number=k + 1, label=label, declared_unit=units.get(key, ""), values=values)
        for k, (label, key, values) in enumerate(v for v in vectors if len(v[2]) == rows)
    )
    return RawTable(
        name=source.name,
        digest=source.digest,
        format=format_name,
        columns=columns,
        sampling_rate_Hz=sampling_rate_Hz,
        metadata=metadata,
        statements=tuple(statements),
    )


def chunk_tables(
    source: Source,
    format_name: str,
    chunks: Iterable[tuple[int, Arrays]],
    *,
    units: Mapping[str, str],
    sampling_rate_Hz: float | None = None,
) -> Iterator[RawTable]:
    """Make a table of every chunk as ``table_of`` makes one of the whole file."""
    for first_row, arrays in chunks:
        table = table_of(
            source, format_name, arrays, units=units, sampling_rate_Hz=sampling_rate_Hz
        )
        yield replace(table, first_row=first_row)


def _in_seconds(
    arrays: Mapping[str, object], units: Mapping[str, str]
) -> tuple[dict[str, object], dict[str, str]]:
    """Return arrays with dates and durations as seconds, dates from the first of them."""
    in_seconds, all_units = dict(arrays), dict(units)
    for key, value in arrays.items():
        array = np.asarray(value)
        if array.dtype.kind not in "mM" or not array.size:
            continue
        if array.dtype.kind == "M":
            array = array - array.reshape(-1)[0]
        seconds = array / np.timedelta64(1, "ns") * 1e-9
        # Nanoseconds at most are stamped; more digits are the noise of the product.
        in_seconds[key] = np.where(np.isnat(array), np.nan, seconds.round(9))
        all_units[key] = "s"
    return in_seconds, all_units


def _vectors_of(
    source: Source, arrays: Mapping[str, object]
) -> tuple[list[tuple[str, str, np.ndarray]], dict[str, str], list[Statement]]:
    vectors: list[tuple[str, str, np.ndarray]] = []
    metadata: dict[str, str] = {}
    statements: list[Statement] = []
    shapes = {key: np.asarray(value).shape for key, value in arrays.items()}
    for key, value in arrays.items():
        array = np.asarray(value)
        if array.dtype.kind == "c" and array.size > 1:
            text = (
                f"{key!r} holds complex numbers: real and imaginary part are the columns of a "
                "frequency response, and of no recording over time"
            )
            statements.append(finding(quantity="complex", place=key, text=text))
            for label, path in _paths(key, array):
                vectors += [(f"real({label})", key, path.real), (f"imag({label})", key, path.imag)]
        elif array.dtype.kind not in "biuf" or array.size <= 1:
            metadata[key] = str(value)[:200]
        elif _response_sides(array) is not None:
            vectors += [(label, key, path) for label, path in _paths(key, array)]
        elif array.ndim > 2 and max(array.shape) != array.size:
            text = f"{key!r} has {array.ndim} axes {array.shape}: which is time, which channel?"
            statements.append(finding(quantity="axes", place=key, text=text))
        elif max(array.shape) == array.size:
            vectors.append((key, key, array.reshape(-1)))
        else:
            array, transposed = _with_a_row_per_sample(source, key, array, shapes)
            statements += transposed
            label = f"{key}(:,{{}})" if key else ""
            vectors += [(label.format(k + 1), key, array[:, k]) for k in range(array.shape[1])]
    return vectors, metadata, statements


def _paths(key: str, array: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """Return the vectors of an array under their names: of (n, n, lines) each path by itself."""
    sides = _response_sides(array)
    if sides is None:
        return [(key, array.reshape(-1))]
    by_path = array if sides == (0, 1) else np.moveaxis(array, 0, -1)
    size = by_path.shape[0]
    return [(f"{key}({i + 1},{j + 1})", by_path[i, j]) for i in range(size) for j in range(size)]


def _response_sides(array: np.ndarray) -> tuple[int, int] | None:
    """Return the two axes of a response of several outputs and inputs, None where it is none.

    MATLAB has (outputs, inputs, lines), NumPy's habit is (lines, outputs, inputs).
    """
    if array.ndim != 3:
        return None
    for sides, lines in (((0, 1), 2), ((1, 2), 0)):
        size = array.shape[sides[0]]
        if 1 < size == array.shape[sides[1]] <= MAX_AXES and array.shape[lines] > size:
            return sides
    return None


def _with_a_row_per_sample(
    source: Source, key: str, array: np.ndarray, shapes: Mapping[str, tuple[int, ...]]
) -> tuple[np.ndarray, list[Statement]]:
    """Return a matrix with a row for each sample, turned where it can only be read that way."""
    rows, columns = array.shape
    lengths = {max(s) for k, s in shapes.items() if k != key and s and max(s) == np.prod(s) > 1}
    if rows > columns and not (columns in lengths and rows not in lengths):
        return array, []
    if columns in lengths - {rows} or columns >= MIN_TRANSPOSED_RATIO * rows:
        text = (
            f"{key or 'the array'} has {rows} rows and {columns} columns: read as {rows} channels "
            f"of {columns} samples"
        )
        return array.T, [finding(quantity="transposed", place=key or "the array", text=text)]
    if rows in lengths - {columns}:
        return array, []
    raise unreadable(
        source.name,
        f"{key or 'the array'} has {rows} rows and {columns} columns",
        needed="a row for each sample and a column for each channel, so more rows",
        remedy="Transpose the array before saving it.",
    )
