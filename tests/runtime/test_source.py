"""The shipped source on its own: other compilers' warnings, C++, the sanitisers."""

import subprocess
from pathlib import Path

import pytest

from piezoid.runtime.library import library
from piezoid.runtime.values import complete
from tests.runtime.compiler import PRECISION, SOURCE, STRICT, found, run
from tests.runtime.test_schema import LATERAL, tunnelling

SANITISERS = ("-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
STEPS = 250_000  # for each of four parameter sets: a million

# Everything the lateral parameters of the other tests leave out.
SECTION = [[0.5, 0.25, 0.25, -0.5, 0.5]]
FURTHER = {
    **{"voltage_minimum_V": -4.0, "voltage_maximum_V": 3.0, "lsb_V": 0.001, "polarity": -1},
    **{"envelope_count": 3, "envelope_knot_V": [-1, 0, 2], "envelope_weight": [0.1, 1, -0.1]},
    **{"reference_section_count": 1, "reference_section": SECTION, "reference_step_m": 0.5},
    **{"command_section_count": 1, "command_section": SECTION, "voltage_step_V": 1.0},
    **{"stuck_samples": 3, "stuck_voltage_V": 0.01},
}


@pytest.mark.parametrize("precision", PRECISION)
def test_it_compiles_alone_without_a_warning_and_needs_no_mathematics(precision, tmp_path):
    compiler = found("cc", "gcc", "clang")
    out = tmp_path / "runtime.so"
    run(
        *(compiler, *STRICT, *PRECISION[precision], "-shared", "-fPIC"),
        *("-Wl,--no-undefined", str(SOURCE / "piezoid_runtime.c"), "-o", str(out)),
    )
    listing = run(found("nm"), "-D", "--undefined-only", str(out))
    used = {line.split()[-1].split("@")[0] for line in listing.splitlines()}
    assert not used & {"log", "logf", "floor", "round", "malloc", "free", "printf", "exp"}


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
    compiler = found("gcc", "clang", "cc")
    probe = tmp_path / "probe.c"
    probe.write_text("int main(void) { return 0; }\n")
    program = str(tmp_path / "probe")
    if subprocess.run([compiler, *SANITISERS, str(probe), "-o", program], check=False).returncode:
        pytest.skip("no sanitisers on this machine")
    packed = tmp_path / "parameters.bin"
    opened = library(precision)
    sets = [{**LATERAL, **FURTHER, "method": method} for method in ("mpi", "dob", "mpi_dob")]
    sets.append(tunnelling(lsb_V=20 / 65536, stuck_samples=10, voltage_step_V=0.01))
    packed.write_bytes(b"".join(bytes(opened.pack(complete(s))) for s in sets))
    fuzz = str(tmp_path / "fuzz")
    sources = (str(Path(__file__).parent / "fuzz.c"), str(SOURCE / "piezoid_runtime.c"))
    warnings = ("-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off")
    run(
        *(compiler, *warnings, *SANITISERS, *PRECISION[precision]),
        *(f"-I{SOURCE}", *sources, "-o", fuzz),
    )
    said = run(fuzz, str(packed), str(STEPS), "20150401")
    assert said.count("digest") == 4
    assert all(int(line.split()[-1]) > 100 for line in said.splitlines() if "accepted" in line)
