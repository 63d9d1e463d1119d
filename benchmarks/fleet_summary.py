"""The summary of a fleet of synthetic stages: seconds, memory, size of the page, how they grow.

    python -m benchmarks.fleet_summary 1000 10000 100000

Three axes, all that is compared, three lists of parameters; one stage in fifty does not pass.
Records are taken in as workers pack them; making them is not counted.
"""

import resource
import sys
from collections.abc import Mapping
from tempfile import TemporaryFile
from time import process_time

import numpy as np

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


def stage_of(
    serial: int,
    name: str,
    *,
    version: str = "1",
    drift: float = 0.0,
    inputs: Mapping[str, str] | None = None,
) -> FleetStage:
    """Return a stage whose numbers are drawn by its serial number.

    drift  what is added to its sensitivity
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
                values=dict(zip(NAMES, values[place].tolist(), strict=True)),
                parameters={f"list_{i}": lists[place, i].tolist() for i in range(3)},
                errors={NAMES[0]: 0.01},
            )
            for place, axis in enumerate("xyz")
        ),
    )


def main() -> None:
    """Print a line for every size asked for, and the exponent between the last two."""
    spent: list[tuple[int, float]] = []
    for count in [int(word) for word in sys.argv[1:]] or [1000, 10_000, 100_000]:
        with StagesOnDisk() as stages:
            for k in range(count):
                made = stage_of(k, f"unit {k:07d}", drift=0.1 * k / count)
                stages.add(made.name, made.packed())
            begun = process_time()
            fleet = Fleet(name="synthetic", stages=stages)
            page = len(render_fleet(fleet).encode())
            drawn = process_time() - begun
            with TemporaryFile() as table, TemporaryFile() as record:
                write_table(fleet, table)
                fleet.write_json(record)
                sizes = table.tell(), record.tell()
            whole = process_time() - begun
        most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        spent.append((count, whole))
        print(
            f"{count} stages: page {drawn:.1f} s of processor, with the rest {whole:.1f} s; "
            f"page {page / 1e6:.2f} MB, table {sizes[0] / 1e6:.1f} MB, "
            f"record {sizes[1] / 1e6:.1f} MB; at most {most:.0f} MB of memory",
            flush=True,
        )
    if len(spent) > 1:
        (few, quick), (many, slow) = spent[-2:]
        print(f"grows with the power {np.log(slow / quick) / np.log(many / few):.2f}")


if __name__ == "__main__":
    main()
