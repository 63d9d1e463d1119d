"""How often the 95 % intervals of mode, damping and delay hold the truth, hysteresis present.

    python benchmarks/dynamics_coverage.py [DRAWS, default 100] [FIRST SEED, default 0]

Every draw is a stage of the virtual laboratory: a ceramic (Preisach, Bouc-Wen or wall pinning;
none is a sum of plays), one mode of 250 to 1200 Hz with a damping of 1 to 6 %, a delay of 20 to
300 us, coloured noise. A lab records a sweep for the hysteresis and a chirp of a tenth of the
range; the operator is fitted to the sweep, the dynamics behind it are found, and both are fitted
jointly.
A draw takes about a minute of processor.
"""

import sys
from dataclasses import replace

import numpy as np

from piezoid.identification.dynamics.axis_dynamics import with_dynamics
from piezoid.identification.dynamics.modal import LinearDynamics
from piezoid.identification.hysteresis.estimate import estimate_axis
from piezoid.identification.hysteresis.pieces import Rig as Declared
from piezoid.identification.model import PieceStart
from piezoid.records.recording import Channel, Quantity, Recording
from piezoid_datasets.virtual_lab import drives
from piezoid_datasets.virtual_lab.effects.effect import Act, Place
from piezoid_datasets.virtual_lab.rig import draw_rig
from piezoid_datasets.virtual_lab.signals import second_order, shifted
from piezoid_datasets.virtual_lab.stage import Rows, Run, Stage, record
from piezoid_datasets.virtual_lab.truths import TRUTHS

HIGHEST_Hz = 2000.0
NAMES = ("frequency", "damping", "delay")


def draw(seed: int) -> tuple[Stage, tuple[float, float, float]]:
    """Return a stage and its mode's frequency, its damping, and the delay."""
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
    return stage, (frequency_Hz, damping, delay_s)


def recordings(stage: Stage) -> list[Recording]:
    """Record a slow sweep and a chirp through the mode."""
    rig = stage.rig
    shapes = {
        "sweep": (500.0, drives.decaying_sweep(500.0, 1.0, 12)),
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
    """Return the dynamics; the chirp's memory is that of the cycles before it."""
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
    return with_dynamics(replace(axis, starts=(*axis.starts, start)), held).dynamics


def judged(
    dynamics: LinearDynamics, truth: tuple[float, float, float]
) -> list[tuple[bool, float]]:
    """Return whether each interval holds the truth, and the error over half the interval."""
    mode = int(np.abs(dynamics.mode_gain_m_per_V[:, 0, 0]).argmax())
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


def main() -> None:
    """Print every draw and the share of intervals that hold."""
    draws, first = (int(a) for a in (*sys.argv[1:], *("100", "0")[len(sys.argv) - 1 :]))
    held = []
    for seed in range(first, first + draws):
        stage, truth = draw(seed)
        dynamics = found_in(stage)
        if dynamics is None:
            print(f"{seed:4d}  nothing found", flush=True)
            held.append([False] * len(NAMES))
            continue
        verdicts = judged(dynamics, truth)
        held.append([inside for inside, _ in verdicts])
        told = "  ".join(
            f"{name} {'in ' if inside else 'OUT'} {error:+5.2f}"
            for name, (inside, error) in zip(NAMES, verdicts, strict=True)
        )
        low, high = dynamics.mode_frequency_interval_Hz()[
            int(np.abs(dynamics.mode_gain_m_per_V[:, 0, 0]).argmax())
        ]
        print(
            f"{seed:4d}  {truth[0]:7.1f} Hz [{low:.1f}, {high:.1f}]  {truth[1]:.4f}  "
            f"{1e6 * truth[2]:5.1f} us  {told}",
            flush=True,
        )
    for name, share in zip(NAMES, np.mean(held, axis=0), strict=True):
        print(f"{name}: {share:.0%} of {draws} intervals hold the truth")


if __name__ == "__main__":
    main()
