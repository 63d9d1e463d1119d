"""The shipped source alone: warnings of compilers, C++, the sanitisers."""

import ctypes
from pathlib import Path

import pytest

from piezoid.runtime.library import library
from tests.runtime.compiler import PRECISION, SOURCE, STRICT, attempt, require_tool, run
from tests.runtime.hostile import hostile_steps

STEPS = 50_000  # for each of five parameter sets


@pytest.mark.parametrize("precision", PRECISION)
def test_it_compiles_without_a_warning_and_calls_nothing_but_memory_functions(precision, tmp_path):
    compiler, out = require_tool("cc", "gcc", "clang"), tmp_path / "runtime.o"
    source = str(SOURCE / "piezoid_runtime.c")
    run(compiler, *STRICT, *PRECISION[precision], "-c", source, "-o", str(out))
    listing = run(require_tool("nm"), "--undefined-only", str(out))
    called = {line.split()[-1] for line in listing.splitlines()}
    assert called <= {"memset", "memcpy", "memmove"}


@pytest.mark.parametrize("precision", PRECISION)
def test_the_header_states_the_bytes_of_the_checksum(precision):
    checked_bytes = ctypes.sizeof(library(precision).parameters) - 12  # schema, size and checksum
    assert f"{checked_bytes} ({precision})" in (SOURCE / "piezoid_runtime.h").read_text()


def test_the_source_has_the_licence_and_refuses_fast_math():
    licence = (Path(__file__).resolve().parents[2] / "LICENSE").read_text().split()
    source = (SOURCE / "piezoid_runtime.c").read_text().replace("\n *", "\n")
    assert " ".join(licence) in " ".join(source.split())
    compiler = require_tool("gcc", "clang", "cc")
    source = str(SOURCE / "piezoid_runtime.c")
    result = attempt(compiler, "-std=c99", "-ffast-math", "-fsyntax-only", source)
    assert result.returncode != 0
    assert "NaN must stay NaN" in result.stderr


@pytest.mark.parametrize("precision", PRECISION)
def test_the_header_is_also_a_header_of_cpp(precision, tmp_path):
    compiler = require_tool("c++", "g++", "clang++")
    user = tmp_path / "user.cpp"
    user.write_text('#include "piezoid_runtime.h"\nint main() { return pz_describe(0) != 0; }\n')
    flags = ("-std=c++11", "-Wall", "-Wextra", "-Werror", "-pedantic", f"-I{SOURCE}")
    run(compiler, *flags, *PRECISION[precision], "-fsyntax-only", str(user))


@pytest.mark.parametrize("precision", PRECISION)
def test_hostile_steps_pass_the_sanitisers(precision, tmp_path):
    output = hostile_steps(precision, tmp_path, STEPS)
    assert output.count("digest") == 5
    assert all(int(line.split()[-1]) > 100 for line in output.splitlines() if "accepted" in line)
