"""Mutation score: draw mutants of a package and count those that its tests detect.

    python -m benchmarks.mutation_score PART [--count 80] [--seed 1] [--seconds 420] [--longest 5]

``PARTS`` lists the packages. The first run profiles the tests (``mutation_trial``). Mutants and
tests run in forked processes, so the repository is not modified. The state is stored in
build/mutation/PART.json, from which the next run continues after ``--seconds``. Without the tests
longer than ``--longest`` the score is a lower bound. Equivalent mutants, which no test can detect,
do not count; ``benchmarks/equivalent_mutants.toml`` lists them with reasons.
"""

import argparse
import importlib
import json
import random
import sys
import time
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.mutants import Mutant, mutants_of
from benchmarks.mutation_trial import KILLED, ROOT, SURVIVED, timed_tests, verdict

STATES = ROOT / "build" / "mutation"
LIGHT = ("numpy", "scipy.linalg", "pytest", "hypothesis", "_pytest.assertion.rewrite")
HEAVY = ("scipy.optimize", "scipy.signal", "scipy.integrate", "pandas", "clarabel", "nlopt")


@dataclass(frozen=True, kw_only=True)
class Part:
    """Sources to mutate and tests to run.

    sources  glob patterns
    tests    folders and files
    without  excluded test files, which compile other copies of the source
    loaded   packages to import before the forks
    """

    sources: tuple[str, ...]
    tests: tuple[str, ...]
    without: tuple[str, ...] = ()
    loaded: tuple[str, ...] = LIGHT


RUNTIME_TESTS = ("tests/runtime/test_source.py",)
KERNEL_TESTS = ("tests/operators/test_sanitised_kernels.py",)
PARTS = {
    "numerics": Part(sources=("piezoid/numerics/*.py",), tests=("tests/numerics",)),
    "optimiser": Part(
        sources=("piezoid/numerics/levenberg_marquardt.py",),
        tests=("tests/numerics/test_levenberg_marquardt.py",),
    ),
    "operators": Part(
        sources=("piezoid/operators/*.py",), tests=("tests/operators",), without=KERNEL_TESTS
    ),
    "kernels": Part(
        sources=("piezoid/operators/*.c",),
        # The tests of the fit check the derivatives of the chain.
        tests=("tests/operators", "tests/identification/hysteresis/test_rows.py"),
        without=KERNEL_TESTS,
    ),
    "forward": Part(
        sources=("piezoid/identification/forward.py",),
        tests=("tests/identification/test_forward.py",),
        loaded=(*LIGHT, *HEAVY),
    ),
    "identification": Part(
        sources=("piezoid/identification/**/*.py",),
        tests=("tests/identification",),
        loaded=(*LIGHT, *HEAVY),
    ),
    "design": Part(
        sources=("piezoid/design/*.py",), tests=("tests/design",), loaded=(*LIGHT, *HEAVY)
    ),
    "diagnosis": Part(
        sources=("piezoid/diagnosis/**/*.py",),
        tests=("tests/diagnosis",),
        loaded=(*LIGHT, *HEAVY),
    ),
    "runtime": Part(
        sources=("piezoid/runtime/*.py",), tests=("tests/runtime",), without=RUNTIME_TESTS
    ),
    "controller": Part(
        sources=("piezoid/runtime/piezoid_runtime.c",),
        tests=("tests/runtime",),
        without=RUNTIME_TESTS,
    ),
}


def equivalent() -> dict[str, str]:
    """Return the equivalent mutants and the reasons."""
    table = tomllib.loads((ROOT / "benchmarks" / "equivalent_mutants.toml").read_text())
    return {mutant: entry["reason"] for entry in table["group"] for mutant in entry["mutants"]}


def control(paths: Sequence[Path], tests: dict[str, dict[str, Any]]) -> None:
    """Stop if the tests fail on the original source, as every mutant would then be killed."""
    path = paths[0].relative_to(ROOT).as_posix()
    original = Mutant(path=path, line=0, function="", change="", source=paths[0].read_text)
    fast = sorted(tests, key=lambda name: tests[name]["seconds"])[: len(tests) // 2]
    if verdict(original, {name: tests[name] for name in fast}) != SURVIVED:
        sys.exit("The tests fail on the original source. Mend them before counting mutants.")


def draw_mutants(
    part: Part, tests: dict[str, dict[str, Any]], count: int, seed: int
) -> list[Mutant]:
    paths = sorted(path for glob in part.sources for path in ROOT.glob(glob))
    mutants = [mutant for path in paths for mutant in mutants_of(path, ROOT)]
    control(paths, tests)
    print(f"{len(mutants)} mutants in {len(paths)} files", flush=True)
    return random.Random(seed).sample(mutants, min(count, len(mutants)))


def report(verdicts: dict[str, str], sample: Sequence[Mutant]) -> None:
    reasons = equivalent()
    survivors = [m for m in sample if verdicts.get(m.name) == SURVIVED]
    for mutant in survivors:
        note = f"   (equivalent: {reasons[mutant.name]})" if mutant.name in reasons else ""
        print(f"survived {mutant.path}:{mutant.line} {mutant.name.partition(' ')[2]}{note}")
    killed = sum(verdicts.get(m.name) == KILLED for m in sample)
    equivalents = sum(m.name in reasons for m in survivors)
    survived = len(survivors) - equivalents
    print(
        f"{killed} killed, {survived} survived, {equivalents} equivalent; "
        f"score {100.0 * killed / max(killed + survived, 1):.1f} %"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("part", choices=PARTS)
    parser.add_argument("--count", type=int, default=80)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=420.0)
    parser.add_argument("--longest", type=float, default=float("inf"))
    options = parser.parse_args()
    part, start_s = PARTS[options.part], time.monotonic()
    for name in part.loaded:
        importlib.import_module(name)
    STATES.mkdir(parents=True, exist_ok=True)
    path = STATES / f"{options.part}.json"
    state: dict[str, Any] = json.loads(path.read_text()) if path.exists() else {}
    if "tests" not in state:
        state = {"tests": timed_tests(part.tests, part.without), "judged": {}}
        path.write_text(json.dumps(state))
    tests = {n: test for n, test in state["tests"].items() if test["seconds"] <= options.longest}
    seconds = sum(test["seconds"] for test in tests.values())
    print(f"{len(tests)} tests, {seconds:.1f} s of processor time", flush=True)
    sample = draw_mutants(part, tests, options.count, options.seed)
    for mutant in sample:
        if mutant.name in state["judged"] or time.monotonic() - start_s > options.seconds:
            continue
        state["judged"][mutant.name] = verdict(mutant, tests)
        path.write_text(json.dumps(state))
    remaining = sum(mutant.name not in state["judged"] for mutant in sample)
    report(state["judged"], sample)
    print(f"{remaining} mutants remain: run again" if remaining else "all mutants done")


if __name__ == "__main__":
    main()
