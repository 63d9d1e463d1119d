"""Where other people's readers are called: a missing one is named, a failing one is explained."""

import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import numpy as np

from piezoid.errors import PiezoidError
from piezoid.records.readers.source import Source, check_columns, check_growth, unreadable
from piezoid.records.recording import Problem
from piezoid.records.table import Column, RawTable


@contextmanager
def reading(source: Source, format_name: str) -> Iterator[None]:
    """Turn whatever a reader raises on a damaged file into the house's error.

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
            f"reading {format_name} needs the Python package {error.name!r}, which is not here",
            needed="the readers of the extra 'io'",
            remedy="Run: pip install 'piezoid[io]'",
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

    Arrays of another length than most are left out and named among the problems; scalars and text
    become metadata.
    """
    units = units or {}
    vectors, metadata, problems = _sorted_out(source, arrays)
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
            problems.append(Problem(kind="other_length", place=label, text=text))
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
        problems=tuple(problems),
    )


def _sorted_out(
    source: Source, arrays: Mapping[str, object]
) -> tuple[list[tuple[str, str, np.ndarray]], dict[str, str], list[Problem]]:
    vectors: list[tuple[str, str, np.ndarray]] = []
    metadata: dict[str, str] = {}
    problems: list[Problem] = []
    for key, value in arrays.items():
        array = np.asarray(value)
        if array.dtype.kind not in "biuf" or array.size <= 1:
            metadata[key] = str(value)[:200]
        elif array.ndim > 2 and max(array.shape) != array.size:
            text = f"{key!r} has {array.ndim} axes {array.shape}: which is time, which channel?"
            problems.append(Problem(kind="axes", place=key, text=text))
        elif max(array.shape) == array.size:
            vectors.append((key, key, array.reshape(-1)))
        elif array.shape[0] <= array.shape[1]:
            raise unreadable(
                source.name,
                f"{key or 'the array'} has {array.shape[0]} rows and {array.shape[1]} columns",
                needed="a row for each sample and a column for each channel, so more rows",
                remedy="Transpose the array before saving it.",
            )
        else:
            label = f"{key}(:,{{}})" if key else ""
            vectors += [(label.format(k + 1), key, array[:, k]) for k in range(array.shape[1])]
    return vectors, metadata, problems
