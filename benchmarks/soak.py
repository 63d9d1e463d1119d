"""Run ``piezoid fit`` on random stages of every frozen simulator; count crashes and false names.

    python -m benchmarks.soak --stages 300 --seed 1 [--first 0] [--processes 2] [--out build/soak]

Stage ``number`` of a seed is always the same: a simulator, a law, hidden effects, and a change of
the files (format, unit, missing cells, copies, length). ``piezoid fit`` runs in a child process
with limits of processor time and memory. The program reports exceptions, time-outs, budgets that
do not add up, false names of effects, and shipped loops that are unstable on the simulated stage.
It prints the command that reproduces each fault. The exit status is 1 after an exception, a
time-out or an unstable loop.
"""

import argparse
import json
import math
import resource
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from shutil import rmtree
from time import perf_counter
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.outsiders.causes import FAIR
from benchmarks.outsiders.cedar import campaigns as cedar
from benchmarks.outsiders.lateral import is_stable_on
from benchmarks.outsiders.simulators import load_simulator
from benchmarks.zoo.stages import KINDS, NAMES, draw_stage, noise_floor_m, stage
from piezoid_datasets.virtual_lab.write import write_campaign

sys.path.insert(0, str(Path(__file__).parent / "outsiders/dogwood"))
import recordings as dogwood  # its files import each other from their folder

TIME_LIMIT_s = 300  # of processor time
WALL_LIMIT_s = 1800.0  # a process that sleeps uses no processor time
MEMORY_LIMIT_bytes = 2 * 2**30
INTERNAL_ERROR = 70  # exit status of an exception that no message explains
REFUSED = (3, 4)  # unusable data, no solution: an answer
ALWAYS_ALLOWED = {"initial_state", "loop_shape", "something_else"}
BUDGET_TOLERANCE = 0.02  # of the baseline's held-out error, as the contract allows
SIMULATORS = ("alder", "birch", "cedar", "dogwood", "laboratory")
CHANGES = ("none", "none", "nanometres", "decimal_comma", "missing_cells", "copy", "shortened")


@dataclass(frozen=True, kw_only=True)
class Truth:
    """Truth of a simulated stage.

    description  simulator, law and effects as text
    allowed      right names of effects, or None if this simulator does not state them
    noise_m      rms of the noise of sensor and converter; 0 if the simulator does not state it
    """

    description: str
    allowed: tuple[str, ...] | None
    noise_m: float


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Result of ``piezoid fit`` on one stage.

    status   exit status, or the negative number of the signal that ended the process
    fault    exception, time-out, budget, unstable loop, or empty
    closure  held-out error of the final model over the true noise; 0 if the noise is not known
    message  last lines of standard error after a fault or a refusal
    """

    number: int
    stage: str
    change: str
    status: int
    seconds: float
    fault: str = ""
    closure: float = 0.0
    names: tuple[str, ...] = ()
    false_names: tuple[str, ...] = ()
    ships: bool = False
    message: str = ""


def write_stage(seed: int, number: int, folder: Path) -> tuple[Truth, str, Callable[[], bool]]:
    """Write the recordings and lab.toml of a stage.

    Returns the truth, how the files were changed, and a function that tells whether the loop in
    the results folder is stable on the simulated stage.
    """
    rng = np.random.default_rng([seed, number])
    name, change = str(rng.choice(SIMULATORS)), str(rng.choice(CHANGES))
    stage_seed = int(rng.integers(1_000_000, 2**31 - 1))
    truth, is_stable = _WRITERS[name](stage_seed, rng, folder)
    if name == "dogwood":
        change = "none"  # its files are damaged already, in ways that a second change would hide
    _change_files(change, rng, folder)
    return truth, change, is_stable


def _write_outsider(
    name: str, seed: int, _: np.random.Generator, folder: Path
) -> tuple[Truth, Callable[[], bool]]:
    simulator = load_simulator(name)
    law = simulator.stage_law(seed)
    simulator.campaigns.write_stage(seed, folder, simulator.library)
    truth = Truth(description=f"{name} {seed}, {law}", allowed=None, noise_m=0.0)
    return truth, partial(is_stable_on, name, seed, folder / "out/params.json")


def _write_cedar(
    seed: int, rng: np.random.Generator, folder: Path
) -> tuple[Truth, Callable[[], bool]]:
    kinds = list(cedar.kinds())
    hidden = tuple(str(k) for k in rng.choice(kinds, int(rng.integers(0, 3)), replace=False))
    size = float(rng.choice([0.25, 0.5, 1.0]))
    truth = cedar.write(seed, hidden, size, folder, measure=False)
    allowed = {*hidden, *(name for kind in hidden for name in FAIR.get(kind, ()))}
    description = f"cedar {seed}, {truth['law']}, {' + '.join(hidden) or 'healthy'} at {size:g}"
    return (
        Truth(
            description=description,
            allowed=tuple(sorted(allowed)),
            noise_m=float(truth["noise_m"]),
        ),
        _assume_stable,
    )


def _write_dogwood(
    seed: int, rng: np.random.Generator, folder: Path
) -> tuple[Truth, Callable[[], bool]]:
    kind = str(rng.choice(list(dogwood.cases())))
    truth = dogwood.write(kind, seed, folder)["truth"]
    return (
        Truth(description=f"dogwood {seed}, {truth['law']}, {kind}", allowed=None, noise_m=0.0),
        _assume_stable,
    )


def _write_laboratory(
    seed: int, rng: np.random.Generator, folder: Path
) -> tuple[Truth, Callable[[], bool]]:
    request = stage(str(rng.choice(NAMES)), str(rng.choice(list(KINDS))), 0, seed % 10**8)
    campaign = draw_stage(request)
    write_campaign(campaign, folder)
    for path in sorted((folder / "recordings").iterdir()):
        path.rename(folder / path.name)
    rmtree(folder / "recordings")
    rmtree(folder / "truth")
    hidden = tuple(sorted(request.hidden))
    return (
        Truth(
            description=f"laboratory {request.seed}, {request.law}, "
            f"{' + '.join(hidden) or 'healthy'} at {request.size:g}",
            allowed=hidden,
            noise_m=noise_floor_m(campaign),
        ),
        _assume_stable,
    )


def _assume_stable() -> bool:
    """Return True, as these simulators have no plant for a controller."""
    return True


_WRITERS = {
    "alder": partial(_write_outsider, "alder"),
    "birch": partial(_write_outsider, "birch"),
    "cedar": _write_cedar,
    "dogwood": _write_dogwood,
    "laboratory": _write_laboratory,
}


def _change_files(change: str, rng: np.random.Generator, folder: Path) -> None:
    """Rewrite the CSV files as another laboratory would have stored them."""
    if change == "none":
        return
    files, lab = sorted(folder.glob("*.csv")), folder / "lab.toml"
    if change == "nanometres" and lab.exists():  # it may name columns
        lab.write_text(lab.read_text().replace("[um]", "[nm]"))
    if change == "copy":
        (folder / "copy_of.csv").write_bytes(files[0].read_bytes())
        return
    for path in files:
        table = pd.read_csv(path)
        displacement = [c for c in table.columns if "um]" in c or c.endswith("(um)")]
        if change == "nanometres":
            table[displacement] *= 1e3
            table = table.rename(columns={c: c.replace("um", "nm") for c in displacement})
        elif change == "missing_cells":
            rows = rng.choice(len(table), max(1, len(table) // 1000), replace=False)
            table.loc[rows, displacement] = np.nan
        elif change == "shortened":
            table = table.iloc[: max(16, int(len(table) * rng.uniform(0.02, 0.6)))]
        if change == "decimal_comma":
            table.to_csv(path, index=False, sep=";", decimal=",")
        else:
            table.to_csv(path, index=False)


def fit(folder: Path) -> tuple[int, float, str]:
    """Run ``piezoid fit`` on a folder; returns exit status, seconds and standard error."""
    program = Path(sys.executable).with_name("piezoid")
    files = [path.name for path in sorted(folder.glob("*.csv"))]
    lab = ["--lab", "lab.toml"] if (folder / "lab.toml").exists() else []
    command = [str(program), "fit", *files, *lab, "--out", "out", "--quiet", "--processes", "1"]
    start = perf_counter()
    try:
        run = subprocess.run(
            command,
            cwd=folder,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=WALL_LIMIT_s,
            preexec_fn=_limit_resources,
        )
    except subprocess.TimeoutExpired:
        return -signal.SIGXCPU, WALL_LIMIT_s, f"no result after {WALL_LIMIT_s:g} s"
    return run.returncode, perf_counter() - start, " ".join(run.stderr.split())[-400:]


def _limit_resources() -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (TIME_LIMIT_s, TIME_LIMIT_s + 30))
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY_LIMIT_bytes, MEMORY_LIMIT_bytes))


def evaluate(number: int, *, seed: int, root: Path) -> Outcome:
    """Write and fit one stage; its folder stays if there is a fault or a false name."""
    folder = root / f"{seed}-{number}"
    rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    truth, change, is_stable = write_stage(seed, number, folder)
    status, seconds, message = fit(folder)
    names, closure, budget_error = _read_diagnosis(folder / "out/diagnosis.json", truth.noise_m)
    ships = (folder / "out/params.json").exists()
    fault = ""
    if status == -signal.SIGXCPU:
        fault = "time-out"
    elif status == INTERNAL_ERROR or status < 0 or "Traceback" in message:
        fault = "exception"
    elif ships and not is_stable():
        fault = "unstable loop"
    elif budget_error:
        fault = "budget does not add up"
    allowed = None if truth.allowed is None else {*truth.allowed, *ALWAYS_ALLOWED}
    false_names = () if allowed is None else tuple(n for n in names if n not in allowed)
    if not fault and not false_names:
        rmtree(folder)
    return Outcome(
        number=number,
        stage=truth.description,
        change=change,
        status=status,
        seconds=seconds,
        fault=fault,
        closure=closure,
        names=names,
        false_names=false_names,
        ships=ships,
        message=message if fault or status in REFUSED else "",
    )


def _read_diagnosis(path: Path, noise_m: float) -> tuple[tuple[str, ...], float, bool]:
    """Return the names of the findings, final error over true noise, and a broken budget."""
    if not path.exists():
        return (), 0.0, False
    record = json.loads(path.read_bytes())
    names = tuple(finding["effect"] for finding in record["findings"])
    closure = record["final"]["held_out_rms_m"] / noise_m if noise_m > 0.0 else 0.0
    axes = (record, *record.get("axes", {}).values())
    return names, closure, not all(is_budget_right(axis) for axis in axes if "budget" in axis)


def is_budget_right(axis: Mapping[str, Any]) -> bool:
    """Return whether the squares of an error budget add up to the error of the baseline."""
    total_m = math.sqrt(sum(part["rms_m"] ** 2 for part in axis["budget"]))
    baseline_m = axis["baseline"]["held_out_rms_m"]
    return bool(abs(total_m - baseline_m) <= BUDGET_TOLERANCE * baseline_m)


def table(outcomes: Sequence[Outcome], seed: int) -> str:
    """Return the counts and, for each fault, the command that reproduces it."""
    faults = Counter(outcome.fault for outcome in outcomes if outcome.fault)
    closures = [outcome.closure for outcome in outcomes if outcome.closure > 0.0]
    lines = [
        f"{len(outcomes)} stages: {sum(o.status in (0, 1) for o in outcomes)} fitted, "
        f"{sum(o.status in REFUSED for o in outcomes)} refused, "
        f"{sum(o.ships for o in outcomes)} shipped",
        *(f"{fault}: {count}" for fault, count in sorted(faults.items())),
        f"stages with a false name: {sum(bool(o.false_names) for o in outcomes)}",
    ]
    if closures:
        low, median, high = np.quantile(closures, (0.1, 0.5, 0.9))
        lines.append(f"closure: median {median:.2f}, 10 to 90 % {low:.2f} to {high:.2f}")
    for outcome in outcomes:
        if outcome.fault or outcome.false_names:
            fault = outcome.fault or f"false: {', '.join(outcome.false_names)}"
            lines.append(
                f"{fault} ({outcome.stage}; files: {outcome.change}): "
                f"python -m benchmarks.soak --seed {seed} --first {outcome.number} --stages 1"
            )
    return "\n".join(lines)


def main() -> int:
    """Evaluate the stages, print a line for each, then the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--stages", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("build/soak"))
    arguments = parser.parse_args()
    numbers = range(arguments.first, arguments.first + arguments.stages)
    root = arguments.out.absolute()
    root.mkdir(parents=True, exist_ok=True)
    outcomes: list[Outcome] = []
    pool = ProcessPoolExecutor(arguments.processes, mp_context=get_context("spawn"))
    with pool, (root / f"outcomes-{arguments.seed}.jsonl").open("a") as file:
        for outcome in pool.map(partial(evaluate, seed=arguments.seed, root=root), numbers):
            outcomes.append(outcome)
            file.write(json.dumps(asdict(outcome)) + "\n")
            file.flush()
            findings = ", ".join(outcome.names) or "nothing"
            print(
                f"{outcome.number}: {outcome.stage}; files: {outcome.change}; status "
                f"{outcome.status}, {outcome.seconds:.0f} s, closure {outcome.closure:.2f}, "
                f"{findings} {outcome.fault.upper()} {outcome.message[-160:]}",
                flush=True,
            )
    print(table(outcomes, arguments.seed))
    hard = ("exception", "time-out", "unstable loop")
    return int(any(outcome.fault in hard for outcome in outcomes))


if __name__ == "__main__":
    sys.exit(main())
