"""Kill `piezoid fit` at random moments: the folder of results is the old one or the new one.

    python -m benchmarks.kill_fit [KILLS [WRITES [SEED]]]

KILLS whole runs are killed at moments drawn over the processor time of a run, so that a busy
machine moves none of them. Nearly all of a run is arithmetic, so a second series aims at the disk:
WRITES runs hold the finished calibration of a first one, and are killed while they put it in
place, half of them over an older folder. Another SEED draws other moments.
The code must not change meanwhile: a whole folder with other bytes is counted apart, as broken.
"""

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

from piezoid.errors import PiezoidError
from piezoid.provenance import unseal

OLD = {"model.json": b"old", "bundle/a.h": b"old"}


def recording(place: Path) -> None:
    """Write a small loop with hysteresis and a bend."""
    u = 5 * (1 - np.cos(2 * np.pi * np.arange(600) / 150))
    late = np.concatenate([np.repeat(u[:1], 4), u[:-4]])
    y = 2 * (u + 0.05 * late) + 0.2 * np.tanh(late - 5)
    rows = (f"{k / 500:.3f},{a:.5f},{b:.5f}\n" for k, (a, b) in enumerate(zip(u, y, strict=True)))
    place.write_text("time [s],voltage [V],pos [um]\n" + "".join(rows))


def held(folder: Path) -> dict[str, bytes]:
    """Return every file below a folder."""
    places = (place for place in folder.rglob("*") if place.is_file())
    return {place.relative_to(folder).as_posix(): place.read_bytes() for place in places}


def put(folder: Path, contents: dict[str, bytes]) -> None:
    """Write files without any care."""
    for name, content in contents.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)


def sight(folder: Path, new: dict[str, bytes]) -> str:
    """Say what a killed run left: ``old``, ``new``, ``nothing``, or what is wrong with it."""
    if not folder.exists():
        return "nothing"
    found = held(folder)
    if found == OLD:
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
        if worked_s(process) >= moment_s:
            process.kill()
        time.sleep(0.002)


def whole_runs(place: Path, kills: int, rng: np.random.Generator) -> Counter[str]:
    """Kill the program as it is; the first run, left alone, says how long one takes."""
    fit = [sys.executable, "-m", "piezoid_cli.main", "fit", str(place / "s.csv"), "--quiet"]
    before = os.times()
    subprocess.run([*fit, "--out", str(place / "known")], check=False)
    after = os.times()
    length_s = sum(after[2:4]) - sum(before[2:4])
    new = held(place / "known")
    assert "model.json" in new, "the run that was left alone wrote nothing"
    print(f"a run works for {length_s:.1f} s and writes {len(new)} files", flush=True)
    seen: Counter[str] = Counter()
    for k in range(kills):
        folder = place / f"whole{k}" / "stage"
        put(folder, OLD)
        process = subprocess.Popen([*fit, "--out", str(folder), "--force"])
        killed_after(process, rng.uniform(0, 1.05 * length_s))
        seen[sight(folder, new)] += 1
        seen["ended before"] += process.returncode != -signal.SIGKILL
    return seen


def writing_runs(place: Path, kills: int, rng: np.random.Generator) -> Counter[str]:
    """Kill children that have the calibration already, at moments drawn over their writing."""
    from piezoid_cli import calibration
    from piezoid_cli.fit import fit

    new = held(place / "known")
    found = calibration.calibrate([place / "s.csv"], None, lambda _: None)
    assert dict(found.files) == new, "the same recording gave other bytes"
    calibration.calibrate = lambda *_: found
    seen: Counter[str] = Counter()
    length_s = 0.0
    for k in range(kills + 1):
        folder = place / f"write{k % 2}" / "stage"
        if k % 2 == 0:
            put(folder, OLD)
        began = time.perf_counter()
        child = os.fork()
        if child == 0:
            try:
                fit([place / "s.csv"], folder, force=True, quiet=True)
            finally:
                os._exit(0)
        if length_s:
            time.sleep(rng.uniform(0, 1.2 * length_s))
            os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        length_s = length_s or time.perf_counter() - began
        if k:
            seen[sight(folder, new)] += 1
            seen["remains of the killed"] += len(list(folder.parent.glob(".stage.*")))
        subprocess.run(["rm", "-rf", str(folder)], check=True)
    return seen


def main() -> None:
    """Print what was left; end with status 1 where anything was broken."""
    kills = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    writes = int(sys.argv[2]) if len(sys.argv) > 2 else 10 * kills
    rng = np.random.default_rng(int(sys.argv[3]) if len(sys.argv) > 3 else 9)
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        recording(place / "s.csv")
        for what, series, count in (
            ("whole runs", whole_runs, kills),
            ("while writing", writing_runs, writes),
        ):
            seen = series(place, count, rng)
            print(f"{what}: {count} killed, left: {dict(sorted(seen.items()))}", flush=True)
            if seen["BROKEN"] + seen["WHOLE, BUT OTHER BYTES"]:
                sys.exit(1)


if __name__ == "__main__":
    main()
