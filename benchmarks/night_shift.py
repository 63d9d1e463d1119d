"""A night of production: how long a batch of virtual stages takes, and what a killed worker costs.

    python benchmarks/night_shift.py FOLDER --stages 200

Each stage is a Preisach ceramic of its own with one short sweep, fitted, diagnosed, designed,
exported and verified. The sensitivity falls slowly with the serial number, one stage has twice the
sensor noise of the others, one recording is empty of drive: the summary must say so.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from piezoid_datasets.virtual_lab import drives
from piezoid_datasets.virtual_lab.rig import Rig
from piezoid_datasets.virtual_lab.stage import Run, Stage, record
from piezoid_datasets.virtual_lab.table import csv_text
from piezoid_datasets.virtual_lab.truths.preisach import draw_preisach
from piezoid_datasets.virtual_lab.write import lab_toml

RATE_Hz, SWEEP_Hz, CYCLES = 1000.0, 5.0, 4
FALL_PER_STAGE = 2e-4  # of the stroke, as a tool wears
NOISY, DEAD = 0.35, 0.7  # which stages of the night, as a share of it


def night(folder: Path, count: int) -> None:
    """Write one folder for each stage."""
    for serial in range(1, count + 1):
        place = folder / f"stage-{serial:04d}"
        place.mkdir(parents=True, exist_ok=True)
        rig, text = one_stage(serial, count)
        (place / "lab.toml").write_text(lab_toml(rig))
        (place / "sweep.csv").write_text(text)


def one_stage(serial: int, count: int) -> tuple[Rig, str]:
    """Return the rig and the sweep of one stage."""
    rng = np.random.default_rng([517, serial])
    stroke_m = 33e-6 * (1.0 - FALL_PER_STAGE * serial) * (1.0 + 0.01 * rng.standard_normal())
    noise_m = 10e-9 * (4.0 if serial == round(NOISY * count) else 1.0)
    rig = replace(Rig(name=f"stage {serial}"), stroke_m=stroke_m, noise_rms_m=noise_m)
    shape = drives.decaying_sweep(RATE_Hz, SWEEP_Hz, CYCLES)
    command_V = 0.5 * (shape + 1.0) * rig.drive_max_V
    history_V = np.array([7.0, 1.0, 4.0, 0.0])
    run = Run(name="sweep", sampling_rate_Hz=RATE_Hz, command_V=command_V, history_V=history_V)
    text = csv_text(record(Stage(rig=rig, ceramic=draw_preisach(rng), seed=serial), run))
    if serial == round(DEAD * count):
        header, *lines = text.splitlines()
        dead = [",".join((line.split(",")[0], "0.00000", line.split(",")[2])) for line in lines]
        text = "\n".join((header, *dead)) + "\n"
    return rig, text


def batch(folder: Path, out: Path, workers: int, *, kill_after: float | None = None) -> float:
    """Run the batch; return the seconds it took. A worker is killed once so many are done."""
    began = time.perf_counter()
    command = [sys.executable, "-m", "piezoid_cli.main", "batch", str(folder), "--out", str(out)]
    process = subprocess.Popen([*command, "--workers", str(workers), "--quiet"])
    if kill_after is not None:
        wanted = kill_after * len(list(folder.iterdir()))
        while process.poll() is None and len(list(out.glob("stages/*"))) < wanted:
            time.sleep(0.1)
        victim = worker_of(process.pid)
        os.kill(victim, signal.SIGKILL)
        print(f"killed worker {victim} after {len(list(out.glob('stages/*')))} stages")
    process.wait()
    return time.perf_counter() - began


def worker_of(parent: int) -> int:
    """Return the process id of a worker: the busiest grandchild of the command."""
    import psutil

    children = psutil.Process(parent).children(recursive=True)
    return int(max(children, key=lambda child: sum(child.cpu_times()[:2])).pid)


def told(out: Path) -> str:
    """Return how the stages of a batch ended."""
    stages = json.loads((out / "batch.json").read_bytes())["stages"]
    states = [stage["state"] for stage in stages]
    return ", ".join(f"{states.count(state)} {state}" for state in sorted(set(states)))


def main() -> None:
    """Make the night, run it three times, print the figures."""
    asked = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    asked.add_argument("folder", type=Path)
    asked.add_argument("--stages", type=int, default=200)
    options = asked.parse_args()
    recordings = options.folder / "night"
    night(recordings, options.stages)
    runs = {"one": (1, None), "two": (2, None), "killed": (2, 0.4)}
    for name, (workers, kill_after) in runs.items():
        out = options.folder / name
        seconds = batch(recordings, out, workers, kill_after=kill_after)
        print(f"{name}: {workers} workers, {seconds:.1f} s, {told(out)}", flush=True)
    same = [
        (options.folder / "one" / "stages" / place.name / "model.json").read_bytes()
        == (options.folder / "killed" / "stages" / place.name / "model.json").read_bytes()
        for place in sorted((options.folder / "one" / "stages").iterdir())
        if (place / "model.json").exists()
    ]
    print(f"{sum(same)} of {len(same)} models are the same bytes after the kill")


if __name__ == "__main__":
    main()
