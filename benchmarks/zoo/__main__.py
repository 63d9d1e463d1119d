"""Measure how often the diagnosis names the hidden effects on stages of every law of the zoo.

    python -m benchmarks.zoo [--laws takacs,dahl] [--kinds healthy,single] [--cases 5]
                             [--seeds 700000] [--workers 1] [--json build/zoo.jsonl] [--minutes 35]
                             [--effects lag,delay]

``--cases`` is the number of stages of each law and kind. The kinds are healthy, single, half,
quarter (one effect of 1, 1/2, 1/4 of the full size), pair and triple. ``--effects`` selects stages
that hide one of these effects. Every stage is one line of the results file. A later run skips the
stages in the file, and its tables cover all requested stages in the file. A stage takes ten
seconds of one core.
"""

import json
import time
from collections.abc import Iterator, Sequence
from functools import partial
from multiprocessing import get_context
from pathlib import Path

from benchmarks.zoo.command_line import add_results, read_rows, stage_parser
from benchmarks.zoo.score import Case, StageRequest, case_of_row, score_stage
from benchmarks.zoo.stages import KINDS, NAMES, draw_stage, stage_requests
from benchmarks.zoo.table import confusion, summary_line, table


def main() -> None:
    """Diagnose the missing stages, print a line for each, then the tables."""
    parser = stage_parser(__doc__, cases=5, first=700_000)
    parser.prog = "python -m benchmarks.zoo"
    parser.add_argument("--laws", default=",".join(NAMES))
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--effects", default="", help="hide at least one of these")
    parser.add_argument("--workers", type=int, default=1)
    add_results(parser, "build/zoo.jsonl")
    options = parser.parse_args()
    laws, kinds = options.laws.split(","), options.kinds.split(",")
    for valid, names in ((NAMES, laws), (tuple(KINDS), kinds)):
        if unknown := sorted(set(names) - set(valid)):
            raise SystemExit(f"found {', '.join(unknown)}, but known are {', '.join(valid)}.")
    requests = list(stage_requests(laws, kinds, options.cases, options.seeds))
    if options.effects:
        effects = set(options.effects.split(","))
        requests = [request for request in requests if set(request.hidden) & effects]
    results = read(options.json)
    missing = [r for r in requests if (r.law, r.kind, r.seed) not in results]
    end_s = time.monotonic() + 60.0 * options.minutes
    with options.json.open("a") as file:
        for case in _score(missing, options.workers):
            results[case.law, case.kind, case.seed] = case
            file.write(json.dumps(case.row()) + "\n")
            file.flush()
            print(summary_line(case), flush=True)
            if time.monotonic() > end_s:
                break
    keys = [(request.law, request.kind, request.seed) for request in requests]
    cases = [results[key] for key in keys if key in results]
    print(table(cases, kinds), confusion(cases), sep="\n\n")


def read(path: Path) -> dict[tuple[str, str, int], Case]:
    """Return the cases of a results file by law, kind and seed."""
    cases = [case_of_row(row) for row in read_rows(path)]
    return {(case.law, case.kind, case.seed): case for case in cases}


def _score(requests: Sequence[StageRequest], workers: int) -> Iterator[Case]:
    task = partial(score_stage, draw=draw_stage)
    if workers == 1:
        yield from map(task, requests)
        return
    with get_context("spawn").Pool(workers) as pool:
        yield from pool.imap(task, requests)


if __name__ == "__main__":
    main()
