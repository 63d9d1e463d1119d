"""A recording of any length fitted in constant memory: peak memory and time against length.

    python benchmarks/streamed_fit.py [SAMPLES ...] [--folder FOLDER] [--elsewhere PROCESSES]

Each length is written and fitted in a process of its own, so that each has a peak of its own
(``ru_maxrss``); times are processor time. The stage has 9 plays and 4 dead zones behind a lag of
0.2 ms, 10 nm of noise, and a zero that drifts by 300 nm; its drive turns at ever other levels. The
file is removed again. With --elsewhere each file is fitted a second time, the passes of the search
made by dask workers, and what the two fits have in common to the last bit is said.
"""

import argparse
import os
import resource
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import from_slopes
from piezoid.operators.prandtl_ishlinskii import PrandtlIshlinskii

if TYPE_CHECKING:
    from piezoid.identification.streamed.passes import Spread

RATE_Hz = 20_000.0
NOISE_m = 10e-9
DRIFT_m = 300e-9
LAG_SAMPLES = 4
WRITTEN = 1 << 20  # samples of a row group
HEADINGS = (
    "samples",
    "file GB",
    "peak MB",
    "before MB",
    "read s",
    "all s",
    "all / read",
    "rows",
    "rms nm",
    "lag us",
    "elapsed s",
    "processes elsewhere",
    "digest of the model",
)
PLAYS = PrandtlIshlinskii(
    threshold=np.arange(9) * 0.5,
    weight=np.concatenate([[2e-6], 2.5e-7 * np.exp(-np.arange(8) / 5)]),
)
ZONES = from_slopes(
    np.array([-8e-6, -4e-6, 0, 4e-6, 8e-6]), np.array([0.9, 0.95, 1, 1, 0.97, 0.9])
)


def drive_V(first: int, count: int) -> Array:
    """A sine at 2 Hz that swells and falls over 37 s: minor loops at all levels."""
    t = (first + np.arange(count)) / RATE_Hz
    return np.asarray(5 * (0.1 + 0.9 * np.abs(np.cos(np.pi * t / 37))) * np.sin(4 * np.pi * t))


def blocks(samples: int) -> "list[tuple[int, int]]":
    """First sample and length of every block that is written."""
    return [(k, min(WRITTEN, samples - k)) for k in range(0, samples, WRITTEN)]


def columns_of(first: int, count: int, samples: int, memory: Array) -> tuple[list[Array], Array]:
    """Return time, voltage and displacement in um of one block, and the memory after it."""
    # the stage answers four samples later: it is driven by what came before
    h_m, memory = PLAYS.run(drive_V(first - LAG_SAMPLES, count), memory)
    k = first + np.arange(count)
    noise_m = NOISE_m * np.random.default_rng([1, first]).standard_normal(count)
    y_m = ZONES.run(h_m) + DRIFT_m * k / samples + noise_m
    return [k / RATE_Hz, drive_V(first, count), 1e6 * y_m], memory


def write(path: Path, samples: int) -> None:
    """Write a recording block by block."""
    import pyarrow as pa
    from pyarrow.parquet import ParquetWriter

    memory = PLAYS.virgin_memory()
    names = ("time [s]", "voltage [V]", "displacement [um]")
    schema = pa.schema([(name, pa.float64()) for name in names])
    with ParquetWriter(path, schema, compression="none", use_dictionary=False) as writer:
        for first, count in blocks(samples):
            columns, memory = columns_of(first, count, samples, memory)
            writer.write_table(pa.table(dict(zip(names, columns, strict=True)), schema=schema))


def peak_megabytes() -> float:
    """Return the largest memory this process has held."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def fit_one(path: Path, elsewhere: int = 0) -> None:
    """Fit one file and print what it took."""
    from piezoid.digests import digest_of_bytes
    from piezoid.identification.store import write_model
    from piezoid.identification.streamed.fit_streamed import fit_streamed
    from piezoid.records.streams.spool import spooled

    before, begun_s, at_s = peak_megabytes(), time.process_time(), time.monotonic()
    with (
        spread_over(elsewhere) as spread,
        spooled([path], folder=path.parent, named=spread is not None) as spool,
    ):
        read_s = time.process_time() - begun_s
        samples = spool.pieces["x"][0].samples
        model = fit_streamed(spool, spread=spread)
        (axis,) = model.axes.values()
    all_s = time.process_time() - begun_s
    cells = (
        f"{samples:.0e}",
        f"{path.stat().st_size / 1e9:.3f}",
        f"{peak_megabytes():.0f}",
        f"{before:.0f}",
        f"{read_s:.3g}",
        f"{all_s:.3g}",
        f"{all_s / read_s:.2g}",
        f"{axis.quality.rows}",
        f"{1e9 * axis.quality.rms_m:.2f}",
        f"{1e6 * axis.lag.time_s:.0f}",
        f"{time.monotonic() - at_s:.0f}",
        f"{elsewhere or 'none'}",
        digest_of_bytes(write_model(model))[7:15],
    )
    print(f"| {' | '.join(cells)} |", flush=True)


@contextmanager
def spread_over(processes: int) -> Iterator["Spread | None"]:
    """Give what makes passes in processes elsewhere; None for none."""
    if not processes:
        yield None
        return
    from distributed import Client, LocalCluster

    with (
        LocalCluster(
            n_workers=processes, threads_per_worker=1, dashboard_address="127.0.0.1:0"
        ) as cluster,
        Client(cluster) as client,
    ):
        yield lambda work, items: client.gather(client.map(work, items, pure=False))


def measure(samples: float, folder: Path, elsewhere: int) -> None:
    """Write one length and fit it, each in a process of its own; the file goes again."""
    folder.mkdir(exist_ok=True)
    path = folder / f"long_{samples:.0e}.parquet"
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    steps = [[str(samples), "--write", str(path)], ["--fit", str(path)]]
    if elsewhere:
        steps.append(["--fit", str(path), "--elsewhere", str(elsewhere)])
    try:
        for step in steps:
            subprocess.run([sys.executable, __file__, *step], check=True, env=environment)
    finally:
        path.unlink(missing_ok=True)


def main() -> None:
    """Print one row for each length."""
    parser = argparse.ArgumentParser()
    parser.add_argument("samples", nargs="*", type=float, default=[1e6, 1e7, 1e8])
    parser.add_argument("--folder", type=Path, default=Path("build"))
    parser.add_argument("--fit", type=Path, help="fit this file in this process")
    parser.add_argument("--write", type=Path, help="write one in this process")
    parser.add_argument("--elsewhere", type=int, default=0, help="processes of dask")
    asked = parser.parse_args()
    if asked.fit:
        return fit_one(asked.fit, asked.elsewhere)
    if asked.write:
        return write(asked.write, int(asked.samples[0]))
    print(f"| {' | '.join(HEADINGS)} |", flush=True)
    for samples in asked.samples:
        measure(samples, asked.folder, asked.elsewhere)
    return None


if __name__ == "__main__":
    main()
