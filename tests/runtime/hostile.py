"""The runtime with sanitisers: every method, hostile inputs, and parameters with broken bytes."""

import subprocess
from pathlib import Path

import numpy as np
import pytest

from piezoid.runtime.library import complete, library
from piezoid.runtime.schema import MAX_TAPS
from tests.runtime.compiler import PRECISION, SOURCE, require_tool, run
from tests.runtime.test_schema import LATERAL, tunnelling

SANITISERS = ("-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
SEED = 20150401

# Parameters that the lateral parameters of the other tests do not use.
SECTION = [[0.5, 0.25, 0.25, -0.5, 0.5]]
FURTHER = {
    **{"voltage_minimum_V": -4.0, "voltage_maximum_V": 3.0, "lsb_V": 0.001, "polarity": -1},
    **{"envelope_count": 3, "envelope_knot_V": [-1, 0, 2], "envelope_weight": [0.1, 1, -0.1]},
    **{"reference_section_count": 1, "reference_section": SECTION, "reference_step_m": 0.5},
    **{"command_section_count": 1, "command_section": SECTION, "voltage_step_V": 1.0},
    **{"stuck_samples": 3, "stuck_voltage_V": 0.01, "blind_samples": 8},
}
GUARDED = {
    **{"retract_step_V": 0.3, "search_voltage_V": 0.02, "trip_limit": 3, "trip_samples": 400},
    **{"contact_samples": 2, "retract_samples": 5, "stuck_current_A": -1.0},
}
# Polynomials that fill their tables, so that any index beyond them leaves the structures.
TAPS = np.r_[1.0, np.full(MAX_TAPS - 1, 1e-3)]
FULL = {
    **{f"rst_{name}_count": MAX_TAPS for name in ("T", "R", "S", "A0")},
    **{"rst_T_V": 1e-3 * TAPS, "rst_R_V": 1e-3 * TAPS, "rst_S": TAPS, "rst_A0": TAPS},
}
SETS = (
    *({**LATERAL, **FURTHER, "method": method} for method in ("mpi", "dob", "mpi_dob")),
    tunnelling(lsb_V=20 / 65536, stuck_samples=10, voltage_step_V=0.01, **FULL),
    tunnelling(stuck_samples=4, stuck_voltage_V=1e-3, **GUARDED),
)


def hostile_steps(precision: str, folder: Path, steps: int) -> str:
    """Run every parameter set for ``steps`` steps, then broken sets; return the output.

    A fault, a number outside the limits or a message of a sanitiser fails the test. A machine
    without sanitisers skips it.
    """
    compiler = require_tool("gcc", "clang", "cc")
    need_sanitisers(compiler, folder)
    parameters_file = folder / "parameters.bin"
    runtime = library(precision)
    parameters_file.write_bytes(b"".join(bytes(runtime.pack(complete(values))) for values in SETS))
    fuzz = str(folder / "fuzz")
    sources = (str(Path(__file__).parent / "fuzz.c"), str(SOURCE / "piezoid_runtime.c"))
    warnings = ("-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off")
    run(
        *(compiler, *warnings, *SANITISERS, *PRECISION[precision]),
        *(f"-I{SOURCE}", *sources, "-o", fuzz),
    )
    return run(fuzz, str(parameters_file), str(steps), str(SEED))


def need_sanitisers(compiler: str, folder: Path) -> None:
    probe = folder / "probe.c"
    probe.write_text("int main(void) { return 0; }\n")
    command = [compiler, *SANITISERS, str(probe), "-o", str(folder / "probe")]
    if subprocess.run(command, check=False).returncode:
        pytest.skip("no sanitisers on this machine")
