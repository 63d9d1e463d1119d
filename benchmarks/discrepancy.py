"""How large the second hysteresis of verification is, beside what the model really misses.

    python -m benchmarks.discrepancy
    python -m benchmarks.discrepancy --outsiders alder --stages 560-575

Ceramics of every law of the zoo, of which full cycles, cycles of two sizes or shrinking ones were
recorded, or stages of an outsider. Judged on a spiral of five turns over 0.7 of the range: rms of
what the model misses there, of the second hysteresis, and of the error on rows left out.
"""

from argparse import ArgumentParser
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import piezoid
from benchmarks.outsiders.lateral import RADIUS, TURNS, LED_s, led_to, middle_of
from benchmarks.outsiders.simulators import RATE_Hz, simulator, track
from piezoid.identification.model import AxisModel
from piezoid.identification.simulation import compare
from piezoid.numerics.arrays import Array
from piezoid.records.frames import from_arrays
from piezoid.records.recording import Quantity
from piezoid.verification.scenarios import constant_angular_velocity
from piezoid_cli.calibration import calibrate
from piezoid_datasets.virtual_lab.truths import ZOO

CYCLED = np.array([1.0, -1.0, 1.0, -1.0])
STROKE_m, NOISE_m, REACH_V = 20e-6, 8e-9, 5.0
SAMPLES = 400  # of a cycle
TURN = np.linspace(0.0, 1.0, 4000)
SPIRAL = 0.7 * TURN * np.sin(2.0 * np.pi * TURNS * TURN)


def triangles(sizes: Array) -> Array:
    """Return a triangle from -1 with cycles that go up by these parts of the range."""
    phase = np.arange(len(sizes) * SAMPLES) / SAMPLES
    wave = 1.0 - np.abs(2.0 * (phase % 1.0) - 1.0)
    return -1.0 + 2.0 * np.repeat(sizes, SAMPLES) * wave


RECORDED = {
    "full cycles": triangles(np.ones(6)),
    "two sizes": triangles(np.repeat([1.0, 0.5], 4)),
    "shrinking": triangles(1.0 - 0.1 * np.arange(8)),
}


def of_the_zoo() -> Iterator[tuple[str, str, AxisModel, float, float]]:
    """Yield kind, name, model, what it misses and the second hysteresis, rms on the spiral."""
    rng = np.random.default_rng(5)
    for kind, field in RECORDED.items():
        for truth in ZOO:
            for seed in (7, 8):
                ceramic = truth.draw(np.random.default_rng(seed))
                whole = np.concatenate([field, np.linspace(field[-1], 0.0, 100), SPIRAL])
                moved_m = STROKE_m * sum(ceramic.respond(whole, CYCLED))
                noise_m = NOISE_m * rng.standard_normal(len(field))
                recording = from_arrays(
                    voltage_V=REACH_V * field,
                    displacement_m=moved_m[: len(field)] + noise_m,
                    sampling_rate_Hz=500.0,
                    axis="x",
                )
                axis = piezoid.fit(recording).one()
                operator, drive_V = axis.hysteresis, REACH_V * whole
                followed_m, _ = operator.run(drive_V, operator.virgin_memory())
                missed_m = (moved_m - followed_m)[-len(SPIRAL) :]
                stated_m = axis.discrepancy.run(drive_V)[-len(SPIRAL) :]
                yield kind, f"{truth.name} {seed}", axis, missed_m.std(), stated_m.std()


def of_an_outsider(name: str, seeds: range) -> Iterator[tuple[str, str, AxisModel, float, float]]:
    """Yield the same of stages that ship, driven open-loop through the inverse."""
    made = simulator(name)
    for seed in seeds:
        with TemporaryDirectory() as scratch:
            folder = Path(scratch)
            made.campaigns.write_stage(seed, folder, made.library)
            files = sorted(folder.glob("*.csv"))
            found = calibrate(files, folder / "lab.toml", lambda _: None)
            like = next(iter(piezoid.read(files[0], lab=folder / "lab.toml")))
        if found.controllers.parameters is None:
            continue
        axis = next(iter(found.model.axes.values()))
        inverse = found.controllers.parameters.axes[0].for_method("mpi")
        middle_m, reach_m = middle_of(inverse)
        path = constant_angular_velocity(RATE_Hz, frequency_Hz=1.0, turns=TURNS)
        run = track(
            made,
            seed,
            7,
            inverse.values,
            None,
            lambda rest_m, m=middle_m, r=reach_m, p=path: np.concatenate(
                [led_to(m, rest_m), m + RADIUS * r * p.x]
            ),
        )
        values = {Quantity.VOLTAGE: run.volts, Quantity.DISPLACEMENT: run.measured}
        channels = tuple(
            replace(channel, values=np.asarray(values[channel.quantity]))
            for channel in like.channels
            if channel.quantity in values
        )
        driven = replace(like, channels=channels, sampling_rate_Hz=RATE_Hz, breaks=())
        led = round(1.5 * LED_s * RATE_Hz)
        power = compare(axis, driven).error_m[led:].var() - axis.quality.noise_rms_m**2
        stated_m = axis.discrepancy.run(np.asarray(run.volts))[led:]
        yield name, f"stage {seed}", axis, float(np.sqrt(max(power, 1e-24))), stated_m.std()


def main() -> None:
    """Print every stage, and for each kind how many are stated within a factor of 2."""
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--outsiders", choices=("alder", "birch"))
    parser.add_argument("--stages", default="560-575")
    asked = parser.parse_args()
    first, last = (int(end) for end in asked.stages.split("-"))
    ratios: dict[str, list[float]] = {}
    stages = range(first, last + 1)
    rows = of_an_outsider(asked.outsiders, stages) if asked.outsiders else of_the_zoo()
    for kind, name, axis, missed_m, stated_m in rows:
        left_m = axis.quality.held_out_rms_m
        ratios.setdefault(kind, []).append(stated_m / missed_m)
        print(
            f"{kind:12} {name:28} misses {1e9 * missed_m:7.1f} nm, stated {1e9 * stated_m:7.1f}, "
            f"left of rows left out {1e9 * left_m:7.1f}",
            flush=True,
        )
    for kind, found in ratios.items():
        within = sum(0.5 <= ratio <= 2.0 for ratio in found)
        print(f"{kind}: {np.median(found):.2f} in the median, {within} of {len(found)} within 2")


if __name__ == "__main__":
    main()
