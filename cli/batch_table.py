"""parameters.parquet: every parameter of every axis of every stage, one row for each axis."""

from collections.abc import Mapping
from io import BytesIO
from typing import Any

from piezoid_reports.fleet.quantities import QUANTITIES
from piezoid_reports.fleet.records import Fleet, FleetAxis, FleetStage


def parquet_of(fleet: Fleet) -> bytes:
    """Return the bytes of the table; a stage that was refused is a row without an axis."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    rows = [row for stage in fleet.stages for row in _rows(stage)]
    lists = [name for name in _parameter_names(fleet, of=list)]
    numbers = [name for name in _parameter_names(fleet, of=float)]
    columns = [
        *(pa.field(name, pa.string()) for name in ("stage", "state", "reason", "axis")),
        pa.field("serial", pa.int64()),
        pa.field("applies", pa.bool_()),
        *(pa.field(quantity.name, pa.float64()) for quantity in QUANTITIES),
        *(pa.field(name, pa.float64()) for name in numbers),
        *(pa.field(name, pa.list_(pa.float64())) for name in lists),
        pa.field("model_digest", pa.string()),
    ]
    table = pa.Table.from_pylist(rows, schema=pa.schema(columns))
    stream = BytesIO()
    pq.write_table(table, stream, compression="zstd")
    return stream.getvalue()


def _rows(stage: FleetStage) -> list[dict[str, Any]]:
    about = {
        "stage": stage.name,
        "state": stage.state,
        "reason": stage.reason,
        "serial": stage.serial,
        "model_digest": stage.outputs.get("model.json"),
    }
    return [{**about, **_row(axis)} for axis in stage.axes] or [about]


def _row(axis: FleetAxis) -> Mapping[str, Any]:
    return {"axis": axis.axis, "applies": axis.applies, **axis.values, **axis.parameters}


def _parameter_names(fleet: Fleet, *, of: type) -> list[str]:
    held = [axis.parameters for stage in fleet.stages for axis in stage.axes]
    return list(dict.fromkeys(n for one in held for n, v in one.items() if isinstance(v, of)))
