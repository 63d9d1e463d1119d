"""Stages and tips of both outsiders: what ships, what is stable, what was promised.

    python -m benchmarks.outsiders [--only birch] [--stages 101-120] [--tips 101-110]

Every seed is a stage of its own; a minute of one core for each.
"""

import argparse
import json
from multiprocessing import get_context
from pathlib import Path

from benchmarks.outsiders.simulators import NAMES
from benchmarks.outsiders.tasks import judged


def _seeds(text: str) -> list[int]:
    first, _, last = text.partition("-")
    return list(range(int(first), int(last or first) + 1)) if text else []


def main() -> None:
    """Judge, print a line for each, then the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=NAMES)
    parser.add_argument("--stages", default="101-120")
    parser.add_argument("--tips", default="101-110")
    parser.add_argument("--out", type=Path, default=Path("build/outsiders/results.jsonl"))
    parser.add_argument("--processes", type=int, default=2)
    asked = parser.parse_args()
    names = [asked.only] if asked.only else list(NAMES)
    tasks = [("stage", n, s) for n in names for s in _seeds(asked.stages)]
    tasks += [("tip", n, s) for n in names for s in _seeds(asked.tips)]
    asked.out.parent.mkdir(parents=True, exist_ok=True)
    rows = []
    with get_context("spawn").Pool(asked.processes) as pool, asked.out.open("w") as file:
        for found in pool.imap(judged, tasks):
            rows.append(found)
            file.write(json.dumps(found) + "\n")
            file.flush()
            print(_line(found), flush=True)
    for name in names:
        print(_stages(name, [r for r in rows if r["kind"] == "stage" and r["simulator"] == name]))
        print(_tips(name, [r for r in rows if r["kind"] == "tip" and r["simulator"] == name]))


def _line(r: dict) -> str:
    head = f"{r['simulator']} {r['kind']} {r['seed']}"
    if not r["ships"]:
        return f"{head}: does not ship: {r['reason'][:160]}"
    if r["kind"] == "tip":
        return (
            f"{head}: closest {r['closest_m'] * 1e9:.2f} nm, least gap "
            f"{r['least_gap_m'] * 1e9:.2f} nm, back {r['slowest_s']:.2f} s; latched: "
            f"{', '.join(r['latched']) or 'none'}; not latched: {r['not_latched']}; {r['covered']}"
        )
    return (
        f"{head}: {r['law']}, mode {r['mode_Hz']:.0f} Hz, Q {r['quality']:.0f}: "
        f"{'stable' if r['stable'] else 'UNSTABLE'}, {r['bandwidth_Hz']:.0f} Hz, at 10 Hz "
        f"{r['error_10_m'] * 1e9:.1f} nm of {r['none_10_m'] * 1e9:.0f} nm; bound "
        f"{r['bound_broken']} of {r['bound_runs']} broken, worst {r['worst_to_bound']:.2f}"
    )


def _stages(name: str, rows: list[dict]) -> str:
    ships = [r for r in rows if r["ships"]]
    stable = [r for r in ships if r["stable"]]
    tenth = [r for r in stable if r["error_10_m"] <= 0.1 * r["none_10_m"]]
    runs, broken = (sum(r[key] for r in ships) for key in ("bound_runs", "bound_broken"))
    worst = max((r["worst_to_bound"] for r in ships), default=0.0)
    ratios = [x for r in ships for _, _, x in r["ratios"]]
    inside = sum(0.5 <= x <= 2.0 for x in ratios)
    return (
        f"{name}: {len(rows)} stages, {len(ships)} ship, {len(stable)} stable, {len(tenth)} track "
        f"10 Hz at a tenth of none or less; bound broken {broken} of {runs}, worst {worst:.2f}; "
        f"truth over own figure in 0.5-2 for {inside} of {len(ratios)}"
    )


def _tips(name: str, rows: list[dict]) -> str:
    ships = [r for r in rows if r["ships"]]
    closest = max((r["closest_m"] for r in ships), default=0.0)
    crashes = sum(len(r["crashes"]) for r in ships)
    held = {}
    for key in ("sweeps", "loop", "delay"):
        known = [r["covered"][key] for r in rows if r["covered"][key] is not None]
        held[key] = (sum(known), len(known))
    return (
        f"{name}: {len(rows)} tips, {len(ships)} ship, {crashes} crashes, closest "
        f"{closest * 1e9:.2f} nm beyond; intervals that hold: "
        + ", ".join(f"{key} {a} of {b}" for key, (a, b) in held.items())
    )


if __name__ == "__main__":
    main()
