"""Sources to one shared library, with whatever C compiler this machine has."""

import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from piezoid.errors import RuntimeLibraryError

# -O2 and no contraction: what the runtime was verified with. The last keeps the clock out.
_FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-shared", "-fvisibility=hidden")


@dataclass(frozen=True, kw_only=True)
class System:
    """For whom to compile.

    name       as a sentence has it
    compilers  names to look for, the first found is taken
    flags      beside those of every system
    package    what installs such a compiler on Debian
    """

    name: str
    compilers: tuple[str, ...]
    flags: tuple[str, ...]
    package: str

    def compiler(self) -> str | None:
        """Return the path of the first compiler that is here, or None."""
        return next((path for name in self.compilers if (path := shutil.which(name))), None)


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
    """Return the compiled library, or None where no compiler for that system is here.

    sources  by name; ``main`` is the one that includes the others

    The compiler runs in a folder of its own and sees bare names, so no path of this machine and no
    time enters the library: same sources and compiler, same bytes.
    """
    compiler = system.compiler()
    if compiler is None:
        return None
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        for name, content in sources.items():
            (folder / name).write_bytes(content)
        command = [compiler, *_FLAGS, *system.flags, *flags, main, "-o", "built.bin"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeLibraryError(
                f"{compiler} does not compile {main}: {done.stderr.strip()[:400]}",
                needed=f"a C99 compiler for {system.name}",
                remedy=f"Install {system.package}, or compile the exported sources yourself.",
            )
        return (folder / "built.bin").read_bytes()
