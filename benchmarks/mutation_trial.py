"""Run the tests on one mutant, which a forked process imports instead of the source.

The repository is not modified. A first run measures the duration of each test and records the
functions that it enters. The tests of a mutant start with those that enter its function, in order
of their duration.
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
MEMORY_bytes = 4 << 30
KILLED, SURVIVED, UNBUILT = "killed", "survived", "does not compile"
# Undefined behaviour ends the process: the original sources are tested under sanitisers too.
TRAPS = ("-fsanitize=undefined", "-fsanitize-undefined-trap-on-error")
# Compiled modules of a C file, with the other sources and options of each module.
BUILDS: dict[str, dict[str, tuple[str, ...]]] = {
    "kernels.c": {"piezoid.operators._kernels": ("chain.c", "states.c")},
    "chain.c": {"piezoid.operators._kernels": ("kernels.c", "states.c")},
    "states.c": {"piezoid.operators._kernels": ("kernels.c", "chain.c")},
    "piezoid_runtime.c": {
        "piezoid.runtime._runtime": ("run_many.c",),
        "piezoid.runtime._runtime32": ("run_many.c", "-DPZ_REAL_FLOAT=1"),
    },
}


class MutantLoader(importlib.abc.MetaPathFinder, importlib.machinery.SourceFileLoader):
    """Import hook that replaces the source of one module by a mutant."""

    def __init__(self, name: str, path: Path, source: str) -> None:
        super().__init__(name, str(path))
        self.code: CodeType = compile(source, str(path), "exec")

    def find_spec(self, fullname: str, *_: Any) -> importlib.machinery.ModuleSpec | None:
        if fullname != self.name:
            return None
        return importlib.util.spec_from_file_location(fullname, self.path, loader=self)

    def get_code(self, _: str) -> CodeType:
        return self.code


class CompiledMutantFinder(importlib.abc.MetaPathFinder):
    """Import hook that finds compiled modules in another folder."""

    def __init__(self, paths: dict[str, Path]) -> None:
        self.paths = paths

    def find_spec(self, fullname: str, *_: Any) -> importlib.machinery.ModuleSpec | None:
        path = self.paths.get(fullname)
        if path is None:
            return None
        loader = importlib.machinery.ExtensionFileLoader(fullname, str(path))
        return importlib.machinery.ModuleSpec(fullname, loader, origin=str(path))


class Profiler:
    """Pytest plugin that records duration, outcome and entered functions of every test."""

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


def run_in_fork(work: Callable[[], int], limit_s: float) -> int:
    """Run a function in a silent child process; return its exit status, or -1 after a signal."""
    child = os.fork()
    if child == 0:
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 1)
        os.dup2(null, 2)
        resource.setrlimit(resource.RLIMIT_CPU, (int(limit_s) + 1, int(limit_s) + 2))
        resource.setrlimit(resource.RLIMIT_DATA, (MEMORY_bytes, MEMORY_bytes))
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
    # The parent has imported packages before the fork, on which pytest would warn.
    options = ("-q", "-p", "no:cacheprovider", "-W", "ignore::pytest.PytestAssertRewriteWarning")
    return int(pytest.main([*options, *arguments], plugins=list(plugins)))


def timed_tests(tests: Sequence[str], without: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Run the tests once; return durations and entered functions of those that pass.

    Every entry also contains the duration of its file.

    tests    folders
    without  excluded files
    """
    with tempfile.NamedTemporaryFile(suffix=".json") as output:

        def work() -> int:
            profiler = Profiler()
            run_tests([*tests, *(f"--ignore={name}" for name in without)], profiler)
            Path(output.name).write_text(json.dumps(profiler.tests))
            return 0

        run_in_fork(work, 3600.0)
        profiles: dict[str, dict[str, Any]] = json.loads(Path(output.name).read_text())
    file_seconds: dict[str, float] = {}
    for name, test in profiles.items():
        file = name.partition("::")[0]
        file_seconds[file] = file_seconds.get(file, 0.0) + test["seconds"]
    for name, test in profiles.items():
        test["file_seconds"] = file_seconds[name.partition("::")[0]]
    return {name: test for name, test in profiles.items() if not test["failed"]}


def relevant_tests(mutant: Mutant, tests: dict[str, dict[str, Any]]) -> list[str]:
    """Return tests that enter the mutated function, fastest first, then the others of their files.

    The other tests of a file may use cached results of the first ones. A constant may be read
    anywhere, so its mutants run all tests.
    """
    by_time = sorted(tests, key=lambda name: tests[name]["seconds"])
    if mutant.path.endswith(".c"):
        return by_time
    functions = entry_points(mutant)
    direct = [name for name in by_time if functions & set(tests[name]["entered"])]
    if not direct:  # the function runs on import, or never
        prefix = f"{mutant.path}:"
        direct = [n for n in by_time if any(e.startswith(prefix) for e in tests[n]["entered"])]
    files = {name.partition("::")[0] for name in (direct if mutant.function else by_time)}
    return direct + [n for n in by_time if n.partition("::")[0] in files and n not in set(direct)]


def entry_points(mutant: Mutant) -> set[str]:
    """Return file and line of the mutated function and of functions and lambdas inside it."""
    import ast

    tree = ast.parse((ROOT / mutant.path).read_text())
    scopes = (
        ast.FunctionDef, ast.Lambda, ast.ListComp, ast.GeneratorExp, ast.DictComp, ast.SetComp,
    )  # fmt: skip
    enclosing = [
        n for n in ast.walk(tree)
        if isinstance(n, ast.FunctionDef) and n.lineno <= mutant.line <= (n.end_lineno or 0)
    ]  # fmt: skip
    root = max(enclosing, key=lambda n: n.lineno) if enclosing else tree
    nodes = [n for n in ast.walk(root) if isinstance(n, scopes)]
    lines = {n.lineno for n in nodes}
    lines |= {d.lineno for n in nodes if isinstance(n, ast.FunctionDef) for d in n.decorator_list}
    return {f"{mutant.path}:{line}" for line in lines}


def verdict(mutant: Mutant, tests: dict[str, dict[str, Any]]) -> str:
    """Run the relevant tests on one mutant; return KILLED, SURVIVED or UNBUILT."""
    names = relevant_tests(mutant, tests)
    if not names:
        return SURVIVED
    # The first test of a file computes its cached results.
    files = {name.partition("::")[0]: tests[name]["file_seconds"] for name in names}
    limit_s = 20.0 + 4.0 * sum(files.values())
    with tempfile.TemporaryDirectory() as folder:
        finder = finder_of(mutant, Path(folder))
        if finder is None:
            return UNBUILT

        def work() -> int:
            sys.meta_path.insert(0, finder)
            return run_tests(["-x", *names])

        return SURVIVED if run_in_fork(work, limit_s) == 0 else KILLED


def finder_of(mutant: Mutant, folder: Path) -> importlib.abc.MetaPathFinder | None:
    """Return the import hook of a mutant, or None if it does not compile."""
    path = ROOT / mutant.path
    if path.suffix == ".py":
        name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        return MutantLoader(name, path, mutant.source())
    libraries = {}
    source = folder / path.name
    source.write_text(mutant.source())
    for name, inputs in BUILDS[path.name].items():
        libraries[name] = folder / f"{name.rpartition('.')[2]}.so"
        arguments = [str(path.parent / k) if k.endswith(".c") else k for k in inputs]
        compiler = subprocess.run(
            ["cc", "-std=c99", "-O1", "-w", "-ffp-contract=off", "-shared", "-fPIC", *TRAPS,
             f"-I{path.parent}", str(source), *arguments, "-o", str(libraries[name]), "-lm"],
            capture_output=True, check=False,
        )  # fmt: skip
        if compiler.returncode:
            return None
    return CompiledMutantFinder(libraries)
