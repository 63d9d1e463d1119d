"""Compile the bundle by the host's compiler and for an emulated Cortex-M4F, and compare bits."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from shutil import which
from subprocess import run
from tempfile import TemporaryDirectory

import numpy as np

from piezoid.errors import ParameterFileError, RuntimeLibraryError
from piezoid.export.bundle import SAMPLES as ORDINARY_SAMPLES
from piezoid.export.bundle import bundle, golden_inputs
from piezoid.export.parameter_file import AxisParameters, ParameterFile
from piezoid.numerics.arrays import Array
from piezoid.runtime.controller import Controller
from piezoid.runtime.library import PRECISIONS

SAMPLES = 6000  # of each axis: ordinary samples, then invalid and extreme samples
_INVALID = (np.nan, np.inf, -np.inf, 0.0, -0.0, 1e30, -1e30, 1e-42)
_TIMEOUT_s = 60  # of a build or a run

_HOST = ("cc", "gcc", "clang")
_FLAGS = ("-std=c99", "-O2", "-ffp-contract=off")
_TARGET = "arm-none-eabi-gcc"
_LIBRARY = "rdimon.specs"
_TARGET_FLAGS = (
    *("-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard"),
    *(f"--specs={_LIBRARY}", "-nostartfiles", "-DPZ_BOARD", "-DPZ_REAL_FLOAT"),
    # A step then calls no function of the C library and has no jump table, so that
    # benchmarks/longest_path.py can bound its execution time.
    *("-g", "-fno-jump-tables", "-fno-tree-loop-distribute-patterns"),
)
_EMULATOR = "qemu-system-arm"
_EMULATED = (
    *("-machine", "mps2-an386", "-cpu", "cortex-m4", "-icount", "shift=5"),
    *("-display", "none", "-serial", "none", "-monitor", "none"),
    *("-semihosting-config", "enable=on,target=native", "-kernel", "replay.elf"),
)


@dataclass(frozen=True, kw_only=True)
class Proof:
    """Comparison of one build of the bundle with the packaged library on the same inputs.

    build                    compiler, flags and precision, or the reason for a missing build
    is_built                 False: no compiler or emulator is installed
    samples                  number of steps compared, over all axes
    differing                number of steps whose voltage or status differs in any bit
    instructions_per_sample  mean by axis; None if not counted
    most_instructions        maximum over all samples by axis; None if not counted
    stack_bytes              deepest stack of a step; None if not measured
    state_bytes              of one axis; None if not measured
    """

    build: str
    is_built: bool
    samples: int = 0
    differing: int = 0
    instructions_per_sample: dict[str, float] | None = None
    most_instructions: dict[str, int] | None = None
    stack_bytes: int | None = None
    state_bytes: int | None = None

    @property
    def passed(self) -> bool:
        """Whether all outputs are equal; a missing build is no failure."""
        return not self.is_built or (self.samples > 0 and self.differing == 0)


def target_source(name: str) -> bytes:
    """Return a file of the folder ``cortex_m4``, byte for byte."""
    return files("piezoid.verification").joinpath("cortex_m4", name).read_bytes()


def write_build_files(
    folder: Path, contents: Mapping[str, bytes], file: ParameterFile, real: str
) -> None:
    """Write the bundle's files, replay.c and its inputs for ``double`` or ``float``."""
    for name, content in {**contents, "replay.c": target_source("replay.c")}.items():
        (folder / name).write_bytes(content)
    pairs = [replay_inputs(axis, index) for index, axis in enumerate(file.axes)]
    counts = np.array([SAMPLES, ORDINARY_SAMPLES], dtype="<u4").tobytes()
    dtype = "<f8" if real == "double" else "<f4"
    with np.errstate(over="ignore"):
        data = [np.stack(pair, axis=1).astype(dtype).tobytes() for pair in pairs]
    (folder / "inputs.bin").write_bytes(counts + b"".join(data))


def replay_inputs(axis: AxisParameters, seed: int) -> tuple[Array, Array]:
    """Return references and measurements: those of golden.csv, then invalid and extreme samples.

    One in five of the latter is NaN, infinite, very large or subnormal; the others are random
    within twice the range.
    """
    rng = np.random.default_rng([seed, SAMPLES])
    signals = []
    for ordinary in golden_inputs(axis, np.random.default_rng(seed)):
        finite = ordinary[np.isfinite(ordinary)]
        centre, span = (finite.max() + finite.min()) / 2, finite.max() - finite.min()
        extreme = centre + span * rng.uniform(-1.0, 1.0, SAMPLES - len(ordinary))
        is_invalid = rng.random(len(extreme)) < 0.2
        extreme[is_invalid] = rng.choice(_INVALID, int(is_invalid.sum()))
        signals.append(np.concatenate([ordinary, extreme]))
    return signals[0], signals[1]


def expected_outputs(file: ParameterFile, real: str) -> bytes:
    """Return the outputs of the packaged library, in the format of replay.c."""
    number = PRECISIONS[real][1]
    record = np.dtype([("voltage_V", np.dtype(number)), ("status", "<u4")])
    contents = []
    for index, axis in enumerate(file.axes):
        reference, measured = replay_inputs(axis, index)
        controller = Controller(axis.values, precision=real)
        with np.errstate(over="ignore"):
            controller.start(0.0, float(measured[0]))
            outputs = controller.run(reference, measured)
        rows = np.empty(len(reference), dtype=record)
        rows["voltage_V"], rows["status"] = outputs.voltage_V, outputs.status
        contents.append(rows.tobytes())
    return b"".join(contents)


def compare(
    folder: Path, command: Sequence[str], file: ParameterFile, real: str, *, build: str
) -> Proof:
    """Run a build in its folder and compare every sample.

    build  compiler, flags and precision, for the record

    Raises ``RuntimeLibraryError`` if it fails or writes outputs of another number of samples.
    """
    printed = run_program(command, folder)
    outputs = (folder / "answers.bin").read_bytes()
    expected = expected_outputs(file, real)
    if len(outputs) != len(expected):
        raise RuntimeLibraryError(
            f"{command[0]} wrote {len(outputs)} bytes of outputs",
            needed=f"{len(expected)} bytes, for all samples",
            remedy="Run it by hand in a folder with the bundle's files.",
        )
    samples = SAMPLES * len(file.axes)
    shape = (samples, len(expected) // samples)
    rows = [
        np.frombuffer(content, dtype=np.uint8).reshape(shape) for content in (outputs, expected)
    ]
    numbers = [[int(word) for word in line.split()] for line in printed.splitlines()]
    counted = [(file.axes[axis].axis, total, peak) for axis, total, peak, *_ in numbers if total]
    return Proof(
        build=build,
        is_built=True,
        samples=samples,
        differing=int(np.any(rows[0] != rows[1], axis=1).sum()),
        instructions_per_sample={axis: total / ORDINARY_SAMPLES for axis, total, _ in counted}
        or None,
        most_instructions={axis: peak for axis, _, peak in counted} or None,
        stack_bytes=max(stack for *_, stack, _ in numbers) if counted else None,
        state_bytes=numbers[0][4],
    )


def run_program(command: Sequence[str], folder: Path) -> str:
    """Run a program in a folder and return its output.

    Raises ``RuntimeLibraryError`` with the program's error output if it fails.
    """
    completed = run(
        command, cwd=folder, capture_output=True, text=True, timeout=_TIMEOUT_s, check=False
    )
    if completed.returncode != 0:
        printed = (completed.stderr or completed.stdout)[:800]
        raise RuntimeLibraryError(
            f"{' '.join(command)} ended with {completed.returncode}: {printed}",
            needed="a build that compiles and runs",
            remedy="Compare the bundle with a fresh export, and the compiler with C99.",
        )
    return completed.stdout


def rebuild(file: ParameterFile, contents: Mapping[str, bytes] | None = None) -> tuple[Proof, ...]:
    """Compile the bundle with the host's compiler, in both precisions, and compare.

    contents  the bundle's files to be checked; by default made of the parameter file

    Raises ``ParameterFileError`` for a bundle that was not made of this parameter file, and
    ``RuntimeLibraryError`` for a bundle that does not compile or run.
    """
    bundle_files = check_bundle(file, contents)
    compiler = next((path for name in _HOST if (path := which(name))), None)
    if compiler is None:
        reason = f"host: none of {', '.join(_HOST)} is on this machine"
        return (Proof(build=reason, is_built=False),)
    proofs = []
    for real, precision_flags in (("double", ()), ("float", ("-DPZ_REAL_FLOAT",))):
        with TemporaryDirectory(prefix="piezoid-") as name:
            folder = Path(name)
            write_build_files(folder, bundle_files, file, real)
            sources = ("replay.c", "piezoid_runtime.c", "-o", "replay")
            run_program((compiler, *_FLAGS, *precision_flags, *sources), folder)
            build = f"{Path(compiler).name} {' '.join(_FLAGS)}, this machine, {real}"
            proofs.append(compare(folder, (str(folder / "replay"),), file, real, build=build))
    return tuple(proofs)


def emulate(file: ParameterFile, contents: Mapping[str, bytes] | None = None) -> Proof:
    """Compile the bundle for a Cortex-M4F, run it in an emulator, compare, count instructions.

    Raises as ``rebuild`` does.
    """
    bundle_files = check_bundle(file, contents)
    missing = [name for name in (_TARGET, _EMULATOR) if which(name) is None]
    if not missing:
        library_path = run_program((_TARGET, f"-print-file-name={_LIBRARY}"), Path.cwd()).strip()
        missing += [_LIBRARY] if library_path == _LIBRARY else []  # the compiler has no path of it
    if missing:
        reason = f"Cortex-M4F: no {' and no '.join(missing)} on this machine"
        return Proof(build=reason, is_built=False)
    with TemporaryDirectory(prefix="piezoid-") as name:
        folder = Path(name)
        build_for_cortex_m4(folder, bundle_files, file)
        build = f"{_TARGET} {' '.join(_FLAGS)}, Cortex-M4F emulated (mps2-an386), float"
        return compare(folder, (_EMULATOR, *_EMULATED), file, "float", build=build)


def build_for_cortex_m4(folder: Path, contents: Mapping[str, bytes], file: ParameterFile) -> None:
    """Write the inputs of ``replay.elf`` into a folder, and compile it there."""
    write_build_files(folder, contents, file, "float")
    for name in ("board.c", "board.ld"):
        (folder / name).write_bytes(target_source(name))
    sources = ("replay.c", "board.c", "piezoid_runtime.c")
    script = ("-T", "board.ld", "-o", "replay.elf")
    run_program((_TARGET, *_FLAGS, *_TARGET_FLAGS, *sources, *script), folder)


def check_bundle(file: ParameterFile, contents: Mapping[str, bytes] | None) -> Mapping[str, bytes]:
    """Return the bundle of a parameter file.

    Raises ``ParameterFileError`` if the given contents differ from it.
    """
    expected = bundle(file)
    for name, content in expected.items():
        if contents is not None and contents.get(name) != content:
            raise ParameterFileError(
                f"bundle/{name} differs from the bundle of this parameter file and version",
                needed="an unedited bundle of the same parameters and runtime",
                remedy="Export again; change params.json's sources, never the bundle.",
            )
    return expected
