"""How much healthy stages leave: the table by which the diagnosis tells what is more than that.

    python -m benchmarks.zoo.healthy [--cases 6] [--seeds 940000] [--json build/healthy.jsonl]
                                     [--minutes 60] [--write]

Healthy stages of every law are diagnosed, each is one line of the file of results, and a run that
was cut short goes on. ``--write`` makes ``piezoid/diagnosis/healthy_scores.json`` of them: the
scores of what is left, by law, with the seeds they are of. Then, for each law, the probabilities
by the table of all *other* laws are held against the uniform distribution.
"""

import argparse
import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from scipy.stats import kstest

from benchmarks.zoo.score import diagnosed
from benchmarks.zoo.stages import NAMES, drawn, stage
from piezoid.diagnosis.healthy import chance_of, score_of
from piezoid.errors import PiezoidError

TABLE = Path(__file__).parents[2] / "piezoid/diagnosis/healthy_scores.json"
DIGITS = 4  # of a score


def main() -> None:
    """Score what is not yet in the file, then write and judge the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--cases", type=int, default=6, help="of each law")
    parser.add_argument("--seeds", type=int, default=940_000, help="the first of them")
    parser.add_argument("--json", type=Path, default=Path("build/healthy.jsonl"))
    parser.add_argument("--minutes", type=float, default=1e9, help="begin no stage after them")
    parser.add_argument("--write", action="store_true", help="make the table")
    asked = parser.parse_args()
    ends_s = time.monotonic() + 60.0 * asked.minutes
    rows = [json.loads(line) for line in _lines(asked.json)]
    known = {row["seed"] for row in rows}
    asked.json.parent.mkdir(parents=True, exist_ok=True)
    with asked.json.open("a") as file:
        for number in range(asked.cases):
            for law in NAMES:
                one = stage(law, "healthy", number, asked.seeds)
                if one.seed in known or time.monotonic() > ends_s:
                    continue
                rows.append(_scored(law, one.seed, number, asked.seeds))
                file.write(json.dumps(rows[-1]) + "\n")
                file.flush()
                print(rows[-1], flush=True)
    scores: dict[str, list[float]] = {}
    for row in sorted(rows, key=lambda row: row["seed"]):
        if row["score"] is not None:
            scores.setdefault(row["law"], []).append(row["score"])
    if asked.write:
        seeds = [row["seed"] for row in rows]
        made = f"python -m benchmarks.zoo.healthy --cases {asked.cases} --seeds {asked.seeds}"
        table = {"made_by": made, "seeds": sorted(seeds), "scores": scores}
        TABLE.write_text(json.dumps(table, indent=1, sort_keys=True) + "\n")
    print(uniformity(scores))


def uniformity(scores: Mapping[str, Sequence[float]]) -> str:
    """Return, law by law, how the probabilities by all other laws' scores are spread."""
    lines, all_of_them = [], []
    for law, own in scores.items():
        others = [s for other, of_it in scores.items() if other != law for s in of_it]
        chances = [chance_of(score, others) for score in own]
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


def _scored(law: str, seed: int, number: int, first: int) -> dict[str, object]:
    row: dict[str, object] = {"law": law, "seed": seed, "score": None, "said": []}
    try:
        found, time_s = diagnosed(drawn(stage(law, "healthy", number, first)))
    except PiezoidError as error:
        return {**row, "failed": str(error)[:200]}
    rest = found.unexplained
    assert rest is not None
    left = found.envelope_rms_m / found.noise_floor_rms_m
    return {
        **row,
        "score": round(score_of(rest.gain, left, 1.0), DIGITS),
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
