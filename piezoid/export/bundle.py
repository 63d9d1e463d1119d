"""The bundle: six files a firmware engineer copies, compiles, and is done with.

golden.csv: inputs for every axis, and what the shipped source answers to them.

A firmware engineer's own build must give the same numbers before it meets a stage.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from textwrap import fill
from types import MappingProxyType

import numpy as np

from piezoid.digests import digest_of_bytes
from piezoid.export.c_header import c_header, plain_ascii
from piezoid.export.parameter_file import AxisParameters, ParameterFile, digest_of
from piezoid.numerics.arrays import Array
from piezoid.records.checks.command_range import DRIVE_VOLTAGE_NOTE
from piezoid.runtime.controller import Controller
from piezoid.runtime.library import PRECISIONS, library

COLUMNS = (
    *("axis", "reference", "measured"),
    *("voltage_double_V", "status_double", "voltage_float_V", "status_float"),
)
SAMPLES = 1000

# Where in the record the inputs are not numbers: one lost reference, three lost measurements.
_LOST_REFERENCE = 601
_LOST_MEASUREMENT = slice(701, 704)

SHIPPED = ("piezoid_runtime.h", "piezoid_runtime.c", "example_main.c")

_README = """\
# Controller of {name}

| file | what it is |
| --- | --- |
| `piezoid_runtime.h`, `piezoid_runtime.c` | the controller, C99; this very source was verified |
| `piezo_params.h` | the parameters of this stage |
| `example_main.c` | how firmware calls it; also compares your build with `golden.csv` |
| `golden.csv` | {samples} samples per axis, and the answers in both precisions |

    cc -std=c99 -O2 -ffp-contract=off example_main.c piezoid_runtime.c -o example
    ./example < golden.csv

must say that 0 samples differ. Add `-DPZ_REAL_FLOAT` for a target of single precision.
With `-ffp-contract=off` every IEEE machine gives these bits; a compiler that contracts products
and sums may choose a neighbouring converter code here and there.

{which_voltage}

Nothing is allocated, printed or kept by the controller; there is one `pz_state` per axis, and it
is yours. `piezoid_runtime.h` says beside each call what it does, what it costs, and when it may
be called.

The error bound of an axis holds while `status` holds none of `PZ_STATUS_UNCERTIFIED`,
`..._REFERENCE_LIMITED`, `..._VOLTAGE_LIMITED`, `..._VOLTAGE_STEP` and of the bits about its
sensor.

Where `status` holds `PZ_STATUS_LATCHED`, an axis waits: a tip that had to flee several times
(the other bits say from what) is retracted, X and Y without a usable sensor are held. Show it to
somebody, and call `pz_reset` from the background when they have looked.

| axis | index | method | calls per second | plays | dead zones | observer order | states, bytes |
| --- | --- | --- | --- | --- | --- | --- | --- |
{axes}
{unshipped}{decoupled}
Parameters: {digest}
Runtime source: {source}
"""


@dataclass(frozen=True, kw_only=True, eq=False)
class Bundle:
    """The files by name, as they are written.

    files          name to bytes
    source_digest  of piezoid_runtime.h and .c, one after the other
    """

    files: Mapping[str, bytes]
    source_digest: str


def runtime_source(name: str) -> bytes:
    """Return a file of the runtime as it was installed, byte for byte."""
    return files("piezoid.runtime").joinpath(name).read_bytes()


def source_digest() -> str:
    """Return the digest of the runtime's source, header first."""
    return digest_of_bytes(
        runtime_source("piezoid_runtime.h") + runtime_source("piezoid_runtime.c")
    )


def bundle(file: ParameterFile) -> Bundle:
    """Return everything firmware needs for this parameter file; the same input, the same bytes."""
    digest = digest_of(file)
    texts = {
        "piezo_params.h": c_header(file, digest),
        "golden.csv": golden_csv(file),
        "README.md": _README.format(
            name=plain_ascii(file.name),
            samples=SAMPLES,
            which_voltage=fill(DRIVE_VOLTAGE_NOTE, 98),
            axes="\n".join(_row(place, axis) for place, axis in enumerate(file.axes)),
            unshipped=_unshipped(file),
            decoupled=_decoupled(file),
            digest=digest,
            source=source_digest(),
        ),
    }
    content = {name: runtime_source(name) for name in SHIPPED}
    content.update({name: text.encode() for name, text in texts.items()})
    return Bundle(files=MappingProxyType(content), source_digest=source_digest())


def _unshipped(file: ParameterFile) -> str:
    """Say which axes firmware will look for in vain, a paragraph each."""
    return "".join(
        f"\nAxis {plain_ascii(axis)} is not in here: {plain_ascii(reason, length=600)}\n"
        for axis, reason in file.unshipped.items()
    )


_DECOUPLED = """
The drives of the axes {names} act on all of their displacements. Before `pz_step`, multiply their
references by the matrix `piezo_decoupling` of `piezo_params.h`, and their readings by the same
matrix; the controllers then see axes that answer to their own drives, up to what `design.json`
says is left. References alone are not enough: feedback would bring each reading, coupling
included, to a reference that is not that of the axis. `golden.csv` and the limits of references
are of the controllers, behind the matrix.

| | {heads} |
| --- | {rules} |
{rows}
"""


def _decoupled(file: ParameterFile) -> str:
    """Say what stands in front of the controllers, if anything does."""
    decoupled = file.decoupled
    if decoupled is None:
        return ""
    names = [plain_ascii(axis) for axis in decoupled.axes]
    return _DECOUPLED.format(
        names=", ".join(names),
        heads=" | ".join(names),
        rules=" | ".join("---" for _ in names),
        rows="\n".join(
            f"| {name} | {' | '.join(f'{value:.6g}' for value in row)} |"
            for name, row in zip(names, decoupled.matrix, strict=True)
        ),
    )


def _row(index: int, axis: AxisParameters) -> str:
    values = axis.values
    counts = [int(values[f"{name}_count"]) for name in ("play", "knot")]
    cells = (
        *(axis.axis, index, axis.method, f"{float(values['sampling_rate_Hz']):g}"),
        *(*counts, int(values["observer_order"])),
        " / ".join(f"{library(p).state_size} ({p})" for p in ("float", "double")),
    )
    return "| " + " | ".join(str(cell) for cell in cells) + " |"


def golden_csv(file: ParameterFile) -> str:
    """Return the table: per axis SAMPLES rows, from a start at 0 V and the first measurement.

    The reference swings over nine tenths of the range with growing amplitude, the measurement
    follows it late and with noise; some of either are no numbers.
    """
    lines = [",".join(COLUMNS)]
    for index, axis in enumerate(file.axes):
        reference, measured = golden_inputs(axis, np.random.default_rng(index))
        answers = [_answers(axis, precision, reference, measured) for precision in PRECISIONS]
        rows = zip(reference, measured, *answers, strict=True)
        lines.extend(f"{index},{_golden_row(row)}" for row in rows)
    return "\n".join(lines) + "\n"


def golden_inputs(axis: AxisParameters, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return references and measurements that reach every branch a usual day reaches.

    returned  (SAMPLES,) and (SAMPLES,)  m, or A where the axis regulates a current
    """
    swing = np.sin(np.linspace(0, 8 * np.pi, SAMPLES)) * np.linspace(0.1, 1.0, SAMPLES)
    delayed = np.r_[np.zeros(20), swing[:-20]] + rng.normal(0, 0.01, SAMPLES)
    values = axis.values
    if axis.method == "rst":
        setpoint_A = float(values["current_reference_A"])
        reference, measured = setpoint_A * np.exp(0.1 * swing), setpoint_A * np.exp(0.2 * delayed)
    else:
        low, high = float(values["reference_minimum_m"]), float(values["reference_maximum_m"])
        centre, half = (low + high) / 2, 0.45 * (high - low)
        reference, measured = centre + half * swing, centre + half * delayed
    reference[_LOST_REFERENCE] = np.nan
    measured[_LOST_MEASUREMENT] = np.nan
    return reference, measured


def _answers(
    axis: AxisParameters, precision: str, reference: Array, measured: Array
) -> Sequence[tuple[float, int]]:
    controller = Controller(axis.values, precision=precision)
    controller.start(0.0, float(measured[0]))
    run = controller.run(reference, measured)
    return [(float(u), int(s)) for u, s in zip(run.voltage_V, run.status, strict=True)]


def _golden_row(row: tuple[float, float, tuple[float, int], tuple[float, int]]) -> str:
    reference, measured, *answers = row
    answered = ",".join(f"{voltage!r},{status}" for voltage, status in answers)
    return f"{float(reference)!r},{float(measured)!r},{answered}"
