"""Memory and time of a fit in chunks against the length of the recording.

    python -m benchmarks.streamed_fit [SAMPLES ...] [--folder FOLDER]

Each length is written and fitted in separate processes, so that each has its own peak memory
(``ru_maxrss``). Times are processor times. Lengths up to ``MAX_IN_MEMORY`` are fitted a second
time, from the whole recording in memory. The stage has 9 plays and 4 dead zones behind a lag of
0.2 ms, 10 nm of noise, and a zero that drifts by 300 nm. Its drive has turning points at all
levels. ``loop error`` is the rms difference between fitted and true hysteresis over one period of
the amplitude. The file is removed afterwards.
"""

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from benchmarks.speed.stopwatch import peak_megabytes
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import from_slopes
from piezoid.operators.prandtl_ishlinskii import PrandtlIshlinskii

MAX_IN_MEMORY = 1e6  # fitted from memory as well: 0.9 GB
RATE_Hz = 20_000.0
NOISE_m = 10e-9
DRIFT_m = 300e-9
LAG_SAMPLES = 4
BLOCK = 1 << 20  # samples of a row group
HEADINGS = (
    "samples",
    "file GB",
    "read",
    "peak MB",
    "before MB",
    "read s",
    "all s",
    "rows",
    "plays",
    "rms nm",
    "lag us",
    "loop error nm",
    "elapsed s",
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
    """Return a sine at 2 Hz whose amplitude changes over 37 s, with minor loops at all levels."""
    t = (first + np.arange(count)) / RATE_Hz
    return np.asarray(5 * (0.1 + 0.9 * np.abs(np.cos(np.pi * t / 37))) * np.sin(4 * np.pi * t))


def blocks(samples: int) -> "list[tuple[int, int]]":
    """Return first sample and length of every block of the file."""
    return [(k, min(BLOCK, samples - k)) for k in range(0, samples, BLOCK)]


def columns_of(first: int, count: int, samples: int, memory: Array) -> tuple[list[Array], Array]:
    """Return time, voltage and displacement in um of one block, and the memory after it."""
    # The stage has a delay of four samples.
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


def loop_error_m(axis: AxisModel) -> float:
    """Return the rms difference between fitted and true hysteresis over 37 s of the drive."""
    voltage_V = drive_V(0, round(37 * RATE_Hz))[::20]
    truth_m = ZONES.run(PLAYS.run(voltage_V, PLAYS.virgin_memory())[0])
    plays = axis.hysteresis.plays
    fitted_m = axis.hysteresis.dead_zones.run(plays.run(voltage_V, plays.virgin_memory())[0])
    return float(np.std(fitted_m - truth_m))


def fit_one(path: Path, *, in_memory: bool = False) -> None:
    """Fit one file, in chunks or from memory, and print its row."""
    from piezoid.digests import digest_of_bytes
    from piezoid.identification.fit import fit
    from piezoid.identification.store import write_model
    from piezoid.records.chunked_reader import read_thinned
    from piezoid.records.collection import collect

    initial_megabytes, start_s, start_elapsed_s = (
        peak_megabytes(),
        time.process_time(),
        time.monotonic(),
    )
    recordings = collect([path]).recordings if in_memory else read_thinned([path])
    read_s = time.process_time() - start_s
    model = fit(recordings)
    (axis,) = model.axes.values()
    cells = (
        path.stem.partition("_")[2],
        f"{path.stat().st_size / 1e9:.3f}",
        "whole" if in_memory else "in chunks",
        f"{peak_megabytes():.0f}",
        f"{initial_megabytes:.0f}",
        f"{read_s:.3g}",
        f"{time.process_time() - start_s:.3g}",
        f"{axis.quality.rows}",
        f"{len(axis.hysteresis.plays.weight)}",
        f"{1e9 * axis.quality.rms_m:.2f}",
        f"{1e6 * axis.lag.time_s:.0f}",
        f"{1e9 * loop_error_m(axis):.2f}",
        f"{time.monotonic() - start_elapsed_s:.0f}",
        digest_of_bytes(write_model(model))[7:15],
    )
    print(f"| {' | '.join(cells)} |", flush=True)


def measure(samples: float, folder: Path) -> None:
    """Write a file of one length, fit it in separate processes, and remove it."""
    folder.mkdir(exist_ok=True)
    path = folder / f"long_{samples:.0e}.parquet"
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    steps = [[str(samples), "--write", str(path)], ["--fit", str(path)]]
    if samples <= MAX_IN_MEMORY:
        steps.append(["--fit", str(path), "--whole"])
    try:
        for step in steps:
            command = [sys.executable, "-m", "benchmarks.streamed_fit", *step]
            subprocess.run(command, check=True, env=environment)
    finally:
        path.unlink(missing_ok=True)


def main() -> None:
    """Print one row for each length."""
    parser = argparse.ArgumentParser()
    parser.add_argument("samples", nargs="*", type=float, default=[1e6, 1e7, 1e8])
    parser.add_argument("--folder", type=Path, default=Path("build"))
    parser.add_argument("--fit", type=Path, help="fit this file in this process")
    parser.add_argument("--write", type=Path, help="write this file in this process")
    parser.add_argument("--whole", action="store_true", help="fit the whole recording in memory")
    arguments = parser.parse_args()
    if arguments.fit:
        return fit_one(arguments.fit, in_memory=arguments.whole)
    if arguments.write:
        return write(arguments.write, int(arguments.samples[0]))
    print(f"| {' | '.join(HEADINGS)} |", flush=True)
    for samples in arguments.samples:
        measure(samples, arguments.folder)
    return None


if __name__ == "__main__":
    main()
