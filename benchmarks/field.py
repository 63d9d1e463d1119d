"""Compensators of others beside ours on stages whose authors never saw piezoid.

    python -m benchmarks.field [--stages 700-711] [--kept FOLDER]

Each stage is recorded and calibrated; then every method of the parameter file and every
compensator of ``other_compensators`` follows the spirals of ``benchmarks.outsiders`` on the stage
itself. The generalised model is fitted to the same recordings as the shipped one.
"""

import argparse
import ctypes
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import piezoid
from benchmarks.other_compensators import Compensator, compensators_of, shipped
from benchmarks.outsiders.lateral import (
    RADIUS,
    TURNS,
    COMPARED_Hz,
    LED_s,
    judge,
    led_to,
    middle_of,
)
from benchmarks.outsiders.simulators import NAMES, RATE_Hz, drive, simulator
from piezoid.design.design import design_from_json
from piezoid.export.parameter_file import AxisParameters, from_json
from piezoid.identification.model import AxisModel
from piezoid.identification.store import read_model
from piezoid.records.recording import Recording
from piezoid.verification.scenarios import constant_angular_velocity
from piezoid.verification.tracking import Tracking, track

NOISE_SEED = 7


@dataclass(frozen=True, kw_only=True)
class Row:
    """One method on one stage: rms at each frequency, m, and the bandwidth of its loop."""

    stage: str
    law: str
    method: str
    bandwidth_Hz: float | None
    rms_m: tuple[float, ...]


def followed(
    name: str, seed: int, axis: AxisParameters, compensator: Compensator, frequency_Hz: float
) -> Tracking:
    """Let a compensator follow a spiral on an outsider's stage."""
    made = simulator(name)
    middle_m, reach_m = middle_of(axis)
    path = constant_angular_velocity(RATE_Hz, frequency_Hz=frequency_Hz, turns=TURNS)
    radius_m = RADIUS * reach_m
    plant = made.library.stage_open(seed, NOISE_SEED)
    volts, rest = ctypes.c_double(), ctypes.c_double()
    made.library.stage_rest(plant, ctypes.byref(volts), ctypes.byref(rest))
    led = led_to(middle_m, rest.value)
    wanted = np.concatenate([led, middle_m + radius_m * path.x])
    controller, given = compensator.started(wanted)
    controller.start(volts.value, rest.value)
    run = drive(controller, made.library.stage_step, plant, given, rest.value)
    made.library.stage_close(plant)
    begun = round(1.5 * LED_s * RATE_Hz) - 1  # positions are those at the ends of ticks
    return track(
        {"x": radius_m * path.x},
        {"x": run.position[begun : begun + len(path.x)] - middle_m},
        path=path,
        radius_m=radius_m,
        frequency_Hz=frequency_Hz,
        sampling_rate_Hz=RATE_Hz,
    )


def rows_of(name: str, seed: int, kept: Path) -> Iterator[Row]:
    """Yield every method on one stage; nothing where no controller ships."""
    folder = kept / f"{name}-{seed}"
    if not folder.exists():
        judge(name, seed, kept)
    if not (folder / "params.json").exists():
        return
    model = read_model((folder / "model.json").read_bytes(), "model.json")
    design = design_from_json((folder / "design.json").read_bytes(), "design.json").axes[0]
    axis = from_json((folder / "params.json").read_bytes(), "params.json").axes[0]
    own = model[axis.axis]
    known = {loop.method: loop.bandwidth_Hz for loop in design.loops}
    used = [
        Compensator(
            method=method,
            bandwidth_Hz=known.get(method),
            started=shipped(axis.for_method(method)),
        )
        for method in axis.methods
    ]
    recordings = tuple(_of_the_fit(own, folder / "recordings"))
    used += compensators_of(axis, design, own, recordings)
    made = simulator(name)
    law = str(made.campaigns.stage_truth(seed, made.library).get("law", "?"))
    for compensator in used:
        method = compensator.method
        each = [followed(name, seed, axis, compensator, f).rms_m for f in COMPARED_Hz]
        yield Row(
            stage=f"{name} {seed}",
            law=law,
            method=method + (" (ships)" if method == axis.method else ""),
            bandwidth_Hz=compensator.bandwidth_Hz,
            rms_m=tuple(each),
        )


def _of_the_fit(model: AxisModel, folder: Path) -> Iterator[Recording]:
    names = {start.recording for start in model.starts}
    for place in sorted(folder.glob("*.csv")):
        for recording in piezoid.read(place, lab=folder / "lab.toml"):
            if recording.name in names:
                yield recording


def summary(rows: list[Row]) -> str:
    """Return a row for each method: median error over that of what ships, and how often first."""
    stages = list(dict.fromkeys(row.stage for row in rows))
    of_stage = {s: {r.method.split()[0]: r for r in rows if r.stage == s} for s in stages}
    ships = {r.stage: r for r in rows if r.method.endswith("(ships)")}
    lines = [
        "| method | stages | bandwidth, median |"
        + "".join(f" {f:g} Hz | first |" for f in COMPARED_Hz),
        "| --- | --- | --- |" + " --- | --- |" * len(COMPARED_Hz),
    ]
    for method in dict.fromkeys(row.method.split()[0] for row in rows):
        own = [s for s in stages if method in of_stage[s]]
        widths = [of_stage[s][method].bandwidth_Hz for s in own]
        known = [w for w in widths if w is not None]
        cells = [f"{np.median(known):.0f} Hz" if known else ""]
        for k in range(len(COMPARED_Hz)):
            ratio = [of_stage[s][method].rms_m[k] / ships[s].rms_m[k] for s in own]
            first = sum(
                of_stage[s][method].rms_m[k] == min(r.rms_m[k] for r in of_stage[s].values())
                for s in own
            )
            cells += [f"{np.median(ratio):.2f}", f"{first}"]
        lines.append(f"| `{method}` | {len(own)} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    """Print every row, then the table."""
    asked = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    asked.add_argument("--stages", default="700-711", help="seeds of each outsider")
    asked.add_argument("--kept", type=Path, default=None, help="calibrated stages, kept here")
    given = asked.parse_args()
    first, _, last = given.stages.partition("-")
    rows: list[Row] = []
    with TemporaryDirectory() as scratch:
        for seed in range(int(first), int(last or first) + 1):
            for name in NAMES:
                for row in rows_of(name, seed, given.kept or Path(scratch)):
                    rows.append(row)
                    width = "" if row.bandwidth_Hz is None else f"{row.bandwidth_Hz:.0f} Hz"
                    shown = "  ".join(f"{1e9 * e:8.1f}" for e in row.rms_m)
                    print(
                        f"{row.stage:10} {row.law:28} {row.method:16} {width:8} {shown} nm",
                        flush=True,
                    )
    print(summary(rows))


if __name__ == "__main__":
    main()
