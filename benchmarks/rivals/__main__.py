"""Compare hysteresis models: prediction error, error of the inverse, instructions.

    python -m benchmarks.rivals [--draws 2] [--stages 700-708]

Every class is fitted to one decaying sweep with 0.05 % of noise. The data are from ceramics of all
laws of the zoo, and from stages of third-party simulators with amplifier, mode and sensor at one
cycle per second. The model predicts a walk between random levels, and its inverse drives the
ceramic or stage open-loop along a spiral of five turns over 0.7 of the range. Errors are standard
deviations of the position without sensor noise, in percent of the stroke. Instructions are those
of the inverse on an emulated Cortex-M4F in float; plays run in the shipped runtime.
"""

import argparse
import subprocess
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.outsiders.simulators import (
    NAMES,
    PythonController,
    drive,
    load_simulator,
    seed_range,
)
from benchmarks.recordings import polyline
from benchmarks.rivals.classes import (
    CYCLE,
    FITS,
    FOLDER,
    NODES,
    BoucWen,
    Functions,
    Model,
    Plays,
    Preisach,
)
from piezoid.export.export_stage import function_values
from piezoid.export.parameter_file import AxisParameters, ParameterFile
from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import LINEAR
from piezoid.operators.preisach_plays import PreisachPlays
from piezoid.verification.rebuild import (
    _EMULATED,
    _EMULATOR,
    _FLAGS,
    _TARGET,
    _TARGET_FLAGS,
    emulate,
    target_source,
)
from piezoid_datasets.virtual_lab.truths import ZOO

NOISE, REACH, TURNS, SPIRAL = 5e-4, 0.7, 5, 4000
TICKS = 50  # of the loop of a simulator per sample: 400 samples per cycle of one second
RANGE = 0.9  # of the drive range of a simulator
Respond = Callable[[Array], tuple[Array, Array]]  # field from -1: position and reading


def spiral(model: Model, samples: int) -> tuple[float, float, Array]:
    """Return start, centre and samples of a spiral over 0.7 of the range of a model."""
    rising = model.forward(np.linspace(-1.0, 1.0, 400))
    centre, half_range = 0.5 * (rising[0] + rising[-1]), 0.5 * (rising[-1] - rising[0])
    turn = np.linspace(0.0, 1.0, samples)
    path = centre + REACH * half_range * turn * np.sin(2.0 * np.pi * TURNS * turn)
    return rising[0], centre, path


def ceramic(law: int, seed: int) -> Respond:
    """Return a ceramic of the zoo."""
    material = ZOO[law].draw(np.random.default_rng([seed, law]))
    rng = np.random.default_rng([seed, law, 1])

    def respond(field: Array) -> tuple[Array, Array]:
        path = np.concatenate([np.tile(CYCLE, 2), field])
        position = np.add(*material.respond(path, np.zeros(0)))[-len(field) :]
        return position, position + NOISE * rng.standard_normal(len(field))

    return respond


def simulated_stage(name: str, seed: int) -> tuple[str, Respond]:
    """Return the law of a third-party stage, and the stage at one cycle per second."""
    simulator = load_simulator(name)
    truth = simulator.campaigns.stage_truth(seed, simulator.library)
    limits_V = [truth[f"output_{end}_V"] / truth["amplifier_gain"] for end in ("min", "max")]
    low_V, high_V = max(limits_V[0], -10.0), min(limits_V[1], 10.0)
    centre_V, half_V = 0.5 * (low_V + high_V), 0.5 * RANGE * (high_V - low_V)
    stroke_m = float(truth["stroke_m"])

    def respond(field: Array) -> tuple[Array, Array]:
        plant, rest_V, rest_m = simulator.open_stage(seed, 7)
        approach = np.linspace((rest_V - centre_V) / half_V, -1.0, 100)
        path = np.concatenate([approach, np.tile(CYCLE, 2), field])
        ticks = np.interp(np.arange(len(path) * TICKS) / TICKS, np.arange(len(path)), path)
        open_loop = PythonController(lambda reference, _: reference)
        step = simulator.library.stage_step
        run = drive(open_loop, step, plant, centre_V + half_V * ticks, rest_m)
        simulator.library.stage_close(plant)
        rows = np.arange(len(path) - len(field), len(path)) * TICKS
        sign = float(np.sign(np.polyfit(ticks, run.position, 1)[0]))
        return sign * run.position[rows] / stroke_m, sign * run.measured[rows] / stroke_m

    return str(truth.get("law", "?")), respond


def errors_of(
    respond: Respond, seed: int, classes: Sequence[str]
) -> Iterator[tuple[str, Model, tuple[float, float, float]]]:
    """Yield class, model, and its errors in %: of the fit, on other drives, of the inverse."""
    rng = np.random.default_rng(seed)
    levels = np.linspace(1.0, 0.05, 31) * (-1.0) ** np.arange(31)
    sweep = polyline(np.concatenate([[-1.0], levels]), 100)
    walk = polyline(np.concatenate([[-1.0, 1.0, -1.0], rng.uniform(-1.0, 1.0, 30)]), 100)
    _, reading = respond(sweep)
    position, _ = respond(walk)
    stroke = float(np.ptp(reading))
    for name in classes:
        model = FITS[name](sweep, reading)
        start, centre, path = spiral(model, SPIRAL)
        reference = np.concatenate([np.linspace(start, centre, 200), path])
        response, _ = respond(model.inverse(reference))
        fit, prediction, inverse = (
            100.0 * float(np.std(error)) / stroke
            for error in (
                model.forward(sweep) - reading,
                model.forward(walk) - position,
                (response - reference)[200:],
            )
        )
        yield name, model, (fit, prediction, inverse)


def instructions(models: dict[str, Model]) -> dict[str, float]:
    """Return instructions per sample of every inverse; NaN without the tools."""
    counts = {}
    for name, model in models.items():
        if isinstance(model, Plays | Functions):
            proof = emulate(ParameterFile(name="rival", axes=(_axis(model),)))
            counts[name] = float((proof.instructions_per_sample or {"x": np.nan})["x"])
    table, state = models.get("Preisach"), models.get("Bouc-Wen")
    if isinstance(table, Preisach) and isinstance(state, BoucWen):
        try:
            counts["Preisach"], counts["Bouc-Wen"] = _emulated_instructions(table, state)
        except (OSError, subprocess.CalledProcessError):
            counts["Preisach"] = counts["Bouc-Wen"] = np.nan
    return counts


def _axis(model: Plays | Functions) -> AxisParameters:
    operator = model.operator
    values = {
        "method": "mpi",
        "gain_m_per_V": float(np.mean(operator.slope_sector_m_per_V)),
        "voltage_minimum_V": -1.0,
        "voltage_maximum_V": 1.0,
        "reference_minimum_m": -1.0,
        "reference_maximum_m": 1.0,
        "displacement_minimum_m": -2.0,
        "displacement_maximum_m": 2.0,
    }
    if isinstance(operator, PreisachPlays):
        values |= function_values(operator)
        return AxisParameters(axis="x", values=values)  # type: ignore[arg-type]
    values |= {
        "play_count": len(operator.plays.threshold),
        "play_threshold_V": operator.plays.threshold,
        "play_weight_m_per_V": operator.plays.weight,
        "knot_count": len(operator.dead_zones.threshold),
        "knot_m": operator.dead_zones.threshold,
        "knot_weight": operator.dead_zones.weight,
    }
    if operator.envelope is not LINEAR:
        values |= {
            "envelope_count": len(operator.envelope.threshold),
            "envelope_knot_V": operator.envelope.threshold,
            "envelope_weight": operator.envelope.weight,
        }
    return AxisParameters(axis="x", values=values)  # type: ignore[arg-type]


def _emulated_instructions(table: Preisach, state: BoucWen) -> tuple[float, float]:
    _, _, path = spiral(table, 1000)
    rows = ",".join("{" + ",".join(f"{v:.9e}f" for v in row) + "}" for row in table.table)
    lines = (
        f"static const preisach table = {{{{{rows}}}, -1.0f, {2.0 / (NODES - 1):.9e}f}};",
        f"static const real start = {table.start:.9e}f;",
        f"static const bouc_wen state = {{{','.join(f'{v:.9e}f' for v in state.numbers)}}};",
        f"static const real path[] = {{{','.join(f'{v:.9e}f' for v in path)}}};",
    )
    with TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "numbers.h").write_text("\n".join(lines))
        (folder / "inverses.c").write_bytes((FOLDER / "inverses.c").read_bytes())
        for source in ("board.c", "board.ld"):
            (folder / source).write_bytes(target_source(source))
        files = ("inverses.c", "board.c", "-T", "board.ld", "-lm", "-o", "replay.elf")
        flags = (*_FLAGS, *_TARGET_FLAGS, "-DBOARD", "-DSINGLE")
        subprocess.run((_TARGET, *flags, *files), cwd=folder, check=True, capture_output=True)
        output = subprocess.run(
            (_EMULATOR, *_EMULATED), cwd=folder, check=True, capture_output=True, text=True
        ).stdout
    counts = [int(count) / len(path) for count in output.split()]
    return counts[0], counts[1]


def main() -> None:
    """Print every ceramic and stage, then the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--draws", type=int, default=2, help="ceramics of each law of the zoo")
    parser.add_argument("--first", type=int, default=0, help="first seed of the ceramics")
    parser.add_argument("--classes", default="; ".join(FITS), help="names of classes")
    parser.add_argument("--stages", default="700-708", help="seeds of each simulator, or empty")
    options = parser.parse_args()
    classes = options.classes.split("; ")
    cases = [
        ("zoo", law.name, f"{law.name} {seed}", ceramic(index, seed), seed)
        for index, law in enumerate(ZOO)
        for seed in range(options.first, options.first + options.draws)
    ]
    for seed in seed_range(options.stages):
        for name in NAMES:
            law, respond = simulated_stage(name, seed)
            cases.append(("outsiders", law, f"{name} {seed}, {law}", respond, seed))
    errors: dict[tuple[str, str], list[tuple[float, float, float]]] = {}
    by_law: dict[str, dict[str, list[float]]] = {}
    models: dict[str, Model] = {}
    for kind, law, title, respond, seed in cases:
        cells = []
        for name, model, class_errors in errors_of(respond, seed, classes):
            models[name] = model
            errors.setdefault((kind, name), []).append(class_errors)
            by_law.setdefault(f"{kind}: {law}", {}).setdefault(name, []).append(class_errors[2])
            cells.append(f"{name} " + " ".join(f"{error:.3f}" for error in class_errors))
        print(f"{kind} {title}: " + "; ".join(cells), flush=True)
    counts = instructions(models)
    print("fit, other drives and inverse, median (worst), % of the stroke")
    for kind in dict.fromkeys(kind for kind, _ in errors):
        print(f"\n{kind}, {len(errors[kind, classes[0]])}")
        print("| class | parameters | fit | other drives | inverse | instructions |")
        print("| --- | --- | --- | --- | --- | --- |")
        for name in classes:
            columns = np.array(errors[kind, name]).T
            cells = (f"{np.median(column):.3f} ({column.max():.2f})" for column in columns)
            print(
                f"| {name} | {models[name].parameters} | {' | '.join(cells)} | "
                f"{counts.get(name, np.nan):.0f} |"
            )
    print("\n| inverse, by law | " + " | ".join(classes) + " |")
    print("| --- |" + " --- |" * len(classes))
    for law, inverse_errors in by_law.items():
        medians = (f"{np.median(inverse_errors[name]):.3f}" for name in classes)
        print(f"| {law} | " + " | ".join(medians) + " |")


if __name__ == "__main__":
    main()
