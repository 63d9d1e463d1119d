"""Learned feedforward on plants whose hysteresis differs from the model.

    python -m benchmarks.learning [--stages 3] [--draws 2] [--laws 13] [--out DIR] [--figure SVG]

Closed loop: stages of two simulators (birch, alder) are recorded and calibrated, and the table is
added to the output of the shipped controller. Open loop: a stage of the virtual laboratory for
each law, where the table is the whole voltage. The references are triangles and spirals (two turns
out, two back) over 0.3 of the range. Five times, one period is recorded and the next table is
computed. Errors are those of the position without sensor noise, over the noise of one reading. A
run is monotone if no period exceeds the one before it by more than a tenth of the noise. It
converges if this holds for all periods with an error above twice the noise.
"""

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from zlib import crc32

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from benchmarks.outsiders.lateral import approach, reference_range
from benchmarks.outsiders.simulators import PythonController, RATE_Hz, drive, load_simulator
from piezoid.errors import PiezoidError
from piezoid.export.parameter_file import AxisParameters
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.learning.learn import Learned, first_table, next_table
from piezoid.numerics.arrays import Array
from piezoid.records.frames import from_arrays
from piezoid.records.lab import Lab
from piezoid.runtime.controller import Controller
from piezoid.verification.plant import AxisPlant, lateral_plant
from piezoid.verification.scenarios import raster
from piezoid.verification.verify_stage import plant_of
from piezoid_cli.calibration import calibrate
from piezoid_cli.stage_files import StageFolder
from piezoid_datasets.virtual_lab.campaign import draw_campaign, member_named
from piezoid_datasets.virtual_lab.stage import Run, Stage, record
from piezoid_datasets.virtual_lab.truths import ZOO
from piezoid_datasets.virtual_lab.write import campaign_files

FREQUENCIES_Hz = (1.0, 10.0, 100.0, 500.0)
SHAPES = ("triangle", "spiral")
PERIODS = 5
NO_MODE_BELOW_Hz = 5e3  # stated bandwidth of the virtual stages
PLANS = ("sweep", "check", "rates", "chirp")  # recordings for the fit
AMPLITUDE = 0.3  # of half the range
SETTLING_s = 0.1
_TOLERANCE = 0.1  # of the noise, by which an error may increase

# (table, noise seed) -> reading and position of one settled period, (points,) each
Bench = Callable[[Learned, int], tuple[Array, Array]]


@dataclass(frozen=True, kw_only=True)
class Case:
    """One run: error over the noise in each recorded period."""

    stage: str
    law: str
    shape: str
    frequency_Hz: float
    errors: tuple[float, ...] = ()
    noise_m: float = 0.0
    contraction: float = 0.0
    learns_to_Hz: float = 0.0
    refused: str = ""

    @property
    def is_monotone(self) -> bool:
        """Whether no period increases the error by more than a tenth of the noise."""
        return bool((np.diff(self.errors) <= _TOLERANCE).all())

    @property
    def converges(self) -> bool:
        """Whether the error increases only in periods with less than twice the noise."""
        errors = np.array(self.errors[1:])
        return bool(((np.diff(self.errors) <= _TOLERANCE) | (errors <= 2.0)).all())

    @property
    def is_open_loop(self) -> bool:
        """Whether the table is the whole voltage."""
        return self.stage.startswith("virtual")


def period_of(shape: str, frequency_Hz: float, rate_Hz: float) -> Array:
    """Return one period within -1 to 1."""
    turn = round(rate_Hz / frequency_Hz)
    if shape == "triangle":
        return raster(rate_Hz, rate_Hz / turn, 1.0).x
    t = np.arange(4 * turn) / turn
    return np.asarray((2.0 - np.abs(t - 2.0)) / 2.0 * np.sin(2.0 * np.pi * t))


def runs(
    stage: str,
    law: str,
    model: ActuatorModel,
    plant: AxisPlant,
    parameters: AxisParameters | None,
    bench: Bench,
    draws: int,
) -> Iterator[Case]:
    """Learn every motion on one stage.

    parameters  of the shipped controller; None for an open loop
    """
    axis = next(iter(model.axes.values()))
    if parameters is None:
        low_V, high_V = axis.voltage_V
        response_m, _ = axis.hysteresis.run(
            np.array([high_V, low_V, high_V]), axis.hysteresis.virgin_memory()
        )
        offset_m = axis.hysteresis.displacement_offset_m
        limits_m = axis.polarity * (response_m[1:] - offset_m) + offset_m
        centre_m, half_range_m = float(limits_m.mean()), 0.5 * float(np.ptp(limits_m))
    else:
        centre_m, half_range_m = reference_range(parameters)
    for shape in SHAPES:
        for frequency_Hz in FREQUENCIES_Hz:
            motion = {"stage": stage, "law": law, "shape": shape, "frequency_Hz": frequency_Hz}
            unit = period_of(shape, frequency_Hz, plant.sampling_rate_Hz)
            amplitude_m = AMPLITUDE * half_range_m
            if parameters is not None:  # the shipped controller limits the speed of its reference
                unit_step = float(np.abs(np.diff(unit, append=unit[0])).max())
                max_step_m = 0.95 * float(parameters.values["reference_step_m"])
                amplitude_m = min(amplitude_m, max_step_m / unit_step)
            reference_m = centre_m + amplitude_m * unit
            try:
                first = first_table(axis, plant, reference_m, parameters=parameters)
                for draw in range(draws):
                    learned, errors = first, []
                    for k in range(PERIODS + 1):
                        read_m, position_m = bench(learned, 100 * draw + k + 1)
                        error_m = reference_m - position_m
                        if parameters is None:
                            error_m = error_m - error_m.mean()
                        errors.append(float(np.sqrt(np.mean(error_m**2))) / plant.noise_rms)
                        if k < PERIODS:
                            recording = from_arrays(
                                voltage_V=learned.table_V,
                                displacement_m={axis.axis: read_m},
                                sampling_rate_Hz=plant.sampling_rate_Hz,
                            )
                            learned = next_table(
                                learned, axis, plant, recording, parameters=parameters
                            )
                    yield Case(
                        **motion,
                        errors=tuple(errors),
                        noise_m=plant.noise_rms,
                        contraction=first.contraction,
                        learns_to_Hz=first.learns_to_Hz,
                    )
            except PiezoidError as error:
                yield Case(**motion, refused=str(error))


def closed_loop_bench(name: str, seed: int, values: dict) -> Bench:
    """Return the simulated stage under the compiled controller with a table."""
    simulator, preview = load_simulator(name), int(values["preview_samples"])

    def bench(learned: Learned, noise_seed: int) -> tuple[Array, Array]:
        points = len(learned.wanted_m)
        settling = 1 + int(np.ceil(SETTLING_s * RATE_Hz / points))
        plant, voltage_V, rest_m = simulator.open_stage(seed, noise_seed)
        controller = Controller(values)
        controller.start(voltage_V, rest_m)
        lead_in = approach(float(learned.wanted_m[0]), rest_m)
        table_V = np.tile(learned.table_V, settling + 1)
        table_V[:points] *= np.arange(points) / points
        feedforward_V = iter([*np.zeros(len(lead_in)).tolist(), *table_V.tolist(), 0.0])
        path = np.concatenate([lead_in, np.tile(learned.wanted_m, settling + 2)])
        count = len(lead_in) + (settling + 1) * points + 1
        stepped = PythonController(
            lambda reference, measured: controller.step(reference, measured, next(feedforward_V)),
            controller.addresses[1:],
        )
        reference = path[np.arange(count) + preview]
        run = drive(stepped, simulator.library.stage_step, plant, reference, rest_m)
        simulator.library.stage_close(plant)
        # Values at the end of a tick belong to the next instant.
        period = slice(count - points - 2, count - 2)
        return run.measured[period], run.position[period]

    return bench


def closed_loop_cases(name: str, seed: int, folder: Path, draws: int) -> Iterator[Case]:
    """Calibrate a stage of a third-party simulator, then learn on it."""
    simulator = load_simulator(name)
    law = simulator.stage_law(seed)
    if not (folder / "model.json").exists():
        simulator.campaigns.write_stage(seed, folder, simulator.library)
        result = calibrate(sorted(folder.glob("*.csv")), folder / "lab.toml", lambda _: None)
        for path in ("model.json", "params.json"):
            if path in result.files:
                (folder / path).write_bytes(result.files[path])
    if not (folder / "params.json").exists():
        yield Case(
            stage=f"{name} {seed}", law=law, shape="-", frequency_Hz=0.0, refused="does not ship"
        )
        return
    stage = StageFolder(folder)
    shipped = stage.parameters.axes[0]
    plant = plant_of(shipped, stage.model, Lab())
    bench = closed_loop_bench(name, seed, dict(shipped.values))
    yield from runs(f"{name} {seed}", law, stage.model, plant, shipped, bench, draws)


def open_loop_cases(law: str, seed: int, folder: Path, draws: int) -> Iterator[Case]:
    """Calibrate a stage of the virtual laboratory, then learn its drive without feedback."""
    campaign = draw_campaign(seed, truth=law, plans=PLANS)
    for name, content in campaign_files(campaign).items():
        (folder / Path(name).name).write_bytes(content)
    with (folder / "lab.toml").open("a") as lab:  # the rig has no mode
        lab.write(f"\n[actuator]\nbandwidth_Hz = {NO_MODE_BELOW_Hz}\n")
    model = calibrate(sorted(folder.glob("*.csv")), folder / "lab.toml", lambda _: None).model
    rig = campaign.rig
    ceramic = member_named(ZOO, law).draw(np.random.default_rng([seed, crc32(b"ceramic")]))
    axis = next(iter(model.axes.values()))
    plant = lateral_plant(axis, sampling_rate_Hz=rig.clock_Hz)

    def bench(learned: Learned, noise_seed: int) -> tuple[Array, Array]:
        points = len(learned.wanted_m)
        settling = 1 + int(np.ceil(SETTLING_s * learned.sampling_rate_Hz / points))
        command_V = np.tile(learned.table_V, settling + 1)
        run = Run(
            name="period",
            sampling_rate_Hz=learned.sampling_rate_Hz,
            command_V=command_V,
            history_V=np.zeros(0),
        )
        rows = record(Stage(rig=rig, ceramic=ceramic, seed=noise_seed), run)
        period = slice(len(rows.time_s) - points, len(rows.time_s))
        # The position follows from the reading without noise and the stated sensor bandwidth.
        frequency_Hz = np.fft.rfftfreq(points, 1.0 / learned.sampling_rate_Hz)
        sensor = 1.0 / (1.0 + 1j * frequency_Hz / rig.sensor_bandwidth_Hz)
        position_m = np.fft.irfft(np.fft.rfft(rows.noise_free_m[period]) / sensor, points)
        return rows.displacement_m[period], position_m

    yield from runs(f"virtual {seed}", law, model, plant, None, bench, draws)


def summary(cases: list[Case]) -> str:
    """Return a row for each loop, shape and frequency, and the totals."""
    lines = [
        "| loop | motion | runs | refused | first table | after 5 periods, median | worst | "
        "at most twice the noise | converges | strictly |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for loop in ("closed", "open"):
        for shape in SHAPES:
            for f in FREQUENCIES_Hz:
                group = [
                    case
                    for case in cases
                    if (case.shape, case.frequency_Hz) == (shape, f)
                    and case.is_open_loop == (loop == "open")
                ]
                completed = [case for case in group if case.errors]
                if not completed:
                    continue
                final = np.array([case.errors[-1] for case in completed])
                lines.append(
                    f"| {loop} | {shape} {f:g} Hz | {len(completed)} | "
                    f"{len(group) - len(completed)} | "
                    f"{np.median([case.errors[0] for case in completed]):.2f} | "
                    f"{np.median(final):.2f} | {final.max():.2f} | {np.mean(final <= 2.0):.0%} | "
                    f"{np.mean([case.converges for case in completed]):.0%} | "
                    f"{np.mean([case.is_monotone for case in completed]):.0%} |"
                )
    completed = [case for case in cases if case.errors]
    lines += [
        "",
        f"{len(completed)} runs: {np.mean([case.errors[-1] <= 2.0 for case in completed]):.1%} at "
        f"most twice the noise, {np.mean([case.converges for case in completed]):.1%} converge "
        f"monotonically, {np.mean([case.is_monotone for case in completed]):.1%} strictly.",
    ]
    return "\n".join(lines)


def draw(cases: list[Case], path: Path) -> None:
    """Draw the error over the noise of every run, period by period."""
    figure = Figure(figsize=(7.2, 2.8), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    for panel, loop in zip(panels, ("closed", "open"), strict=True):
        runs = [c.errors for c in cases if c.errors and c.is_open_loop == (loop == "open")]
        for errors in runs:
            panel.semilogy(errors, color="#0072b2", alpha=0.35, lw=0.9)
        panel.axhline(2.0, color="#d55e00", lw=1.2, ls="--", label="aim: twice the noise")
        panel.set(title=f"{loop} loop, {len(runs)} runs", xlabel="recorded periods")
        panel.spines[["top", "right"]].set_visible(False)
    panels[0].set(ylabel="rms error / noise of a reading")
    panels[0].legend(frameon=False, fontsize="small")
    with mpl.rc_context({"svg.hashsalt": "piezoid"}):
        figure.savefig(path, format="svg", metadata={"Date": None, "Creator": "piezoid"})


def main() -> None:
    """Print every run, then the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--stages", type=int, default=3, help="number for each simulator")
    parser.add_argument("--laws", type=int, default=len(ZOO), help="number of open-loop stages")
    parser.add_argument("--draws", type=int, default=2, help="noise seeds for each motion")
    parser.add_argument("--out", type=Path, help="folder that keeps the calibrated stages")
    parser.add_argument("--figure", type=Path, help="SVG file to write")
    options = parser.parse_args()
    cases: list[Case] = []
    with TemporaryDirectory() as scratch:
        parent = options.out or Path(scratch)
        tasks = [
            (closed_loop_cases, name, seed + 1)
            for seed in range(options.stages)
            for name in ("birch", "alder")
        ]
        laws = ZOO[: options.laws]
        tasks += [(open_loop_cases, truth.name, k + 1) for k, truth in enumerate(laws)]
        for cases_of, name, seed in tasks:
            folder = parent / f"{name}-{seed}"
            folder.mkdir(parents=True, exist_ok=True)
            for case in cases_of(name, seed, folder, options.draws):
                cases.append(case)
                result = " ".join(f"{error:.2f}" for error in case.errors) or case.refused
                print(
                    f"{case.stage}, {case.law}, {case.shape} {case.frequency_Hz:g} Hz, "
                    f"contraction {case.contraction:.2f} to {case.learns_to_Hz:.0f} Hz, "
                    f"noise {1e9 * case.noise_m:.2f} nm: {result}",
                    flush=True,
                )
    print(summary(cases))
    if options.figure is not None:
        draw(cases, options.figure)


if __name__ == "__main__":
    main()
