"""Distribution of scores on healthy stages, to which the diagnosis compares its evidence.

    python -m benchmarks.zoo.healthy [--cases 4] [--seeds 2500000] [--json build/healthy.jsonl]
                                     [--minutes 60] [--workers 2] [--write]

Healthy stages of every law are diagnosed; each is one line of the results file, which a later run
continues. ``--write`` writes ``piezoid/diagnosis/healthy_scores.json``: by law, the scores of the
remaining structure and the largest strength of evidence, with the seeds. Initial states do not
count as evidence, because these stages have drive histories. For each law, the p-values by the
scores of all other laws are then compared with a uniform distribution. Most healthy stages show
no evidence, so the p-value of a cause is at most the share of those that do.
"""

import json
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

from scipy.stats import kstest

from benchmarks.zoo.command_line import add_results, read_rows, stage_parser
from benchmarks.zoo.score import INITIAL_STATE, StageRequest, diagnose_campaign
from benchmarks.zoo.stages import NAMES, draw_stage, stage_requests
from piezoid.diagnosis.null_distribution import rank_p_value, structure_score
from piezoid.errors import PiezoidError

TABLE = Path(__file__).parents[2] / "piezoid/diagnosis/healthy_scores.json"
DIGITS = 4  # of a score


def main() -> None:
    """Score the missing stages, then print and write the table."""
    parser = stage_parser(__doc__, cases=4, first=2_500_000)
    add_results(parser, "build/healthy.jsonl")
    parser.add_argument("--workers", type=int, default=1, help="number of processes")
    parser.add_argument("--write", action="store_true", help="write the table")
    options = parser.parse_args()
    end_s = time.monotonic() + 60.0 * options.minutes
    rows = read_rows(options.json)
    seeds = {row["seed"] for row in rows}
    requests = [
        request
        for request in stage_requests(NAMES, ["healthy"], options.cases, options.seeds)
        if request.seed not in seeds
    ]
    with options.json.open("a") as file, ProcessPoolExecutor(options.workers) as pool:
        for row in pool.map(partial(_score, end_s=end_s), requests):
            if row is not None:
                rows.append(row)
                file.write(json.dumps(row) + "\n")
                file.flush()
                print(row, flush=True)
    scores, strengths = (_by_law(rows, key) for key in ("score", "strength"))
    if options.write:
        command = f"python -m benchmarks.zoo.healthy --cases {options.cases}"
        table = {
            "made_by": f"{command} --seeds {options.seeds}",
            "seeds": sorted(row["seed"] for row in rows),
            "scores": scores,
            "strengths": strengths,
        }
        TABLE.write_text(json.dumps(table, indent=1, sort_keys=True) + "\n")
    print(uniformity(scores))
    positive = [f"{value:.2f}" for law in strengths.values() for value in law if value > 0.0]
    print(f"strengths of the stages with evidence: {', '.join(positive)}")


def _by_law(rows: Sequence[Mapping[str, Any]], key: str) -> dict[str, list[float]]:
    values: dict[str, list[float]] = {}
    for row in sorted(rows, key=lambda row: int(row["seed"])):
        if row[key] is not None:
            values.setdefault(row["law"], []).append(row[key])
    return values


def uniformity(scores: Mapping[str, Sequence[float]]) -> str:
    """Return for each law the p-values by the scores of all other laws."""
    lines = [
        "| law | p-values by the other laws | uniform with p |",
        "| --- | --- | --- |",
    ]
    total: list[float] = []
    for law, law_scores in scores.items():
        null = [score for name, values in scores.items() if name != law for score in values]
        p_values = sorted(rank_p_value(score, null) for score in law_scores)
        total += p_values
        listed = ", ".join(f"{p:.2f}" for p in p_values)
        lines.append(f"| {law} | {listed} | {kstest(p_values, 'uniform').pvalue:.2g} |")
    below = sum(p <= 0.05 for p in total)
    p_value = kstest(total, "uniform").pvalue
    return "\n".join([*lines, f"| all | at most 0.05: {below} of {len(total)} | {p_value:.2g} |"])


def _score(request: StageRequest, *, end_s: float) -> dict[str, Any] | None:
    """Diagnose one healthy stage, unless the time is up."""
    if time.monotonic() > end_s:
        return None
    row: dict[str, Any] = {"law": request.law, "seed": request.seed, "findings": []}
    row |= {"score": None, "strength": None}
    try:
        diagnosis, time_s = diagnose_campaign(draw_stage(request))
    except PiezoidError as error:
        return {**row, "failed": str(error)[:200]}
    unexplained = diagnosis.unexplained
    assert unexplained is not None
    strengths = [v for name, v in diagnosis.strengths.items() if name != INITIAL_STATE]
    times_noise = diagnosis.envelope_rms_m / diagnosis.noise_floor_rms_m
    return {
        **row,
        "score": round(structure_score(unexplained.gain, times_noise, 1.0), DIGITS),
        "strength": round(max(strengths, default=0.0), DIGITS),
        "findings": [[finding.effect, finding.p_value] for finding in diagnosis.findings],
        "times_noise": round(times_noise, DIGITS),
        "gain": round(unexplained.gain, DIGITS),
        "coordinate": unexplained.coordinate,
        "time_s": round(time_s, 1),
    }


if __name__ == "__main__":
    main()
