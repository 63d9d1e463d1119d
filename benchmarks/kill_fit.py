"""Kill `piezoid fit` at random moments: the folder of results is the old one or the new one.

    python -m benchmarks.kill_fit [--kills 20] [--writes 200] [--seed 9] [--seconds 420]

Whole runs are killed at moments drawn over the processor time of a run, so that a busy
machine moves none of them. Nearly all of a run is arithmetic, so a second series aims at the disk:
runs that hold the finished calibration of a first one are killed while they put it in place, half
of them over an older folder. Another seed draws other moments.
What was seen is kept in build/kill_fit/, from which a series that was cut off by ``--seconds`` is
continued. The code must not change meanwhile: a whole folder with other bytes is counted apart, as
broken; removing build/kill_fit/ starts anew.
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

KEPT = Path(__file__).parents[1] / "build" / "kill_fit"
OLD = {"model.json": b"old", "bundle/a.h": b"old"}
FIT = (sys.executable, "-m", "piezoid_cli.main", "fit", "--quiet")
Run = Callable[[Path, int, float], Counter[str]]
WRONG = ("BROKEN", "LOST", "WHOLE, BUT OTHER BYTES")


def recording(place: Path) -> None:
    """Write a small loop with hysteresis and a bend."""
    u = 5 * (1 - np.cos(2 * np.pi * np.arange(600) / 150))
    late = np.concatenate([np.repeat(u[:1], 4), u[:-4]])
    y = 2 * (u + 0.05 * late) + 0.2 * np.tanh(late - 5)
    rows = (f"{k / 500:.3f},{a:.5f},{b:.5f}\n" for k, (a, b) in enumerate(zip(u, y, strict=True)))
    place.write_text("time [s],voltage [V],pos [um]\n" + "".join(rows))


def held(folder: Path) -> dict[str, bytes]:
    """Return every file below a folder, but for the manifest of a folder of results."""
    places = (p for p in folder.rglob("*") if p.is_file() and p.name != MANIFEST)
    return {place.relative_to(folder).as_posix(): place.read_bytes() for place in places}


def sight(folder: Path, new: dict[str, bytes], *, stood: bool) -> str:
    """Say what a killed run left: ``old``, ``new``, ``nothing``, or what is wrong with it.

    stood  whether an older folder was there
    """
    if not folder.exists():
        return "LOST" if stood else "nothing"
    found = held(folder)
    if stood and found == OLD:
        return "old"
    if found == new:
        return "new"
    return "WHOLE, BUT OTHER BYTES" if is_whole(found, new) else "BROKEN"


def is_whole(found: dict[str, bytes], new: dict[str, bytes]) -> bool:
    """Tell whether every file is there, and every sealed one is whole."""
    try:
        for name in found:
            if name.endswith(".json"):
                unseal(found[name], json.loads(found[name])["schema"], name)
    except (PiezoidError, ValueError):
        return False
    return found.keys() == new.keys()


def worked_s(process: "subprocess.Popen[bytes]") -> float:
    """Return the processor time a process has used."""
    fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def killed_after(process: "subprocess.Popen[bytes]", moment_s: float) -> None:
    """Kill a process once it has worked so long; one that ends before is left alone."""
    while process.poll() is None:
        left_s = moment_s - worked_s(process)
        if left_s <= 0.0:
            process.kill()
        time.sleep(max(0.5 * left_s, 0.002))  # it cannot work faster than time goes by


def first_run(place: Path) -> tuple[float, dict[str, bytes]]:
    """Return how long a run works that is left alone, and what it writes; once for all series."""
    length = place / "length_s"
    if not length.exists():
        recording(place / "s.csv")
        shutil.rmtree(place / "known", ignore_errors=True)
        before = os.times()
        done = subprocess.run(
            [*FIT, str(place / "s.csv"), "--out", str(place / "known")], check=False
        )
        after = os.times()
        assert done.returncode in (0, 1), "the run that was left alone failed"  # 1: a verdict
        length.write_text(f"{sum(after[2:4]) - sum(before[2:4])}\n")
    new = held(place / "known")
    assert "model.json" in new, "the run that was left alone wrote nothing"
    return float(length.read_text()), new


def whole_run(place: Path, k: int, moment: float) -> Counter[str]:
    """Kill the program as it is after a share of its work."""
    length_s, new = first_run(place)
    folder, stood = laid_out(place / "whole", k)
    process = subprocess.Popen([*FIT, str(place / "s.csv"), "--out", str(folder), "--force"])
    killed_after(process, 1.05 * moment * length_s)
    return Counter([sight(folder, new, stood=stood)]) + Counter(
        {"ended before": int(process.returncode != -signal.SIGKILL)}
    )


def writing_run(place: Path, k: int, moment: float) -> Counter[str]:
    """Kill a child that has the calibration already, at a share of the time of its writing."""
    _, new = first_run(place)
    whole_s = writing_alone_s(place)
    folder, stood = laid_out(place / "write", k)
    written_s(folder, place, 1.2 * moment * whole_s)
    remains = len(list(folder.parent.glob(".stage.*")))
    return Counter([sight(folder, new, stood=stood)]) + Counter({"remains of the killed": remains})


def laid_out(place: Path, k: int) -> tuple[Path, bool]:
    """Return where a run is to write, and whether an older folder stands there: in every other."""
    folder, stood = place / "stage", k % 2 == 0
    shutil.rmtree(folder, ignore_errors=True)
    if stood:
        write_folder(folder, OLD)
    return folder, stood


@cache
def writing_alone_s(place: Path) -> float:
    """Calibrate once for all children to come, and return how long one of them writes."""
    from piezoid_cli import calibration

    found = calibration.calibrate([place / "s.csv"], None, lambda _: None)
    assert dict(found.files) == first_run(place)[1], "the same recording gave other bytes"
    calibration.calibrate = lambda *_: found
    return written_s(place / "alone" / "stage", place, None)


def written_s(folder: Path, place: Path, until_s: float | None) -> float:
    """Let a child write, until it is killed; return how long that took."""
    from piezoid_cli.fit import fit

    began = time.perf_counter()
    child = os.fork()
    if child == 0:
        try:
            fit([place / "s.csv"], folder, force=True, quiet=True)
        finally:
            os._exit(0)
    if until_s is not None:
        time.sleep(until_s)
        os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return time.perf_counter() - began


def series(what: str, one: Run, count: int, seed: int, until: float) -> Counter[str]:
    """Go on with a series, and return what was seen of it so far; print it."""
    kept = KEPT / f"{what} {seed}.json"
    seen = Counter(json.loads(kept.read_text()) if kept.exists() else {})
    while seen["killed"] < count and time.monotonic() < until:
        k = seen["killed"]
        seen.update(one(KEPT, k, float(np.random.default_rng([seed, k]).random())))
        seen["killed"] += 1
        kept.write_text(json.dumps(seen))
    print(f"{what}: of {count} killed {seen['killed']}, left: {dict(sorted(seen.items()))}")
    return seen


def main() -> None:
    """Print what was left; end with status 1 where anything was broken."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--writes", type=int, default=200)
    parser.add_argument("--seed", type=int, default=9)
    parser.add_argument("--seconds", type=float, default=420.0)
    asked = parser.parse_args()
    until = time.monotonic() + asked.seconds
    KEPT.mkdir(parents=True, exist_ok=True)
    seen = series("whole runs", whole_run, asked.kills, asked.seed, until)
    seen = seen + series("while writing", writing_run, asked.writes, asked.seed, until)
    sys.exit(int(any(seen[wrong] for wrong in WRONG)))


if __name__ == "__main__":
    main()
