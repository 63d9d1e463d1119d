"""HDF5: the numeric vectors of all groups, units from the attribute ``unit`` or ``units``."""

from typing import Any

from piezoid.records.readers.foreign import reading, table_of
from piezoid.records.readers.hdf5_trees import SIGNATURE, check_trees
from piezoid.records.readers.reader import Reader
from piezoid.records.readers.source import MOST_COLUMNS, Source, check_growth
from piezoid.records.table import RawTable

_DEEPEST = 32  # groups; the library takes minutes to walk through some thousand
_UNIT_ATTRIBUTES = ("unit", "units", "Unit", "Units", "UNIT")


def check_datasets(source: Source) -> None:
    """Refuse a file without end, or too large for the memory, before any of it is read."""
    with source.open() as stream:
        check_trees(stream)
        check_growth(source, 8 * sum(dataset.size for dataset in _datasets(stream).values()))


def read(source: Source) -> RawTable:
    """Read every numeric dataset; a name that two groups share keeps its group before it."""
    with reading(source, "HDF5"):
        check_datasets(source)
        with source.open() as stream:
            held = named_datasets(stream)
            arrays = {name: dataset[()] for name, dataset in held.items()}
            units = {name: unit_of_dataset(dataset) for name, dataset in held.items()}
    return table_of(source, "HDF5", arrays, units=units)


def named_datasets(stream: object) -> dict[str, Any]:
    """Return the numeric datasets by name; one that two groups share keeps its group before it."""
    held = _datasets(stream)
    short = [path.rsplit("/", 1)[-1] for path in held]
    return {
        name if short.count(name) == 1 else path: dataset
        for name, (path, dataset) in zip(short, held.items(), strict=True)
    }


def _datasets(stream: object) -> dict[str, Any]:
    import h5py

    found: dict[str, Any] = {}

    def keep(path: str, item: Any) -> None:
        if path.count("/") > _DEEPEST:
            raise ValueError(f"its groups lie more than {_DEEPEST} deep in one another")
        if not isinstance(item, h5py.Dataset) or item.dtype.kind not in "biuf":
            return
        # No digest of this file would tell that they changed, and a pipe among them never ends.
        if item.external or item.is_virtual:
            raise ValueError(f"the numbers of {path} lie in other files")
        if len(found) == MOST_COLUMNS:
            raise ValueError(f"it holds more than {MOST_COLUMNS} datasets")
        found[path] = item

    h5py.File(stream, "r").visititems(keep)
    return found


def unit_of_dataset(dataset: Any) -> str:
    """Return the unit among a dataset's attributes, empty where there is none."""
    for key in _UNIT_ATTRIBUTES:
        if key in dataset.attrs:
            value = dataset.attrs[key]
            return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
    return ""


READER = Reader(
    name="HDF5",
    suffixes=(".h5", ".hdf5"),
    recognises=lambda source: source.head.startswith(SIGNATURE),
    read=read,
)
