"""What learning feedforward reaches on plants whose hysteresis is not the model.

    python -m benchmarks.learning [--stages 3] [--draws 2] [--laws 13] [--out DIR] [--figure SVG]

Closed loop: outsiders' stages (birch, alder), from their recordings to what ships, then the table
on top of it. Open loop: a stage of the virtual laboratory for each of its laws, the table being
all of the voltage. Triangles and spirals (two turns out, two back) of 0.3 of the range; a period
is recorded, the next table is made of it, five times. Errors are of the position in front of the
sensor, without its noise, over the noise of one reading. A run is monotone where no period errs
by more than the one before it and a tenth of the noise; it converges monotonely where that holds
of every period that errs by more than twice the noise.
"""

import argparse
import ctypes
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from zlib import crc32

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from benchmarks.outsiders.simulators import RATE_Hz, drive, simulator
from piezoid.errors import PiezoidError
from piezoid.export.parameter_file import AxisParameters, from_json
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.learning.learn import Learned, first_table, next_table
from piezoid.numerics.arrays import Array
from piezoid.records.frames import from_arrays
from piezoid.runtime.controller import Controller
from piezoid.verification.plant import AxisPlant, lateral_plant
from piezoid.verification.scenarios import raster
from piezoid.verification.verify_stage import plant_of
from piezoid_cli.calibration import calibrate
from piezoid_datasets.virtual_lab.campaign import draw_campaign, named
from piezoid_datasets.virtual_lab.stage import Run, Stage, record
from piezoid_datasets.virtual_lab.truths import ZOO
from piezoid_datasets.virtual_lab.write import campaign_files

FREQUENCIES_Hz = (1.0, 10.0, 100.0, 500.0)
SHAPES = ("triangle", "spiral")
PERIODS = 5
NO_MODE_BELOW_Hz = 5e3  # of the virtual stages, as their maker would state
PLANS = ("sweep", "check", "rates", "chirp")  # of what is played for the fit
SHARE = 0.3  # of the range, from its middle
SETTLED_s, LED_s = 0.1, 0.4
_RISES = 0.1  # of the noise

# reading and position, (points,) each, that a table makes in one settled period
Bench = Callable[[Learned, int], tuple[Array, Array]]


@dataclass(frozen=True, kw_only=True)
class Case:
    """One run: errors over the noise, before the first recorded period and after each."""

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
        """Whether no period made it worse by more than a tenth of the noise."""
        return bool((np.diff(self.errors) <= _RISES).all())

    @property
    def converges(self) -> bool:
        """Whether no period beyond twice the noise was worse than the one before."""
        late = np.array(self.errors[1:])
        return bool(((np.diff(self.errors) <= _RISES) | (late <= 2.0)).all())


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
    """Learn every motion on one stage."""
    axis = next(iter(model.axes.values()))
    if parameters is None:
        low_V, high_V = axis.voltage_V
        there_m, _ = axis.hysteresis.run(
            np.array([high_V, low_V, high_V]), axis.hysteresis.virgin_memory()
        )
        offset_m = axis.hysteresis.displacement_offset_m
        ends_m = axis.polarity * (there_m[1:] - offset_m) + offset_m
    else:
        ends_m = np.array([float(parameters.values[f"reference_{e}_m"]) for e in _ENDS])
    middle_m, half_m = float(ends_m.mean()), 0.5 * float(np.ptp(ends_m))
    for shape in SHAPES:
        for frequency_Hz in FREQUENCIES_Hz:
            known = {"stage": stage, "law": law, "shape": shape, "frequency_Hz": frequency_Hz}
            unit = period_of(shape, frequency_Hz, plant.sampling_rate_Hz)
            far_m = SHARE * half_m
            if parameters is not None:  # as fast as the shipped controller lets a reference move
                step_m = float(np.abs(np.diff(unit, append=unit[0])).max())
                far_m = min(far_m, 0.95 * float(parameters.values["reference_step_m"]) / step_m)
            wanted_m = middle_m + far_m * unit
            try:
                first = first_table(axis, plant, wanted_m, parameters=parameters)
                for draw in range(draws):
                    learned, errors = first, []
                    for k in range(PERIODS + 1):
                        read_m, position_m = bench(learned, 100 * draw + k + 1)
                        error_m = wanted_m - position_m
                        if parameters is None:
                            error_m = error_m - error_m.mean()
                        errors.append(float(np.sqrt(np.mean(error_m**2))) / plant.noise_rms)
                        if k < PERIODS:
                            seen = from_arrays(
                                voltage_V=learned.table_V,
                                displacement_m={axis.axis: read_m},
                                sampling_rate_Hz=plant.sampling_rate_Hz,
                            )
                            learned = next_table(learned, axis, plant, seen, parameters=parameters)
                    yield Case(
                        **known,
                        errors=tuple(errors),
                        noise_m=plant.noise_rms,
                        contraction=first.contraction,
                        learns_to_Hz=first.learns_to_Hz,
                    )
            except PiezoidError as refused:
                yield Case(**known, refused=str(refused))


_ENDS = ("minimum", "maximum")
_STEP = ctypes.CFUNCTYPE(
    ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_double, ctypes.c_double
)


def outsiders_bench(name: str, seed: int, values: dict) -> Bench:
    """Return an outsider's stage under the compiled controller with a table."""
    made, ahead = simulator(name), int(values["preview_samples"])

    def bench(learned: Learned, noise_seed: int) -> tuple[Array, Array]:
        points = len(learned.wanted_m)
        settling = 1 + int(np.ceil(SETTLED_s * RATE_Hz / points))
        plant = made.library.stage_open(seed, noise_seed)
        volts, rest = ctypes.c_double(), ctypes.c_double()
        made.library.stage_rest(plant, ctypes.byref(volts), ctypes.byref(rest))
        controller = Controller(values)
        controller.start(volts.value, rest.value)
        ticks, begin = round(LED_s * RATE_Hz), learned.wanted_m[0]
        way = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, ticks))
        led = np.concatenate([rest.value + (begin - rest.value) * way, np.full(ticks // 2, begin)])
        fed = np.tile(learned.table_V, settling + 1)
        fed[:points] *= np.arange(points) / points
        table = iter([*np.zeros(len(led)).tolist(), *fed.tolist(), 0.0])
        path = np.concatenate([led, np.tile(learned.wanted_m, settling + 2)])
        count = len(led) + (settling + 1) * points + 1
        step = _STEP(
            lambda _s, _p, wanted, measured: controller.step(wanted, measured, next(table))
        )

        class Stepped:
            addresses = (ctypes.cast(step, ctypes.c_void_p).value, *controller.addresses[1:])

        reference = path[np.arange(count) + ahead]
        run = drive(Stepped(), made.library.stage_step, plant, reference, rest.value)
        made.library.stage_close(plant)
        kept = slice(count - points - 2, count - 2)  # ends of ticks: the instants after them
        return run.measured[kept], run.position[kept]

    return bench


def outsider_cases(name: str, seed: int, folder: Path, draws: int) -> Iterator[Case]:
    """Calibrate an outsider's stage, then learn on it."""
    made = simulator(name)
    law = str(made.campaigns.stage_truth(seed, made.library).get("law", "?"))
    if not (folder / "model.json").exists():
        made.campaigns.write_stage(seed, folder, made.library)
        found = calibrate(sorted(folder.glob("*.csv")), folder / "lab.toml", lambda _: None)
        for path in ("model.json", "params.json"):
            if path in found.files:
                (folder / path).write_bytes(found.files[path])
    if not (folder / "params.json").exists():
        yield Case(
            stage=f"{name} {seed}", law=law, shape="-", frequency_Hz=0.0, refused="does not ship"
        )
        return
    from piezoid.identification.store import read_model
    from piezoid.records.lab import Lab

    model = read_model((folder / "model.json").read_bytes(), "model.json")
    shipped = from_json((folder / "params.json").read_bytes(), "params.json").axes[0]
    plant = plant_of(shipped, model, Lab())
    bench = outsiders_bench(name, seed, dict(shipped.values))
    yield from runs(f"{name} {seed}", law, model, plant, shipped, bench, draws)


def law_cases(law: str, seed: int, folder: Path, draws: int) -> Iterator[Case]:
    """Calibrate a stage of the virtual laboratory, then learn its drive without any feedback."""
    campaign = draw_campaign(seed, truth=law, plans=PLANS)
    for name, content in campaign_files(campaign).items():
        (folder / Path(name).name).write_bytes(content)
    with (folder / "lab.toml").open("a") as declared:  # the rig has no mode at all
        declared.write(f"\n[actuator]\nbandwidth_Hz = {NO_MODE_BELOW_Hz}\n")
    found = calibrate(sorted(folder.glob("*.csv")), folder / "lab.toml", lambda _: None)
    rig = campaign.rig
    ceramic = named(ZOO, law).draw(np.random.default_rng([seed, crc32(b"ceramic")]))
    axis = next(iter(found.model.axes.values()))
    plant = lateral_plant(axis, sampling_rate_Hz=rig.clock_Hz)

    def bench(learned: Learned, noise_seed: int) -> tuple[Array, Array]:
        points = len(learned.wanted_m)
        settling = 1 + int(np.ceil(SETTLED_s * learned.sampling_rate_Hz / points))
        command_V = np.tile(learned.table_V, settling + 1)
        run = Run(
            name="period",
            sampling_rate_Hz=learned.sampling_rate_Hz,
            command_V=command_V,
            history_V=np.zeros(0),
        )
        rows = record(Stage(rig=rig, ceramic=ceramic, seed=noise_seed), run)
        kept = slice(len(rows.time_s) - points, len(rows.time_s))
        read_m = rows.noise_free_m[kept]
        sensed = 1.0 / (
            1.0
            + 1j
            * np.fft.rfftfreq(points, 1.0 / learned.sampling_rate_Hz)
            / rig.sensor_bandwidth_Hz
        )  # reported by the maker; the reading without it is the position
        position_m = np.fft.irfft(np.fft.rfft(read_m) / sensed, points)
        return rows.displacement_m[kept], position_m

    yield from runs(f"virtual {seed}", law, found.model, plant, None, bench, draws)


def summary(cases: list[Case]) -> str:
    """Return the table: a row for each loop, shape and frequency."""
    lines = [
        "| loop | motion | runs | refused | first table | after 5 periods, median | worst | "
        "at most twice the noise | converges | strictly |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for loop in ("closed", "open"):
        for shape in SHAPES:
            for f in FREQUENCIES_Hz:
                own = [
                    c
                    for c in cases
                    if (c.shape, c.frequency_Hz) == (shape, f)
                    and c.stage.startswith("virtual") == (loop == "open")
                ]
                ran = [c for c in own if c.errors]
                if not ran:
                    continue
                ends = np.array([c.errors[-1] for c in ran])
                lines.append(
                    f"| {loop} | {shape} {f:g} Hz | {len(ran)} | {len(own) - len(ran)} | "
                    f"{np.median([c.errors[0] for c in ran]):.2f} | {np.median(ends):.2f} | "
                    f"{ends.max():.2f} | {np.mean(ends <= 2.0):.0%} | "
                    f"{np.mean([c.converges for c in ran]):.0%} | "
                    f"{np.mean([c.is_monotone for c in ran]):.0%} |"
                )
    ran = [c for c in cases if c.errors]
    lines += [
        "",
        f"{len(ran)} runs: {np.mean([c.errors[-1] <= 2.0 for c in ran]):.1%} at most twice the "
        f"noise, {np.mean([c.converges for c in ran]):.1%} converge monotonely, "
        f"{np.mean([c.is_monotone for c in ran]):.1%} strictly.",
    ]
    return "\n".join(lines)


def draw(cases: list[Case], place: Path) -> None:
    """Draw the error over the noise of every run, period by period."""
    figure = Figure(figsize=(7.2, 2.8), layout="constrained")
    sides = figure.subplots(1, 2, sharey=True)
    for side, loop in zip(sides, ("closed", "open"), strict=True):
        own = [c for c in cases if c.errors and c.stage.startswith("virtual") == (loop == "open")]
        for case in own:
            side.semilogy(case.errors, color="#0072b2", alpha=0.35, lw=0.9)
        side.axhline(2.0, color="#d55e00", lw=1.2, ls="--", label="aim: twice the noise")
        side.set(title=f"{loop} loop, {len(own)} runs", xlabel="recorded periods")
        side.spines[["top", "right"]].set_visible(False)
    sides[0].set(ylabel="rms error / noise of a reading")
    sides[0].legend(frameon=False, fontsize="small")
    with mpl.rc_context({"svg.hashsalt": "piezoid"}):
        figure.savefig(place, format="svg", metadata={"Date": None, "Creator": "piezoid"})


def main() -> None:
    """Print every run, then the table."""
    asked = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    asked.add_argument("--stages", type=int, default=3, help="of each outsider")
    asked.add_argument("--laws", type=int, default=len(ZOO))
    asked.add_argument("--draws", type=int, default=2, help="of the noise, for each motion")
    asked.add_argument("--out", type=Path, default=None, help="keep calibrated stages here")
    asked.add_argument("--figure", type=Path, default=None, help="draw an SVG here")
    given = asked.parse_args()
    cases: list[Case] = []
    with TemporaryDirectory() as scratch:
        place = given.out or Path(scratch)
        tasks = [
            (outsider_cases, name, seed + 1)
            for seed in range(given.stages)
            for name in ("birch", "alder")
        ]
        tasks += [(law_cases, truth.name, k + 1) for k, truth in enumerate(ZOO[: given.laws])]
        for cases_of, name, seed in tasks:
            folder = place / f"{name}-{seed}"
            folder.mkdir(parents=True, exist_ok=True)
            for case in cases_of(name, seed, folder, given.draws):
                cases.append(case)
                shown = " ".join(f"{e:.2f}" for e in case.errors) or case.refused
                print(
                    f"{case.stage}, {case.law}, {case.shape} {case.frequency_Hz:g} Hz, "
                    f"contraction {case.contraction:.2f} to {case.learns_to_Hz:.0f} Hz, "
                    f"noise {1e9 * case.noise_m:.2f} nm: {shown}",
                    flush=True,
                )
    print(summary(cases))
    if given.figure is not None:
        draw(cases, given.figure)


if __name__ == "__main__":
    main()
