"""What a batch costs its client: processor time a stage, bytes that come back, memory.

    python -m benchmarks.batch_client [--stubbed 20000] [--real 200]

Two workers on this machine; the scheduler is a thread of the client and is counted as such.
Stubbed stages are folders with a lab.toml and a recording of one line, digested by workers, which
write a record of three axes and a page of 10 kB. Real stages are 300 samples of two plays, without
a controller, fitted and reported as `piezoid batch` does.
"""

import argparse
import resource
import sys
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic, process_time

import numpy as np

from benchmarks.fleet_summary import stage_of
from piezoid_cli.batch import calibrate_stages, write_summary
from piezoid_cli.batch_cluster import cluster_client, find_stages
from piezoid_cli.batch_stage import StageTask, run_task
from piezoid_reports.fleet.records import Fleet, FleetStage, StagesOnDisk

PAGE = {"report.html": b"x" * 10_000}


def write_stubs(folder: Path, count: int) -> None:
    """Write folders of stages with next to nothing in them."""
    for number in range(count):
        place = folder / f"unit-{number:07d}"
        place.mkdir(parents=True)
        (place / "lab.toml").write_text("")
        (place / "sweep.csv").write_text("1,2\n")


def write_real(folder: Path, count: int) -> None:
    """Write recordings of three cycles of two plays with noise."""
    phase = 2 * np.pi * np.arange(300) / 100
    drive = 5 - 5 * np.cos(phase)
    for number in range(count):
        place = folder / f"unit-{number:07d}"
        place.mkdir(parents=True)
        memory, moved = 0.0, np.empty(len(drive))
        for k, u in enumerate(drive):
            memory = max(u - 1.5, min(u + 1.5, memory))
            moved[k] = (2 + 0.001 * number) * u + 0.6 * memory
        moved += 0.002 * np.random.default_rng(number).standard_normal(len(moved))
        rows = np.column_stack([np.arange(300) / 100, drive, moved])
        heading = "time [s],voltage [V],position [um]"
        np.savetxt(place / "sweep.csv", rows, "%.6f", ",", header=heading, comments="")
        (place / "lab.toml").write_text("")


def stub(task: StageTask, inputs: Mapping[str, str]) -> tuple[FleetStage, Mapping[str, bytes]]:
    """Do what takes no time instead of a calibration."""
    number = int(task.name.rpartition("-")[2])
    return stage_of(number, task.name, version=task.version, inputs=inputs), PAGE


def measure(
    what: str,
    write: Callable[[Path, int], None],
    count: int,
    work: Callable[[StageTask], bytes],
) -> None:
    """Do a batch of so many stages, and print what it cost."""
    with TemporaryDirectory() as held, StagesOnDisk() as stages:
        write(Path(held) / "night", count)
        out = str(Path(held) / "results")
        begun, at = process_time(), monotonic()
        tasks = find_stages(Path(held) / "night", out)
        found = process_time()
        with cluster_client("", 2) as client:
            started = process_time()
            calibrate_stages(client, tasks, stages, work=work)
            ended = process_time()
        packed = stages.size / count
        write_summary(out, Fleet(name="night", stages=stages))
        told = process_time()
        most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        each = partial("{:.2f}".format)
        ms = 1e3 / count
        print(
            f"{count} {what} stages: client {each(ms * (found - begun + told - started))} ms of "
            f"processor a stage (finding {each(ms * (found - begun))}, giving and taking "
            f"{each(ms * (ended - started))}, summary {each(ms * (told - ended))}), "
            f"{packed:.0f} bytes a stage come back, {monotonic() - at:.0f} s in all, "
            f"at most {most:.0f} MB",
            flush=True,
        )


def main() -> None:
    """Print a line for stubs and a line for real stages."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--stubbed", type=int, default=20_000)
    parser.add_argument("--real", type=int, default=200)
    asked = parser.parse_args()
    if asked.stubbed:
        measure("stubbed", write_stubs, asked.stubbed, partial(run_task, calibrate=stub))
    if asked.real:
        measure("real", write_real, asked.real, run_task)
    sys.stdout.flush()


if __name__ == "__main__":
    main()
