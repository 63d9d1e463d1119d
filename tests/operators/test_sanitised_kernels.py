"""The kernels pass the address and undefined-behaviour sanitisers."""

import os
import subprocess
import sys
from pathlib import Path

import piezoid.operators
from tests.operators.sanitised import LIBRARY
from tests.runtime.compiler import require_tool, run
from tests.runtime.hostile import SANITISERS, need_sanitisers

ROOT = Path(__file__).parents[2]
SOURCE = Path(piezoid.operators.__file__).parent
PLAYS = ("tests/operators/test_laws_of_plays.py",)
# Together these tests enter every function of every source, with chunks and banks of odd sizes.
TESTS = (
    *PLAYS,
    *("tests/operators/test_worked_example.py", "tests/operators/test_chain.py"),
    *("tests/operators/test_filters.py", "tests/operators/test_wide_hysteresis.py"),
    "tests/identification/test_forward.py",
)


def run_with_sanitisers(
    folder: Path, sources: list[Path], tests: tuple[str, ...]
) -> "subprocess.CompletedProcess[str]":
    """Compile the kernels with sanitisers and run the tests on them in a separate process."""
    compiler = require_tool("gcc")
    need_sanitisers(compiler, folder)
    library = folder / "kernels.so"
    flags = ("-std=c99", "-O1", "-ffp-contract=off", "-shared", "-fPIC", f"-I{SOURCE}")
    run(compiler, *flags, *SANITISERS, *map(str, sources), "-o", str(library), "-lm")
    preload = run(compiler, "-print-file-name=libasan.so").strip()
    environment = {LIBRARY: str(library), "LD_PRELOAD": preload, "ASAN_OPTIONS": "detect_leaks=0"}
    plugins = ("-p", "no:cacheprovider", "-p", "tests.operators.sanitised")
    return subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-x", "-s", *plugins, *tests],
        env=os.environ | environment, cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip


def test_the_kernels_pass_the_sanitisers(tmp_path):
    result = run_with_sanitisers(tmp_path, sorted(SOURCE.glob("*.c")), TESTS)
    assert result.returncode == 0, result.stdout[-2000:] + result.stderr[-2000:]


def test_the_sanitisers_detect_an_index_out_of_bounds(tmp_path):
    sources = {path.name: path.read_text() for path in SOURCE.glob("*.c")}
    loop = "for (size_t i = 0; i < LANES; ++i) {"
    assert loop in sources["kernels.c"]
    sources["kernels.c"] = sources["kernels.c"].replace(loop, loop.replace("<", "<="), 1)
    for name, source in sources.items():
        (tmp_path / name).write_text(source)
    result = run_with_sanitisers(tmp_path, sorted(tmp_path.glob("*.c")), PLAYS)
    assert result.returncode != 0
    assert "out of bounds" in result.stderr
