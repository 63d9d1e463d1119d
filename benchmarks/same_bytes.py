"""Fit bundled recordings with one and with several threads of linear algebra: the same bytes?

    python -m benchmarks.same_bytes [THREADS]

Each fit runs in a process of its own, because the library reads the number when it is loaded.
"""

import hashlib
import os
import subprocess
import sys
import time
from pathlib import Path

DATASETS = Path(__file__).parents[1] / "datasets"
FILES = ("y_sweep.csv", "y_check.csv")
PROGRAMME = """
import sys
from pathlib import Path
from piezoid.identification.fit import fit
from piezoid.identification.store import write_model
from piezoid.records.ingest import ingest_all
from piezoid.records.lab import read_lab
folder = Path(sys.argv[1])
lab = read_lab(folder / "lab.toml")
recordings = ingest_all([folder / name for name in sys.argv[2:]], lab)
sys.stdout.buffer.write(write_model(fit(recordings, lab=lab)))
"""


def model_json(threads: int) -> bytes:
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
    done = subprocess.run(
        [sys.executable, "-c", PROGRAMME, str(DATASETS), *FILES],
        env=os.environ | dict.fromkeys(names, str(threads)),
        capture_output=True,
        check=True,
    )
    return done.stdout


def main() -> int:
    found = []
    for threads in (1, int(sys.argv[1]) if len(sys.argv) > 1 else 2):
        began_s = time.perf_counter()
        content = model_json(threads)
        found.append(content)
        digest = hashlib.sha256(content).hexdigest()[:16]
        print(f"{threads} threads: {digest}, {time.perf_counter() - began_s:.1f} s")
    print("the same bytes" if found[0] == found[1] else "other bytes")
    return int(found[0] != found[1])


if __name__ == "__main__":
    sys.exit(main())
