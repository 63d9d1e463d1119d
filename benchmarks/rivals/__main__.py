"""Rivals of the hysteresis model in one run: error on other drives, inverse error, instructions.

    python -m benchmarks.rivals [--draws 2] [--stages 700-708]

Every class is fitted to one decaying sweep with 0.05 % of noise: of ceramics of every law of the
zoo, and of stages of outsiders, recorded through their amplifiers, modes and sensors at a cycle a
second. Then it predicts a walk between random levels, and its inverse drives the ceramic or stage
open-loop along a spiral of five turns over 0.7 of the range. Errors are those of the position
without the sensor's noise, rms, of the stroke; a constant is taken away. Instructions are those of
the inverse on an emulated Cortex-M4F in float, of plays in the runtime that ships.
"""

import argparse
import ctypes
import subprocess
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.outsiders.simulators import NAMES, drive, simulator
from benchmarks.rivals.classes import (
    CLASSES,
    CYCLE,
    HERE,
    NODES,
    BoucWen,
    Functions,
    Model,
    Plays,
    Preisach,
    fitted,
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
TICKS = 50  # of an outsider's loop for each sample: 400 a cycle of one second
SHARE = 0.9  # of an outsider's range
Respond = Callable[[Array], tuple[Array, Array]]  # field from -1: position and reading


def through(levels: Array) -> Array:
    """Return straight runs between levels, 100 samples a unit of field."""
    runs = [np.linspace(a, b, int(100 * abs(b - a)) + 3)[1:] for a, b in pairwise(levels)]
    return np.concatenate([levels[:1], *runs])


def ceramic(law: int, seed: int) -> Respond:
    """Return a ceramic of the zoo."""
    made = ZOO[law].draw(np.random.default_rng([seed, law]))
    rng = np.random.default_rng([seed, law, 1])

    def respond(field: Array) -> tuple[Array, Array]:
        path = np.concatenate([np.tile(CYCLE, 2), field])
        moved = np.add(*made.respond(path, np.zeros(0)))[-len(field) :]
        return moved, moved + NOISE * rng.standard_normal(len(field))

    return respond


_STEP = ctypes.CFUNCTYPE(
    ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_double, ctypes.c_double
)


class _Played:
    """What puts out its reference, where a controller would be."""

    def __init__(self) -> None:
        self._step = _STEP(lambda _state, _parameters, wanted, _measured: wanted)
        self._status = (ctypes.c_uint32 * 2)()

    @property
    def addresses(self) -> tuple[int | None, int, int]:
        """Of the step, and of a state without anything."""
        status = ctypes.addressof(self._status)
        return ctypes.cast(self._step, ctypes.c_void_p).value, status, status


def outsider(name: str, seed: int) -> tuple[str, Respond]:
    """Return the law of an outsider's stage, and the stage at a cycle a second."""
    made = simulator(name)
    truth = made.campaigns.stage_truth(seed, made.library)
    ends = [truth[f"output_{e}_V"] / truth["amplifier_gain"] for e in ("min", "max")]
    low_V, high_V = max(ends[0], -10.0), min(ends[1], 10.0)
    middle_V, half_V = 0.5 * (low_V + high_V), 0.5 * SHARE * (high_V - low_V)
    stroke_m = float(truth["stroke_m"])

    def respond(field: Array) -> tuple[Array, Array]:
        plant = made.library.stage_open(seed, 7)
        volts, rest = ctypes.c_double(), ctypes.c_double()
        made.library.stage_rest(plant, ctypes.byref(volts), ctypes.byref(rest))
        begin = np.linspace((volts.value - middle_V) / half_V, -1.0, 100)
        path = np.concatenate([begin, np.tile(CYCLE, 2), field])
        ticks = np.interp(np.arange(len(path) * TICKS) / TICKS, np.arange(len(path)), path)
        run = drive(
            _Played(),  # type: ignore[arg-type]
            made.library.stage_step,
            plant,
            middle_V + half_V * ticks,
            rest.value,
        )
        made.library.stage_close(plant)
        at = np.arange(len(path) - len(field), len(path)) * TICKS
        sign = float(np.sign(np.polyfit(ticks, run.position, 1)[0]))
        return sign * run.position[at] / stroke_m, sign * run.measured[at] / stroke_m

    return str(truth.get("law", "?")), respond


def measured(
    respond: Respond, seed: int, classes: Sequence[str]
) -> Iterator[tuple[str, Model, float, float, float]]:
    """Yield class, model, and its errors: of the fit, on other drives, of the inverse, in %."""
    rng = np.random.default_rng(seed)
    sweep = through(np.concatenate([[-1.0], np.linspace(1.0, 0.05, 31) * (-1.0) ** np.arange(31)]))
    walk = through(np.concatenate([[-1.0, 1.0, -1.0], rng.uniform(-1.0, 1.0, 30)]))
    _, seen = respond(sweep)
    moved, _ = respond(walk)
    stroke = float(np.ptp(seen))
    turn = np.linspace(0.0, 1.0, SPIRAL)
    for name in classes:
        model = fitted(name, sweep, seen)
        up = model.forward(np.linspace(-1.0, 1.0, 400))
        middle, half = 0.5 * (up[0] + up[-1]), 0.5 * (up[-1] - up[0])
        spiral = middle + REACH * half * turn * np.sin(2.0 * np.pi * TURNS * turn)
        led = np.concatenate([np.linspace(up[0], middle, 200), spiral])
        reached, _ = respond(model.inverse(led))
        left = (model.forward(sweep) - seen, model.forward(walk) - moved, (reached - led)[200:])
        yield name, model, *(100.0 * float(np.std(e)) / stroke for e in left)


def instructions(models: dict[str, Model]) -> dict[str, float]:
    """Return instructions a sample of every inverse, as far as the tools are here."""
    found = {}
    for name, model in models.items():
        if isinstance(model, Plays | Functions):
            proof = emulate(ParameterFile(name="rival", axes=(_axis(model),)))
            found[name] = float((proof.instructions_per_sample or {"x": np.nan})["x"])
    table, state = models.get("Preisach"), models.get("Bouc-Wen")
    if not isinstance(table, Preisach) or not isinstance(state, BoucWen):
        return found
    try:
        counts = _on_the_board(table, state)
    except (OSError, subprocess.CalledProcessError):
        counts = (np.nan, np.nan)
    return found | {"Preisach": counts[0], "Bouc-Wen": counts[1]}


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


def _on_the_board(table: Preisach, state: BoucWen) -> tuple[float, float]:
    up = table.forward(np.linspace(-1.0, 1.0, 400))
    middle, half = 0.5 * (up[0] + up[-1]), 0.5 * (up[-1] - up[0])
    turn = np.linspace(0.0, 1.0, 1000)
    wanted = middle + REACH * half * turn * np.sin(2.0 * np.pi * TURNS * turn)
    rows = ",".join("{" + ",".join(f"{v:.9e}f" for v in row) + "}" for row in table.table)
    lines = (
        f"static const preisach table = {{{{{rows}}}, -1.0f, {2.0 / (NODES - 1):.9e}f}};",
        f"static const real start = {table.begun:.9e}f;",
        f"static const bouc_wen state = {{{','.join(f'{v:.9e}f' for v in state.numbers)}}};",
        f"static const real wanted[] = {{{','.join(f'{v:.9e}f' for v in wanted)}}};",
    )
    with TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "numbers.h").write_text("\n".join(lines))
        (folder / "inverses.c").write_bytes((HERE / "inverses.c").read_bytes())
        for own in ("board.c", "board.ld"):
            (folder / own).write_bytes(target_source(own))
        made = ("inverses.c", "board.c", "-T", "board.ld", "-lm", "-o", "replay.elf")
        flags = (*_FLAGS, *_TARGET_FLAGS, "-DBOARD", "-DSINGLE")
        subprocess.run((_TARGET, *flags, *made), cwd=folder, check=True, capture_output=True)
        said = subprocess.run(
            (_EMULATOR, *_EMULATED), cwd=folder, check=True, capture_output=True, text=True
        ).stdout
    counts = [int(count) / len(wanted) for count in said.split()]
    return counts[0], counts[1]


def main() -> None:
    """Print every ceramic and stage, then the table."""
    asked = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    asked.add_argument("--draws", type=int, default=2, help="ceramics of each law of the zoo")
    asked.add_argument("--first", type=int, default=0, help="seed of the first of them")
    asked.add_argument("--classes", default="; ".join(CLASSES), help="names of classes")
    asked.add_argument("--stages", default="700-708", help="seeds of each outsider; empty: none")
    given = asked.parse_args()
    classes = given.classes.split("; ")
    truths = [
        ("zoo", f"{law.name} {seed}", ceramic(place, seed), seed)
        for place, law in enumerate(ZOO)
        for seed in range(given.first, given.first + given.draws)
    ]
    if given.stages:
        first, _, last = given.stages.partition("-")
        for seed in range(int(first), int(last or first) + 1):
            for name in NAMES:
                law, respond = outsider(name, seed)
                truths.append(("outsiders", f"{name} {seed}, {law}", respond, seed))
    errors: dict[tuple[str, str], list[tuple[float, float, float]]] = {}
    by_law: dict[str, dict[str, list[float]]] = {}
    models: dict[str, Model] = {}
    for kind, told, respond, seed in truths:
        shown = []
        for name, model, *left in measured(respond, seed, classes):
            models[name] = model
            errors.setdefault((kind, name), []).append((left[0], left[1], left[2]))
            law = told.rpartition(" ")[0] if kind == "zoo" else told.partition(", ")[2]
            by_law.setdefault(f"{kind}: {law}", {}).setdefault(name, []).append(left[2])
            shown.append(f"{name} {left[0]:.3f} {left[1]:.3f} {left[2]:.3f}")
        print(f"{kind} {told}: " + "; ".join(shown), flush=True)
    counts = instructions(models)
    print("fit, other drives and inverse, median (worst), % of the stroke")
    for kind in dict.fromkeys(kind for kind, _ in errors):
        print(f"\n{kind}, {len(errors[kind, classes[0]])}")
        print("| class | parameters | fit | other drives | inverse | instructions |")
        print("| --- | --- | --- | --- | --- | --- |")
        for name in classes:
            each = np.array(errors[kind, name])
            cells = (f"{np.median(c):.3f} ({c.max():.2f})" for c in each.T)
            print(
                f"| {name} | {models[name].parameters} | {' | '.join(cells)} | "
                f"{counts[name]:.0f} |"
            )
    print("\n| inverse, by law | " + " | ".join(classes) + " |")
    print("| --- |" + " --- |" * len(classes))
    for law, each in by_law.items():
        print(f"| {law} | " + " | ".join(f"{np.median(each[n]):.3f}" for n in classes) + " |")


if __name__ == "__main__":
    main()
