"""Cost of a batch for its client: processor time per stage, returned bytes, memory.

    python -m benchmarks.batch_client [--stubbed 20000] [--real 200]

There are two local workers. The scheduler is a thread of the client, so its time is included.
Stub stages are folders with a lab.toml and a recording of one line, for which workers write a
record of three axes and a page of 10 kB. Real stages have 300 samples of two plays and no
controller, and are fitted as by `piezoid batch`.
"""

import argparse
import sys
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic, process_time

import numpy as np

from benchmarks.fleet_summary import synthetic_stage
from benchmarks.speed.stopwatch import peak_megabytes
from piezoid_cli.batch import calibrate_stages, write_summary
from piezoid_cli.batch_cluster import cluster_client, find_stages
from piezoid_cli.batch_stage import StageTask, run_task
from piezoid_reports.fleet.records import Fleet, FleetStage, StagesOnDisk

PAGE = {"report.html": b"x" * 10_000}


def write_stubs(folder: Path, count: int) -> None:
    """Write folders of stages with minimal files."""
    for number in range(count):
        stage_folder = folder / f"unit-{number:07d}"
        stage_folder.mkdir(parents=True)
        (stage_folder / "lab.toml").write_text("")
        (stage_folder / "sweep.csv").write_text("1,2\n")


def write_real(folder: Path, count: int) -> None:
    """Write recordings of two plays with noise, of three cycles each."""
    phase = 2 * np.pi * np.arange(300) / 100
    drive = 5 - 5 * np.cos(phase)
    for number in range(count):
        stage_folder = folder / f"unit-{number:07d}"
        stage_folder.mkdir(parents=True)
        memory, position = 0.0, np.empty(len(drive))
        for k, u in enumerate(drive):
            memory = max(u - 1.5, min(u + 1.5, memory))
            position[k] = (2 + 0.001 * number) * u + 0.6 * memory
        position += 0.002 * np.random.default_rng(number).standard_normal(len(position))
        rows = np.column_stack([np.arange(300) / 100, drive, position])
        heading = "time [s],voltage [V],position [um]"
        np.savetxt(stage_folder / "sweep.csv", rows, "%.6f", ",", header=heading, comments="")
        (stage_folder / "lab.toml").write_text("")


def stub(task: StageTask, inputs: Mapping[str, str]) -> tuple[FleetStage, Mapping[str, bytes]]:
    """Return a synthetic result instead of a calibration."""
    number = int(task.name.rpartition("-")[2])
    return synthetic_stage(number, task.name, version=task.version, inputs=inputs), PAGE


def measure(
    title: str,
    write: Callable[[Path, int], None],
    count: int,
    work: Callable[[StageTask], bytes],
) -> None:
    """Run a batch of stages and print its cost."""
    with TemporaryDirectory() as scratch, StagesOnDisk() as stages:
        folder = Path(scratch)
        write(folder / "night", count)
        out = str(folder / "results")
        start_s, search_start_s = monotonic(), process_time()
        tasks = find_stages(folder / "night", out)
        search_s = process_time() - search_start_s
        with cluster_client("", 2) as client:
            schedule_start_s = process_time()
            calibrate_stages(client, tasks, stages, work=work)
            schedule_s = process_time() - schedule_start_s
        summary_start_s = process_time()
        bytes_per_stage = stages.size / count
        write_summary(out, Fleet(name="night", stages=stages))
        # The end of the cluster, before the summary, is part of the client's time.
        total_s = search_s + process_time() - schedule_start_s
        summary_s = process_time() - summary_start_s
        ms = 1e3 / count
        print(
            f"{count} {title} stages: client {ms * total_s:.2f} ms of processor time per stage "
            f"(finding files {ms * search_s:.2f}, scheduling {ms * schedule_s:.2f}, summary "
            f"{ms * summary_s:.2f}), {bytes_per_stage:.0f} bytes returned per stage, "
            f"{monotonic() - start_s:.0f} s, at most {peak_megabytes():.0f} MB",
            flush=True,
        )


def main() -> None:
    """Print a line for stubs and a line for real stages."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--stubbed", type=int, default=20_000)
    parser.add_argument("--real", type=int, default=200)
    options = parser.parse_args()
    if options.stubbed:
        measure("stubbed", write_stubs, options.stubbed, partial(run_task, calibrate=stub))
    if options.real:
        measure("real", write_real, options.real, run_task)
    sys.stdout.flush()


if __name__ == "__main__":
    main()
