"""Fit bundled recordings with other numbers of threads and of processes: the same bytes?

    python -m benchmarks.same_bytes [THREADS]

Every file of the folder is compared. The bundled Y and Z are two jobs, so that two processes have
something to do. Several threads of linear algebra give other last digits, which is why `piezoid`
keeps to one, whatever number the environment asks for.
"""

import hashlib
import os
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

DATASETS = Path(__file__).parents[1] / "datasets"
FILES = ("y_sweep.csv", "y_check.csv", "z_loop_1.csv", "z_loop_2.csv", "z_spectroscopy.dat")
THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


def folder_of(threads: int, processes: int, place: Path) -> dict[str, bytes]:
    """Return what `piezoid fit` writes."""
    given = [*(DATASETS / name for name in FILES), "--lab", DATASETS / "lab.toml"]
    asked = ["--processes", processes, "--out", place, "--quiet"]
    done = subprocess.run(
        [sys.executable, "-m", "piezoid_cli.main", "fit", *map(str, [*given, *asked])],
        env=os.environ | dict.fromkeys(THREADS, str(threads)),
        check=False,
    )
    if done.returncode not in (0, 1):  # 1 is a verdict, which does not matter here
        sys.exit(done.returncode)
    return {
        str(file.relative_to(place)): file.read_bytes()
        for file in sorted(place.rglob("*"))
        if file.is_file()
    }


def main() -> int:
    several = int(sys.argv[1]) if len(sys.argv) > 1 else 2
    found = []
    with TemporaryDirectory() as folder:
        for threads, processes in ((1, 1), (several, 1), (1, 2), (several, 2)):
            began_s = time.perf_counter()
            held = folder_of(threads, processes, Path(folder) / f"{threads}_{processes}")
            found.append(held)
            digest = hashlib.sha256(b"".join(held.values())).hexdigest()[:16]
            took_s = time.perf_counter() - began_s
            print(
                f"{threads} threads, {processes} processes: {digest}, {took_s:.1f} s", flush=True
            )
    others = {name for held in found for name in held if held.get(name) != found[0].get(name)}
    print(f"other bytes in {', '.join(sorted(others))}" if others else "the same bytes")
    return int(bool(others))


if __name__ == "__main__":
    sys.exit(main())
