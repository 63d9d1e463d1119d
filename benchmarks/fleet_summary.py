"""Time, memory and page size of the summary of many synthetic stages.

    python -m benchmarks.fleet_summary 1000 10000 100000

Every stage has three axes with all compared quantities and three lists of parameters. One stage in
fifty fails. The records are packed as by workers; their creation is not timed.
"""

import sys
from collections.abc import Mapping
from tempfile import TemporaryFile
from time import process_time

import numpy as np

from benchmarks.speed.stopwatch import peak_megabytes
from piezoid_cli.batch import write_table
from piezoid_reports.fleet.records import (
    FAILED,
    PASSED,
    Fleet,
    FleetAxis,
    FleetStage,
    StagesOnDisk,
)
from piezoid_reports.fleet.sections import render_fleet
from piezoid_reports.fleet.statistics import QUANTITIES

NAMES = [quantity.name for quantity in QUANTITIES]


def synthetic_stage(
    serial: int,
    name: str,
    *,
    version: str = "1",
    drift: float = 0.0,
    inputs: Mapping[str, str] | None = None,
) -> FleetStage:
    """Return a stage whose values depend on its serial number.

    drift  added to its sensitivity
    """
    rng = np.random.default_rng(serial)
    values = np.exp(0.1 * rng.standard_normal((3, len(NAMES))))
    values[:, 0] += drift
    lists = rng.uniform(size=(3, 3, 10))
    failed = serial % 50 == 7
    digests = {f"{kind}.json": f"sha256:{serial:064x}" for kind in ("model", "params")}
    return FleetStage(
        name=name,
        state=FAILED if failed else PASSED,
        reason="shape error of the shipped controller: 1.2 % of the diameter" if failed else "",
        version=version,
        inputs=inputs or {},
        outputs=digests,
        axes=tuple(
            FleetAxis(
                axis=axis,
                applies=True,
                values=dict(zip(NAMES, values[index].tolist(), strict=True)),
                parameters={f"list_{i}": lists[index, i].tolist() for i in range(3)},
                errors={NAMES[0]: 0.01},
            )
            for index, axis in enumerate("xyz")
        ),
    )


def main() -> None:
    """Print a line for every number of stages, and the exponent between the last two."""
    times_s: list[tuple[int, float]] = []
    for count in [int(argument) for argument in sys.argv[1:]] or [1000, 10_000, 100_000]:
        with StagesOnDisk() as stages:
            for k in range(count):
                stage = synthetic_stage(k, f"unit {k:07d}", drift=0.1 * k / count)
                stages.add(stage.name, stage.packed())
            start_s = process_time()
            fleet = Fleet(name="synthetic", stages=stages)
            page = len(render_fleet(fleet).encode())
            page_s = process_time() - start_s
            with TemporaryFile() as table, TemporaryFile() as record:
                write_table(fleet, table)
                fleet.write_json(record)
                sizes = table.tell(), record.tell()
            total_s = process_time() - start_s
        times_s.append((count, total_s))
        print(
            f"{count} stages: page {page_s:.1f} s of processor time, with table and record "
            f"{total_s:.1f} s; page {page / 1e6:.2f} MB, table {sizes[0] / 1e6:.1f} MB, "
            f"record {sizes[1] / 1e6:.1f} MB; peak memory {peak_megabytes():.0f} MB",
            flush=True,
        )
    if len(times_s) > 1:
        (small, shorter_s), (large, longer_s) = times_s[-2:]
        print(f"exponent of the time {np.log(longer_s / shorter_s) / np.log(large / small):.2f}")


if __name__ == "__main__":
    main()
