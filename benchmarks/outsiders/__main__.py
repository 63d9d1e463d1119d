"""Calibrate stages and tips of two simulators, and run what ships on their plants.

    python -m benchmarks.outsiders [--only birch] [--stages 101-120] [--tips 101-110]

Every seed is another stage and takes a minute of one core.
"""

import argparse
import json
from multiprocessing import get_context
from pathlib import Path

from benchmarks.outsiders.lateral import StageResult
from benchmarks.outsiders.simulators import NAMES, seed_range
from benchmarks.outsiders.tasks import evaluate


def main() -> None:
    """Evaluate all seeds, print a line for each, then the totals."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=NAMES)
    parser.add_argument("--stages", default="101-120")
    parser.add_argument("--tips", default="101-110")
    parser.add_argument("--out", type=Path, default=Path("build/outsiders/results.jsonl"))
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    names = [options.only] if options.only else list(NAMES)
    tasks = [("stage", name, seed) for name in names for seed in seed_range(options.stages)]
    tasks += [("tip", name, seed) for name in names for seed in seed_range(options.tips)]
    options.out.parent.mkdir(parents=True, exist_ok=True)
    rows = []
    with get_context("spawn").Pool(options.processes) as pool, options.out.open("w") as file:
        for row in pool.imap(evaluate, tasks):
            rows.append(row)
            file.write(json.dumps(row) + "\n")
            file.flush()
            print(_line(row), flush=True)
    for name in names:
        simulator_rows = [row for row in rows if row["simulator"] == name]
        print(_stage_totals(name, [row for row in simulator_rows if row["kind"] == "stage"]))
        print(_tip_totals(name, [row for row in simulator_rows if row["kind"] == "tip"]))


def _line(row: dict) -> str:
    head = f"{row['simulator']} {row['kind']} {row['seed']}"
    if not row["ships"]:
        return f"{head}: does not ship: {row['reason'][:160]}"
    if row["kind"] == "tip":
        return (
            f"{head}: closest {row['closest_m'] * 1e9:.2f} nm, least gap "
            f"{row['least_gap_m'] * 1e9:.2f} nm, recovery {row['slowest_s']:.2f} s; latched: "
            f"{', '.join(row['latched']) or 'none'}; not latched: {row['not_latched']}; "
            f"{row['covered']}"
        )
    stage = StageResult(**{key: value for key, value in row.items() if key != "kind"})
    return (
        f"{head}: {stage.law}, mode {stage.mode_Hz:.0f} Hz, Q {stage.quality:.0f}: "
        f"{stage.loop_summary()}"
    )


def _stage_totals(name: str, rows: list[dict]) -> str:
    shipped = [row for row in rows if row["ships"]]
    stable = [row for row in shipped if row["stable"]]
    tenth = [row for row in stable if row["error_10_m"] <= 0.1 * row["none_10_m"]]
    runs, broken = (sum(row[key] for row in shipped) for key in ("bound_runs", "bound_broken"))
    worst = max((row["worst_to_bound"] for row in shipped), default=0.0)
    ratios = [ratio for row in shipped for _, _, ratio in row["ratios"]]
    close = sum(0.5 <= ratio <= 2.0 for ratio in ratios)
    return (
        f"{name}: {len(rows)} stages, {len(shipped)} ship, {len(stable)} stable, {len(tenth)} "
        f"track 10 Hz at a tenth of none or less; bound broken {broken} of {runs}, worst "
        f"{worst:.2f}; true error 0.5 to 2 times the predicted one in {close} of {len(ratios)}"
    )


def _tip_totals(name: str, rows: list[dict]) -> str:
    shipped = [row for row in rows if row["ships"]]
    closest = max((row["closest_m"] for row in shipped), default=0.0)
    crashes = sum(len(row["crashes"]) for row in shipped)
    coverage = {}
    for key in ("sweeps", "loop", "delay"):
        intervals = [row["covered"][key] for row in rows if row["covered"][key] is not None]
        coverage[key] = f"{key} {sum(intervals)} of {len(intervals)}"
    return (
        f"{name}: {len(rows)} tips, {len(shipped)} ship, {crashes} crashes, closest "
        f"{closest * 1e9:.2f} nm beyond; intervals that hold: {', '.join(coverage.values())}"
    )


if __name__ == "__main__":
    main()
