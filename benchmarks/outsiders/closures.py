"""Closure and names on stages of three simulators with none to three hidden effects.

    python -m benchmarks.outsiders.closures elder [--stages 12] [--first 1000] [--size 1.0]
        [--groups healthy,single,pair,triple,outside] [--processes 2]

``piezoid fit`` runs on each stage. Stage ``number`` of a group is always the same: a seed, and
effects drawn from the catalogue (for ``outside``, one effect outside the catalogue, whose
coordinate must be right). Closure is the error of the final model over the true noise of sensor
and converter, whose steps no model removes. A name is right if it is that of a hidden effect, or
one that the author of the simulator declared fair before the first run.
"""

import argparse
import json
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import partial
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path
from shutil import rmtree

import numpy as np

from benchmarks.outsiders.causes import FAIR as FAIR_OF_CEDAR
from benchmarks.soak import ALWAYS_ALLOWED, fit, is_budget_right

GROUPS = {"healthy": 0, "single": 1, "pair": 2, "triple": 3, "outside": 1}
SEEDS = 10_000  # between the first seeds of two groups


@dataclass(frozen=True, kw_only=True)
class Closure:
    """Result of one stage.

    kinds        of the hidden effects
    held_out, explained  errors of the final model over the true noise; 0 without a diagnosis
    noise_floor  stated noise floor over the true noise
    names        of all findings
    coordinate   of the unexplained structure; empty if none is stated
    missed       hidden kinds without a right name or coordinate
    false_names  names that are right for no hidden kind
    is_budget_right  whether the squares of the error budget add up
    """

    group: str
    seed: int
    law: str
    kinds: tuple[str, ...]
    status: int
    seconds: float
    message: str
    held_out: float = 0.0
    explained: float = 0.0
    noise_floor: float = 0.0
    names: tuple[str, ...] = ()
    coordinate: str = ""
    missed: tuple[str, ...] = ()
    false_names: tuple[str, ...] = ()
    ships: bool = False
    is_budget_right: bool = True


def evaluate(task: tuple[str, int], *, simulator: str, first: int, size: float) -> Closure:
    """Write and fit one stage of a group."""
    group, number = task
    campaigns = import_module(f"benchmarks.outsiders.{simulator}.campaigns")
    seed = first + SEEDS * list(GROUPS).index(group) + number
    candidates = [
        kind
        for kind, description in campaigns.kinds().items()
        if (description["catalogue"] is None) == (group == "outside")
    ]
    rng = np.random.default_rng([seed, 0])
    kinds = tuple(map(str, rng.choice(candidates, GROUPS[group], replace=False)))
    folder = Path(f"build/closures/{simulator}-{seed}-{size:g}").absolute()
    rmtree(folder, ignore_errors=True)
    truth = campaigns.write(seed, kinds, size, folder, measure=False)
    status, seconds, message = fit(folder)
    result = Closure(
        group=group,
        seed=seed,
        law=str(truth["law"]),
        kinds=kinds,
        status=status,
        seconds=seconds,
        message="" if status in (0, 1) else message,
    )
    out = folder / "out"
    if not (out / "diagnosis.json").exists():
        return result
    record = json.loads((out / "diagnosis.json").read_bytes())
    steps_m = [effect.get("parameters", {}).get("step_m", 0.0) for effect in truth["effects"]]
    noise_m = float(np.linalg.norm([truth["noise_m"], *np.array(steps_m) / np.sqrt(12.0)]))
    names = tuple(finding["effect"] for finding in record["findings"])
    declared = getattr(campaigns, "FAIR", FAIR_OF_CEDAR)
    fair = {kind: {kind, *declared.get(kind, ())} for kind in kinds}
    coordinates = [f["coordinate"] for f in record["findings"] if f.get("coordinate")]
    expected = {k: np.atleast_1d(campaigns.kinds()[k]["coordinate"] or "") for k in kinds}
    return replace(
        result,
        held_out=record["final"]["held_out_rms_m"] / noise_m,
        explained=record["final"]["explained_rms_m"] / noise_m,
        noise_floor=record["noise_floor_rms_m"] / noise_m,
        names=names,
        coordinate=coordinates[0] if coordinates else "",
        missed=tuple(
            kind
            for kind in kinds
            if not fair[kind] & set(names) and not set(expected[kind]) & set(coordinates)
        ),
        false_names=tuple(set(names) - ALWAYS_ALLOWED.union(*fair.values())),
        ships=(out / "params.json").exists(),
        is_budget_right=is_budget_right(record),
    )


def summary(group: str, rows: Sequence[Closure]) -> str:
    """Return a line of figures for one group."""
    diagnosed = [row for row in rows if row.held_out > 0.0]
    held_out = np.sort([row.held_out for row in diagnosed])
    explained = np.array([row.explained for row in diagnosed])
    floor = np.array([row.noise_floor for row in diagnosed])
    closures = " ".join(f"{closure:.2f}" for closure in held_out)
    hidden = sum(len(row.kinds) for row in diagnosed)
    missed = sum(len(row.missed) for row in diagnosed)
    names = sum(len(set(row.names) - ALWAYS_ALLOWED) for row in diagnosed)
    false_names = sum(len(row.false_names) for row in diagnosed)
    return (
        f"{group}: {len(rows)} stages, {len(diagnosed)} diagnosed, "
        f"{sum(row.ships for row in diagnosed)} ship"
        f"; held out <= 1.5 in {sum(held_out <= 1.5)}, <= 2 in {sum(held_out <= 2)}; explained"
        f" <= 1.5 in {sum(explained <= 1.5)}, <= 2 in {sum(explained <= 2)}; held out {closures}; "
        f"{hidden - missed} of {hidden} effects named, "
        f"{names - false_names} of {names} names right; noise floor "
        f"within 20 % in {sum(abs(floor - 1.0) <= 0.2)}; "
        f"budgets that do not add up: {sum(not row.is_budget_right for row in diagnosed)}"
    )


def main() -> None:
    """Evaluate all groups, print a line for each stage, then the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("simulator", choices=("cedar", "elder", "rowan"))
    parser.add_argument("--stages", type=int, default=12)
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--size", type=float, default=1.0)
    parser.add_argument("--groups", default=",".join(GROUPS))
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    groups = options.groups.split(",")
    tasks = [(group, number) for number in range(options.stages) for group in groups]
    job = partial(evaluate, simulator=options.simulator, first=options.first, size=options.size)
    out = Path("build/closures")
    out.mkdir(parents=True, exist_ok=True)
    rows = []
    pool = ProcessPoolExecutor(options.processes, mp_context=get_context("spawn"))
    with pool, (out / f"{options.simulator}.jsonl").open("a") as file:
        for row in pool.map(job, tasks):
            rows.append(row)
            file.write(json.dumps(asdict(row)) + "\n")
            file.flush()
            missed, false = (", ".join(n) or "none" for n in (row.missed, row.false_names))
            print(
                f"{row.group} {row.seed} {row.law}, {' + '.join(row.kinds) or 'healthy'}: "
                f"{row.held_out:.2f} ({row.explained:.2f}), {', '.join(row.names)}"
                f"{' [' + row.coordinate + ']' if row.coordinate else ''}; missed {missed}; "
                f"false {false}; "
                f"{'ships' if row.ships else 'no controller'}, {row.seconds:.0f} s {row.message}",
                flush=True,
            )
    for group in groups:
        print(summary(group, [row for row in rows if row.group == group]))


if __name__ == "__main__":
    main()
