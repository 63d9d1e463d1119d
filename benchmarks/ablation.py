"""What each rule of the diagnosis is worth: stages of every law, with one rule after another off.

    python -m benchmarks.ablation [--laws takacs,dahl] [--kinds healthy,single,pair] [--cases 1]
                                  [--seeds 920000] [--json build/ablation.jsonl] [--minutes 60]
                                  [--watch]

A stage is diagnosed once with all rules at work, and it is noted which of them changed a decision
there. It is then diagnosed again without each of these, one at a time: without a rule that changed
nothing the diagnosis is the same, to the last bit, and need not be made. Every diagnosis is one
line of the file of results, so a run that was cut short goes on. ``--watch`` only notes where
rules act.
"""

import argparse
import json
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest.mock import patch

from benchmarks.zoo.score import Case, case_of_row, judged
from benchmarks.zoo.stages import KINDS, NAMES, asked_for, drawn
from benchmarks.zoo.table import told
from piezoid.diagnosis import (
    candidate,
    diagnose,
    forward_selection,
    selection,
)
from piezoid.diagnosis.blocked_regression import paired_z
from piezoid.diagnosis.initial_state_search import OTHER_INITIAL_STATES
from piezoid.diagnosis.residual_structure import locate_residual

Decision = Callable[..., Any]
Place = tuple[ModuleType | type, str]
Rows = dict[tuple[str, str], dict[str, Any]]  # by stage and rule, "" for none


def _changed(with_rule: Any, without: Any) -> bool:
    return with_rule is not without and with_rule != without


def _leaves_less(factor: float) -> Callable[[Any, Any], bool]:
    return lambda with_rule, without: with_rule.rms < factor * without.rms


@dataclass(frozen=True, kw_only=True)
class Rule:
    """A rule of the engine, where it is asked, and what is done without it.

    places   functions and properties that ask it
    without  what stands in their place; of a property, a function of its object
    matters  (what it said, what is said without it) -> whether a decision can be another one
    dear     what is said without it takes a search, and is not asked for by ``matters``
    """

    name: str
    places: tuple[Place, ...]
    without: Decision
    matters: Callable[[Any, Any], bool] = _changed
    dear: bool = False


def _surely_close(alternative: Any, cause: Any) -> bool:
    return paired_z(alternative.cv.loss, cause.cv.loss) < selection.SEPARABLE


def _evidence(*, worth: bool = True, placebos: bool = True) -> Decision:
    def is_significant(one: candidate.Candidate) -> bool:
        return (
            one.physical
            and one.cv.z > candidate.MINIMUM_Z
            and (one.cv.gain > one.effect.minimum_gain or not worth)
            and (one.beats_placebo or not placebos)
        )

    return is_significant


JUDGED = candidate.Candidate
RULES = (
    Rule(
        name="the other side of the hysteresis",
        places=((forward_selection, "exchange_filter_side"),),
        without=lambda *_: None,
    ),
    Rule(
        name="behind jumps",
        places=((forward_selection, "modes_after_steps"),),
        without=lambda _: (),
    ),
    Rule(
        name="one more state of hysteresis",
        places=((forward_selection, "with_best_bouc_wen"),),
        without=lambda view, *_: view,
        matters=_leaves_less(forward_selection.BOUC_WEN),
    ),
    Rule(
        name="other initial states",
        places=((forward_selection, "initial_states_explain"),),
        without=lambda *_: False,
    ),
    Rule(
        name="other initial states before faults",
        places=(
            (selection, "with_individual_initial_states"),
            (selection, "with_shared_initial_state"),
        ),
        without=lambda view, *_: view,
        matters=_leaves_less(OTHER_INITIAL_STATES),
    ),
    Rule(
        name="shared before own initial states",
        places=((selection, "is_shared_state_as_good"),),
        without=lambda *_: False,
    ),
    Rule(name="alike is close", places=((selection, "is_confounded"),), without=_surely_close),
    Rule(name="placebos", places=((JUDGED, "is_significant"),), without=_evidence(placebos=False)),
    Rule(
        name="not small beside structure",
        places=((candidate, "exceeds_structure"),),
        without=lambda *_: True,
    ),
    Rule(
        name="a least gain",
        places=((JUDGED, "is_significant"),),
        without=_evidence(worth=False),
    ),
    Rule(
        name="what has no name",
        places=((diagnose, "search_all"),),
        without=lambda view, hands: locate_residual(view, selection.search(view, hands)),
        matters=lambda said, _: said.structure is not None or said.without_structure is not None,
        dear=True,
    ),
)


@contextmanager
def watched(changed: set[str]) -> Iterator[None]:
    """Note which rules change a decision."""
    with ExitStack() as stack:
        for rule in RULES:
            for module, name in rule.places:
                stack.enter_context(_replaced(module, name, _watching(rule, changed)))
        yield


def _watching(rule: Rule, changed: set[str]) -> Callable[[Decision], Decision]:
    def around(asked: Decision) -> Decision:
        def decided(*given: Any, **named: Any) -> Any:
            said = asked(*given, **named)
            if rule.name in changed:
                return said
            other = None if rule.dear else rule.without(*given, **named)
            if rule.matters(said, other):
                changed.add(rule.name)
            return said

        return decided

    return around


@contextmanager
def _replaced(module: Any, name: str, around: Callable[[Decision], Decision]) -> Iterator[None]:
    was = module.__dict__[name]
    if isinstance(was, property):
        assert was.fget is not None
        new: Any = property(around(was.fget))
    else:
        new = around(was)
    with patch.object(module, name, new):
        yield


@contextmanager
def without(rule: Rule) -> Iterator[None]:
    """Switch a rule off."""
    with ExitStack() as stack:
        for module, name in rule.places:
            stack.enter_context(_replaced(module, name, lambda _: rule.without))
        yield


def main() -> None:
    """Diagnose what is not yet in the file, then print what each rule is worth."""
    asked = _arguments().parse_args()
    rows = _read(asked.json)
    asked.json.parent.mkdir(parents=True, exist_ok=True)
    ends_s = time.monotonic() + 60.0 * asked.minutes
    laws, kinds = asked.laws.split(","), asked.kinds.split(",")
    stages = {
        f"{one.law} {one.kind} {one.seed}": one
        for one in asked_for(laws, kinds, asked.cases, asked.seeds)
    }
    with asked.json.open("a") as file:
        for key, rule in _missing(stages, rows, asked.watch):
            if time.monotonic() > ends_s:
                break
            changed: set[str] = set()
            with without(rule) if rule else watched(changed):
                case = judged(stages[key], drawn=drawn)
            name = rule.name if rule else ""
            rows[key, name] = {"changed": sorted(changed), **case.row()}
            file.write(json.dumps({"key": key, "rule": name, **rows[key, name]}) + "\n")
            file.flush()
            print(f"without {name or 'nothing'}: {told(case)}", flush=True)
            if changed:
                print(f"    acted: {', '.join(sorted(changed))}", flush=True)
    print(table(rows))


def table(rows: Rows) -> str:
    """Return a row for each rule: where it acts; what is named, wrong, accused without it."""
    cases = {key: _case(row) for key, row in rows.items() if not row["failed"]}
    stages = [key for key, rule in cases if not rule]
    whole = {key: cases[key, ""] for key in stages}
    lines = [
        "| without | acts in | tried in | named | wrong names | healthy accused | seconds |",
        "| --- | --- | --- | --- | --- | --- | --- |",
        _row("nothing", len(whole), len(whole), list(whole.values())),
    ]
    for rule in RULES:
        acts = [key for key in stages if rule.name in rows[key, ""]["changed"]]
        done = [key for key in acts if (key, rule.name) in cases]
        rest = [cases[key, rule.name] if key in done else whole[key] for key in stages]
        lines.append(_row(rule.name, len(acts), len(done), rest))
    return "\n".join(lines)


def _row(name: str, acts: int, done: int, cases: Sequence[Case]) -> str:
    counts = Counter[str]()
    for case in cases:
        counts["hidden"] += len(case.hidden)
        counts["named"] += len(set(case.hidden) & set(case.names))
        counts["wrong"] += len(case.wrong) if case.hidden else 0
        counts["healthy"] += not case.hidden
        counts["accused"] += not case.hidden and bool(case.said) and not case.fair
    seconds = sum(case.time_s for case in cases)
    return (
        f"| {name} | {acts} | {done} | {counts['named']}/{counts['hidden']} | {counts['wrong']} | "
        f"{counts['accused']}/{counts['healthy']} | {seconds:.0f} |"
    )


def _case(row: dict[str, Any]) -> Case:
    return case_of_row({name: value for name, value in row.items() if name != "changed"})


def _missing(stages: Iterable[str], rows: Rows, watch: bool) -> Iterator[tuple[str, Rule | None]]:
    """Yield what is not yet in the file: all stages with every rule first."""
    yield from ((key, None) for key in stages if (key, "") not in rows)
    if watch:
        return
    for key in stages:
        for rule in RULES:
            done = (key, "") not in rows or (key, rule.name) in rows
            if not done and rule.name in rows[key, ""]["changed"]:
                yield key, rule


def _read(place: Path) -> Rows:
    """Return the rows of a file of results; one cut short by the end of a run is made again."""
    rows: Rows = {}
    text = place.read_text() if place.exists() else ""
    for line in text[: text.rfind("\n") + 1].splitlines():
        row = json.loads(line)
        rows[row.pop("key"), row.pop("rule")] = row
    return rows


def _arguments() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.ablation", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--laws", default=",".join(NAMES))
    parser.add_argument("--kinds", default="healthy,single,pair", help=", ".join(KINDS))
    parser.add_argument("--cases", type=int, default=1, help="of each law and kind")
    parser.add_argument("--seeds", type=int, default=920_000, help="the first of them")
    parser.add_argument("--json", type=Path, default=Path("build/ablation.jsonl"))
    parser.add_argument("--watch", action="store_true", help="only note where rules act")
    parser.add_argument("--minutes", type=float, default=1e9, help="begin no stage after them")
    return parser


if __name__ == "__main__":
    main()
