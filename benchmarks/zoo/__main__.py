"""How often the diagnosis names what is hidden in stages of every law of the zoo.

    python -m benchmarks.zoo [--laws takacs,dahl] [--kinds healthy,single] [--cases 5]
                             [--seeds 700000] [--workers 1] [--json build/zoo.jsonl] [--minutes 35]
                             [--effects lag,delay]

``--cases`` stages of each law and kind; kinds are healthy, single, half, quarter (one effect at 1,
1/2, 1/4 of full size), pair and triple; of these only those that hide one of ``--effects``,
where it is given. Every stage is appended to the file of results as one
line; one that stands there already is not made again, so a run that was cut short goes on, and
the table is of all that was asked for and stands in the file. Ten seconds of one core a stage.
"""

import argparse
import json
import time
from collections.abc import Iterator, Sequence
from functools import partial
from multiprocessing import get_context
from pathlib import Path

from benchmarks.zoo.score import Asked, Case, case_of_row, judged
from benchmarks.zoo.stages import KINDS, NAMES, asked_for, drawn
from benchmarks.zoo.table import confusion, table, told


def main() -> None:
    """Judge what is not yet in the file, print a line for each, then the tables."""
    asked = _arguments().parse_args()
    laws, kinds = asked.laws.split(","), asked.kinds.split(",")
    for known, names in ((NAMES, laws), (tuple(KINDS), kinds)):
        if unknown := sorted(set(names) - set(known)):
            raise SystemExit(f"found {', '.join(unknown)}, but known are {', '.join(known)}.")
    wanted = list(asked_for(laws, kinds, asked.cases, asked.seeds))
    if asked.effects:
        wanted = [one for one in wanted if set(one.hidden) & set(asked.effects.split(","))]
    held = read(asked.json)
    missing = [one for one in wanted if (one.law, one.kind, one.seed) not in held]
    asked.json.parent.mkdir(parents=True, exist_ok=True)
    ends_s = time.monotonic() + 60.0 * asked.minutes
    with asked.json.open("a") as file:
        for case in _judged(missing, asked.workers):
            held[case.law, case.kind, case.seed] = case
            file.write(json.dumps(case.row()) + "\n")
            file.flush()
            print(told(case), flush=True)
            if time.monotonic() > ends_s:
                break
    keys = [(one.law, one.kind, one.seed) for one in wanted]
    cases = [held[key] for key in keys if key in held]
    print(table(cases, kinds), confusion(cases), sep="\n\n")


def read(place: Path) -> dict[tuple[str, str, int], Case]:
    """Return what a file of results holds; a line cut short by the end of a run is left out."""
    if not place.exists():
        return {}
    text = place.read_text()
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        place.write_text(whole)
    cases = [case_of_row(json.loads(line)) for line in whole.splitlines()]
    return {(case.law, case.kind, case.seed): case for case in cases}


def _judged(missing: Sequence[Asked], workers: int) -> Iterator[Case]:
    task = partial(judged, drawn=drawn)
    if workers == 1:
        yield from map(task, missing)
        return
    with get_context("spawn").Pool(workers) as pool:
        yield from pool.imap(task, missing)


def _arguments() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.zoo", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--laws", default=",".join(NAMES))
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--effects", default="", help="of which one at least is hidden")
    parser.add_argument("--cases", type=int, default=5, help="of each law and kind")
    parser.add_argument("--seeds", type=int, default=700_000, help="the first of them")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--json", type=Path, default=Path("build/zoo.jsonl"))
    parser.add_argument("--minutes", type=float, default=1e9, help="begin no stage after them")
    return parser


if __name__ == "__main__":
    main()
