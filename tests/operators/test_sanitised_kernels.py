"""The kernels under the sanitisers: no byte outside what they are given, nothing undefined."""

import os
import subprocess
import sys
from pathlib import Path

import piezoid.operators
from tests.operators.sanitised import LIBRARY
from tests.runtime.compiler import found, run
from tests.runtime.hostile import SANITISERS, need_sanitisers

ROOT = Path(__file__).parents[2]
SOURCE = Path(piezoid.operators.__file__).parent
PLAYS = ("tests/operators/test_laws_of_plays.py",)
# Together they enter every function of every source, with chunks and banks of odd sizes.
TESTS = (
    *PLAYS,
    *("tests/operators/test_worked_example.py", "tests/operators/test_chain.py"),
    *("tests/operators/test_filters.py", "tests/operators/test_wide_hysteresis.py"),
    "tests/identification/hysteresis/test_rows.py",
)


def under_sanitisers(
    folder: Path, sources: list[Path], tests: tuple[str, ...]
) -> "subprocess.CompletedProcess[str]":
    """Compile the kernels with sanitisers, and run the tests on them in a process of its own."""
    compiler = found("gcc")
    need_sanitisers(compiler, folder)
    library = folder / "kernels.so"
    flags = ("-std=c99", "-O1", "-ffp-contract=off", "-shared", "-fPIC", f"-I{SOURCE}")
    run(compiler, *flags, *SANITISERS, *map(str, sources), "-o", str(library), "-lm")
    preload = run(compiler, "-print-file-name=libasan.so").strip()
    chosen = {LIBRARY: str(library), "LD_PRELOAD": preload, "ASAN_OPTIONS": "detect_leaks=0"}
    plugins = ("-p", "no:cacheprovider", "-p", "tests.operators.sanitised")
    return subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-x", "-s", *plugins, *tests],
        env=os.environ | chosen, cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip


def test_no_kernel_leaves_what_it_is_given(tmp_path: Path) -> None:
    done = under_sanitisers(tmp_path, sorted(SOURCE.glob("*.c")), TESTS)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]


def test_a_kernel_that_did_would_be_seen(tmp_path: Path) -> None:
    sources = {place.name: place.read_text() for place in SOURCE.glob("*.c")}
    whole = "for (size_t i = 0; i < LANES; ++i) {"
    assert whole in sources["kernels.c"]
    sources["kernels.c"] = sources["kernels.c"].replace(whole, whole.replace("<", "<="), 1)
    for name, source in sources.items():
        (tmp_path / name).write_text(source)
    done = under_sanitisers(tmp_path, sorted(tmp_path.glob("*.c")), PLAYS)
    assert done.returncode != 0
    assert "out of bounds" in done.stderr
