"""Compare the files of `piezoid fit` with several numbers of threads and of processes.

    python -m benchmarks.same_bytes [THREADS]

All files of the output folder must be identical. The bundled axes Y and Z are two jobs for two
processes. Several threads of linear algebra would change the last digits. `piezoid` therefore uses
one thread, whatever the environment requests.
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


def fit_files(threads: int, processes: int, out: Path) -> dict[str, bytes]:
    """Run `piezoid fit` and return the files that it writes."""
    inputs = [*(DATASETS / name for name in FILES), "--lab", DATASETS / "lab.toml"]
    options = ["--processes", processes, "--out", out, "--quiet"]
    process = subprocess.run(
        [sys.executable, "-m", "piezoid_cli.main", "fit", *map(str, [*inputs, *options])],
        env=os.environ | dict.fromkeys(THREADS, str(threads)),
        check=False,
    )
    if process.returncode not in (0, 1):  # 1: a failed verdict
        sys.exit(process.returncode)
    return {
        str(file.relative_to(out)): file.read_bytes()
        for file in sorted(out.rglob("*"))
        if file.is_file()
    }


def main() -> int:
    several = int(sys.argv[1]) if len(sys.argv) > 1 else 2
    runs = []
    with TemporaryDirectory() as folder:
        for threads, processes in ((1, 1), (several, 1), (1, 2), (several, 2)):
            start_s = time.perf_counter()
            runs.append(fit_files(threads, processes, Path(folder) / f"{threads}_{processes}"))
            digest = hashlib.sha256(b"".join(runs[-1].values())).hexdigest()[:16]
            elapsed_s = time.perf_counter() - start_s
            print(
                f"{threads} threads, {processes} processes: {digest}, {elapsed_s:.1f} s",
                flush=True,
            )
    different = {name for files in runs for name in files if files[name] != runs[0].get(name)}
    print(f"other bytes in {', '.join(sorted(different))}" if different else "the same bytes")
    return int(bool(different))


if __name__ == "__main__":
    sys.exit(main())
