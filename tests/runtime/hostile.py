"""The runtime under the sanitisers: every method, hostile inputs, parameters with bytes broken."""

import subprocess
from pathlib import Path

import numpy as np
import pytest

from piezoid.runtime.library import complete, library
from piezoid.runtime.schema import MAX_TAPS
from tests.runtime.compiler import PRECISION, SOURCE, found, run
from tests.runtime.test_schema import LATERAL, tunnelling

SANITISERS = ("-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
SEED = 20150401

# Everything the lateral parameters of the other tests leave out.
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
# Polynomials filled to their last places: what reaches further leaves the structures.
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
    """Run every set for so many steps, then broken ones; return what the program said.

    A fault, a number outside the limits or a sanitiser's complaint fails; a machine without
    sanitisers skips.
    """
    compiler = found("gcc", "clang", "cc")
    need_sanitisers(compiler, folder)
    packed = folder / "parameters.bin"
    opened = library(precision)
    packed.write_bytes(b"".join(bytes(opened.pack(complete(given))) for given in SETS))
    fuzz = str(folder / "fuzz")
    sources = (str(Path(__file__).parent / "fuzz.c"), str(SOURCE / "piezoid_runtime.c"))
    warnings = ("-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off")
    run(
        *(compiler, *warnings, *SANITISERS, *PRECISION[precision]),
        *(f"-I{SOURCE}", *sources, "-o", fuzz),
    )
    return run(fuzz, str(packed), str(steps), str(SEED))


def need_sanitisers(compiler: str, folder: Path) -> None:
    probe = folder / "probe.c"
    probe.write_text("int main(void) { return 0; }\n")
    command = [compiler, *SANITISERS, str(probe), "-o", str(folder / "probe")]
    if subprocess.run(command, check=False).returncode:
        pytest.skip("no sanitisers on this machine")
