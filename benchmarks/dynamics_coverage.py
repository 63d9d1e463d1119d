"""Coverage of the 95 % intervals of mode, damping and delay behind hysteresis.

    python -m benchmarks.dynamics_coverage STORE [DRAWS, default 100] [FIRST SEED, default 0]

Every draw is a stage of the virtual laboratory with a Preisach, Bouc-Wen or wall-pinning ceramic,
none of which is a sum of plays. It has one mode of 250 to 1200 Hz with a damping of 1 to 6 %, a
delay of 20 to 300 us and coloured noise. The recordings are a sweep and a chirp over a tenth of
the range. The operator is fitted to the sweep, then the dynamics, then both jointly. A draw
without a mode counts as a miss of all three intervals.

STORE contains one line of JSON per draw. A later run adds the missing seeds.
"""

import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.recordings import recording_of
from benchmarks.zoo.command_line import read_rows
from piezoid.identification.dynamics.axis_dynamics import with_dynamics
from piezoid.identification.dynamics.modal import NORMAL_95, LinearDynamics
from piezoid.identification.hysteresis.estimate import estimate_axis
from piezoid.identification.hysteresis.pieces import PieceStart
from piezoid.identification.hysteresis.pieces import Rig as Declared
from piezoid.identification.model import AxisModel
from piezoid.records.recording import Recording
from piezoid_datasets.virtual_lab import drives
from piezoid_datasets.virtual_lab.effects.effect import Act, Place
from piezoid_datasets.virtual_lab.rig import draw_rig
from piezoid_datasets.virtual_lab.signals import second_order, shifted
from piezoid_datasets.virtual_lab.stage import FINER, Run, Stage, record
from piezoid_datasets.virtual_lab.truths import TRUTHS

SWEEP_Hz = 250.0
HIGHEST_Hz = 2000.0
NAMES = ("frequency", "damping", "delay")


def draw(seed: int) -> tuple[Stage, tuple[float, float, float]]:
    """Return a stage, and the frequency and damping of its mode and its delay.

    The laboratory interpolates linearly between its instants. Behind the lag of the amplifier this
    delays by h^2 / (12 T), here 0.33 us, which is included in the delay.
    """
    rng = np.random.default_rng([seed, 404])
    frequency_Hz = float(np.exp(rng.uniform(*np.log([250.0, 1200.0]))))
    damping, delay_s = float(rng.uniform(0.01, 0.06)), float(rng.uniform(20e-6, 300e-6))
    acts = (
        Act(
            name="mode",
            place=Place.MECHANICS,
            change=lambda m, scene, _: second_order(m, frequency_Hz, damping, scene.rate_Hz),
        ),
        Act(
            name="delay",
            place=Place.SENSOR,
            change=lambda m, scene, _: shifted(m, delay_s, scene.rate_Hz),
        ),
    )
    truth = TRUTHS[seed % len(TRUTHS)]
    stage = Stage(rig=draw_rig(rng), ceramic=truth.draw(rng), acts=acts, seed=seed)
    grid_s = 2.0 * np.pi * stage.rig.amplifier_bandwidth_Hz / (FINER * stage.rig.clock_Hz) ** 2
    return stage, (frequency_Hz, damping, delay_s + grid_s / 12.0)


def recordings(stage: Stage) -> list[Recording]:
    """Record a slow sweep and a chirp through the mode."""
    rig = stage.rig
    shapes = {
        "sweep": (SWEEP_Hz, drives.decaying_sweep(SWEEP_Hz, 1.0, 12)),
        "chirp": (rig.clock_Hz, drives.chirp(rig.clock_Hz, 5.0, HIGHEST_Hz, 2.0, 0.1)),
    }
    span_V = 0.5 * (rig.drive_max_V - rig.drive_min_V)
    runs = [
        Run(
            name=name,
            sampling_rate_Hz=rate_Hz,
            command_V=rig.drive_min_V + span_V * (shape + 1.0),
            history_V=np.array([rig.drive_max_V, rig.drive_min_V] * 2),
        )
        for name, (rate_Hz, shape) in shapes.items()
    ]
    return [
        recording_of(rows.voltage_V, rows.displacement_m, run.sampling_rate_Hz, run.name)
        for run, rows in ((run, record(stage, run, order)) for order, run in enumerate(runs))
    ]


def fit_stage(stage: Stage) -> AxisModel:
    """Fit the axis with a joint fit; the cycles before the chirp determine its memory."""
    sweep, chirp = recordings(stage)
    rig = Declared(
        amplifier_bandwidth_Hz=stage.rig.amplifier_bandwidth_Hz,
        sensor_bandwidth_Hz=stage.rig.sensor_bandwidth_Hz,
    )
    axis = estimate_axis([sweep], "x", rig, orders=((8, 2),))
    turns_V = np.array([stage.rig.drive_max_V, stage.rig.drive_min_V] * 2)
    _, memory_V = axis.hysteresis.run(turns_V, axis.virgin_memory_V)
    start = PieceStart(
        recording="chirp", memory_V=memory_V, zero_m=np.zeros(1), first=0, last=chirp.samples
    )
    return with_dynamics(replace(axis, starts=(*axis.starts, start)), [sweep, chirp])


def coverage(
    dynamics: LinearDynamics, truth: tuple[float, float, float]
) -> list[tuple[bool, float]]:
    """Return whether each interval contains the truth, and the error over its half-width."""
    mode = int(np.abs(dynamics.mode_gain_m_per_V).argmax())
    intervals = (
        dynamics.mode_frequency_interval_Hz()[mode],
        dynamics.mode_damping_interval()[mode],
        dynamics.delay_interval_s(),
    )
    values = (
        dynamics.mode_frequency_Hz[mode],
        dynamics.mode_damping[mode],
        dynamics.delay_s,
    )
    return [
        (bool(low <= true <= high), float((value - true) / (0.5 * (high - low))))
        for (low, high), value, true in zip(intervals, values, truth, strict=True)
    ]


def evaluate(seed: int) -> dict[str, Any]:
    """Return the line of one draw in the store."""
    stage, truth = draw(seed)
    start_s = time.process_time()
    dynamics = fit_stage(stage).dynamics
    elapsed_s = time.process_time() - start_s
    intervals = [] if dynamics is None else coverage(dynamics, truth)
    return {
        "seed": seed,
        "truth": truth,
        "ceramic": seed % len(TRUTHS),
        "processor_s": round(elapsed_s, 2),
        "inside": [is_covered for is_covered, _ in intervals],
        "over_half": [error for _, error in intervals],
    }


def main() -> None:
    """Run the draws that the store lacks, and print the coverage."""
    draws, first = (int(a) for a in (*sys.argv[2:], *("100", "0")[len(sys.argv) - 2 :]))
    store = Path(sys.argv[1])
    rows = {row["seed"]: row for row in read_rows(store)}
    for seed in range(first, first + draws):
        if seed not in rows:
            rows[seed] = evaluate(seed)
            with store.open("a", encoding="utf-8") as file:
                file.write(json.dumps(rows[seed]) + "\n")
    requested = [rows[seed] for seed in range(first, first + draws)]
    with_mode = [row for row in requested if row["inside"]]
    for index, name in enumerate(NAMES):
        covered = sum(row["inside"][index] for row in with_mode)
        spread = np.sqrt(np.mean([row["over_half"][index] ** 2 for row in with_mode])) * NORMAL_95
        print(
            f"{name}: {covered} of {draws} intervals hold the truth; "
            f"errors are {spread:.2f} standard deviations rms"
        )
    print(f"{len(with_mode)} of {draws} draws determined a mode")
    print(f"{sum(row['processor_s'] for row in requested) / 60:.1f} minutes of processor time")


if __name__ == "__main__":
    main()
