"""Igor binary waves (``.ibw``), as Igor Pro and the microscopes of Asylum Research write them.

One wave of two dimensions is a table: a row for each sample, a column for each channel under its
dimension label. The row dimension is the clock where its unit is a time.
"""

import re
from typing import Any

import numpy as np

from piezoid.records.readers.optional_readers import reading, table_of
from piezoid.records.readers.reader import Reader
from piezoid.records.readers.source import Source, check_columns, unreadable
from piezoid.records.table import RawTable, rate_of
from piezoid.records.units import Dimension, unit_of

_VERSIONS = (1, 2, 3, 5)  # a short, in either order of bytes
_POINTS_PER_SECOND = re.compile(r"^NumPtsPerSec:\s*([\d.eE+]+)\s*$", re.MULTILINE)


def recognises(source: Source) -> bool:
    """Tell a wave by its version, in either order of bytes; two bytes are weak: the suffix too."""
    head = source.head[:2]
    numbers = int.from_bytes(head, "little"), int.from_bytes(head, "big")
    return source.suffix == ".ibw" and any(number in _VERSIONS for number in numbers)


def read(source: Source) -> RawTable:
    """Read the columns of a wave, with its unit and its clock."""
    with reading(source, "Igor", extra="afm"), source.open() as stream:
        from igor2 import binarywave

        wave = binarywave.load(stream)["wave"]
        values = np.asarray(wave["wData"])
        if values.ndim != 2 or values.dtype.kind not in "iuf":
            raise unreadable(
                source.name,
                f"it is a wave {_text(wave['wave_header']['bname'])!r} of shape {values.shape}: "
                "one quantity, an image or text",
                needed="a wave of two dimensions: a row for each sample, and a column for each of "
                "drive and displacement",
                remedy="Put the waves of the recording side by side with Concatenate, or save "
                "them together as delimited text.",
            )
        check_columns(source.name, values.shape[1])
        names = _column_names(wave, values.shape[1])
        unit = _text(wave["wave_header"]["dataUnits"])
        rate_Hz = _rate_Hz(wave)
    arrays = {name: values[:, k] for k, name in enumerate(names)}
    return table_of(
        source, "Igor", arrays, units=dict.fromkeys(arrays, unit), sampling_rate_Hz=rate_Hz
    )


def _column_names(wave: Any, count: int) -> list[str]:
    """Return the labels of the columns; the first of the dimension is that of all."""
    labels = [_text(label) for label in (wave["labels"][1] if wave["labels"] else [])]
    own = labels[-count:] if len(labels) >= count else []
    own = [label or f"column {k + 1}" for k, label in enumerate(own)]
    return own if len(set(own)) == count else [f"column {k + 1}" for k in range(count)]


def _rate_Hz(wave: Any) -> float | None:
    """Return the rate of the row dimension, or the one that a microscope notes."""
    header = wave["wave_header"]
    unit = unit_of(_text(header["dimUnits"][0]))
    if unit is not None and unit.dimension is Dimension.TIME:
        return rate_of(float(header["sfA"][0]) * unit.factor)
    noted = _POINTS_PER_SECOND.search(_text(wave["note"]).replace("\r", "\n"))
    return None if noted is None else rate_of(1.0 / max(float(noted[1]), 1e-30))


def _text(held: Any) -> str:
    """Return a text of the file: Igor writes bytes, padded with zeros."""
    content = held if isinstance(held, bytes) else np.asarray(held).tobytes()
    return content.split(b"\0", 1)[0].decode("utf-8", "replace").strip()


READER = Reader(
    name="Igor",
    suffixes=(".ibw",),
    recognises=recognises,
    read=read,
    extra="afm",
)
