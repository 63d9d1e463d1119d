"""Break a module on purpose, one slip at a time, and count how many its own tests notice.

    python -m benchmarks.mutation_score PART [--count 80] [--seed 1] [--seconds 420] [--longest 5]

Parts: see ``PARTS``. The first run times the tests and notes which functions each of them enters;
a mutant then meets first those that enter its function, the quickest first, then all others of
the same files, up to the first failure. Everything happens in forked processes: nothing is
written into the tree, but for build/mutation/PART.json, in which a run that was cut off by
``--seconds`` is continued. Tests longer than ``--longest`` are left out: the score is then a bound
from below. ``benchmarks/equivalent_mutants.toml`` names those that change nothing
a test could see, each with its reason; they are left out of the score.
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

KEPT = ROOT / "build" / "mutation"
LIGHT = ("numpy", "scipy.linalg", "pytest", "hypothesis", "_pytest.assertion.rewrite")
HEAVY = ("scipy.optimize", "scipy.signal", "scipy.integrate", "pandas", "clarabel", "nlopt")


@dataclass(frozen=True, kw_only=True)
class Part:
    """What is broken and what must notice.

    sources  globs of files
    tests    folders and files
    without  test files that look at other copies of the source
    loaded   packages that the tests need: loaded once, before the forks
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
        # The derivatives of the chain are promised where a fit takes them.
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
    """Return the mutants that change nothing a test could see, with the reasons."""
    table = tomllib.loads((ROOT / "benchmarks" / "equivalent_mutants.toml").read_text())
    return {mutant: entry["reason"] for entry in table["group"] for mutant in entry["mutants"]}


def control(paths: Sequence[Path], tests: dict[str, dict[str, Any]]) -> None:
    """Stop unless the unbroken source passes: else every mutant would count as noticed."""
    path = paths[0].relative_to(ROOT).as_posix()
    unbroken = Mutant(path=path, line=0, function="", change="", broken=paths[0].read_text)
    quick = sorted(tests, key=lambda name: tests[name]["seconds"])[: len(tests) // 2]
    if verdict(unbroken, {name: tests[name] for name in quick}) != SURVIVED:
        sys.exit("the tests fail on the source as it is: nothing can be said of mutants")


def sampled(part: Part, tests: dict[str, dict[str, Any]], count: int, seed: int) -> list[Mutant]:
    paths = sorted(path for glob in part.sources for path in ROOT.glob(glob))
    every = [mutant for path in paths for mutant in mutants_of(path, ROOT)]
    control(paths, tests)
    print(f"{len(every)} mutants in {len(paths)} files", flush=True)
    return random.Random(seed).sample(every, min(count, len(every)))


def report(judged: dict[str, str], sample: Sequence[Mutant]) -> None:
    excused = equivalent()
    survivors = [m for m in sample if judged.get(m.name) == SURVIVED]
    for mutant in survivors:
        note = f"   (equivalent: {excused[mutant.name]})" if mutant.name in excused else ""
        print(f"survived {mutant.path}:{mutant.line} {mutant.name.partition(' ')[2]}{note}")
    counts = {kind: sum(judged.get(m.name) == kind for m in sample) for kind in (KILLED, SURVIVED)}
    alike = sum(m.name in excused for m in survivors)
    real = counts[KILLED] + counts[SURVIVED] - alike
    print(
        f"{counts[KILLED]} killed, {counts[SURVIVED] - alike} survived, {alike} equivalent; "
        f"score {100.0 * counts[KILLED] / max(real, 1):.1f} %"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("part", choices=PARTS)
    parser.add_argument("--count", type=int, default=80)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=420.0)
    parser.add_argument("--longest", type=float, default=float("inf"))
    asked = parser.parse_args()
    part, began_s = PARTS[asked.part], time.monotonic()
    for name in part.loaded:
        importlib.import_module(name)
    KEPT.mkdir(parents=True, exist_ok=True)
    kept = KEPT / f"{asked.part}.json"
    state: dict[str, Any] = json.loads(kept.read_text()) if kept.exists() else {}
    if "tests" not in state:
        state = {"tests": timed_tests(part.tests, part.without), "judged": {}}
        kept.write_text(json.dumps(state))
    tests = {n: test for n, test in state["tests"].items() if test["seconds"] <= asked.longest}
    seconds = sum(test["seconds"] for test in tests.values())
    print(f"{len(tests)} tests, {seconds:.1f} s of processor time", flush=True)
    sample = sampled(part, tests, asked.count, asked.seed)
    for mutant in sample:
        if mutant.name in state["judged"] or time.monotonic() - began_s > asked.seconds:
            continue
        state["judged"][mutant.name] = verdict(mutant, tests)
        kept.write_text(json.dumps(state))
    left = sum(mutant.name not in state["judged"] for mutant in sample)
    report(state["judged"], sample)
    print("all judged" if not left else f"{left} left: run again")


if __name__ == "__main__":
    main()
