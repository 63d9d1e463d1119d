"""How the bundled recordings were made; running it again makes the same bytes.

    python -m piezoid_datasets.virtual_lab.bundled FOLDER

One Preisach ceramic on one rig, creep of 0.3 % per decade, unknown turns before each record, and
nothing else hidden: what a good stage looks like.
"""

import sys
from pathlib import Path

import numpy as np

from piezoid_datasets.virtual_lab import drives
from piezoid_datasets.virtual_lab.effects import creep
from piezoid_datasets.virtual_lab.rig import Rig
from piezoid_datasets.virtual_lab.signals import Array
from piezoid_datasets.virtual_lab.stage import Run, Stage, record
from piezoid_datasets.virtual_lab.table import csv_text
from piezoid_datasets.virtual_lab.truths.preisach import draw_preisach

SEED = 517
RIG = Rig(name="piezoid bundled stage", stroke_m=33e-6, noise_rms_m=10e-9)
CREEP_PER_DECADE = 0.003


def stage() -> Stage:
    """Return the bench of the bundled recordings."""
    ceramic = draw_preisach(np.random.default_rng(SEED))
    acts = creep.creep_of(CREEP_PER_DECADE, 0.0).acts
    return Stage(rig=RIG, ceramic=ceramic, acts=acts, seed=SEED)


def runs() -> tuple[Run, ...]:
    """Return the plans: a sweep to fit, another kind of drive to check, several speeds."""
    rng = np.random.default_rng([SEED, 1])
    minor = (1.0, -0.2, 0.5, -0.7, 0.3, -1.0)
    sweep = np.concatenate(
        (
            drives.decaying_sweep(500.0, 1.0, 12),
            drives.nested_loops(500.0, 4.0, minor),
        )
    )
    return (
        _run("x_sweep", 500.0, sweep, history_V=(7.3, 1.2, 4.4, 0.0)),
        _run(
            "x_check",
            500.0,
            drives.random_levels(500.0, 0.4, 39, rng),
            history_V=(10.0, 0.0),
        ),
        _run(
            "x_rates",
            5e3,
            drives.rates(5e3, ((2.0, 2), (10.0, 5), (50.0, 20))),
            history_V=(9.1, 2.0, 6.0, 0.0),
        ),
    )


def rebuild() -> dict[str, bytes]:
    """Return the bundled files by name, made anew."""
    bench = stage()
    rows = [record(bench, run, order) for order, run in enumerate(runs())]
    return {f"{r.run.name}.csv": csv_text(r).encode() for r in rows}


def main(folder: Path) -> None:
    """Write the bundled files into a folder."""
    for name, content in rebuild().items():
        (folder / name).write_bytes(content)


def _run(name: str, rate_Hz: float, shape: Array, *, history_V: tuple[float, ...]) -> Run:
    command_V = RIG.drive_min_V + 0.5 * (shape + 1.0) * (RIG.drive_max_V - RIG.drive_min_V)
    return Run(
        name=name, sampling_rate_Hz=rate_Hz, command_V=command_V, history_V=np.array(history_V)
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
