"""Kill `piezoid fit` at random moments: the output folder must be the old or the new version.

    python -m benchmarks.kill_fit [--kills 20] [--writes 200] [--seed 9] [--seconds 420]

The first series kills whole runs after a random share of their processor time, so that the load
of the machine does not shift the moments. A run writes only at its end. The second series
therefore kills processes that received a finished calibration while they write it. Every other
run replaces an older folder.

The counts are stored in build/kill_fit/. A series that ``--seconds`` interrupts continues from
there. The code must not change in between: a complete folder with different bytes counts as a
failure. Delete build/kill_fit/ to start again.
"""

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

from piezoid.digests import unseal
from piezoid.errors import PiezoidError
from piezoid.manifest import MANIFEST
from piezoid.output_folder import write_folder

WORK_FOLDER = Path(__file__).parents[1] / "build" / "kill_fit"
OLD = {"model.json": b"old", "bundle/a.h": b"old"}
FIT = (sys.executable, "-m", "piezoid_cli.main", "fit", "--quiet")
Run = Callable[[Path, int, float], Counter[str]]
FAILURES = ("BROKEN", "LOST", "WHOLE, BUT OTHER BYTES")


def write_recording(path: Path) -> None:
    """Write a short recording of a hysteresis loop with a bend."""
    voltage = 5 * (1 - np.cos(2 * np.pi * np.arange(600) / 150))
    delayed = np.concatenate([np.repeat(voltage[:1], 4), voltage[:-4]])
    position = 2 * (voltage + 0.05 * delayed) + 0.2 * np.tanh(delayed - 5)
    rows = (
        f"{k / 500:.3f},{u:.5f},{y:.5f}\n"
        for k, (u, y) in enumerate(zip(voltage, position, strict=True))
    )
    path.write_text("time [s],voltage [V],pos [um]\n" + "".join(rows))


def folder_contents(folder: Path) -> dict[str, bytes]:
    """Read all files below a folder except the manifest."""
    files = (p for p in folder.rglob("*") if p.is_file() and p.name != MANIFEST)
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def folder_state(folder: Path, new: dict[str, bytes], *, has_old: bool) -> str:
    """Classify the folder after a kill as ``old``, ``new``, ``nothing`` or one of FAILURES.

    has_old  whether the run replaces an older folder
    """
    if not folder.exists():
        return "LOST" if has_old else "nothing"
    contents = folder_contents(folder)
    if has_old and contents == OLD:
        return "old"
    if contents == new:
        return "new"
    try:
        for name, content in contents.items():
            if name.endswith(".json"):
                unseal(content, json.loads(content)["schema"], name)
    except (PiezoidError, ValueError):
        return "BROKEN"
    return "WHOLE, BUT OTHER BYTES" if contents.keys() == new.keys() else "BROKEN"


def processor_time_s(process: "subprocess.Popen[bytes]") -> float:
    """Read the processor time of a running process."""
    fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def kill_after(process: "subprocess.Popen[bytes]", moment_s: float) -> None:
    """Kill a process at the given processor time, unless it ends earlier."""
    while process.poll() is None:
        remaining_s = moment_s - processor_time_s(process)
        if remaining_s <= 0.0:
            process.kill()
        time.sleep(max(0.5 * remaining_s, 0.002))  # processor time grows no faster than the clock


def reference_run(work: Path) -> tuple[float, dict[str, bytes]]:
    """Return processor time and output of an uninterrupted run; all series share it."""
    duration = work / "length_s"
    if not duration.exists():
        write_recording(work / "s.csv")
        shutil.rmtree(work / "known", ignore_errors=True)
        start = os.times()
        process = subprocess.run(
            [*FIT, str(work / "s.csv"), "--out", str(work / "known")], check=False
        )
        end = os.times()
        assert process.returncode in (0, 1), "the reference run failed"  # 1: a failed verdict
        duration.write_text(f"{sum(end[2:4]) - sum(start[2:4])}\n")
    output = folder_contents(work / "known")
    assert "model.json" in output, "the reference run wrote nothing"
    return float(duration.read_text()), output


def kill_whole_run(work: Path, k: int, moment: float) -> Counter[str]:
    """Kill the command line after a share of its processor time."""
    duration_s, new = reference_run(work)
    folder, has_old = prepare_folder(work / "whole", k)
    process = subprocess.Popen([*FIT, str(work / "s.csv"), "--out", str(folder), "--force"])
    kill_after(process, 1.05 * moment * duration_s)
    return Counter([folder_state(folder, new, has_old=has_old)]) + Counter(
        {"ended before": int(process.returncode != -signal.SIGKILL)}
    )


def kill_while_writing(work: Path, k: int, moment: float) -> Counter[str]:
    """Kill a process after a share of the time that it needs to write a calibration."""
    _, new = reference_run(work)
    duration_s = writing_duration_s(work)
    folder, has_old = prepare_folder(work / "write", k)
    write_in_child_s(folder, work, 1.2 * moment * duration_s)
    temporary = len(list(folder.parent.glob(".stage.*")))
    return Counter([folder_state(folder, new, has_old=has_old)]) + Counter(
        {"remains of the killed": temporary}
    )


def prepare_folder(work: Path, k: int) -> tuple[Path, bool]:
    """Return the output folder; every other run starts with an older version of it."""
    folder, has_old = work / "stage", k % 2 == 0
    shutil.rmtree(folder, ignore_errors=True)
    if has_old:
        write_folder(folder, OLD)
    return folder, has_old


@cache
def writing_duration_s(work: Path) -> float:
    """Calibrate once for all child processes; return the duration of writing."""
    from piezoid_cli import calibration

    result = calibration.calibrate([work / "s.csv"], None, lambda _: None)
    assert dict(result.files) == reference_run(work)[1], "the same recording gave other bytes"
    calibration.calibrate = lambda *_: result
    return write_in_child_s(work / "alone" / "stage", work, None)


def write_in_child_s(folder: Path, work: Path, kill_s: float | None) -> float:
    """Write the calibration in a child process; return the elapsed time.

    kill_s  time after which the child is killed, or None
    """
    from piezoid_cli.fit import fit

    start_s = time.perf_counter()
    child = os.fork()
    if child == 0:
        try:
            fit([work / "s.csv"], folder, force=True, quiet=True)
        finally:
            os._exit(0)
    if kill_s is not None:
        time.sleep(kill_s)
        os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return time.perf_counter() - start_s


def run_series(title: str, run: Run, count: int, seed: int, end_s: float) -> Counter[str]:
    """Continue a series until its count or the deadline; print and return its totals."""
    path = WORK_FOLDER / f"{title} {seed}.json"
    counts = Counter(json.loads(path.read_text()) if path.exists() else {})
    while counts["killed"] < count and time.monotonic() < end_s:
        k = counts["killed"]
        counts.update(run(WORK_FOLDER, k, float(np.random.default_rng([seed, k]).random())))
        counts["killed"] += 1
        path.write_text(json.dumps(counts))
    print(f"{title}: {counts['killed']} of {count} killed, result: {dict(sorted(counts.items()))}")
    return counts


def main() -> None:
    """Run both series; exit with status 1 after any failure."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--writes", type=int, default=200)
    parser.add_argument("--seed", type=int, default=9)
    parser.add_argument("--seconds", type=float, default=420.0)
    options = parser.parse_args()
    end_s = time.monotonic() + options.seconds
    WORK_FOLDER.mkdir(parents=True, exist_ok=True)
    counts = run_series("whole runs", kill_whole_run, options.kills, options.seed, end_s)
    counts += run_series("while writing", kill_while_writing, options.writes, options.seed, end_s)
    sys.exit(int(any(counts[failure] for failure in FAILURES)))


if __name__ == "__main__":
    main()
