"""Closure and names on outsiders' stages with none to three hidden effects, by ``piezoid fit``.

    python -m benchmarks.outsiders.closures elder [--stages 12] [--first 1000] [--size 1.0]
        [--groups healthy,single,pair,triple,outside] [--processes 2]

Stage ``number`` of a group is always the same: a seed, and kinds drawn from the simulator's
catalogue (of ``outside``: one in no catalogue, of which the coordinate has to be right). Closure
is the error of the final model over the true noise. A name is right where it is the hidden
effect's, or one that the simulator's author called a fair answer before anything was run.
"""

import argparse
import json
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path
from shutil import rmtree

import numpy as np

from benchmarks.soak import ALWAYS_ALLOWED, BUDGET_TOLERANCE, fit

GROUPS = {"healthy": 0, "single": 1, "pair": 2, "triple": 3, "outside": 1}
SEEDS = 10_000  # between the first seeds of two groups


@dataclass(frozen=True, kw_only=True)
class Closure:
    """What was said of one stage.

    kinds        hidden
    held_out, explained  of the final model, over the true noise; 0: no diagnosis
    noise_floor  stated, over the true noise
    names        of all findings
    coordinate   in which something else lives; empty: nothing is said
    missed, false_names  hidden kinds that have no fair name; names that are fair for none
    is_budget_right  whether its squares add up
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


def judge(task: tuple[str, int], *, simulator: str, first: int, size: float) -> Closure:
    """Write, fit and judge one stage of a group."""
    group, number = task
    campaigns = import_module(f"benchmarks.outsiders.{simulator}.campaigns")
    seed = first + SEEDS * list(GROUPS).index(group) + number
    listed = campaigns.kinds()
    drawn = [k for k, v in listed.items() if (v["catalogue"] is None) == (group == "outside")]
    rng = np.random.default_rng([seed, 0])
    kinds = tuple(map(str, rng.choice(drawn, GROUPS[group], replace=False)))
    folder = Path(f"build/closures/{simulator}-{seed}-{size:g}").absolute()
    rmtree(folder, ignore_errors=True)
    truth = campaigns.write(seed, kinds, size, folder, measure=False)
    status, seconds, message = fit(folder)
    said = Closure(
        group=group,
        seed=seed,
        law=str(truth["law"]),
        kinds=kinds,
        status=status,
        seconds=seconds,
        message="" if status in (0, 1) else message,
    )
    return _read(said, folder / "out", truth["noise_m"], campaigns, listed)


def _read(said: Closure, out: Path, noise_m: float, campaigns, listed: dict) -> Closure:
    if not (out / "diagnosis.json").exists():
        return said
    record = json.loads((out / "diagnosis.json").read_bytes())
    names = tuple(finding["effect"] for finding in record["findings"])
    fair = {kind: {kind, *campaigns.FAIR.get(kind, ())} for kind in said.kinds}
    coordinates = [f["coordinate"] for f in record["findings"] if f.get("coordinate")]
    places = {k: np.atleast_1d(listed[k]["coordinate"] or "") for k in said.kinds}
    total_m = np.sqrt(sum(part["rms_m"] ** 2 for part in record["budget"]))
    baseline_m = record["baseline"]["held_out_rms_m"]
    return Closure(
        **{
            **asdict(said),
            "held_out": record["final"]["held_out_rms_m"] / noise_m,
            "explained": record["final"]["explained_rms_m"] / noise_m,
            "noise_floor": record["noise_floor_rms_m"] / noise_m,
            "names": names,
            "coordinate": coordinates[0] if coordinates else "",
            "missed": tuple(
                kind
                for kind in said.kinds
                if not fair[kind] & set(names) and not set(places[kind]) & set(coordinates)
            ),
            "false_names": tuple(set(names) - ALWAYS_ALLOWED.union(*fair.values())),
            "ships": (out / "params.json").exists(),
            "is_budget_right": bool(abs(total_m - baseline_m) <= BUDGET_TOLERANCE * baseline_m),
        }
    )


def summary(group: str, rows: Sequence[Closure]) -> str:
    """Return a line of figures for one group."""
    known = [row for row in rows if row.held_out > 0.0]
    held_out = np.sort([row.held_out for row in known])
    explained = np.array([row.explained for row in known])
    floor = np.array([row.noise_floor for row in known])
    closures = " ".join(f"{closure:.2f}" for closure in held_out)
    hidden = sum(len(row.kinds) for row in known)
    named = sum(len(set(row.names) - ALWAYS_ALLOWED) for row in known)
    return (
        f"{group}: {len(rows)} stages, {len(known)} diagnosed, {sum(r.ships for r in known)} ship"
        f"; held out <= 1.5 in {sum(held_out <= 1.5)}, <= 2 in {sum(held_out <= 2)}; explained"
        f" <= 1.5 in {sum(explained <= 1.5)}, <= 2 in {sum(explained <= 2)}; held out {closures}; "
        f"{hidden - sum(len(r.missed) for r in known)} of {hidden} effects named, "
        f"{named - sum(len(r.false_names) for r in known)} of {named} names right; noise floor "
        f"within 20 % in {sum(abs(floor - 1.0) <= 0.2)}; "
        f"budgets that do not add up: {sum(not r.is_budget_right for r in known)}"
    )


def main() -> None:
    """Judge all groups, print a line for each stage, then the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("simulator", choices=("cedar", "elder", "rowan"))
    parser.add_argument("--stages", type=int, default=12)
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--size", type=float, default=1.0)
    parser.add_argument("--groups", default=",".join(GROUPS))
    parser.add_argument("--processes", type=int, default=2)
    asked = parser.parse_args()
    groups = asked.groups.split(",")
    tasks = [(group, number) for number in range(asked.stages) for group in groups]
    job = partial(judge, simulator=asked.simulator, first=asked.first, size=asked.size)
    out = Path("build/closures")
    out.mkdir(parents=True, exist_ok=True)
    rows = []
    pool = ProcessPoolExecutor(asked.processes, mp_context=get_context("spawn"))
    with pool, (out / f"{asked.simulator}.jsonl").open("a") as file:
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
