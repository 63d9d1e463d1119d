"""Duration of a batch of virtual stages, with and without a killed worker.

    python -m benchmarks.night_shift FOLDER --stages 200

Each stage is a Preisach ceramic with one short sweep. `piezoid batch` fits, diagnoses, designs,
exports and verifies it, or only fits and diagnoses it with --without-controllers. The sensitivity
decreases slowly with the serial number. One stage has four times the sensor noise of the others,
and one recording has no drive: the summary must report them.

The first run has two workers, of which one is killed; the second run has one worker. With
--minutes a run is interrupted, and the same command continues it; the durations are added.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from piezoid_datasets.virtual_lab import drives
from piezoid_datasets.virtual_lab.rig import Rig
from piezoid_datasets.virtual_lab.stage import Run, Stage, record
from piezoid_datasets.virtual_lab.truths.return_point import draw_preisach
from piezoid_datasets.virtual_lab.write import csv_text, lab_toml

RATE_Hz, SWEEP_Hz, CYCLES = 1000.0, 5.0, 4
DECREASE_PER_STAGE = 2e-4  # of the stroke, as by wear of a tool
RUNS: dict[str, tuple[int, float | None]] = {"killed": (2, 0.4), "one": (1, None)}
NOISY, DEAD = 0.35, 0.7  # positions of these stages, as a share of all


def write_stages(folder: Path, count: int, *, controllers: bool = True) -> None:
    """Write one folder for each stage; lab.toml without a rate means no controllers."""
    for serial in range(1, count + 1):
        stage_folder = folder / f"stage-{serial:04d}"
        stage_folder.mkdir(parents=True, exist_ok=True)
        rig, text = stage_files(serial, count)
        lines = lab_toml(rig).splitlines(keepends=True)
        if not controllers:
            lines = [line for line in lines if not line.startswith("sampling_rate_Hz")]
        (stage_folder / "lab.toml").write_text("".join(lines))
        (stage_folder / "sweep.csv").write_text(text)


def stage_files(serial: int, count: int) -> tuple[Rig, str]:
    """Return the rig and the CSV text of one stage."""
    rng = np.random.default_rng([517, serial])
    stroke_m = 33e-6 * (1.0 - DECREASE_PER_STAGE * serial) * (1.0 + 0.01 * rng.standard_normal())
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


@dataclass(frozen=True, kw_only=True)
class Shift:
    """One run of a batch, which may have several parts.

    kill_after  share of the stages after which a worker is killed, or None
    limit_s     time after which the run is interrupted; the next part continues
    """

    recordings: Path
    out: Path
    workers: int
    kill_after: float | None
    limit_s: float

    def run(self) -> bool:
        """Run the batch, add its duration to that of earlier parts; return whether it is done."""
        command = [sys.executable, "-m", "piezoid_cli.main", "batch", str(self.recordings)]
        options = ["--out", str(self.out), "--workers", str(self.workers), "--quiet"]
        totals = {"seconds": 0.0, "cpu": 0.0, "parts": 0, "killed": 0, **self._totals}
        start_s, start_cpu_s = time.perf_counter(), _child_cpu_s()
        process = subprocess.Popen([*command, *options])
        while process.poll() is None and time.perf_counter() - start_s < self.limit_s:
            time.sleep(0.1)
            if self._must_kill(totals["killed"]):
                totals["killed"] = self._written_stages
                os.kill(worker_of(process.pid), signal.SIGKILL)
        is_finished = process.poll() is not None
        if not is_finished:
            process.send_signal(signal.SIGINT)
            process.wait()
        totals["seconds"] += time.perf_counter() - start_s
        totals["cpu"] += _child_cpu_s() - start_cpu_s
        totals["parts"] += 1
        self.out.with_suffix(".json").write_text(json.dumps(totals))
        return is_finished

    @property
    def summary(self) -> str:
        """Durations of all parts, and the number of written stages."""
        totals = self._totals
        killed = f", a worker killed after {totals['killed']} stages" if totals["killed"] else ""
        return (
            f"{self.workers} workers: {totals['seconds']:.1f} s, processor time "
            f"{totals['cpu']:.0f} s, {totals['parts']} parts{killed}; {self._written_stages} "
            f"stages written; load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"
        )

    def _must_kill(self, killed: int) -> bool:
        if self.kill_after is None or killed:
            return False
        return self._written_stages >= self.kill_after * len(list(self.recordings.iterdir()))

    @property
    def _written_stages(self) -> int:
        return len(list(self.out.glob("stages/*")))

    @property
    def _totals(self) -> dict[str, Any]:
        path = self.out.with_suffix(".json")
        totals: dict[str, Any] = json.loads(path.read_text()) if path.exists() else {}
        return totals


def _child_cpu_s() -> float:
    times = os.times()
    return times.children_user + times.children_system


def worker_of(parent: int) -> int:
    """Return the process id of the worker with the largest processor time."""
    import psutil

    children = psutil.Process(parent).children(recursive=True)
    return int(max(children, key=lambda child: sum(child.cpu_times()[:2])).pid)


def stage_states(out: Path) -> str:
    """Return the final states of the stages of a batch, with their numbers."""
    stages = json.loads((out / "batch.json").read_bytes())["stages"]
    states = [stage["state"] for stage in stages]
    return ", ".join(f"{states.count(state)} {state}" for state in sorted(set(states)))


def compare_models(first: Path, second: Path) -> str:
    """Count the models that are identical in two runs."""
    names = [folder.name for folder in sorted((first / "stages").iterdir())]
    pairs = [
        tuple(run / "stages" / name / "model.json" for run in (first, second)) for name in names
    ]
    pairs = [(a, b) for a, b in pairs if a.exists() or b.exists()]
    count = sum(a.exists() and b.exists() and a.read_bytes() == b.read_bytes() for a, b in pairs)
    return f"{count} of {len(pairs)} models are identical after the kill"


def main() -> None:
    """Write the stages, run the batch twice, print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--stages", type=int, default=200)
    parser.add_argument("--without-controllers", action="store_true")
    parser.add_argument("--minutes", type=float, default=float("inf"))
    parser.add_argument("--runs", nargs="+", choices=list(RUNS), default=list(RUNS))
    options = parser.parse_args()
    recordings = options.folder / "night"
    write_stages(recordings, options.stages, controllers=not options.without_controllers)
    limit_s = 60.0 * options.minutes
    for name in options.runs:
        (workers, kill_after), out = RUNS[name], options.folder / name
        if (out / "summary.html").exists():
            continue
        shift = Shift(
            recordings=recordings,
            out=out,
            workers=workers,
            kill_after=kill_after,
            limit_s=limit_s,
        )
        is_finished = shift.run()
        print(f"{name}: {shift.summary}", flush=True)
        if not is_finished:
            return
        print(f"{name}: {stage_states(out)}", flush=True)
    if all((options.folder / name / "summary.html").exists() for name in RUNS):
        print(compare_models(options.folder / "one", options.folder / "killed"))


if __name__ == "__main__":
    main()
