"""One mutant before its tests: loaded in place of the source, in a process of its own.

Nothing is written into the tree. Tests are timed once, and it is noted which functions each of
them enters; a mutant then meets first those that enter its function, the quickest first.
"""

import contextlib
import importlib.abc
import importlib.machinery
import importlib.util
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

from benchmarks.mutants import Mutant

ROOT = Path(__file__).resolve().parents[1]
ROOM_bytes = 4 << 30
KILLED, SURVIVED, UNBUILT = "killed", "survived", "does not compile"
# What is undefined ends the process: tests of the unbroken sources run under sanitisers as well.
TRAPS = ("-fsanitize=undefined", "-fsanitize-undefined-trap-on-error")
# Which compiled modules a C file becomes, with what is compiled beside it.
BUILDS: dict[str, dict[str, tuple[str, ...]]] = {
    "kernels.c": {"piezoid.operators._kernels": ("chain.c", "states.c")},
    "chain.c": {"piezoid.operators._kernels": ("kernels.c", "states.c")},
    "states.c": {"piezoid.operators._kernels": ("kernels.c", "chain.c")},
    "piezoid_runtime.c": {
        "piezoid.runtime._runtime": ("run_many.c",),
        "piezoid.runtime._runtime32": ("run_many.c", "-DPZ_REAL_FLOAT=1"),
    },
}


class Broken(importlib.abc.MetaPathFinder, importlib.machinery.SourceFileLoader):
    """Hands out one module with its mutant, and everything else as it is, files beside it too."""

    def __init__(self, name: str, path: Path, source: str) -> None:
        super().__init__(name, str(path))
        self.code: CodeType = compile(source, str(path), "exec")

    def find_spec(self, fullname: str, *_: Any) -> importlib.machinery.ModuleSpec | None:
        if fullname != self.name:
            return None
        return importlib.util.spec_from_file_location(fullname, self.path, loader=self)

    def get_code(self, _: str) -> CodeType:
        return self.code


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


def timed_tests(tests: Sequence[str], without: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Run tests once and return what the witness saw; the failing are left out.

    Each is given the seconds of its whole file as well.

    tests    folders
    without  files that are not run
    """
    with tempfile.NamedTemporaryFile(suffix=".json") as kept:

        def work() -> int:
            witness = Witness()
            run_tests([*tests, *(f"--ignore={name}" for name in without)], witness)
            Path(kept.name).write_text(json.dumps(witness.tests))
            return 0

        forked(work, 3600.0)
        seen: dict[str, dict[str, Any]] = json.loads(Path(kept.name).read_text())
    of_file: dict[str, float] = {}
    for name, test in seen.items():
        file = name.partition("::")[0]
        of_file[file] = of_file.get(file, 0.0) + test["seconds"]
    for name, test in seen.items():
        test["file_seconds"] = of_file[name.partition("::")[0]]
    return {name: test for name, test in seen.items() if not test["failed"]}


def chosen_tests(mutant: Mutant, tests: dict[str, dict[str, Any]]) -> list[str]:
    """Those that enter the mutant's function, quickest first, then all others of their files.

    A file's other tests may live on what the first of them has computed and kept. A constant is
    seen by whoever reads it: such a mutant meets all.
    """
    by_time = sorted(tests, key=lambda name: tests[name]["seconds"])
    if mutant.path.endswith(".c"):
        return by_time
    functions = lines_of(mutant)
    first = [name for name in by_time if functions & set(tests[name]["entered"])]
    if not first:  # entered when the file is imported, if ever
        ours = f"{mutant.path}:"
        first = [n for n in by_time if any(e.startswith(ours) for e in tests[n]["entered"])]
    files = {name.partition("::")[0] for name in (first if mutant.function else by_time)}
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
    # What a file computes once is paid for by whichever of its tests comes first.
    files = {name.partition("::")[0]: tests[name]["file_seconds"] for name in names}
    limit_s = 20.0 + 4.0 * sum(files.values())
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
            ["cc", "-std=c99", "-O1", "-w", "-ffp-contract=off", "-shared", "-fPIC", *TRAPS,
             f"-I{path.parent}", str(source), *others, "-o", str(places[name]), "-lm"],
            capture_output=True, check=False,
        )  # fmt: skip
        if done.returncode:
            return None
    return Compiled(places)
