"""Produce the bundled recordings, always with the same bytes.

    python -m piezoid_datasets.virtual_lab.bundled FOLDER

A scanner of three axes: X and Y are different Preisach ceramics with creep of 0.3 % per decade and
unknown turning points before each recording; Z holds a tunnelling tip over two spots. There are no
other effects: this is a good stage.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from piezoid_datasets.virtual_lab import drives
from piezoid_datasets.virtual_lab.effects.ceramic import creep_of
from piezoid_datasets.virtual_lab.effects.effect import Act
from piezoid_datasets.virtual_lab.junction_campaign import draw_junction_campaign
from piezoid_datasets.virtual_lab.plans import volts_of
from piezoid_datasets.virtual_lab.rig import Rig
from piezoid_datasets.virtual_lab.signals import Array
from piezoid_datasets.virtual_lab.stage import Run, Stage, record
from piezoid_datasets.virtual_lab.truths.return_point import draw_preisach
from piezoid_datasets.virtual_lab.write import csv_text

SEED, SEED_Y, SEED_Z = 517, 518, 7
RIG = Rig(name="piezoid bundled stage", stroke_m=33e-6, noise_rms_m=10e-9)
RIG_Y = replace(RIG, stroke_m=30e-6)
LOOP_s = 1.2
SPOTS = 2
CREEP_PER_DECADE = 0.003


def stage(rig: Rig = RIG, seed: int = SEED) -> Stage:
    """Return the stage of one lateral axis, by default X."""
    ceramic = draw_preisach(np.random.default_rng(seed))
    fault = creep_of(CREEP_PER_DECADE, 0.0)
    creep = Act(name="creep", place=fault.place, change=fault.change)
    return Stage(rig=rig, ceramic=ceramic, acts=(creep,), seed=seed)


def runs() -> tuple[Run, ...]:
    """Return the runs of X: a sweep for the fit, a different drive as a check, several speeds."""
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
    """Return the contents of the bundled files by name."""
    rng = np.random.default_rng([SEED_Y, 1])
    sweep = drives.decaying_sweep(500.0, 1.0, 12)
    check = drives.random_levels(500.0, 0.4, 20, rng)
    runs_y = (
        _run("y_sweep", 500.0, sweep, history_V=(6.1, 2.2, 5.0, 0.0)),
        _run("y_check", 500.0, check, history_V=(9.0, 0.0)),
    )
    x, y = stage(), stage(RIG_Y, SEED_Y)
    files = {
        f"{run.name}.csv": csv_text(record(x, run, order)).encode()
        for order, run in enumerate(runs())
    }
    files |= {
        f"{run.name}.csv": csv_text(record(y, run, order), axis="y").encode()
        for order, run in enumerate(runs_y)
    }
    # Closed loops of Z at the rate of the controller, without a time column, and a spectroscopy.
    campaign = draw_junction_campaign(SEED_Z, seconds=LOOP_s)
    for spot, loop in enumerate(campaign.records[:SPOTS]):
        columns = (loop.drive_V, 1e9 * loop.current_A, loop.reference_nepers)
        rows = zip(*(column.tolist() for column in columns), strict=True)
        lines = [f"{u:.7f},{i:.6f},{r:.6f}" for u, i, r in rows]
        text = "\n".join(("drive_z [V],current_z [nA],dither of ln set point", *lines)) + "\n"
        files[f"z_loop_{spot + 1}.csv"] = text.encode()
    return files | {"z_spectroscopy.dat": campaign.spectroscopy.text().encode()}


def main(folder: Path) -> None:
    """Write the bundled files into a folder."""
    for name, content in rebuild().items():
        (folder / name).write_bytes(content)


def _run(name: str, rate_Hz: float, shape: Array, *, history_V: tuple[float, ...]) -> Run:
    return Run(
        name=name,
        sampling_rate_Hz=rate_Hz,
        command_V=volts_of(RIG, shape),
        history_V=np.array(history_V),
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
