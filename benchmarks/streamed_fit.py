"""A recording of any length fitted in constant memory: peak memory and time against length.

    python benchmarks/streamed_fit.py [SAMPLES ...] [--folder FOLDER] [--format parquet|csv]

Each length is written and fitted in a process of its own, so that each has a peak of its own
(``ru_maxrss``). The stage has 9 plays and 4 dead zones behind a lag of 0.2 ms, 10 nm of noise, and
a zero that drifts by 300 nm; its drive turns at ever other levels. The file is removed again.
"""

import argparse
import os
import resource
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import from_slopes
from piezoid.operators.prandtl_ishlinskii import PrandtlIshlinskii

RATE_Hz = 20_000.0
NOISE_m = 10e-9
LAG_SAMPLES = 4
WRITTEN = 1 << 20  # samples of a row group
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


def write(path: Path, samples: int) -> None:
    """Write a recording block by block."""
    import pyarrow as pa
    from pyarrow.parquet import ParquetWriter

    memory, rng = PLAYS.virgin_memory(), np.random.default_rng(1)
    names = ("time [s]", "voltage [V]", "displacement [um]")
    schema = pa.schema([(name, pa.float64()) for name in names])
    with ParquetWriter(path, schema, compression="none", use_dictionary=False) as writer:
        for first, count in blocks(samples):
            # the stage answers four samples later: it is driven by what came before
            h_m, memory = PLAYS.run(drive_V(first - LAG_SAMPLES, count), memory)
            t = (first + np.arange(count)) / RATE_Hz
            drift_m = 300e-9 * (first + np.arange(count)) / samples
            y_m = ZONES.run(h_m) + drift_m + NOISE_m * rng.standard_normal(count)
            columns = (t, drive_V(first, count), 1e6 * y_m)
            writer.write_table(pa.table(dict(zip(names, columns, strict=True)), schema=schema))


def peak_megabytes() -> float:
    """Return the largest memory this process has held."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def fit_one(path: Path) -> None:
    """Fit one file and print what it took."""
    from piezoid.identification.streamed.fit_streamed import fit_streamed
    from piezoid.records.streams.spool import spooled

    before = peak_megabytes()
    start, cpu = time.perf_counter(), time.process_time()
    with spooled([path], folder=path.parent) as spool:
        read_s, read_cpu_s = time.perf_counter() - start, time.process_time() - cpu
        samples = spool.pieces["x"][0].samples
        (axis,) = fit_streamed(spool).axes.values()
    total_s, cpu_s = time.perf_counter() - start, time.process_time() - cpu
    quality = axis.quality
    print(
        f"| {samples:.0e} | {path.stat().st_size / 1e9:.3f} | {peak_megabytes():.0f} "
        f"| {before:.0f} | "
        f"{read_s:.0f} ({read_cpu_s:.0f}) | {total_s:.0f} ({cpu_s:.0f}) | {quality.rows} | "
        f"{1e9 * quality.rms_m:.2f} | {1e6 * axis.lag.time_s:.0f} |",
        flush=True,
    )


def main() -> None:
    """Print one row for each length."""
    parser = argparse.ArgumentParser()
    parser.add_argument("samples", nargs="*", type=float, default=[1e6, 1e7, 1e8])
    parser.add_argument("--folder", type=Path, default=Path("build"))
    parser.add_argument("--fit", type=Path, help="fit this file in this process")
    parser.add_argument("--write", type=Path, help="write one in this process")
    asked = parser.parse_args()
    if asked.fit:
        return fit_one(asked.fit)
    if asked.write:
        return write(asked.write, int(asked.samples[0]))
    print(
        "| samples | file GB | peak MB | before MB | read s (CPU) | all s (CPU) | rows | rms nm |"
    )
    for samples in asked.samples:
        path = asked.folder / f"long_{samples:.0e}.parquet"
        path.parent.mkdir(exist_ok=True)
        environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
        try:
            for step in ([str(samples), "--write", str(path)], ["--fit", str(path)]):
                command = [sys.executable, __file__, *step]
                subprocess.run(command, check=True, env=environment)
        finally:
            path.unlink(missing_ok=True)
    return None


if __name__ == "__main__":
    main()
