"""The target `library`: a shared library with plain numbers and arrays, and its example."""

import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from piezoid.errors import RuntimeLibraryError
from piezoid.export.bundle import golden_csv, runtime_source
from piezoid.export.c_header import c_header, plain_ascii
from piezoid.export.parameter_file import ParameterFile, digest_of

# -O2 without contraction, as in the verification of the runtime.
_FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-shared", "-fvisibility=hidden")


@dataclass(frozen=True, kw_only=True)
class System:
    """Target system of a compilation.

    name       in messages
    compilers  names of commands; the first that is installed is used
    flags      in addition to those of every system
    package    of such a compiler on Debian
    """

    name: str
    compilers: tuple[str, ...]
    flags: tuple[str, ...]
    package: str


LINUX = System(
    name="Linux",
    compilers=("cc", "gcc", "clang"),
    flags=("-fPIC", "-Wl,--build-id=none"),
    package="gcc",
)
WINDOWS = System(
    name="Windows",
    compilers=("x86_64-w64-mingw32-gcc",),
    flags=("-static-libgcc", "-Wl,--no-insert-timestamp"),
    package="gcc-mingw-w64-x86-64",
)


def shared_library(
    sources: Mapping[str, bytes], main: str, system: System, *flags: str
) -> bytes | None:
    """Return the compiled library, or None if no compiler for that system is installed.

    sources  by name
    main     name of the source that includes all others

    The compiler runs in a temporary folder with relative names, so that the library contains no
    path and no time: the same sources and compiler give the same bytes.
    """
    compiler = next((path for name in system.compilers if (path := shutil.which(name))), None)
    if compiler is None:
        return None
    with tempfile.TemporaryDirectory() as directory:
        folder = Path(directory)
        for name, content in sources.items():
            (folder / name).write_bytes(content)
        command = [compiler, *_FLAGS, *system.flags, *flags, main, "-o", "built.bin"]
        completed = subprocess.run(
            command, cwd=folder, capture_output=True, text=True, check=False
        )
        if completed.returncode:
            raise RuntimeLibraryError(
                f"{compiler} does not compile {main}: {completed.stderr.strip()[:400]}",
                needed=f"a C99 compiler for {system.name}",
                remedy=f"Install {system.package}, or compile the exported sources yourself.",
            )
        return (folder / "built.bin").read_bytes()


MAIN = "piezoid_controller.c"
_SOURCES = ("piezoid_runtime.h", "piezoid_runtime.c", "piezoid_controller.h", MAIN)
_BUILT = ((LINUX, "libpiezoid_controller.so"), (WINDOWS, "piezoid_controller.dll"))

_README = """\
# Controller of {name} as a shared library

| call | what it does |
| --- | --- |
| `piezoid_open(axis, voltage_V, measured)` | open an axis: a handle above 0, or an error |
| `piezoid_step(handle, samples, reference, measured, voltage_V, status)` | arrays in and out |
| `piezoid_reset(handle)`, `piezoid_close(handle)` | continue after a latch; close the handle |
| `piezoid_axes()`, `piezoid_rate_Hz(axis)` | number of axes; rate at which each is called |

Arrays hold doubles of 8 bytes, `status` unsigned integers of 4 bytes; `piezoid_controller.h`
documents the calls. The README of `bundle/` states timing, units and the handling of bad
readings. `python3 example.py` plays `golden.csv` and must end with `0 differ`. To build it:

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
library.piezoid_open.argtypes = (ctypes.c_int32, ctypes.c_double, ctypes.c_double)
reals = ctypes.POINTER(ctypes.c_double)
words = ctypes.POINTER(ctypes.c_uint32)
library.piezoid_step.argtypes = (ctypes.c_int32, ctypes.c_int32, reals, reals, reals, words)

with (HERE / "golden.csv").open() as table:
    rows = list(csv.DictReader(table))
differ = 0
for axis in range(library.piezoid_axes()):
    own = [row for row in rows if int(row["axis"]) == axis]
    samples = len(own)
    reference = (ctypes.c_double * samples)(*(float(row["reference"]) for row in own))
    measured = (ctypes.c_double * samples)(*(float(row["measured"]) for row in own))
    voltage_V = (ctypes.c_double * samples)()
    status = (ctypes.c_uint32 * samples)()
    handle = library.piezoid_open(axis, 0.0, measured[0])
    if handle <= 0:
        sys.exit(f"axis {axis} does not open: {handle}")
    library.piezoid_step(handle, samples, reference, measured, voltage_V, status)
    library.piezoid_close(handle)
    differ += sum(
        voltage_V[k] != float(row["voltage_double_V"]) or status[k] != int(row["status_double"])
        for k, row in enumerate(own)
    )
print(f"{len(rows)} samples, {differ} differ")
sys.exit(1 if differ else 0)
'''


def shared_library_files(file: ParameterFile) -> tuple[Mapping[str, bytes], tuple[str, ...]]:
    """Return the folder's files by name, and notes on libraries that could not be built here."""
    digest = digest_of(file)
    sources = {name: runtime_source(name) for name in _SOURCES}
    sources["piezo_params.h"] = c_header(file, digest).encode()
    axes = "\n".join(
        f"| {axis.axis} | {index} | {axis.sampling_rate_Hz:g} "
        f"| {'A' if axis.method == 'rst' else 'm'} |"
        for index, axis in enumerate(file.axes)
    )
    files = {
        **sources,
        "golden.csv": golden_csv(file).encode(),
        "example.py": _EXAMPLE.encode(),
        "README.md": _README.format(
            name=plain_ascii(file.name), axes=axes, digest=digest
        ).encode(),
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
