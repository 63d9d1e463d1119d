"""The bundle compiled again: by the host's compiler, and for an emulated Cortex-M4F."""

from collections.abc import Mapping
from pathlib import Path
from shutil import which
from tempfile import TemporaryDirectory

from piezoid.errors import ParameterFileError
from piezoid.export.bundle import bundle
from piezoid.export.parameter_file import ParameterFile
from piezoid.verification.longest_path import longest_path, loop_counts
from piezoid.verification.proof import Proof
from piezoid.verification.replay import called, compare, lay_out, source

_HOST = ("cc", "gcc", "clang")
_FLAGS = ("-std=c99", "-O2", "-ffp-contract=off")
_TARGET = "arm-none-eabi-gcc"
_LIBRARY = "rdimon.specs"
_TARGET_FLAGS = (
    *("-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard"),
    *(f"--specs={_LIBRARY}", "-nostartfiles", "-DPZ_BOARD", "-DPZ_REAL_FLOAT"),
    # a step calls nothing of the C library and jumps through no table: its longest path is known
    *("-g", "-fno-jump-tables", "-fno-tree-loop-distribute-patterns"),
)
_DISASSEMBLED = ("arm-none-eabi-objdump", "-d", "-l", "--no-show-raw-insn", "replay.elf")
_EMULATOR = "qemu-system-arm"
_EMULATED = (
    *("-machine", "mps2-an386", "-cpu", "cortex-m4", "-icount", "shift=5"),
    *("-display", "none", "-serial", "none", "-monitor", "none"),
    *("-semihosting-config", "enable=on,target=native", "-kernel", "replay.elf"),
)


def rebuild(file: ParameterFile, contents: Mapping[str, bytes] | None = None) -> tuple[Proof, ...]:
    """Compile the bundle with the host's compiler, in both precisions, and compare.

    contents  the bundle's files as they were found; by default made of the parameter file

    Raises ``ParameterFileError`` for a bundle that is not this parameter file's, and
    ``RuntimeLibraryError`` for one that does not compile or run.
    """
    held = own_files(file, contents)
    compiler = next((found for name in _HOST if (found := which(name))), None)
    if compiler is None:
        said = f"host: none of {', '.join(_HOST)} is on this machine"
        return (Proof(build=said, is_built=False),)
    return tuple(_on_host(file, held, compiler, real) for real in ("double", "float"))


def emulate(file: ParameterFile, contents: Mapping[str, bytes] | None = None) -> Proof:
    """Compile the bundle for a Cortex-M4F, run it in an emulator, compare, count instructions.

    Raises as ``rebuild`` does.
    """
    held = own_files(file, contents)
    missing = _missing_for_target()
    if missing:
        said = f"Cortex-M4F: no {' and no '.join(missing)} on this machine"
        return Proof(build=said, is_built=False)
    with TemporaryDirectory(prefix="piezoid-") as name:
        folder = Path(name)
        ordinary = lay_out(folder, held, file, "float")
        for own in ("board.c", "board.ld"):
            (folder / own).write_bytes(source(own))
        sources = ("replay.c", "board.c", "piezoid_runtime.c")
        script = ("-T", "board.ld", "-o", "replay.elf")
        called((_TARGET, *_FLAGS, *_TARGET_FLAGS, *sources, *script), folder)
        found = compare(folder, (_EMULATOR, *_EMULATED), file, "float", ordinary)
        code = called(_DISASSEMBLED, folder)
    runtime = held["piezoid_runtime.c"].decode()
    return Proof(
        build=f"{_TARGET} {' '.join(_FLAGS)}, Cortex-M4F emulated (mps2-an386), float",
        is_built=True,
        samples=found.samples,
        differing=found.differing,
        instructions_per_sample=found.instructions,
        most_instructions=found.most,
        longest_path={
            axis.axis: longest_path(code, runtime, loop_counts(axis.values), entry="pz_step")
            for axis in file.axes
        },
        stack_bytes=found.stack_bytes,
        state_bytes=found.state_bytes,
    )


def _missing_for_target() -> list[str]:
    """Return what of compiler, its C library and emulator is not here."""
    missing = [name for name in (_TARGET, _EMULATOR) if which(name) is None]
    if not missing:
        place = called((_TARGET, f"-print-file-name={_LIBRARY}"), Path.cwd()).strip()
        missing += [_LIBRARY] if place == _LIBRARY else []  # a path where there is one
    return missing


def _on_host(file: ParameterFile, held: Mapping[str, bytes], compiler: str, real: str) -> Proof:
    chosen = ("-DPZ_REAL_FLOAT",) if real == "float" else ()
    with TemporaryDirectory(prefix="piezoid-") as name:
        folder = Path(name)
        ordinary = lay_out(folder, held, file, real)
        called(
            (compiler, *_FLAGS, *chosen, "replay.c", "piezoid_runtime.c", "-o", "replay"), folder
        )
        found = compare(folder, (str(folder / "replay"),), file, real, ordinary)
    return Proof(
        build=f"{Path(compiler).name} {' '.join(_FLAGS)}, this machine, {real}",
        is_built=True,
        samples=found.samples,
        differing=found.differing,
        state_bytes=found.state_bytes,
    )


def own_files(file: ParameterFile, contents: Mapping[str, bytes] | None) -> Mapping[str, bytes]:
    """Return the bundle's files, after comparing those found with what this file makes."""
    made = bundle(file).files
    for name, content in made.items():
        if contents is not None and contents.get(name) != content:
            raise ParameterFileError(
                f"bundle/{name} is not what this parameter file and this version make",
                needed="a bundle nobody edited, of the same parameters and runtime",
                remedy="Export again; change params.json's sources, never the bundle.",
            )
    return made
