"""Break a module on purpose, one slip at a time, and count how many its own tests notice.

    python -m benchmarks.mutation_score PART [--count 80] [--seed 1] [--seconds 420]

Parts: see ``PARTS``. The first run times the tests and notes which functions each of them enters;
a mutant then meets first those that enter its function, the quickest first, then all others of
the same files, up to the first failure. Everything happens in forked processes: nothing is
written into the tree, but for build/mutation/PART.json, in which a run that was cut off by
``--seconds`` is continued. ``benchmarks/equivalent_mutants.toml`` names those that change nothing
a test could see, each with its reason; they are left out of the score.
"""

import argparse
import contextlib
import importlib
import importlib.abc
import importlib.machinery
import json
import os
import random
import resource
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import CodeType, FrameType, ModuleType
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from benchmarks.mutants import Mutant, mutants_of

ROOT = Path(__file__).resolve().parents[1]
KEPT = ROOT / "build" / "mutation"
LIGHT = ("numpy", "scipy.linalg", "pytest", "hypothesis", "_pytest.assertion.rewrite")
HEAVY = ("scipy.optimize", "scipy.signal", "scipy.integrate", "pandas", "cvxpy", "nlopt")
ROOM_bytes = 4 << 30
KILLED, SURVIVED, UNBUILT = "killed", "survived", "does not compile"


@dataclass(frozen=True, kw_only=True)
class Part:
    """What is broken and what must notice.

    sources  globs of files
    tests    folders
    without  test files that look at other copies of the source
    loaded   packages that the tests need: loaded once, before the forks
    """

    sources: tuple[str, ...]
    tests: tuple[str, ...]
    without: tuple[str, ...] = ()
    loaded: tuple[str, ...] = LIGHT


RUNTIME_TESTS = ("tests/runtime/test_source.py",)
PARTS = {
    "numerics": Part(sources=("piezoid/numerics/*.py",), tests=("tests/numerics",)),
    "operators": Part(sources=("piezoid/operators/*.py",), tests=("tests/operators",)),
    "kernels": Part(sources=("piezoid/operators/*.c",), tests=("tests/operators",)),
    "identification": Part(
        sources=("piezoid/identification/**/*.py",),
        tests=("tests/identification",),
        loaded=(*LIGHT, *HEAVY),
    ),
    "design": Part(
        sources=("piezoid/design/*.py",), tests=("tests/design",), loaded=(*LIGHT, *HEAVY)
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
# Which compiled modules a C file becomes, with what is compiled beside it.
BUILDS: dict[str, dict[str, tuple[str, ...]]] = {
    "kernels.c": {"piezoid.operators._kernels": ("chain.c",)},
    "chain.c": {"piezoid.operators._kernels": ("kernels.c",)},
    "piezoid_runtime.c": {
        "piezoid.runtime._runtime": ("run_many.c",),
        "piezoid.runtime._runtime32": ("run_many.c", "-DPZ_REAL_FLOAT=1"),
    },
}


class Broken(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Hands out one module with its mutant, and everything else as it is."""

    def __init__(self, name: str, path: Path, source: str) -> None:
        self.name, self.path = name, path
        self.code: CodeType = compile(source, str(path), "exec")

    def find_spec(self, fullname: str, *_: Any) -> importlib.machinery.ModuleSpec | None:
        if fullname != self.name:
            return None
        folder = [str(self.path.parent)] if self.path.name == "__init__.py" else None
        spec = importlib.machinery.ModuleSpec(fullname, self, origin=str(self.path))
        spec.submodule_search_locations = folder
        spec.has_location = True
        return spec

    def exec_module(self, module: ModuleType) -> None:
        exec(self.code, module.__dict__)


class Compiled(importlib.abc.MetaPathFinder):
    """Hands out compiled modules from another folder."""

    def __init__(self, places: dict[str, Path]) -> None:
        self.places = places

    def find_spec(self, fullname: str, *_: Any) -> importlib.machinery.ModuleSpec | None:
        place = self.places.get(fullname)
        if place is None:
            return None
        loader = importlib.machinery.ExtensionFileLoader(fullname, str(place))
        return importlib.machinery.ModuleSpec(fullname, loader, origin=str(place))


class Witness:
    """A pytest plugin: seconds, outcome and entered functions of every test."""

    def __init__(self) -> None:
        self.entered: set[tuple[str, int]] = set()
        self.tests: dict[str, dict[str, Any]] = {}

    def _call(self, frame: FrameType, event: str, _: Any) -> None:
        if event == "call" and "/piezoid/" in frame.f_code.co_filename:
            self.entered.add((frame.f_code.co_filename, frame.f_code.co_firstlineno))

    def pytest_runtest_protocol(self, item: Any) -> None:
        self.entered.clear()
        self.tests[item.nodeid] = {"began": time.process_time(), "failed": False}
        sys.setprofile(self._call)

    def pytest_runtest_logreport(self, report: Any) -> None:
        sys.setprofile(None)
        test = self.tests[report.nodeid]
        test["failed"] |= report.failed
        if report.when == "teardown":
            test["seconds"] = time.process_time() - test.pop("began")
            test["entered"] = sorted(
                f"{Path(name).resolve().relative_to(ROOT).as_posix()}:{line}"
                for name, line in self.entered
                if Path(name).resolve().is_relative_to(ROOT)
            )
        else:
            sys.setprofile(self._call)


def forked(work: Callable[[], int], limit_s: float) -> int:
    """Run something in a process of its own, silent; its exit status, or -1 for a violent end."""
    child = os.fork()
    if child == 0:
        silence = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silence, 1)
        os.dup2(silence, 2)
        resource.setrlimit(resource.RLIMIT_CPU, (int(limit_s) + 1, int(limit_s) + 2))
        resource.setrlimit(resource.RLIMIT_DATA, (ROOM_bytes, ROOM_bytes))
        status = 70
        with contextlib.suppress(BaseException):
            status = work()
        os._exit(status)
    _, status = os.waitpid(child, 0)
    return os.WEXITSTATUS(status) if os.WIFEXITED(status) else -1


def run_tests(arguments: Sequence[str], *plugins: object) -> int:
    import pytest

    os.chdir(ROOT)
    os.environ["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"
    # What the parent has imported already stays as it is, on purpose.
    options = ("-q", "-p", "no:cacheprovider", "-W", "ignore::pytest.PytestAssertRewriteWarning")
    return int(pytest.main([*options, *arguments], plugins=list(plugins)))


def timed_tests(part: Part) -> dict[str, dict[str, Any]]:
    """Run the tests of a part once and return what the witness saw; the failing are left out."""
    with tempfile.NamedTemporaryFile(suffix=".json") as kept:

        def work() -> int:
            witness = Witness()
            run_tests([*part.tests, *(f"--ignore={name}" for name in part.without)], witness)
            Path(kept.name).write_text(json.dumps(witness.tests))
            return 0

        forked(work, 3600.0)
        tests: dict[str, dict[str, Any]] = json.loads(Path(kept.name).read_text())
    return {name: test for name, test in tests.items() if not test["failed"]}


def chosen_tests(mutant: Mutant, tests: dict[str, dict[str, Any]]) -> list[str]:
    """Those that enter the mutant's function, quickest first, then all others of their files.

    A file's other tests may live on what the first of them has computed and kept.
    """
    by_time = sorted(tests, key=lambda name: tests[name]["seconds"])
    if mutant.path.endswith(".c"):
        return by_time
    functions = lines_of(mutant)
    first = [name for name in by_time if functions & set(tests[name]["entered"])]
    if not first:  # entered when the file is imported, if ever
        ours = f"{mutant.path}:"
        first = [n for n in by_time if any(e.startswith(ours) for e in tests[n]["entered"])]
    files = {name.partition("::")[0] for name in first}
    return first + [n for n in by_time if n.partition("::")[0] in files and n not in set(first)]


def lines_of(mutant: Mutant) -> set[str]:
    """The places at which the mutant's function, or any of its file, is entered."""
    import ast

    tree = ast.parse((ROOT / mutant.path).read_text())
    kinds = (
        ast.FunctionDef,
        ast.Lambda,
        ast.ListComp,
        ast.GeneratorExp,
        ast.DictComp,
        ast.SetComp,
    )
    around = [
        n for n in ast.walk(tree)
        if isinstance(n, ast.FunctionDef) and n.lineno <= mutant.line <= (n.end_lineno or 0)
    ]  # fmt: skip
    root = max(around, key=lambda n: n.lineno) if around else tree
    inside = [n for n in ast.walk(root) if isinstance(n, kinds)]
    lines = {n.lineno for n in inside}
    lines |= {d.lineno for n in inside if isinstance(n, ast.FunctionDef) for d in n.decorator_list}
    return {f"{mutant.path}:{line}" for line in lines}


def verdict(mutant: Mutant, tests: dict[str, dict[str, Any]]) -> str:
    """Run the tests on one mutant."""
    names = chosen_tests(mutant, tests)
    if not names:
        return SURVIVED
    limit_s = 20.0 + 4.0 * sum(tests[name]["seconds"] for name in names)
    with tempfile.TemporaryDirectory() as folder:
        finder = finder_of(mutant, Path(folder))
        if finder is None:
            return UNBUILT

        def work() -> int:
            sys.meta_path.insert(0, finder)
            return run_tests(["-x", *names])

        return SURVIVED if forked(work, limit_s) == 0 else KILLED


def finder_of(mutant: Mutant, folder: Path) -> importlib.abc.MetaPathFinder | None:
    path = ROOT / mutant.path
    if path.suffix == ".py":
        name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        return Broken(name, path, mutant.broken())
    places = {}
    source = folder / path.name
    source.write_text(mutant.broken())
    for name, beside in BUILDS[path.name].items():
        places[name] = folder / f"{name.rpartition('.')[2]}.so"
        others = [str(path.parent / b) if b.endswith(".c") else b for b in beside]
        done = subprocess.run(
            ["cc", "-std=c99", "-O1", "-w", "-ffp-contract=off", "-shared", "-fPIC",
             f"-I{path.parent}", str(source), *others, "-o", str(places[name]), "-lm"],
            capture_output=True, check=False,
        )  # fmt: skip
        if done.returncode:
            return None
    return Compiled(places)


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
    asked = parser.parse_args()
    part, began_s = PARTS[asked.part], time.monotonic()
    for name in part.loaded:
        importlib.import_module(name)
    KEPT.mkdir(parents=True, exist_ok=True)
    kept = KEPT / f"{asked.part}.json"
    state: dict[str, Any] = json.loads(kept.read_text()) if kept.exists() else {}
    if "tests" not in state:
        state = {"tests": timed_tests(part), "judged": {}}
        kept.write_text(json.dumps(state))
    seconds = sum(test["seconds"] for test in state["tests"].values())
    print(f"{len(state['tests'])} tests, {seconds:.1f} s of processor time", flush=True)
    sample = sampled(part, state["tests"], asked.count, asked.seed)
    for mutant in sample:
        if mutant.name in state["judged"] or time.monotonic() - began_s > asked.seconds:
            continue
        state["judged"][mutant.name] = verdict(mutant, state["tests"])
        kept.write_text(json.dumps(state))
    left = sum(mutant.name not in state["judged"] for mutant in sample)
    report(state["judged"], sample)
    print("all judged" if not left else f"{left} left: run again")


if __name__ == "__main__":
    main()
