"""The bundle: six files that a firmware engineer copies and compiles.

``golden.csv`` contains inputs for every axis and the outputs of the exported source. The firmware
must reproduce them before it drives a stage.
"""

from collections.abc import Mapping
from ctypes import sizeof
from dataclasses import dataclass
from importlib.metadata import version
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
| `example_main.c`, `golden.csv` | a test of your build: {samples} samples per axis |

| axis | index | method | calls per second | preview | reference | output, V | step, V | codes |
| --- | --- | --- | --- | --- | --- | --- | --- | --- |
{axes}
{unshipped}
Methods: `mpi_dob` is a disturbance observer on the inverse hysteresis model, `dob` an observer
without the inverse, `mpi` the inverse without feedback, `rst` a polynomial controller on the
logarithm of a current. Memory: code of about 14 kB (Cortex-M4, float), and per axis
{memory}.

## 1. Build and check

    cc -std=c99 -O2 -ffp-contract=off example_main.c piezoid_runtime.c -o example
    ./example < golden.csv

must end with `0 differ`; add `-DPZ_REAL_FLOAT` for single precision. The test needs standard
input: run it on a host, and with your cross compiler in an emulator. On a target without files,
start at 0 V and the first reading of the axis, step through its first rows, compare the outputs;
where 0 V is outside the output range, `pz_start` starts at the nearest limit.
With contracted products and sums, some outputs of the float version differ by a few converter
codes, which does not matter in the loop. `golden.csv` covers motion, limits, a lost reference and
lost readings; not an approach, retract, stuck sensor, latch, `pz_reset` or feedforward. Its first
reading does not belong to 0 V, so that the start assumes a shifted zero.

## 2. Call order and timing

    static pz_state state;
    static const pz_parameters *const p = &piezo_params[PIEZO_AXIS_{first}];

    void power_up(void) {{                /* with the interrupt stopped */
        const int32_t invalid = pz_start(&state, p, dac_voltage_V(), read_sensor());
        if (invalid != PZ_OK) stop_with(pz_describe(invalid)->name);
    }}
    void on_timer(void) {{                /* at the rate of the table */
        write_dac(pz_step(&state, p, reference, read_sensor()));
    }}

- `pz_start` needs the voltage that the DAC puts out at that moment. Call it again, with the
  interrupt stopped, after a pause and after you have moved the DAC yourself. To park, move the
  reference slowly to the position and stop the interrupt; the DAC keeps its last voltage.
- Read, step and write in the same call. The design knows the delay of the recordings: delay that
  your firmware adds costs accuracy, and stability beyond the delay margin in `design.json`.
- The rate cannot be checked. Another rate or missed calls cost accuracy without a status bit.
- `reference` is the position wanted `preview` samples ahead. If you do not know the future, give
  the present one: the motion is then late by so many samples, otherwise the same.

## 3. Units and DAC codes

{which_voltage}
- Reading and reference are in m (`rst`: A) with the scale, zero and sign of the recordings. Do not
  zero the sensor at power-up: a small shift is taken for hysteresis and costs accuracy.
- `output / step`, rounded, is the code of a two's-complement DAC, within the column `codes`; an
  offset-binary DAC of n bits adds 2^(n-1). A step of 0: lab.toml declares no `dac_bits`, and
  outputs are not rounded. Saturate codes to your DAC: a mask turns one too many into the other
  end.

## 4. Bad readings and limits

- Pass `NAN` for a reading that you do not trust (timeout, checksum, out of range).
- X, Y: unusable are NaN, infinity, and a value that does not change for `stuck_samples` although
  the voltage moves by `stuck_voltage_V`. The voltage then follows the reference on the model
  alone for at most `blind_samples`, and is held until `pz_reset`.
- X, Y: a reading beyond the displacement limits is replaced by the limit and used. The output can
  then go to the end of its range and does not latch; nor does it with a reversed sensor. Detect a
  broken cable and a railed or reversed sensor yourself.
- Z retracts from a current that is dead (`NO_CURRENT`), frozen (`STUCK_SENSOR`) or saturated
  (`MEASUREMENT_LIMITED`), and, after holding for `bad_samples`, from one that is reversed
  (`WRONG_SIGN`) or NaN. It latches, retracted to `retract_voltage_V`, after `trip_limit` retracts
  in a row or at the end of the drive.

## 5. Status

`state.status` is 0, or bits `PZ_STATUS_...` that state what was limited, replaced or faulty in
this sample; the header lists them. `status_ever` collects them until the next `pz_start`. The
guaranteed error of `report.html` holds while `status` is 0, and again once the transient after a
bit has decayed. After `LATCHED`, find the cause, then call `pz_reset(&state)`.

## 6. Changing parameters

Fit or design and export again after a change of the recordings or of lab.toml. In firmware: copy
the structure, change it, set `copy.checksum = pz_checksum(&copy)`, then call `pz_start` with the
copy. Narrower limits of voltage and reference and smaller steps keep the margins; any other change
voids margins, guaranteed error and proofs.
{decoupled}
## 7. Provenance

- Written by piezoid {version}. MIT licence, at the end of `piezoid_runtime.c`.
- Parameters: {digest},
  the `digest` of `params.json`: SHA-256 of that file with zeros for its 64 digits
- Runtime: {source},
  SHA-256 of `piezoid_runtime.h` followed by `piezoid_runtime.c`
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
            axes="\n".join(_row(index, axis) for index, axis in enumerate(file.axes)),
            memory=_memory(),
            first=file.axes[0].axis.upper(),
            which_voltage=fill(f"- {_VOLTAGE}", 98, subsequent_indent="  "),
            unshipped="".join(
                f"\nAxis {plain_ascii(axis)} is not included: {plain_ascii(reason, length=600)}\n"
                for axis, reason in file.unshipped.items()
            ),
            decoupled=_decoupled(file),
            version=version("piezoid"),
            digest=digest,
            source=source_digest(),
        ),
    }
    content = {name: runtime_source(name) for name in SHIPPED}
    content.update({name: text.encode() for name, text in texts.items()})
    return Bundle(files=MappingProxyType(content), source_digest=source_digest())


_PRECISIONS = ("float", "double")
_VOLTAGE = (
    f"{DRIVE_VOLTAGE_NOTE} Outputs stay within the drive of the recordings, and within the "
    "converter and amplifier of lab.toml."
)

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
    values = {name: float(value) for name, value in axis.values.items() if not value.ndim}
    low_V, high_V, step_V = (values[f"{name}_V"] for name in _OUTPUT)
    codes = ""
    if step_V:
        codes = f"{np.ceil(low_V / step_V):.0f} to {np.floor(high_V / step_V):.0f}"
    first, last, unit = _RANGE_A if axis.method == "rst" else _RANGE_m
    cells = (
        *(axis.axis, index, axis.method, f"{values['sampling_rate_Hz']:g}"),
        f"{values['preview_samples']:g}",
        f"{values[first]:.4g} to {values[last]:.4g} {unit}",
        *(f"{low_V:.7g} to {high_V:.7g}", f"{step_V:.12g}", codes),
    )
    return "| " + " | ".join(str(cell) for cell in cells) + " |"


_OUTPUT = ("voltage_minimum", "voltage_maximum", "lsb")
_RANGE_m = ("reference_minimum_m", "reference_maximum_m", "m")
_RANGE_A = ("current_floor_A", "current_ceiling_A", "A")


def _memory() -> str:
    """Return the bytes of state and parameters in both precisions."""
    states = [f"{library(precision).state_size} ({precision})" for precision in _PRECISIONS]
    parameters = [str(sizeof(library(precision).parameters)) for precision in _PRECISIONS]
    return f"{' or '.join(states)} bytes of state and {' or '.join(parameters)} of parameters"


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
