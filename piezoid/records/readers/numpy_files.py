"""NumPy ``.npy`` and ``.npz``. Pickled objects are not loaded, since they can run code."""

import numpy as np

from piezoid.records.readers.archive import ZIP, check_unpacked_size, members
from piezoid.records.readers.named_arrays import table_of
from piezoid.records.readers.reader import Reader, Source, check_columns, unreadable
from piezoid.records.table import RawTable


def read_npy(source: Source) -> RawTable:
    """Read one array of shape (samples,) or (samples, channels), or a structured array.

    Only fields of a structured array have names, which may contain units (``displacement_um``).
    """
    with source.open() as stream:
        formats = np.lib.format
        is_first = formats.read_magic(stream) == (1, 0)
        header = formats.read_array_header_1_0 if is_first else formats.read_array_header_2_0
        shape, _, dtype = header(stream)
        # NumPy allocates the size in the header, which must not exceed that of the file.
        declared = int(np.prod(shape, dtype=object)) * dtype.itemsize
        if dtype.hasobject or declared > source.size():
            raise unreadable(
                source.name,
                f"it declares {shape} of {dtype}, {declared} bytes, and has {source.size()}",
                needed="a whole array of numbers, without Python objects",
                remedy="Save it again with numpy.save of a plain float array.",
            )
        stream.seek(0)
        array = np.load(stream, allow_pickle=False)
    if array.ndim > 2:
        raise unreadable(
            source.name,
            f"the array has {array.ndim} axes of lengths {array.shape}",
            needed="one recording: (samples,) or (samples, channels)",
            remedy="Save one realisation at a time, drive and response side by side, and name the "
            "columns by number in lab.toml.",
            shape=array.shape,
        )
    fields = array.dtype.names
    return table_of(source, {name: array[name] for name in fields} if fields else {"": array})


def read_npz(source: Source) -> RawTable:
    """Read an archive of named vectors; the names may contain units (``displacement_um``)."""
    check_unpacked_size(source)
    with source.open() as stream, np.load(stream, allow_pickle=False) as archive:
        check_columns(source.name, len(archive.files))
        return table_of(source, {name: archive[name] for name in archive.files})


NPY = Reader(
    name="npy",
    usual_suffixes=(".npy",),
    recognises=lambda source: source.head.startswith(b"\x93NUMPY"),
    read=read_npy,
    library=True,
)
NPZ = Reader(
    name="npz",
    usual_suffixes=(".npz",),
    # A damaged or empty archive is recognised by its suffix.
    recognises=lambda source: (
        (source.suffix == ".npz" and source.head.startswith((ZIP, b"PK\x05\x06")))
        or any(name.endswith(".npy") for name in members(source))
    ),
    read=read_npz,
    library=True,
)
