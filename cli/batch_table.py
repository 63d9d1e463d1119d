"""parameters.parquet: every parameter of every axis of every stage, one row for each axis."""

from collections.abc import Mapping
from itertools import islice
from typing import Any, BinaryIO

from piezoid_reports.fleet.quantities import QUANTITIES
from piezoid_reports.fleet.records import Fleet, FleetAxis, FleetStage

TOGETHER = 5000  # stages that are rows in memory at one time


def write_table(fleet: Fleet, stream: BinaryIO) -> None:
    """Write the table; a stage that was refused is a row without an axis."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    named = _parameter_names(fleet)
    columns = [
        *(pa.field(name, pa.string()) for name in ("stage", "state", "reason", "axis")),
        pa.field("serial", pa.int64()),
        pa.field("applies", pa.bool_()),
        *(pa.field(quantity.name, pa.float64()) for quantity in QUANTITIES),
        *(pa.field(name, pa.float64()) for name, of in named.items() if of is float),
        *(pa.field(name, pa.list_(pa.float64())) for name, of in named.items() if of is list),
        pa.field("model_digest", pa.string()),
    ]
    schema = pa.schema(columns)
    with pq.ParquetWriter(stream, schema, compression="zstd") as table:
        stages = iter(fleet.stages)
        while part := list(islice(stages, TOGETHER)):
            table.write_table(_columns([row for stage in part for row in _rows(stage)], schema))


def _columns(rows: list[dict[str, Any]], schema: Any) -> Any:
    import pyarrow as pa

    arrays = [pa.array([row.get(one.name) for row in rows], type=one.type) for one in schema]
    return pa.Table.from_arrays(arrays, schema=schema)


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


def _parameter_names(fleet: Fleet) -> dict[str, type]:
    """Return the kind of every parameter, in the order in which they are first seen."""
    found: dict[str, type] = {}
    for stage in fleet.stages:
        for axis in stage.axes:
            if not axis.parameters.keys() <= found.keys():
                found |= {n: type(v) for n, v in axis.parameters.items() if n not in found}
    return found
