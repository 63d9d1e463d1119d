"""The bundle: six files that a firmware engineer copies and compiles.

``golden.csv`` contains inputs for every axis and the outputs of the exported source. The firmware
must reproduce them before it drives a stage.
"""

from collections.abc import Mapping
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

| file | content |
| --- | --- |
| `piezoid_runtime.h`, `piezoid_runtime.c` | the controller in C99, as it was verified |
| `piezo_params.h` | the parameters of this stage |
| `example_main.c` | a program that calls the controller and tests your build |
| `golden.csv` | {samples} samples per axis with the expected outputs in double and float |

## Test your build

    cc -std=c99 -O2 -ffp-contract=off example_main.c piezoid_runtime.c -o example
    ./example < golden.csv

must end with `0 differ`. Add `-DPZ_REAL_FLOAT` for single precision. With `-ffp-contract=off`
every IEEE machine gives the same bits; without it some outputs may differ by one converter code.

## Call it

1. At power-up, for each axis: `pz_start(&state, &piezo_params[index], voltage_V, measured)` with
   the present converter voltage and sensor reading. It returns `PZ_OK`, or the index of an invalid
   parameter (`pz_describe` gives its name).
2. In the interrupt, at the rate of the table below: read the sensor, call
   `pz_step(&state, &piezo_params[index], reference, measured)`, and write the voltage that it
   returns to the converter. The voltage is within the range of the table and rounded to a
   converter code. `reference` and `measured` are in metres, with the zero and the sign that the
   sensor had in the recordings; for an axis with method `rst` they are currents in amperes.
   Give the reference of a moving path ahead of time, by the samples in the column `preview`.
3. If `state.status` is not 0, its bits (`PZ_STATUS_...`) state why the output differs from the
   requested one. If `PZ_STATUS_LATCHED` is set, the axis holds its voltage (x, y) or its tip stays
   retracted (z) until an operator has found the cause and you call `pz_reset(&state)`.

You own the states, one `pz_state` per axis; the controller does not allocate, print or keep
anything. The comment of each function in `piezoid_runtime.h` states its cost and when it may be
called.

{which_voltage}

The guaranteed error of an axis, stated in `report.html`, holds while none of these status bits is
set: `PZ_STATUS_UNCERTIFIED`, `REFERENCE_LIMITED`, `VOLTAGE_LIMITED`, `VOLTAGE_STEP`,
`BAD_MEASUREMENT`, `MEASUREMENT_LIMITED`, `STUCK_SENSOR` and `BLIND`.

| axis | index | method | calls per second | voltage range, V | preview | state, bytes |
| --- | --- | --- | --- | --- | --- | --- |
{axes}

Methods: `mpi_dob` is a disturbance observer on the inverse hysteresis model, `dob` an observer
without the inverse, `mpi` the inverse without feedback, `rst` a polynomial controller on the
logarithm of a current.
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
            axes="\n".join(_row(index, axis) for index, axis in enumerate(file.axes)),
            unshipped="".join(
                f"\nAxis {plain_ascii(axis)} is not included: {plain_ascii(reason, length=600)}\n"
                for axis, reason in file.unshipped.items()
            ),
            decoupled=_decoupled(file),
            digest=digest,
            source=source_digest(),
        ),
    }
    content = {name: runtime_source(name) for name in SHIPPED}
    content.update({name: text.encode() for name, text in texts.items()})
    return Bundle(files=MappingProxyType(content), source_digest=source_digest())


_DECOUPLED = """
The drives of the axes {names} act on all of their displacements. Before `pz_step`, multiply their
references and their readings by the matrix `piezo_decoupling` of `piezo_params.h`; each axis then
depends on its own drive, up to the coupling that `design.json` states. Multiplying the references
alone is not enough, because feedback would control the coupled readings. `golden.csv` and the
limits of references apply behind the matrix.

| | {heads} |
| --- | {rules} |
{rows}
"""


def _decoupled(file: ParameterFile) -> str:
    """Return the paragraph on the decoupling matrix; empty if no axes are coupled."""
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
    limits = [f"{float(values[f'voltage_{end}_V']):g}" for end in ("minimum", "maximum")]
    cells = (
        *(axis.axis, index, axis.method, f"{float(values['sampling_rate_Hz']):g}"),
        *(" to ".join(limits), int(values["preview_samples"])),
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
        columns = [map(repr, reference.tolist()), map(repr, measured.tolist())]
        for precision in PRECISIONS:
            controller = Controller(axis.values, precision=precision)
            controller.start(0.0, float(measured[0]))
            run = controller.run(reference, measured)
            columns += [map(repr, run.voltage_V.tolist()), map(str, run.status.tolist())]
        lines += [",".join((str(index), *row)) for row in zip(*columns, strict=True)]
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
