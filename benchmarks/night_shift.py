"""A night of production: how long a batch of virtual stages takes, and what a killed worker costs.

    python benchmarks/night_shift.py FOLDER --stages 200

Each stage is a Preisach ceramic of its own with one short sweep, fitted, diagnosed, designed,
exported and verified; with --without-controllers fitted and diagnosed. The sensitivity falls
slowly with the serial number, one stage has four times the sensor noise of the others, one
recording is empty of drive: the summary must say so.

One run has one worker; another has two, of which one is killed in the middle. With --minutes a run
is interrupted after so long, and the same command goes on with it: seconds add up.
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
FALL_PER_STAGE = 2e-4  # of the stroke, as a tool wears
RUNS: dict[str, tuple[int, float | None]] = {"killed": (2, 0.4), "one": (1, None)}
NOISY, DEAD = 0.35, 0.7  # which stages of the night, as a share of it


def night(folder: Path, count: int, *, controllers: bool = True) -> None:
    """Write one folder for each stage; without the controllers' rate there are none."""
    for serial in range(1, count + 1):
        place = folder / f"stage-{serial:04d}"
        place.mkdir(parents=True, exist_ok=True)
        rig, text = one_stage(serial, count)
        lines = lab_toml(rig).splitlines(keepends=True)
        kept = [line for line in lines if controllers or not line.startswith("sampling_rate_Hz")]
        (place / "lab.toml").write_text("".join(kept))
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


@dataclass(frozen=True, kw_only=True)
class Shift:
    """One run of a batch, or a part of one.

    kill_after  share of the stages after which a worker is killed; none: nobody is
    limit_s     after which it is interrupted; the next run goes on
    """

    recordings: Path
    out: Path
    workers: int
    kill_after: float | None
    limit_s: float

    def run(self) -> bool:
        """Run it, add its seconds to those of earlier parts; return whether it came to its end."""
        command = [sys.executable, "-m", "piezoid_cli.main", "batch", str(self.recordings)]
        options = ["--out", str(self.out), "--workers", str(self.workers), "--quiet"]
        began, before = time.perf_counter(), _children(os.times())
        killed = self._notes.get("killed", 0)
        process = subprocess.Popen([*command, *options])
        while process.poll() is None and time.perf_counter() - began < self.limit_s:
            time.sleep(0.1)
            if self._is_time_to_kill(killed):
                killed = self._done
                os.kill(worker_of(process.pid), signal.SIGKILL)
        ended = process.poll() is not None
        if not ended:
            process.send_signal(signal.SIGINT)
            process.wait()
        notes = {
            "seconds": self._notes.get("seconds", 0.0) + time.perf_counter() - began,
            "cpu": self._notes.get("cpu", 0.0) + _children(os.times()) - before,
            "parts": self._notes.get("parts", 0) + 1,
            "killed": killed,
        }
        self._place.write_text(json.dumps(notes))
        return ended

    @property
    def said(self) -> str:
        """What is known of it so far."""
        notes = self._notes
        killed = f", a worker killed after {notes['killed']} stages" if notes["killed"] else ""
        return (
            f"{self.workers} workers: {notes['seconds']:.1f} s, processors {notes['cpu']:.0f} s, "
            f"in {notes['parts']} parts{killed}; {self._done} stages written; load "
            f"{os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"
        )

    def _is_time_to_kill(self, killed: int) -> bool:
        if self.kill_after is None or killed:
            return False
        return self._done >= self.kill_after * len(list(self.recordings.iterdir()))

    @property
    def _done(self) -> int:
        return len(list(self.out.glob("stages/*")))

    @property
    def _place(self) -> Path:
        return self.out.with_suffix(".json")

    @property
    def _notes(self) -> dict[str, Any]:
        notes: dict[str, Any] = json.loads(self._place.read_text()) if self._place.exists() else {}
        return notes


def _children(used: os.times_result) -> float:
    return used.children_user + used.children_system


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


def same_models(one: Path, other: Path) -> str:
    """Count the models that two runs made alike, to the last bit."""
    places = [place.name for place in sorted((one / "stages").iterdir())]
    pairs = [
        tuple(run / "stages" / name / "model.json" for run in (one, other)) for name in places
    ]
    held = [(a, b) for a, b in pairs if a.exists() or b.exists()]
    same = sum(a.exists() and b.exists() and a.read_bytes() == b.read_bytes() for a, b in held)
    return f"{same} of {len(held)} models are the same bytes after the kill"


def main() -> None:
    """Make the night, run it twice, print the figures."""
    asked = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    asked.add_argument("folder", type=Path)
    asked.add_argument("--stages", type=int, default=200)
    asked.add_argument("--without-controllers", action="store_true")
    asked.add_argument("--minutes", type=float, default=float("inf"))
    asked.add_argument("--runs", nargs="+", choices=list(RUNS), default=list(RUNS))
    options = asked.parse_args()
    recordings = options.folder / "night"
    night(recordings, options.stages, controllers=not options.without_controllers)
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
        ended = shift.run()
        print(f"{name}: {shift.said}", flush=True)
        if not ended:
            return
        print(f"{name}: {told(out)}", flush=True)
    if all((options.folder / name / "summary.html").exists() for name in RUNS):
        print(same_models(options.folder / "one", options.folder / "killed"))


if __name__ == "__main__":
    main()
