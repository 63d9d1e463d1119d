"""Second hysteresis of the verification plant against the true model error.

    python -m benchmarks.discrepancy
    python -m benchmarks.discrepancy --outsiders alder --stages 560-575

Ceramics of every law of the zoo, recorded with full cycles, cycles of two sizes or shrinking
cycles, or stages of a third-party simulator. On a spiral of five turns over 0.7 of the range, the
program compares the rms of the model error with that of the second hysteresis. It also prints the
held-out error.
"""

from argparse import ArgumentParser
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import piezoid
from benchmarks.outsiders.lateral import RADIUS, TURNS, APPROACH_s, approach, reference_range
from benchmarks.outsiders.simulators import RATE_Hz, load_simulator, seed_range, track
from piezoid.identification.model import AxisModel
from piezoid.identification.simulation import compare
from piezoid.numerics.arrays import Array
from piezoid.records.frames import from_arrays
from piezoid.records.recording import Quantity
from piezoid.verification.scenarios import constant_angular_velocity
from piezoid_cli.calibration import calibrate
from piezoid_datasets.virtual_lab.truths import ZOO

HISTORY = np.array([1.0, -1.0, 1.0, -1.0])
STROKE_m, NOISE_m, REACH_V = 20e-6, 8e-9, 5.0
SAMPLES = 400  # of a cycle
TURN = np.linspace(0.0, 1.0, 4000)
SPIRAL = 0.7 * TURN * np.sin(2.0 * np.pi * TURNS * TURN)


def triangles(sizes: Array) -> Array:
    """Return triangles from -1 whose cycles cover these shares of the range."""
    phase = np.arange(len(sizes) * SAMPLES) / SAMPLES
    wave = 1.0 - np.abs(2.0 * (phase % 1.0) - 1.0)
    return -1.0 + 2.0 * np.repeat(sizes, SAMPLES) * wave


RECORDED = {
    "full cycles": triangles(np.ones(6)),
    "two sizes": triangles(np.repeat([1.0, 0.5], 4)),
    "shrinking": triangles(1.0 - 0.1 * np.arange(8)),
}


def zoo_errors() -> Iterator[tuple[str, str, AxisModel, float, float]]:
    """Yield group, name, model, and rms of model error and second hysteresis on the spiral."""
    rng = np.random.default_rng(5)
    for kind, field in RECORDED.items():
        for truth in ZOO:
            for seed in (7, 8):
                ceramic = truth.draw(np.random.default_rng(seed))
                path = np.concatenate([field, np.linspace(field[-1], 0.0, 100), SPIRAL])
                position_m = STROKE_m * sum(ceramic.respond(path, HISTORY))
                noise_m = NOISE_m * rng.standard_normal(len(field))
                recording = from_arrays(
                    voltage_V=REACH_V * field,
                    displacement_m=position_m[: len(field)] + noise_m,
                    sampling_rate_Hz=500.0,
                    axis="x",
                )
                axis = piezoid.fit(recording).one()
                operator, drive_V = axis.hysteresis, REACH_V * path
                model_m, _ = operator.run(drive_V, operator.virgin_memory())
                error_m = (position_m - model_m)[-len(SPIRAL) :]
                stated_m = axis.discrepancy.run(drive_V)[-len(SPIRAL) :]
                yield kind, f"{truth.name} {seed}", axis, error_m.std(), stated_m.std()


def simulator_errors(
    name: str, seeds: range
) -> Iterator[tuple[str, str, AxisModel, float, float]]:
    """Yield the same for stages that ship, driven open-loop through the inverse."""
    simulator = load_simulator(name)
    for seed in seeds:
        with TemporaryDirectory() as scratch:
            folder = Path(scratch)
            simulator.campaigns.write_stage(seed, folder, simulator.library)
            files = sorted(folder.glob("*.csv"))
            result = calibrate(files, folder / "lab.toml", lambda _: None)
            template = next(iter(piezoid.read(files[0], lab=folder / "lab.toml")))
        if result.controllers.parameters is None:
            continue
        axis = next(iter(result.model.axes.values()))
        inverse = result.controllers.parameters.axes[0].for_method("mpi")
        centre_m, half_range_m = reference_range(inverse)
        path = constant_angular_velocity(RATE_Hz, frequency_Hz=1.0, turns=TURNS)
        spiral_m = centre_m + RADIUS * half_range_m * path.x
        run = track(
            simulator,
            seed,
            7,
            inverse.values,
            lambda rest_m, c=centre_m, s=spiral_m: np.concatenate([approach(c, rest_m), s]),
        )
        values = {Quantity.VOLTAGE: run.volts, Quantity.DISPLACEMENT: run.measured}
        channels = tuple(
            replace(channel, values=np.asarray(values[channel.quantity]))
            for channel in template.channels
            if channel.quantity in values
        )
        recording = replace(template, channels=channels, sampling_rate_Hz=RATE_Hz, breaks=())
        start = round(1.5 * APPROACH_s * RATE_Hz)
        power = compare(axis, recording).error_m[start:].var() - axis.quality.noise_rms_m**2
        stated_m = axis.discrepancy.run(np.asarray(run.volts))[start:]
        yield name, f"stage {seed}", axis, float(np.sqrt(max(power, 1e-24))), stated_m.std()


def main() -> None:
    """Print every stage, and for each group how many are stated within a factor of 2."""
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--outsiders", choices=("alder", "birch"))
    parser.add_argument("--stages", default="560-575")
    options = parser.parse_args()
    ratios: dict[str, list[float]] = {}
    if options.outsiders:
        rows = simulator_errors(options.outsiders, seed_range(options.stages))
    else:
        rows = zoo_errors()
    for kind, name, axis, error_m, stated_m in rows:
        ratios.setdefault(kind, []).append(stated_m / error_m)
        print(
            f"{kind:12} {name:28} model error {1e9 * error_m:7.1f} nm, stated "
            f"{1e9 * stated_m:7.1f}, held-out error {1e9 * axis.quality.held_out_rms_m:7.1f}",
            flush=True,
        )
    for kind, values in ratios.items():
        close = sum(0.5 <= ratio <= 2.0 for ratio in values)
        print(
            f"{kind}: stated / true error {np.median(values):.2f} (median), "
            f"{close} of {len(values)} within a factor of 2"
        )


if __name__ == "__main__":
    main()
