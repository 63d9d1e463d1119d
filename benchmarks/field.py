"""Compensators of other authors and of piezoid on stages of third-party simulators.

    python -m benchmarks.field [--stages 700-711] [--kept FOLDER]

Each stage is recorded and calibrated. Every method of the parameter file and every compensator of
``other_compensators`` then follows the spirals of ``benchmarks.outsiders`` on the stage. The
generalised model is fitted to the same recordings as the shipped one.
"""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import piezoid
from benchmarks.other_compensators import Compensator, compensators_of, starter_of
from benchmarks.outsiders.lateral import (
    RADIUS,
    TURNS,
    FREQUENCIES_Hz,
    approach,
    evaluate_stage,
    reference_range,
    spiral_error,
)
from benchmarks.outsiders.simulators import NAMES, RATE_Hz, drive, load_simulator, seed_range
from piezoid.export.parameter_file import AxisParameters
from piezoid.verification.scenarios import constant_angular_velocity
from piezoid_cli.stage_files import StageFolder

NOISE_SEED = 7


@dataclass(frozen=True, kw_only=True)
class Row:
    """One method on one stage: rms error [m] at each frequency, and the bandwidth of its loop."""

    stage: str
    law: str
    method: str
    bandwidth_Hz: float | None
    rms_m: tuple[float, ...]


def spiral_rms_m(
    name: str, seed: int, axis: AxisParameters, compensator: Compensator, frequency_Hz: float
) -> float:
    """Return the rms error of a compensator along a spiral on the simulated stage."""
    simulator = load_simulator(name)
    centre_m, half_range_m = reference_range(axis)
    path = constant_angular_velocity(RATE_Hz, frequency_Hz=frequency_Hz, turns=TURNS)
    radius_m = RADIUS * half_range_m
    plant, voltage_V, rest_m = simulator.open_stage(seed, NOISE_SEED)
    reference_m = np.concatenate([approach(centre_m, rest_m), centre_m + radius_m * path.x])
    controller, command_m = compensator.prepare(reference_m)
    controller.start(voltage_V, rest_m)
    run = drive(controller, simulator.library.stage_step, plant, command_m, rest_m)
    simulator.library.stage_close(plant)
    return spiral_error(
        run, path, frequency_Hz=frequency_Hz, radius_m=radius_m, centre_m=centre_m
    ).rms_m


def rows_of(name: str, seed: int, parent: Path) -> Iterator[Row]:
    """Yield a row for every method on one stage, if a controller ships.

    parent  folder that keeps the calibrated stages
    """
    folder = parent / f"{name}-{seed}"
    if not folder.exists():
        evaluate_stage(name, seed, parent)
    if not (folder / "params.json").exists():
        return
    stage = StageFolder(folder)
    design, axis = stage.design.axes[0], stage.parameters.axes[0]
    model = stage.model[axis.axis]
    bandwidths_Hz = {loop.method: loop.bandwidth_Hz for loop in design.loops}
    compensators = [
        Compensator(
            method=method,
            bandwidth_Hz=bandwidths_Hz.get(method),
            prepare=starter_of(axis.for_method(method)),
        )
        for method in axis.methods
    ]
    names = {start.recording for start in model.starts}
    recordings = tuple(
        recording
        for path in sorted((folder / "recordings").glob("*.csv"))
        for recording in piezoid.read(path, lab=folder / "recordings" / "lab.toml")
        if recording.name in names
    )
    compensators += compensators_of(axis, design, model, recordings)
    law = load_simulator(name).stage_law(seed)
    for compensator in compensators:
        method = compensator.method
        yield Row(
            stage=f"{name} {seed}",
            law=law,
            method=method + (" (ships)" if method == axis.method else ""),
            bandwidth_Hz=compensator.bandwidth_Hz,
            rms_m=tuple(spiral_rms_m(name, seed, axis, compensator, f) for f in FREQUENCIES_Hz),
        )


def summary(rows: list[Row]) -> str:
    """Return for each method the median error over that of the shipped one, and its wins."""
    stages = list(dict.fromkeys(row.stage for row in rows))
    by_stage = {s: {r.method.split()[0]: r for r in rows if r.stage == s} for s in stages}
    shipped = {row.stage: row for row in rows if row.method.endswith("(ships)")}
    lines = [
        "| method | stages | bandwidth, median |"
        + "".join(f" {f:g} Hz | first |" for f in FREQUENCIES_Hz),
        "| --- | --- | --- |" + " --- | --- |" * len(FREQUENCIES_Hz),
    ]
    for method in dict.fromkeys(row.method.split()[0] for row in rows):
        method_rows = {s: by_stage[s][method] for s in stages if method in by_stage[s]}
        bandwidths_Hz = [
            r.bandwidth_Hz for r in method_rows.values() if r.bandwidth_Hz is not None
        ]
        cells = [f"{np.median(bandwidths_Hz):.0f} Hz" if bandwidths_Hz else ""]
        for k in range(len(FREQUENCIES_Hz)):
            ratios = [row.rms_m[k] / shipped[s].rms_m[k] for s, row in method_rows.items()]
            first = sum(
                row.rms_m[k] == min(r.rms_m[k] for r in by_stage[s].values())
                for s, row in method_rows.items()
            )
            cells += [f"{np.median(ratios):.2f}", f"{first}"]
        lines.append(f"| `{method}` | {len(method_rows)} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    """Print every row, then the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--stages", default="700-711", help="seeds of each simulator")
    parser.add_argument("--kept", type=Path, help="folder that keeps the calibrated stages")
    options = parser.parse_args()
    rows: list[Row] = []
    with TemporaryDirectory() as scratch:
        for seed in seed_range(options.stages):
            for name in NAMES:
                for row in rows_of(name, seed, options.kept or Path(scratch)):
                    rows.append(row)
                    width = "" if row.bandwidth_Hz is None else f"{row.bandwidth_Hz:.0f} Hz"
                    errors = "  ".join(f"{1e9 * rms_m:8.1f}" for rms_m in row.rms_m)
                    print(
                        f"{row.stage:10} {row.law:28} {row.method:16} {width:8} {errors} nm",
                        flush=True,
                    )
    print(summary(rows))


if __name__ == "__main__":
    main()
