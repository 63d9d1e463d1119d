"""parameters.parquet: every parameter of every axis of every stage, one row for each axis."""

from collections.abc import Mapping
from io import BytesIO
from typing import Any

from piezoid_reports.fleet.quantities import QUANTITIES
from piezoid_reports.fleet.records import Fleet, FleetAxis, FleetStage

TOGETHER = 5000  # stages that are rows in memory at one time


def parquet_of(fleet: Fleet) -> bytes:
    """Return the bytes of the table; a stage that was refused is a row without an axis."""
    import pyarrow as pa
    import pyarrow.parquet as pq

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
    schema, stream = pa.schema(columns), BytesIO()
    with pq.ParquetWriter(stream, schema, compression="zstd") as table:
        for first in range(0, len(fleet.stages), TOGETHER):
            part = fleet.stages[first : first + TOGETHER]
            rows = [row for stage in part for row in _rows(stage)]
            table.write_table(pa.Table.from_pylist(rows, schema=schema))
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
