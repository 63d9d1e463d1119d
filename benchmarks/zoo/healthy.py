"""How much healthy stages show: the table by which the diagnosis tells what is more than that.

    python -m benchmarks.zoo.healthy [--cases 4] [--seeds 2500000] [--json build/healthy.jsonl]
                                     [--minutes 60] [--workers 2] [--write]

Healthy stages of every law are diagnosed, each is one line of the file of results, and a run that
was cut short goes on. ``--write`` makes ``piezoid/diagnosis/healthy_scores.json`` of them: the
scores of what is left and the strengths of the strongest evidence, by law, with the seeds they
are of. An initial state is no evidence against health: these stages have pasts. Then, for each
law, the probabilities of what is left by the table of all *other* laws are held against the
uniform distribution. Most healthy stages show no evidence at all: a cause's probability is then no
larger than the part of those that do.
"""

import argparse
import json
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

from scipy.stats import kstest

from benchmarks.zoo.score import PAST, diagnosed
from benchmarks.zoo.stages import NAMES, drawn, stage
from piezoid.diagnosis.null_distribution import rank_p_value, structure_score
from piezoid.errors import PiezoidError

TABLE = Path(__file__).parents[2] / "piezoid/diagnosis/healthy_scores.json"
DIGITS = 4  # of a score


def main() -> None:
    """Score what is not yet in the file, then write and judge the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--cases", type=int, default=4, help="of each law")
    parser.add_argument("--seeds", type=int, default=2_500_000, help="the first of them")
    parser.add_argument("--json", type=Path, default=Path("build/healthy.jsonl"))
    parser.add_argument("--minutes", type=float, default=1e9, help="begin no stage after them")
    parser.add_argument("--workers", type=int, default=1, help="stages diagnosed at once")
    parser.add_argument("--write", action="store_true", help="make the table")
    asked = parser.parse_args()
    ends_s = time.monotonic() + 60.0 * asked.minutes
    rows = [json.loads(line) for line in _lines(asked.json)]
    known = {row["seed"] for row in rows}
    asked.json.parent.mkdir(parents=True, exist_ok=True)
    wanted = [
        (law, number)
        for number in range(asked.cases)
        for law in NAMES
        if stage(law, "healthy", number, asked.seeds).seed not in known
    ]
    with asked.json.open("a") as file, ProcessPoolExecutor(asked.workers) as pool:
        for row in pool.map(partial(_scored, first=asked.seeds, ends_s=ends_s), wanted):
            if row is not None:
                rows.append(row)
                file.write(json.dumps(row) + "\n")
                file.flush()
                print(row, flush=True)
    scores, strengths = (_by_law(rows, kind) for kind in ("score", "strength"))
    if asked.write:
        seeds = [row["seed"] for row in rows]
        made = f"python -m benchmarks.zoo.healthy --cases {asked.cases} --seeds {asked.seeds}"
        table = {"made_by": made, "seeds": sorted(seeds), "scores": scores}
        table["strengths"] = strengths
        TABLE.write_text(json.dumps(table, indent=1, sort_keys=True) + "\n")
    print(uniformity(scores))
    told = ", ".join(f"{one:.2f}" for of_law in strengths.values() for one in of_law if one > 0.0)
    print(f"strengths of the stages that show evidence at all: {told}")


def _by_law(rows: Sequence[Mapping[str, Any]], kind: str) -> dict[str, list[float]]:
    found: dict[str, list[float]] = {}
    for row in sorted(rows, key=lambda row: int(row["seed"])):
        if row[kind] is not None:
            found.setdefault(row["law"], []).append(row[kind])
    return found


def uniformity(scores: Mapping[str, Sequence[float]]) -> str:
    """Return, law by law, how the probabilities by all other laws' scores are spread."""
    lines, all_of_them = [], []
    for law, own in scores.items():
        others = [s for other, of_it in scores.items() if other != law for s in of_it]
        chances = [rank_p_value(score, others) for score in own]
        all_of_them += chances
        told = ", ".join(f"{chance:.2f}" for chance in sorted(chances))
        lines.append(f"| {law} | {told} | {kstest(chances, 'uniform').pvalue:.2g} |")
    whole = kstest(all_of_them, "uniform").pvalue
    below = sum(chance <= 0.05 for chance in all_of_them)
    return "\n".join(
        [
            "| law | probabilities by the other laws | uniform with p |",
            "| --- | --- | --- |",
            *lines,
            f"| all | at most 0.05: {below} of {len(all_of_them)} | {whole:.2g} |",
        ]
    )


def _scored(wanted: tuple[str, int], *, first: int, ends_s: float) -> dict[str, Any] | None:
    """Diagnose one healthy stage; None where time is up."""
    if time.monotonic() > ends_s:
        return None
    law, number = wanted
    asked = stage(law, "healthy", number, first)
    row: dict[str, Any] = {"law": law, "seed": asked.seed, "said": []}
    row |= {"score": None, "strength": None}
    try:
        found, time_s = diagnosed(drawn(asked))
    except PiezoidError as error:
        return {**row, "failed": str(error)[:200]}
    rest = found.unexplained
    assert rest is not None
    strengths = [v for name, v in found.strengths.items() if name != PAST]
    left = found.envelope_rms_m / found.noise_floor_rms_m
    return {
        **row,
        "score": round(structure_score(rest.gain, left, 1.0), DIGITS),
        "strength": round(max(strengths, default=0.0), DIGITS),
        "said": [[one.effect, one.p_value] for one in found.findings],
        "times_noise": round(left, DIGITS),
        "gain": round(rest.gain, DIGITS),
        "coordinate": rest.coordinate,
        "time_s": round(time_s, 1),
    }


def _lines(place: Path) -> list[str]:
    text = place.read_text() if place.exists() else ""
    return text[: text.rfind("\n") + 1].splitlines()


if __name__ == "__main__":
    main()
