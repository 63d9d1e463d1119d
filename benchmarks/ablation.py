"""Ablation of the rules of the diagnosis: stages of every law, with one rule at a time disabled.

    python -m benchmarks.ablation [--laws takacs,dahl] [--kinds healthy,single,pair] [--cases 1]
                                  [--seeds 920000] [--json build/ablation.jsonl] [--minutes 60]
                                  [--watch]

A first diagnosis of each stage uses all rules and records which of them change a decision. The
stage is then diagnosed again without each of these rules, one at a time. A rule that changes no
decision needs no second diagnosis, as the result would be identical. Every diagnosis is one line
of the results file, which a later run continues. ``--watch`` makes only the first diagnoses.
"""

import json
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from types import ModuleType
from typing import Any
from unittest.mock import patch

from benchmarks.zoo.command_line import add_results, read_rows, stage_parser
from benchmarks.zoo.score import Case, case_of_row, score_stage
from benchmarks.zoo.stages import KINDS, NAMES, draw_stage, stage_requests
from benchmarks.zoo.table import summary_line
from piezoid.diagnosis import (
    candidate,
    diagnose,
    forward_selection,
    selection,
)
from piezoid.diagnosis.blocked_regression import paired_z
from piezoid.diagnosis.nuisance_search import OTHER_INITIAL_STATES
from piezoid.diagnosis.residual_structure import locate_residual

Decision = Callable[..., Any]
Target = tuple[ModuleType | type, str]
Rows = dict[tuple[str, str], dict[str, Any]]  # by stage and disabled rule, "" for none


def _differs(with_rule: Any, without: Any) -> bool:
    return with_rule is not without and with_rule != without


def _is_smaller(factor: float) -> Callable[[Any, Any], bool]:
    return lambda with_rule, without: with_rule.rms < factor * without.rms


@dataclass(frozen=True, kw_only=True)
class Rule:
    """A rule of the diagnosis and its replacement.

    targets       functions and properties that implement it
    replacement   function without the rule; for a property, a function of its object
    matters       (result, result without the rule) -> whether a decision may differ
    is_expensive  the replacement needs a search, so ``matters`` does without its result
    """

    name: str
    targets: tuple[Target, ...]
    replacement: Decision
    matters: Callable[[Any, Any], bool] = _differs
    is_expensive: bool = False


def _is_close(alternative: Any, cause: Any) -> bool:
    return paired_z(alternative.cv.loss, cause.cv.loss) < selection.SEPARABLE


def _is_significant(*, has_minimum_gain: bool = True, has_placebos: bool = True) -> Decision:
    def is_significant(trial: candidate.Candidate) -> bool:
        return (
            trial.physical
            and trial.cv.z > candidate.MINIMUM_Z
            and (trial.cv.gain > trial.effect.minimum_gain or not has_minimum_gain)
            and (trial.beats_placebo or not has_placebos)
        )

    return is_significant


RULES = (
    Rule(
        name="the other side of the hysteresis",
        targets=((forward_selection, "exchange_filter_side"),),
        replacement=lambda *_: None,
    ),
    Rule(
        name="modes after steps",
        targets=((forward_selection, "modes_after_steps"),),
        replacement=lambda _: (),
    ),
    Rule(
        name="one more state of hysteresis",
        targets=((forward_selection, "with_best_bouc_wen"),),
        replacement=lambda view, *_: view,
        matters=_is_smaller(forward_selection.BOUC_WEN),
    ),
    Rule(
        name="other initial states",
        targets=((forward_selection, "initial_states_explain"),),
        replacement=lambda *_: False,
    ),
    Rule(
        name="other initial states before faults",
        targets=(
            (selection, "with_individual_initial_states"),
            (selection, "with_shared_initial_state"),
        ),
        replacement=lambda view, *_: view,
        matters=_is_smaller(OTHER_INITIAL_STATES),
    ),
    Rule(
        name="shared before individual initial states",
        targets=((selection, "is_shared_state_as_good"),),
        replacement=lambda *_: False,
    ),
    Rule(
        name="confounded effects",
        targets=((selection, "is_confounded"),),
        replacement=_is_close,
    ),
    Rule(
        name="placebos",
        targets=((candidate.Candidate, "is_significant"),),
        replacement=_is_significant(has_placebos=False),
    ),
    Rule(
        name="larger than the remaining structure",
        targets=((candidate, "exceeds_structure"),),
        replacement=lambda *_: True,
    ),
    Rule(
        name="minimum gain",
        targets=((candidate.Candidate, "is_significant"),),
        replacement=_is_significant(has_minimum_gain=False),
    ),
    Rule(
        name="unexplained structure",
        targets=((diagnose, "search_all"),),
        replacement=lambda view, hands: locate_residual(view, selection.search(view, hands)),
        matters=lambda result, _: (
            result.structure is not None or result.without_structure is not None
        ),
        is_expensive=True,
    ),
)


@contextmanager
def observe(active: set[str]) -> Iterator[None]:
    """Add the names of rules that change a decision to a set."""

    def observer(rule: Rule) -> Callable[[Decision], Decision]:
        def wrap(decision: Decision) -> Decision:
            def observed(*arguments: Any, **options: Any) -> Any:
                result = decision(*arguments, **options)
                if rule.name in active:
                    return result
                without = None if rule.is_expensive else rule.replacement(*arguments, **options)
                if rule.matters(result, without):
                    active.add(rule.name)
                return result

            return observed

        return wrap

    with ExitStack() as stack:
        for rule in RULES:
            for module, name in rule.targets:
                stack.enter_context(_patched(module, name, observer(rule)))
        yield


@contextmanager
def disable(rule: Rule) -> Iterator[None]:
    """Replace a rule."""
    with ExitStack() as stack:
        for module, name in rule.targets:
            stack.enter_context(_patched(module, name, lambda _: rule.replacement))
        yield


@contextmanager
def _patched(module: Any, name: str, wrap: Callable[[Decision], Decision]) -> Iterator[None]:
    original = module.__dict__[name]
    if isinstance(original, property):
        assert original.fget is not None
        new: Any = property(wrap(original.fget))
    else:
        new = wrap(original)
    with patch.object(module, name, new):
        yield


def main() -> None:
    """Make the missing diagnoses, then print the effect of each rule."""
    parser = stage_parser(__doc__, cases=1, first=920_000)
    parser.prog = "python -m benchmarks.ablation"
    parser.add_argument("--laws", default=",".join(NAMES))
    parser.add_argument("--kinds", default="healthy,single,pair", help=", ".join(KINDS))
    parser.add_argument("--watch", action="store_true", help="disable no rule")
    add_results(parser, "build/ablation.jsonl")
    options = parser.parse_args()
    rows: Rows = {(row.pop("key"), row.pop("rule")): row for row in read_rows(options.json)}
    end_s = time.monotonic() + 60.0 * options.minutes
    laws, kinds = options.laws.split(","), options.kinds.split(",")
    requests = {
        f"{request.law} {request.kind} {request.seed}": request
        for request in stage_requests(laws, kinds, options.cases, options.seeds)
    }
    with options.json.open("a") as file:
        for key, rule in _missing(requests, rows, options.watch):
            if time.monotonic() > end_s:
                break
            active: set[str] = set()
            with disable(rule) if rule else observe(active):
                case = score_stage(requests[key], draw=draw_stage)
            name = rule.name if rule else ""
            rows[key, name] = {"changed": sorted(active), **case.row()}
            file.write(json.dumps({"key": key, "rule": name, **rows[key, name]}) + "\n")
            file.flush()
            print(f"without {name or 'nothing'}: {summary_line(case)}", flush=True)
            if active:
                print(f"    active: {', '.join(sorted(active))}", flush=True)
    print(table(rows))


def table(rows: Rows) -> str:
    """Return for each rule the stages on which it is active, and the result without it."""
    cases = {
        key: case_of_row({name: value for name, value in row.items() if name != "changed"})
        for key, row in rows.items()
        if not row["failed"]
    }
    stages = [key for key, rule in cases if not rule]
    baseline = {key: cases[key, ""] for key in stages}
    lines = [
        "| without | active in | disabled in | named | wrong names | healthy accused | seconds |",
        "| --- | --- | --- | --- | --- | --- | --- |",
        _row("nothing", len(baseline), len(baseline), list(baseline.values())),
    ]
    for rule in RULES:
        active = [key for key in stages if rule.name in rows[key, ""]["changed"]]
        disabled = [key for key in active if (key, rule.name) in cases]
        results = [cases[key, rule.name] if key in disabled else baseline[key] for key in stages]
        lines.append(_row(rule.name, len(active), len(disabled), results))
    return "\n".join(lines)


def _row(name: str, active: int, disabled: int, cases: Sequence[Case]) -> str:
    counts = Counter[str]()
    for case in cases:
        is_accused = bool(case.findings) and not case.is_only_initial_state
        counts["hidden"] += len(case.hidden)
        counts["named"] += len(set(case.hidden) & set(case.names))
        counts["wrong"] += len(case.wrong) if case.hidden else 0
        counts["healthy"] += not case.hidden
        counts["accused"] += not case.hidden and is_accused
    seconds = sum(case.time_s for case in cases)
    return (
        f"| {name} | {active} | {disabled} | {counts['named']}/{counts['hidden']} | "
        f"{counts['wrong']} | {counts['accused']}/{counts['healthy']} | {seconds:.0f} |"
    )


def _missing(stages: Iterable[str], rows: Rows, watch: bool) -> Iterator[tuple[str, Rule | None]]:
    """Yield the diagnoses that the results lack: all stages with all rules first."""
    yield from ((key, None) for key in stages if (key, "") not in rows)
    if watch:
        return
    for key in stages:
        for rule in RULES:
            is_done = (key, "") not in rows or (key, rule.name) in rows
            if not is_done and rule.name in rows[key, ""]["changed"]:
                yield key, rule


if __name__ == "__main__":
    main()
