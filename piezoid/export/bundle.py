"""The bundle: six files that a firmware engineer copies and compiles.

``golden.csv`` contains inputs for every axis and the outputs of the exported source. The firmware
must reproduce them before it drives a stage.
"""

from collections.abc import Mapping
from ctypes import sizeof
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

# Samples whose inputs are NaN: one lost reference, three lost measurements.
_LOST_REFERENCE = 601
_LOST_MEASUREMENT = slice(701, 704)

SHIPPED = ("piezoid_runtime.h", "piezoid_runtime.c", "example_main.c")

_README = """\
# Controller of {name}

`piezoid_runtime.h` and `.c` are the controller in C99, as it was verified; `piezo_params.h` has
the parameters; `example_main.c` tests your build with {samples} samples per axis.

| axis | index | method | rate, Hz | preview, samples | reference | output, V | LSB, V \
| codes |
| --- | --- | --- | --- | --- | --- | --- | --- | --- |
{axes}
{unshipped}
Methods: `mpi_dob` is a disturbance observer on the inverse hysteresis model, `dob` an observer
alone, `mpi` the inverse without feedback, `none` a static gain, `rst` a controller of the
logarithm of a current. X and Y stand for every axis with another method than `rst`, Z for a tip.
Memory on a Cortex-M4: about 14 kB of code and 200 bytes of stack (float), 19 kB and 520 (double).
Each axis of this table needs
{memory};
`piezo_params.h` contains the parameters of all axes, also of those that you do not use.
Time of `pz_step`: the emulated axes X and Y of another stage took at most 2200 instructions on a
Cortex-M7. It grows with plays and observer states; measure it on your core.

## 1. Build and check

    cc -std=c99 -O2 -ffp-contract=off example_main.c piezoid_runtime.c -o example
    ./example < golden.csv

The output must end with `0 differ`; add `-DPZ_REAL_FLOAT` for single precision. The expected
outputs belong to these inputs: after any change of a reference or reading in `golden.csv`, rows
differ. To try your own references, call `pz_step` from your own `main` as in section 2.

On a target without standard input, compile rows of `golden.csv` into your test (`nan` is `NAN` in
C). Call `pz_start` with 0 V and the first `measured` of the axis, then `pz_step` with each row,
and compare voltage and status. (This first reading does not belong to 0 V; `pz_start` treats the
difference as a shift of the sensor's zero.) The table does not test approach, retract, stuck
sensor, latch, `pz_reset` and feedforward.

A build that contracts products and sums (FMA) rounds differently and exits with 1: rows then
differ by a few LSB, or by about 1e-5 of the output range if the LSB is 0. Use `-ffp-contract=off`.

## 2. Call order and timing

    static pz_state state;
    static const pz_parameters *const p = &piezo_params[PIEZO_AXIS_{first}];

    void power_up(void) {{                /* with the interrupt stopped */
        const int32_t invalid = pz_start(&state, p, dac_voltage_V(), read_sensor());
        if (invalid != PZ_OK) stop_with(pz_describe(invalid)->name);
        reference = state.reference_m;   /* X, Y: the reading, within `reference` of the table */
    }}
    void on_timer(void) {{                /* at the rate of the table */
        write_dac(pz_step(&state, p, reference, read_sensor()));
    }}

- Switch on, X and Y: ramp the DAC until the reading lies within `reference` of the table; at 0 V
  it often lies outside. Then call `pz_start`, set the reference to the reading, start the
  interrupt, and ramp the reference to the wanted position. If the reading lies outside, the first
  output jumps, on some stages by half the range; only `reference_step_m`, which is large, limits
  a jump. Before `pz_reset`, too, the reading must lie inside, and the reference must be the
  reading. Z: the reference is always the set point.
- `pz_start` needs the present output voltage of the DAC. NaN counts as 0 V and a voltage out of
  range as the nearest limit, and the first output starts from there: check it first. The reading
  may be NaN: the model's position is then used. Call `pz_start` again, with the interrupt
  stopped, after a pause and after you have moved the DAC yourself.
- Park: ramp the reference to the parking position and stop the interrupt; the DAC keeps its last
  voltage. Switch off: park, then ramp the DAC to 0 V yourself.
- Read, step and write in the same call. The design includes the delay that the recordings show.
  The delay margin of the exported loop (`method` of the table) is the additional delay at which it
  becomes unstable; `report.html`, beside `bundle/`, states it under Controllers. Each additional
  sample of delay costs accuracy. Another rate or missed calls are not detected.
- If another thread writes the reference, no interrupt may see half of it: on a 32-bit core, stop
  the interrupt while you copy a double. Axes that share an interrupt can be stepped in any order;
  to restart one of them, skip its `pz_step` until its `pz_start` has returned.
- `reference` is the position wanted `preview` samples later. If you do not know it, pass the
  present position wanted: the motion is the same, `preview` samples late.

## 3. Units and DAC codes

{voltage_note}
- X, Y: reading and reference in m, with the scale, zero and sign of the recordings. Do not zero
  the sensor at power-up: a small shift is taken for hysteresis and costs accuracy.
- Z: reading and reference in A. If your bias makes the current negative, negate every reading.
- `output / LSB`, rounded, is the code of a two's-complement DAC, within the column `codes`; an
  offset-binary DAC of n bits adds 2^(n-1). Clamp the code; masking wraps a code above full scale
  to the opposite end.
- An LSB of 0 and no `codes` mean that lab.toml declares no `dac_bits`. Outputs are then not
  rounded, and your firmware converts volts to codes with the scale of its DAC.
- A DAC with other steps rounds once more; keep `lsb_V`. For a DAC with a smaller range, narrow the
  voltages (section 6).

## 4. Bad readings and limits

| axis | {guard_names} |
| --- | {guard_rules} |
{guards}

- Pass `NAN` for a reading that you do not trust (timeout, checksum, out of range).
- X, Y: a reading is unusable if it is NaN or infinite, or if it does not change for
  `stuck_samples` although the voltage moves by `stuck_voltage_V`. The model then continues alone,
  with the last estimate of the disturbance. After `blind_samples` unusable readings in a row the
  output latches: it holds its last value until `pz_reset`. After `pz_reset`, the same number of
  unusable readings latches it again. If the reading then lies outside `reference`, ramp the DAC
  and call `pz_start` as in section 2.
- X, Y: a reading beyond the displacement limits is replaced by the limit, with the bit
  `MEASUREMENT_LIMITED`, and the loop continues with it. A saturated sensor therefore drives the
  output to one end. There a constant reading counts as stuck, and the output latches; a noisy
  reading never does. A reversed sensor and a broken cable are not detected either. Your firmware
  must detect these three faults.
- X, Y: at a voltage limit the output is clipped, with the bit `VOLTAGE_LIMITED`. The observer uses
  the clipped voltage, so the loop does not wind up.
- Z retracts at once from a current that is dead (`NO_CURRENT`), frozen (`STUCK_SENSOR`) or at
  the ceiling, the end of its range (`MEASUREMENT_LIMITED`); after `bad_samples` from one that is
  reversed (`WRONG_SIGN`) or NaN. It latches at `retract_voltage_V` after `trip_limit` retracts
  in a row or at the end of the drive. Keep the set point well below the ceiling. The ADC must
  show noise: `stuck_samples` equal readings above `stuck_current_A` (-1: even 0 A) stop every
  approach.

## 5. Status

`state.status` is 0, or bits `PZ_STATUS_...` (header) of what was limited, replaced or faulty in
this sample. `status_ever` collects them; the first samples may set some, and only `pz_start`
clears them. X, Y: a latch sets `LATCHED` and `BLIND`. Its cause, `BAD_MEASUREMENT` or
`STUCK_SENSOR`, is set until the sample of the latch, and remains in `status_ever`.
After `RESTARTED` the loop goes on by itself. `UNCERTIFIED` is no fault: the reference moves faster
than the guaranteed error covers, as fast scans do. If `report.html` states a guaranteed error, it
holds while `status` is 0 and the transient after the last set bit is over.

## 6. Changing parameters

After new recordings or a change of lab.toml: `piezoid fit`. In firmware: copy the structure,
change it, set `copy.checksum = pz_checksum(&copy)`, stop the interrupt, call `pz_start` with the
copy, and pass the same copy to every later `pz_step`; it must stay in RAM. You may narrow
`voltage_minimum_V`, `voltage_maximum_V` (Z: `retract_voltage_V` within them),
`reference_minimum_m` and `reference_maximum_m`, and limit `voltage_step_V` and
`reference_step_m` further (0 is unlimited). The margins remain valid while no limit
acts. Any other change voids margins, bounds and proofs. Do not edit gains: state limits
in design.toml (`[x]`, then `bandwidth_Hz = 120` or `modulus_margin = 0.6`), then run
`piezoid design FOLDER --spec design.toml` and `piezoid export FOLDER`, where FOLDER is that of the
fit.
{decoupled}
## 7. Provenance

- Written by piezoid {version}. MIT licence, at the end of `piezoid_runtime.c`.
- Parameters: {digest},
  the `digest` of `params.json`: SHA-256 of that file with zeros for its 64 digits
- Runtime: {source},
  SHA-256 of `piezoid_runtime.h` followed by `piezoid_runtime.c`
"""


def runtime_source(name: str) -> bytes:
    """Return a file of the runtime as it was installed, byte for byte."""
    return files("piezoid.runtime").joinpath(name).read_bytes()


def source_digest() -> str:
    """Return the digest of the runtime's source, header first."""
    return digest_of_bytes(
        runtime_source("piezoid_runtime.h") + runtime_source("piezoid_runtime.c")
    )


def bundle(file: ParameterFile) -> Mapping[str, bytes]:
    """Return the files that firmware needs by name; the same input gives the same bytes."""
    digest = digest_of(file)
    states = [f"{library(name).state_size} ({name})" for name in ("float", "double")]
    sizes = [str(sizeof(library(name).parameters)) for name in ("float", "double")]
    memory = f"{' or '.join(states)} bytes of state and {' or '.join(sizes)} of parameters"
    voltage_note = (
        f"- {DRIVE_VOLTAGE_NOTE} Outputs stay within the drive of the recordings, and within the "
        "converter and amplifier of lab.toml."
    )
    axis_rows, guard_rows = zip(
        *(_rows(index, axis) for index, axis in enumerate(file.axes)), strict=True
    )
    decoupled = ""
    if file.decoupled is not None:
        names = [plain_ascii(axis) for axis in file.decoupled.axes]
        decoupled = _DECOUPLED.format(
            names=", ".join(names),
            heads=" | ".join(names),
            rules=" | ".join("---" for _ in names),
            rows="\n".join(
                f"| {name} | {' | '.join(f'{value:.6g}' for value in row)} |"
                for name, row in zip(names, file.decoupled.matrix, strict=True)
            ),
        )
    texts = {
        "piezo_params.h": c_header(file, digest),
        "golden.csv": golden_csv(file),
        "README.md": _README.format(
            name=plain_ascii(file.name),
            samples=SAMPLES,
            axes="\n".join(axis_rows),
            memory=memory,
            guard_names=" | ".join(name for name, _, _ in _GUARDS),
            guard_rules=" | ".join("---" for _ in _GUARDS),
            guards="\n".join(guard_rows),
            first=file.axes[0].axis.upper(),
            voltage_note=fill(voltage_note, 98, subsequent_indent="  "),
            unshipped="".join(
                f"\nAxis {plain_ascii(axis)} is not included, so indices may have changed: "
                f"{plain_ascii(reason, length=600)}\n"
                for axis, reason in file.unshipped.items()
            ),
            decoupled=decoupled,
            version=version("piezoid"),
            digest=digest,
            source=source_digest(),
        ),
    }
    content = {name: runtime_source(name) for name in SHIPPED}
    content.update({name: text.encode() for name, text in texts.items()})
    return MappingProxyType(content)


_DECOUPLED = """
The drives of the axes {names} act on all of their displacements. Before `pz_step`, multiply their
references and their readings by the matrix `piezo_decoupling` of `piezo_params.h`; each axis then
depends on its own drive, up to the coupling that `design.json` states. Multiplying the references
alone is not enough, because feedback would control the coupled readings. `golden.csv`,
`state.reference_m` and the limits apply behind the matrix.

| | {heads} |
| --- | {rules} |
{rows}
"""


# Heading and cell of each guard, for tips only (True), for X and Y only (False) or for both
# (None).
_GUARDS: tuple[tuple[str, str, bool | None], ...] = (
    ("`stuck_samples`", "{stuck_samples:.0f}", None),
    ("`stuck_voltage_V`", "{stuck_voltage_V:.4g}", None),
    ("`blind_samples`", "{blind_samples:.0f} ({blind_s:.3g} s)", False),
    (
        "displacement limits, m",
        "{displacement_minimum_m:.4g} to {displacement_maximum_m:.4g}",
        False,
    ),
    ("`bad_samples`", "{bad_samples:.0f}", True),
    ("`stuck_current_A`", "{stuck_current_A:.4g}", True),
    ("`trip_limit`", "{trip_limit:.0f}", True),
    ("`retract_voltage_V`", "{retract_voltage_V:.4g}", True),
)
_OUTPUT = ("voltage_minimum", "voltage_maximum", "lsb")
_RANGE_m = ("reference_minimum_m", "reference_maximum_m", "m")
_RANGE_A = ("current_floor_A", "current_ceiling_A", "A")


def _rows(index: int, axis: AxisParameters) -> tuple[str, str]:
    """Return the rows of an axis in the tables of axes and of guards.

    Cells of guards that do not apply are empty.
    """
    values = {name: float(value) for name, value in axis.values.items() if not value.ndim}
    low_V, high_V, step_V = (values[f"{name}_V"] for name in _OUTPUT)
    codes = ""
    if step_V:
        first_code, last_code = np.ceil(low_V / step_V), np.floor(high_V / step_V)
        codes = f"{first_code:.0f} to {last_code:.0f}"
        low_V, high_V = first_code * step_V, last_code * step_V
    is_tip = axis.method == "rst"
    low, high, unit = _RANGE_A if is_tip else _RANGE_m
    if is_tip:
        unit += f", set point {values['current_reference_A']:.4g}"
    cells = (
        *(axis.axis, index, axis.method, f"{values['sampling_rate_Hz']:g}"),
        f"{values['preview_samples']:g}",
        f"{values[low]:.7g} to {values[high]:.7g} {unit}",
        *(f"{low_V:.7g} to {high_V:.7g}", f"{step_V:.12g}", codes),
    )
    blind_s = values["blind_samples"] / values["sampling_rate_Hz"]
    guards = [
        text.format(**values, blind_s=blind_s) if only_tip in (None, is_tip) else ""
        for _, text, only_tip in _GUARDS
    ]
    axis_row, guard_row = (" | ".join(map(str, row)) for row in (cells, (axis.axis, *guards)))
    return f"| {axis_row} |", f"| {guard_row} |"


def golden_csv(file: ParameterFile) -> str:
    """Return the text of golden.csv: SAMPLES rows of each axis, from a start at 0 V.

    The initial reading is the first measurement.
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
    """Return references and measurements that execute every branch of ordinary operation.

    The reference is a sine of growing amplitude over nine tenths of the range. The measurement is
    the delayed reference with noise. Some samples of both are NaN.

    returned  (SAMPLES,) and (SAMPLES,)  m, or A if the axis regulates a current
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
