"""How often the 95 % intervals of mode, damping and delay hold the truth, hysteresis present.

    python benchmarks/dynamics_coverage.py STORE [DRAWS, default 100] [FIRST SEED, default 0]

Every draw is a stage of the virtual laboratory: a ceramic (Preisach, Bouc-Wen or wall pinning;
none is a sum of plays), one mode of 250 to 1200 Hz with a damping of 1 to 6 %, a delay of 20 to
300 us, coloured noise. A lab records a sweep for the hysteresis and a chirp of a tenth of the
range; the operator is fitted to the sweep, the dynamics behind
it are found, and both are fitted jointly. A draw that finds no mode counts against all three.

STORE keeps one line of JSON per draw: started again, only the seeds it does not hold are run.
"""

import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from piezoid.identification.dynamics.axis_dynamics import with_dynamics
from piezoid.identification.dynamics.modal import NORMAL_95, LinearDynamics
from piezoid.identification.hysteresis.estimate import estimate_axis
from piezoid.identification.hysteresis.pieces import PieceStart
from piezoid.identification.hysteresis.pieces import Rig as Declared
from piezoid.identification.model import AxisModel
from piezoid.records.recording import Channel, Quantity, Recording
from piezoid_datasets.virtual_lab import drives
from piezoid_datasets.virtual_lab.effects.effect import Act, Place
from piezoid_datasets.virtual_lab.rig import draw_rig
from piezoid_datasets.virtual_lab.signals import second_order, shifted
from piezoid_datasets.virtual_lab.stage import FINER, Rows, Run, Stage, record
from piezoid_datasets.virtual_lab.truths import TRUTHS

SWEEP_Hz = 250.0
HIGHEST_Hz = 2000.0
NAMES = ("frequency", "damping", "delay")


def draw(seed: int) -> tuple[Stage, tuple[float, float, float]]:
    """Return a stage and its mode's frequency, its damping, and the delay.

    The laboratory joins its instants by straight lines. Under the amplifier's exponentials these
    lag by h^2 / (12 T), 0.33 us here, which no fit could tell from the delay and counts to it.
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
    return [_recording(record(stage, run, order)) for order, run in enumerate(runs)]


def _recording(rows: Rows) -> Recording:
    values = ((Quantity.VOLTAGE, rows.voltage_V), (Quantity.DISPLACEMENT, rows.displacement_m))
    return Recording(
        name=rows.run.name,
        digest="",
        axis="x",
        sampling_rate_Hz=rows.run.sampling_rate_Hz,
        channels=tuple(Channel(quantity=q, axis="x", values=v, label=q.name) for q, v in values),
    )


def found_in(stage: Stage) -> LinearDynamics | None:
    """Return the dynamics of a stage, None where none were found."""
    return fitted(stage).dynamics


def fitted(stage: Stage) -> AxisModel:
    """Return the axis, joint fit included; the chirp's memory is that of the cycles before it."""
    held = recordings(stage)
    rig = Declared(
        amplifier_bandwidth_Hz=stage.rig.amplifier_bandwidth_Hz,
        sensor_bandwidth_Hz=stage.rig.sensor_bandwidth_Hz,
    )
    axis = estimate_axis(held[:1], "x", rig, orders=((8, 2),))
    turns_V = np.array([stage.rig.drive_max_V, stage.rig.drive_min_V] * 2)
    _, memory_V = axis.hysteresis.run(turns_V, axis.virgin_memory_V)
    start = PieceStart(
        recording="chirp", memory_V=memory_V, zero_m=np.zeros(1), first=0, last=held[1].samples
    )
    return with_dynamics(replace(axis, starts=(*axis.starts, start)), held)


def judged(
    dynamics: LinearDynamics, truth: tuple[float, float, float]
) -> list[tuple[bool, float]]:
    """Return whether each interval holds the truth, and the error over half the interval."""
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


def told(seed: int) -> dict[str, Any]:
    """Return what one draw shows, as a line of the store."""
    stage, truth = draw(seed)
    began = time.process_time()
    dynamics = found_in(stage)
    record: dict[str, Any] = {"seed": seed, "truth": truth, "ceramic": seed % len(TRUTHS)}
    record["processor_s"] = round(time.process_time() - began, 2)
    verdicts = [] if dynamics is None else judged(dynamics, truth)
    return {**record, "inside": [a for a, _ in verdicts], "over_half": [e for _, e in verdicts]}


def main() -> None:
    """Run the draws the store does not hold, and print the share of intervals that hold."""
    draws, first = (int(a) for a in (*sys.argv[2:], *("100", "0")[len(sys.argv) - 2 :]))
    store = Path(sys.argv[1])
    text = store.read_text(encoding="utf-8") if store.exists() else ""
    held = {line["seed"]: line for line in map(json.loads, text.splitlines())}
    for seed in range(first, first + draws):
        if seed not in held:
            held[seed] = told(seed)
            with store.open("a", encoding="utf-8") as file:
                file.write(json.dumps(held[seed]) + "\n")
    lines = [held[seed] for seed in range(first, first + draws)]
    found = [line for line in lines if line["inside"]]
    for place, name in enumerate(NAMES):
        inside = sum(line["inside"][place] for line in found)
        spread = np.sqrt(np.mean([line["over_half"][place] ** 2 for line in found])) * NORMAL_95
        print(
            f"{name}: {inside} of {draws} intervals hold the truth; "
            f"errors are {spread:.2f} standard deviations rms"
        )
    print(f"{len(found)} of {draws} draws determined a mode")
    print(f"{sum(line['processor_s'] for line in lines) / 60:.1f} minutes of processor")


if __name__ == "__main__":
    main()
