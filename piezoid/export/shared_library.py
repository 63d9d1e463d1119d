"""The target `library`: a shared library with plain numbers and arrays, and its example."""

from collections.abc import Mapping

from piezoid.export.bundle import shipped
from piezoid.export.c_header import c_header
from piezoid.export.compiled import LINUX, WINDOWS, shared_library
from piezoid.export.golden import golden_csv
from piezoid.export.inert import inert
from piezoid.export.parameter_file import ParameterFile, digest_of

MAIN = "piezoid_controller.c"
_SOURCES = ("piezoid_runtime.h", "piezoid_runtime.c", "piezoid_controller.h", MAIN)
_BUILT = ((LINUX, "libpiezoid_controller.so"), (WINDOWS, "piezoid_controller.dll"))

_README = """\
# Controller of {name} as a shared library

| call | what it does |
| --- | --- |
| `pz_open(axis, voltage_V, measured)` | an axis at rest: a handle above 0, or an error |
| `pz_step(handle, samples, reference, measured, voltage_V, status)` | arrays in and out |
| `pz_reset(handle)`, `pz_close(handle)` | an operator has looked; give the handle back |
| `pz_axes()`, `pz_rate_Hz(axis)` | how many axes; how often to call each |

Arrays hold 8-byte reals, `status` 4-byte unsigned integers; `piezoid_controller.h` says the rest.
`python3 example.py` plays `golden.csv` and must say that 0 samples differ. To build it yourself:

    cc -std=c99 -O2 -ffp-contract=off -shared -fPIC -fvisibility=hidden piezoid_controller.c \\
        -o libpiezoid_controller.so

| axis | number | calls per second | reference and measured in |
| --- | --- | --- | --- |
{axes}

Parameters: {digest}
"""

_EXAMPLE = '''\
"""Play golden.csv through the shared library, with nothing but Python's own ctypes."""

import csv
import ctypes
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
NAME = "piezoid_controller.dll" if sys.platform == "win32" else "libpiezoid_controller.so"
library = ctypes.CDLL(str(HERE / NAME))
library.pz_open.argtypes = (ctypes.c_int32, ctypes.c_double, ctypes.c_double)
reals = ctypes.POINTER(ctypes.c_double)
words = ctypes.POINTER(ctypes.c_uint32)
library.pz_step.argtypes = (ctypes.c_int32, ctypes.c_int32, reals, reals, reals, words)

with (HERE / "golden.csv").open() as table:
    rows = list(csv.DictReader(table))
differ = 0
for axis in range(library.pz_axes()):
    own = [row for row in rows if int(row["axis"]) == axis]
    samples = len(own)
    reference = (ctypes.c_double * samples)(*(float(row["reference"]) for row in own))
    measured = (ctypes.c_double * samples)(*(float(row["measured"]) for row in own))
    voltage_V = (ctypes.c_double * samples)()
    status = (ctypes.c_uint32 * samples)()
    handle = library.pz_open(axis, 0.0, measured[0])
    if handle <= 0:
        sys.exit(f"axis {axis} does not open: {handle}")
    library.pz_step(handle, samples, reference, measured, voltage_V, status)
    library.pz_close(handle)
    differ += sum(
        voltage_V[k] != float(row["voltage_double_V"]) or status[k] != int(row["status_double"])
        for k, row in enumerate(own)
    )
print(f"{len(rows)} samples, {differ} differ")
sys.exit(1 if differ else 0)
'''


def shared_library_files(file: ParameterFile) -> tuple[Mapping[str, bytes], tuple[str, ...]]:
    """Return the folder's files by name, and what could not be made on this machine."""
    digest = digest_of(file)
    sources = {name: shipped(name) for name in _SOURCES}
    sources["piezo_params.h"] = c_header(file, digest).encode()
    axes = "\n".join(
        f"| {axis.axis} | {place} | {float(axis.values['sampling_rate_Hz']):g} "
        f"| {'A' if axis.method == 'rst' else 'm'} |"
        for place, axis in enumerate(file.axes)
    )
    files = {
        **sources,
        "golden.csv": golden_csv(file).encode(),
        "example.py": _EXAMPLE.encode(),
        "README.md": _README.format(name=inert(file.name), axes=axes, digest=digest).encode(),
    }
    notes = []
    for system, name in _BUILT:
        built = shared_library(sources, MAIN, system)
        if built is None:
            notes.append(
                f"library/{name} is not built: no C compiler for {system.name} here "
                f"({', '.join(system.compilers)}; Debian's {system.package}); its sources are"
            )
        else:
            files[name] = built
    return files, tuple(notes)
