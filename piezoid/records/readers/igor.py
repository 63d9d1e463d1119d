"""Igor binary waves (``.ibw``) of Igor Pro and of the microscopes of Asylum Research.

A wave of two dimensions is a table: a row for each sample, a column for each channel, named by its
dimension label. The row dimension is the clock if its unit is a time.
"""

import re
from typing import Any

import numpy as np

from piezoid.records.readers.named_arrays import table_of
from piezoid.records.readers.reader import Reader, Source, check_columns, unreadable
from piezoid.records.table import RawTable, rate_of
from piezoid.records.units import Dimension, unit_of

_VERSIONS = frozenset({1, 2, 3, 5})  # a short integer of either byte order
_POINTS_PER_SECOND = re.compile(r"^NumPtsPerSec:\s*([\d.eE+]+)\s*$", re.MULTILINE)


def read(source: Source) -> RawTable:
    """Read the columns of a wave, with its unit and its clock."""
    from igor2 import binarywave

    with source.open() as stream:
        wave = binarywave.load(stream)["wave"]
    values = np.asarray(wave["wData"])
    if values.ndim != 2 or values.dtype.kind not in "iuf":
        raise unreadable(
            source.name,
            f"it is a wave {_text(wave['wave_header']['bname'])!r} of shape {values.shape}: one "
            "quantity, an image or text",
            needed="a wave of two dimensions: a row for each sample, and a column for each of "
            "drive and displacement",
            remedy="Put the waves of the recording side by side with Concatenate, or save them "
            "together as delimited text.",
        )
    check_columns(source.name, values.shape[1])
    # A first, surplus label is that of the whole dimension.
    count = values.shape[1]
    labels = [_text(label) for label in (wave["labels"][1] if wave["labels"] else [])]
    names = numbered = [f"column {k + 1}" for k in range(count)]
    if len(labels) >= count:
        names = [label or number for label, number in zip(labels[-count:], numbered, strict=True)]
    names = names if len(set(names)) == count else numbered
    arrays = dict(zip(names, values.T, strict=True))
    header = wave["wave_header"]
    units = dict.fromkeys(arrays, _text(header["dataUnits"]))
    # The rate is that of the row dimension, or the one in the note of a microscope.
    rate_Hz, row_unit = None, unit_of(_text(header["dimUnits"][0]))
    if row_unit is not None and row_unit.dimension is Dimension.TIME:
        rate_Hz = rate_of(float(header["sfA"][0]) * row_unit.factor)
    elif noted := _POINTS_PER_SECOND.search(_text(wave["note"]).replace("\r", "\n")):
        rate_Hz = rate_of(1.0 / max(float(noted[1]), 1e-30))
    return table_of(source, arrays, units=units, sampling_rate_Hz=rate_Hz)


def _text(field: Any) -> str:
    """Return a text of the file, which Igor pads with zeros."""
    content = field if isinstance(field, bytes) else np.asarray(field).tobytes()
    return content.split(b"\0", 1)[0].decode("utf-8", "replace").strip()


READER = Reader(
    name="Igor",
    usual_suffixes=(".ibw",),
    recognises=lambda source: (
        source.suffix == ".ibw"
        and not _VERSIONS.isdisjoint(
            {int.from_bytes(source.head[:2], "little"), int.from_bytes(source.head[:2], "big")}
        )
    ),
    read=read,
    library=True,
    extra="afm",
)
