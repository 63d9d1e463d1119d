"""The summary of a fleet of synthetic stages: seconds, memory, size of the page, how they grow.

    python -m benchmarks.fleet_summary 1000 10000 100000

Three axes, all that is compared, three lists of parameters; one stage in fifty does not pass.
"""

import resource
import sys
from time import process_time

import numpy as np

from piezoid_cli.batch_table import parquet_of
from piezoid_reports.fleet.quantities import QUANTITIES
from piezoid_reports.fleet.records import FAILED, PASSED, Fleet, FleetAxis, FleetStage
from piezoid_reports.fleet.render import render_fleet


def fleet_of(count: int) -> Fleet:
    """Return so many stages with numbers in their names, whose sensitivity drifts."""
    rng = np.random.default_rng(count)
    names = [quantity.name for quantity in QUANTITIES]
    values = np.exp(0.1 * rng.standard_normal((count, 3, len(names))))
    values[..., 0] += 0.1 * np.arange(count)[:, None] / count
    weights = rng.uniform(size=(count, 3, 3, 10)).tolist()
    return Fleet(
        name="synthetic",
        stages=tuple(
            FleetStage(
                name=f"unit {k:07d}",
                state=FAILED if k % 50 == 7 else PASSED,
                reason="shape error of what ships: 1.2 % of the diameter" if k % 50 == 7 else "",
                version="1",
                outputs={"model.json": f"sha256:{k:064x}", "params.json": f"sha256:{k:064x}"},
                axes=tuple(
                    FleetAxis(
                        axis=axis,
                        applies=True,
                        values=dict(zip(names, values[k, place].tolist(), strict=True)),
                        parameters={f"list_{i}": weights[k][place][i] for i in range(3)},
                        errors={names[0]: 0.01},
                    )
                    for place, axis in enumerate("xyz")
                ),
            )
            for k in range(count)
        ),
    )


def main() -> None:
    """Print a line for every size asked for, and the exponent between the last two."""
    spent: list[tuple[int, float]] = []
    for count in [int(word) for word in sys.argv[1:]] or [1000, 10_000, 100_000]:
        fleet, begun = fleet_of(count), process_time()
        page = len(render_fleet(fleet).encode())
        drawn = process_time() - begun
        table, record = len(parquet_of(fleet)), len(fleet.to_json())
        whole = process_time() - begun
        most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        spent.append((count, whole))
        print(
            f"{count} stages: page {drawn:.1f} s of processor, with the rest {whole:.1f} s; "
            f"page {page / 1e6:.2f} MB, table {table / 1e6:.1f} MB, record {record / 1e6:.1f} MB; "
            f"at most {most:.0f} MB of memory",
            flush=True,
        )
    if len(spent) > 1:
        (few, quick), (many, slow) = spent[-2:]
        print(f"grows with the power {np.log(slow / quick) / np.log(many / few):.2f}")


if __name__ == "__main__":
    main()
