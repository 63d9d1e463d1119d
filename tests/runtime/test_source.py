"""The shipped source on its own: other compilers' warnings, C++, the sanitisers."""

import ctypes
import subprocess
from pathlib import Path

import pytest

from piezoid.runtime.library import library
from tests.runtime.compiler import PRECISION, SOURCE, STRICT, found, run
from tests.runtime.hostile import hostile_steps

STEPS = 200_000  # for each of five parameter sets: a million


@pytest.mark.parametrize("precision", PRECISION)
def test_it_compiles_without_a_warning_and_calls_nothing_but_memory_functions(precision, tmp_path):
    compiler, out = found("cc", "gcc", "clang"), tmp_path / "runtime.o"
    source = str(SOURCE / "piezoid_runtime.c")
    run(compiler, *STRICT, *PRECISION[precision], "-c", source, "-o", str(out))
    listing = run(found("nm"), "--undefined-only", str(out))
    called = {line.split()[-1] for line in listing.splitlines()}
    assert called <= {"memset", "memcpy", "memmove"}


@pytest.mark.parametrize("precision", PRECISION)
def test_the_header_states_the_bytes_of_the_checksum(precision):
    sealed = ctypes.sizeof(library(precision).parameters) - 12  # schema, size and checksum
    assert f"{sealed} ({precision})" in (SOURCE / "piezoid_runtime.h").read_text()


def test_the_source_carries_the_licence():
    licence = (Path(__file__).resolve().parents[2] / "LICENSE").read_text().split()
    source = (SOURCE / "piezoid_runtime.c").read_text().replace("\n *", "\n")
    assert " ".join(licence) in " ".join(source.split())


@pytest.mark.parametrize("precision", PRECISION)
def test_the_header_is_also_a_header_of_cpp(precision, tmp_path):
    compiler = found("c++", "g++", "clang++")
    user = tmp_path / "user.cpp"
    user.write_text('#include "piezoid_runtime.h"\nint main() { return pz_describe(0) != 0; }\n')
    flags = ("-std=c++11", "-Wall", "-Wextra", "-Werror", "-pedantic", f"-I{SOURCE}")
    run(compiler, *flags, *PRECISION[precision], "-fsyntax-only", str(user))


def test_fast_math_is_refused():
    compiler = found("gcc", "clang", "cc")
    source = str(SOURCE / "piezoid_runtime.c")
    done = subprocess.run(
        [compiler, "-std=c99", "-ffast-math", "-fsyntax-only", source],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode != 0
    assert "NaN must stay NaN" in done.stderr


@pytest.mark.parametrize("precision", PRECISION)
def test_a_million_hostile_steps_pass_the_sanitisers(precision, tmp_path):
    said = hostile_steps(precision, tmp_path, STEPS)
    assert said.count("digest") == 5
    assert all(int(line.split()[-1]) > 100 for line in said.splitlines() if "accepted" in line)
