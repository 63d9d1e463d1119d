"""Recordings from arrays and data frames, and back, with the same checks as files.

Heading and unit identify a column by the same rules as for files: ``Voltage [V]``,
``position_um``. Ambiguous columns are refused.
"""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from piezoid.digests import digest_of_bytes
from piezoid.errors import RecordingError, UnitError
from piezoid.numerics.arrays import Array
from piezoid.records.column_roles import meaning_of
from piezoid.records.ingest import ingest_table, parts_of, with_checks
from piezoid.records.lab import Lab
from piezoid.records.lab_tables import RecordingEntry
from piezoid.records.recording import Quantity, Recording
from piezoid.records.table import Column, RawTable
from piezoid.records.units import heading_of, unit_of

if TYPE_CHECKING:
    from pandas import DataFrame

ByAxis = ArrayLike | Mapping[str, ArrayLike]  # samples of one axis, or by the name of the axis


def from_arrays(
    *,
    voltage_V: ByAxis,
    displacement_m: ByAxis | None = None,
    current_A: ByAxis | None = None,
    time_s: ArrayLike | None = None,
    sampling_rate_Hz: float | None = None,
    axis: str = "x",
    name: str = "recording",
) -> Recording:
    """Return a recording of arrays in SI units, with problems in ``statements``.

    voltage_V, displacement_m, current_A  (samples,), or by axis: ``{"x": ..., "y": ...}``
    time_s, sampling_rate_Hz  exactly one of the two: (samples,) s, or Hz
    axis  axis of the recording, and of arrays that are not given by axis
    name  name of the recording, by which results refer to it

    Raises ``RecordingError`` for arrays of other shapes or lengths, or without a clock.

    >>> import numpy as np
    >>> time_s = np.arange(2000) / 1000.0
    >>> voltage_V = 5.0 - 5.0 * np.cos(2.0 * np.pi * time_s)
    >>> recording = piezoid.from_arrays(
    ...     time_s=time_s, voltage_V=voltage_V, displacement_m=1e-7 * voltage_V
    ... )
    >>> recording.samples, round(recording.sampling_rate_Hz), recording.axes
    (2000, 1000, ('x',))
    """
    if (time_s is None) == (sampling_rate_Hz is None):
        both = "neither time_s nor" if time_s is None else "both time_s and"
        raise RecordingError(
            f"{name}: {both} sampling_rate_Hz given",
            needed="one clock",
            remedy="Give the time of every sample, or the common sampling rate.",
        )
    columns = [] if time_s is None else [("time", "s", _as_samples(time_s, f"{name}: time_s"))]
    for quantity, channel in (
        (Quantity.VOLTAGE, voltage_V),
        (Quantity.DISPLACEMENT, displacement_m),
        (Quantity.CURRENT, current_A),
    ):
        by_axis = channel if isinstance(channel, Mapping) else {axis: channel}
        for axis_of_values, values in by_axis.items():
            if values is not None:
                label = quantity.name.lower()
                samples = _as_samples(values, f"{name}: {label} of {axis_of_values}")
                columns.append((f"{label}_{axis_of_values}", quantity.value, samples))
    if len({len(values) for _, _, values in columns}) > 1:
        lengths = ", ".join(f"{label} {len(values)}" for label, _, values in columns)
        raise RecordingError(
            f"{name}: arrays of different length: {lengths}",
            needed="one value of each for every sample",
            remedy="Cut them to the same samples.",
        )
    entry = RecordingEntry(
        file=name,
        axis=axis,
        columns={label: number for number, (label, _, _) in enumerate(columns, 1)},
        sampling_rate_Hz=sampling_rate_Hz,
    )
    return _make_recording(columns, entry)


def from_frame(
    frame: "DataFrame",
    *,
    units: Mapping[str, str] | None = None,
    columns: Mapping[str, str] | None = None,
    axis: str | None = None,
    name: str = "frame",
    sampling_rate_Hz: float | None = None,
) -> Recording:
    """Return a recording of a pandas DataFrame, with headings interpreted as those of a file.

    frame    a column for each channel, a row for each sample; NaN for missing numbers.
             An index of times is the clock
    units    by heading, for columns without a unit in the heading: ``{"piezo": "V"}``
    columns  headings by role, if the headings do not identify them, as in lab.toml:
             ``{"voltage": "piezo", "displacement": "gauge"}``; other columns are not read
    axis     axis of the recording; default: that of the headings, else ``x``
    sampling_rate_Hz  if no column is a time

    Raises ``UnitError`` for a column without unit or meaning, and for two columns of one quantity
    and axis; ``RecordingError`` for any other object than a frame, or without numbers.

    >>> import pandas as pd
    >>> frame = pd.DataFrame(
    ...     {"t [ms]": [0.0, 1.0, 2.0], "U [V]": [0.0, 1.0, 2.0], "weg": [0.0, 0.1, 0.2]}
    ... )
    >>> piezoid.from_frame(frame, units={"weg": "um"}).displacement_m().tolist()
    [0.0, 1e-07, 2e-07]
    """
    from pandas import DataFrame, MultiIndex

    if not isinstance(frame, DataFrame):
        raise RecordingError(
            f"{name}: {type(frame).__name__} given",
            needed="a pandas DataFrame, one column for each channel",
            remedy="Use piezoid.from_arrays for arrays.",
        )
    if isinstance(frame.columns, MultiIndex) or isinstance(frame.index, MultiIndex):
        raise RecordingError(
            f"{name}: headings or rows on several levels",
            needed="one heading for each column, one row for each sample",
            remedy="Flatten them, for example with frame.droplevel(0, axis=1).",
        )
    headings = [str(heading) for heading in frame.columns]
    for heading in (*(units or {}), *(columns or {}).values()):
        if headings.count(heading) != 1:
            names = ", ".join(map(repr, headings))
            raise RecordingError(
                f"{name}: {headings.count(heading)} columns are called {heading!r}, among {names}",
                needed="the heading of one column",
                remedy="Name the column as the frame does.",
            )
    declared = {
        heading: _declared_unit(name, heading, unit) for heading, unit in (units or {}).items()
    }
    arrays = _numeric_columns(frame, set((columns or {}).values()), name)
    entry = RecordingEntry(
        file=name,
        axis=axis,
        columns=dict(columns or {}),
        sampling_rate_Hz=sampling_rate_Hz,
    )
    try:
        return _make_recording(
            [(label, declared.get(label, ""), values) for label, values in arrays], entry
        )
    except UnitError as error:
        raise UnitError(
            error.found,
            needed="one meaning, one axis and one unit for every column that is read",
            remedy="Pass units={heading: unit} for columns without one, and columns={'voltage': "
            "heading, 'displacement': heading} where headings do not say which is which.",
        ) from error


def to_frame(recording: Recording) -> "DataFrame":
    """Return a pandas DataFrame that ``from_frame`` reads back.

    Columns ``time_s``, ``voltage_x_V``, ``displacement_x_m`` and so on, in SI units, humidity in
    percent. A row of NaN stands at each break; bridged samples keep their interpolated values.

    >>> list(piezoid.to_frame(recordings["sweep.csv"]))
    ['time_s', 'voltage_x_V', 'displacement_x_m']
    """
    from pandas import DataFrame

    time_s = np.arange(recording.samples) / recording.sampling_rate_Hz
    columns = {"time_s": time_s}
    for channel in recording.channels:
        label, values = f"{channel.quantity.name.lower()}_{channel.axis}", channel.values
        if channel.quantity is Quantity.HUMIDITY:
            columns[f"{label} [%]"] = 100.0 * values
        elif channel.is_counted:
            columns[f"{label} [{channel.unit}]"] = values
        elif channel.quantity is Quantity.REFERENCE:
            columns[label] = values
        else:
            columns[f"{label}_{channel.unit}"] = values
    breaks = list(recording.breaks)
    return DataFrame({label: np.insert(v, breaks, np.nan) for label, v in columns.items()})


def _make_recording(columns: Sequence[tuple[str, str, Array]], entry: RecordingEntry) -> Recording:
    """Make a recording of headings, units and samples, with the statements of a file."""
    text = "\n".join(f"{label}\t{unit}" for label, unit, _ in columns)
    table_columns = tuple(
        Column(number=k, label=label, declared_unit=unit, values=values)
        for k, (label, unit, values) in enumerate(columns, 1)
    )
    content = b"".join(column.values.tobytes() for column in table_columns)
    table = RawTable(
        name=entry.file,
        digest=digest_of_bytes(text.encode() + b"\0" + content),
        format="data frame",
        columns=table_columns,
    )
    parts = parts_of(table, Lab(), entry)
    if len(parts) > 1:
        raise RecordingError(
            f"{table.name}: it holds {len(parts)} segments with different sampling rates",
            needed="one rate in a recording",
            remedy="Make a recording of each segment.",
        )
    return with_checks(ingest_table(table, Lab(), entry), Lab())


def _as_samples(data: ArrayLike, name: str) -> Array:
    try:
        values = np.asarray(data, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise RecordingError(
            f"{name} is {type(data).__name__} with values that are not numbers ({error})",
            needed="one number for each sample",
            remedy="Pass an array of real numbers.",
        ) from error
    if values.ndim != 1:
        raise RecordingError(
            f"{name} has shape {values.shape}",
            needed="one number for each sample, shape (samples,)",
            remedy="Pass each channel as a separate array.",
        )
    return values


def _declared_unit(name: str, heading: str, symbol: str) -> str:
    """Return a declared unit; refuse an unknown unit and one that contradicts the heading."""
    unit, in_heading = unit_of(symbol), heading_of(heading).unit
    if unit is None:
        raise UnitError(
            f"{name}: the unit of {heading!r} is stated as {symbol!r}",
            needed="a unit of time, voltage, length, current or temperature",
            remedy="Write s, ms, V, mV, m, um, nm, A, nA, K, degC or the like.",
        )
    if in_heading is not None and (in_heading.dimension, in_heading.factor) != (
        unit.dimension,
        unit.factor,
    ):
        raise UnitError(
            f"{name}: {heading!r} names the unit {in_heading.symbol}, and {symbol} is stated",
            needed="one unit for the column",
            remedy="Leave the column out of units, or rename it.",
        )
    return symbol


def _numeric_columns(frame: "DataFrame", declared: set[str], name: str) -> list[tuple[str, Array]]:
    """Return the index, if it is a clock, and the numeric columns.

    Refuses a column of another type that has a role by its heading or is declared.
    """
    from pandas import DatetimeIndex, TimedeltaIndex
    from pandas.api.types import is_bool_dtype, is_numeric_dtype, is_timedelta64_dtype

    clock: list[tuple[str, Array]] = []
    index: Any = frame.index
    if isinstance(index, DatetimeIndex | TimedeltaIndex):
        if len(index):
            elapsed: Any = index - index[0]
            clock.append(("time_s", _as_samples(elapsed.total_seconds(), f"{name}: the index")))
    elif index.name is not None and meaning_of(heading_of(str(index.name))).is_time:
        clock.append((str(index.name), _as_samples(index, f"{name}: the index {index.name!r}")))
    arrays = []
    for number, heading in enumerate(map(str, frame.columns), 1):
        column: Any = frame.iloc[:, number - 1]
        meaning = meaning_of(heading_of(heading))
        if is_timedelta64_dtype(column.dtype) and meaning.is_time:
            arrays.append((f"{heading} [s]", _as_samples(column.dt.total_seconds(), heading)))
        elif is_numeric_dtype(column.dtype) and not is_bool_dtype(column.dtype):
            arrays.append(
                (heading, _as_samples(column.to_numpy(np.float64, na_value=np.nan), heading))
            )
        elif heading in declared or meaning.is_read:
            raise RecordingError(
                f"{name}: column {number} {heading!r} is of type {column.dtype}",
                needed="numbers",
                remedy="Convert it with pandas.to_numeric, or leave the column out.",
            )
    if not arrays:
        raise RecordingError(
            f"{name}: no column of {len(frame.columns)} holds numbers",
            needed="a drive and a displacement",
            remedy="Pass the frame that holds the samples.",
        )
    return [*clock, *arrays]
