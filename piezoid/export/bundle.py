"""The bundle: six files that a firmware engineer copies and compiles.

``golden.csv`` contains inputs for every axis and the outputs of the exported source. The firmware
must reproduce them before it drives a stage.
"""

from collections.abc import Iterable, Mapping, Sequence
from ctypes import sizeof
from importlib.metadata import version
from importlib.resources import files
from itertools import product
from textwrap import fill
from types import MappingProxyType

import numpy as np

from piezoid.digests import digest_of_bytes
from piezoid.export.c_header import c_header, plain_ascii
from piezoid.export.parameter_file import AxisParameters, ParameterFile, Robustness, digest_of
from piezoid.formatting import with_unit
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

# Lines that begin with @ and a name are for bundles with that feature, see ``_features_of``.
_README = """\
# Controller of {name}

`piezoid_runtime.h` and `.c` are the controller in C99, as it was verified; `piezo_params.h` has
the parameters; `example_main.c` tests your build with {samples} samples per axis.

| axis | index | method | rate, Hz | preview, samples | reference | output, V | LSB, V \
| codes |
| --- | --- | --- | --- | --- | --- | --- | --- | --- |
{axes}
{unshipped}
Methods:

@mpi_dob - `mpi_dob`: a disturbance observer on the inverse hysteresis model
@dob - `dob`: a disturbance observer alone
@mpi - `mpi`: the inverse hysteresis model without feedback
@none - `none`: a static gain without feedback
@rst - `rst`: a controller of the logarithm of a current

X and Y stand for every axis with another method than `rst`, Z for an axis with `rst` (a tip).
@xy_only This bundle has no Z; skip what the comments of the header state about Z.

Memory on a Cortex-M4: about 14 kB of code and 200 bytes of stack (float), 19 kB and 520 (double).
Each axis of this table needs
{memory};
`piezo_params.h` contains the parameters of all axes, also of those that you do not use.

@xy Time of `pz_step` on an emulated Cortex-M4 (float): at most 2360 instructions with 17 plays, 26
@xy knots, 8 creep elements and an observer of order 3. Each play adds about 40 and each creep
@xy element about 20.
@xy {sizes}
@functions The time of plays with functions (`edge_count` above 0) was not measured.
@z A tip took at most 1300 instructions of an emulated Cortex-M4 (float).
Measure the time on your core.

## 1. Build and check

    cc -std=c99 -O2 -ffp-contract=off example_main.c piezoid_runtime.c -o example
    ./example < golden.csv

The output must end with `0 differ`; add `-DPZ_REAL_FLOAT` for single precision. The expected
outputs belong to these inputs: after any change of a reference or reading in `golden.csv`, rows
differ. To try your own references, call `pz_step` from your own `main` as in section 2.

On a target without standard input, compile rows of `golden.csv` into your test (`nan` is `NAN` in
C). Call `pz_start` with 0 V and the first `measured` of the axis, then `pz_step` with each row,
and compare voltage and status. (In this test the stage is assumed away from 0 V: the first reading
does not belong to 0 V, and `pz_start` treats the difference as a zero shift.) The table does not
@xy_only test stuck sensor, latch, `pz_reset` and feedforward.
@z test approach, retract, stuck sensor, latch, `pz_reset` and feedforward.

A build that contracts products and sums (FMA) may round differently.
@rounded Some rows can then differ by a few LSB.
@unrounded Some rows of an axis with an LSB of 0 can then differ by about 1e-5 of its output range.
Such a build exits with 1 if a row differs. Use `-ffp-contract=off`.

## 2. Call order and timing

    static pz_state state;
    static const pz_parameters *const p = &piezo_params[PIEZO_AXIS_{first}];

    void power_up(void) {{                /* with the interrupt stopped */
        const int32_t invalid = pz_start(&state, p, dac_voltage_V(), read_sensor());
        if (invalid != PZ_OK) stop_with(pz_describe(invalid)->name);
        reference = state.reference_m;   /* {XY}the reading, within `reference` of the table */
    }}
    void on_timer(void) {{                /* at the rate of the table */
        write_dac(pz_step(&state, p, reference, read_sensor()));
    }}

The other names are yours: `dac_voltage_V` returns the last voltage written to the DAC, in V;
`write_dac` converts V to a code; `read_sensor` returns {unit}; `reference` is a `pz_real`
variable in {unit}; `stop_with` reports the name of an invalid parameter and does not return.

{loops}

The delay margin is the additional delay at which the loop becomes unstable, on the worst plant
that is consistent with the recordings.
@xy The guaranteed error holds up to the given speed of the reference; section 5 states when.
@xy The transient is the time in which an error decays to 1 %, by the slowest closed-loop pole.
@xy The start is the voltage nearest 0 V that lies 5 % of the output range inside the limits.
@xy There the model expects the reading within `reference` of the first table. The ramp is the
@xy largest speed of the DAC, that of `reference_step_m`. The jump is the largest jump of the first
@xy output if the reading lies outside `reference`.

@xy - {XY}To switch on, ramp the DAC from 0 V towards the start voltage until the reading lies
@xy   within `reference`. Then call `pz_start`, set the reference to the reading, start the
@xy   interrupt, and ramp the reference to the wanted position. If the reading lies outside, the
@xy   output moves at once, and `reference_step_m` does not limit this motion. Before `pz_reset`,
@xy   too, the reading must lie inside, and the reference must be the reading.
@z - Z: the reference is always the set point.
- `pz_start` needs the present output voltage of the DAC. NaN counts as 0 V and a voltage out of
  range as the nearest limit, and the first output starts from there: check it first. The reading
  may be NaN: the model's position is then used. Call `pz_start` again, with the interrupt
  stopped, after a pause and after you have moved the DAC yourself.
- Park: ramp the reference to the parking position and stop the interrupt; the DAC keeps its last
  voltage. Switch off: park, then ramp the DAC to 0 V yourself.
- Read, step and write in the same call. The design includes the delay of the recordings. It
  includes your converters only if this firmware made the recordings. Otherwise keep the additional
  delay well below the delay margin. Each additional sample of delay costs accuracy. Another rate
  or missed calls are not detected.
- If another thread writes the reference, no interrupt may see half of it: on a 32-bit core, stop
  the interrupt while you copy a double. Axes that share an interrupt can be stepped in any order;
  to restart one of them, skip its `pz_step` until its `pz_start` has returned.
- `reference` is the position wanted `preview` samples later. If you do not know it, pass the
  present position wanted: the motion is the same, `preview` samples late.

## 3. Units and DAC codes

{voltage_note}
@xy - {XY}Reading and reference in m, with the scale, zero and sign of the recordings. Do not zero
@xy   the sensor at power-up: a small shift is taken for hysteresis and costs accuracy.
@z - Z: reading and reference in A. If your bias makes the current negative, negate every reading.
@rounded - `output / LSB`, rounded, is the code of a two's-complement DAC, within the column
@rounded   `codes`; an offset-binary DAC of n bits adds 2^(n-1). Clamp the code; masking wraps a
@rounded   code above full scale to the opposite end.
@unrounded - An LSB of 0 and no `codes` mean that lab.toml declares no `dac_bits`. Outputs are then
@unrounded   not rounded, and your firmware converts volts to codes with the scale of its DAC.
@rounded - A DAC with other steps rounds once more; keep the parameter `lsb_V` (column LSB).
- For a DAC with a smaller range, narrow the voltages (section 6).

## 4. Bad readings and limits

{guards}

- Pass `NAN` for a reading that you do not trust (timeout, checksum, out of range).
@xy - {XY}A reading is unusable if it is NaN or infinite, or if it does not change for
@xy   `stuck_samples` although the voltage moves by `stuck_voltage_V`. The model then continues
@xy   alone, with the last estimate of the disturbance. After `blind_samples` unusable readings in
@xy   a row the output latches: it holds its last value until `pz_reset`. After `pz_reset`, the
@xy   same number of unusable readings latches it again. If the reading then lies outside
@xy   `reference`, ramp the DAC and call `pz_start` as in section 2.
@xy - {XY}A reading beyond the displacement limits is replaced by the limit, with the bit
@xy   `MEASUREMENT_LIMITED`, and the loop continues with it. A saturated sensor therefore drives
@xy   the output towards one end. A constant reading counts as stuck once the voltage has moved by
@xy   `stuck_voltage_V`, and the output latches after `blind_samples`; a noisy reading never does.
@xy   A reversed sensor is not detected, nor a broken cable with a noisy reading. Your firmware
@xy   must detect saturated sensors, reversed sensors and broken cables.
@xy - {XY}At a voltage limit the output is clipped, with the bit `VOLTAGE_LIMITED`. The observer
@xy   uses the clipped voltage, so the loop does not wind up.
@z - Z retracts at once from a current that is dead (`NO_CURRENT`), frozen (`STUCK_SENSOR`) or at
@z   the ceiling, the end of its range (`MEASUREMENT_LIMITED`); after `bad_samples` from one that
@z   is reversed (`WRONG_SIGN`) or NaN. It latches at `retract_voltage_V` after `trip_limit`
@z   retracts in a row or at the end of the drive. Keep the set point well below the ceiling. The
@z   ADC must show noise: `stuck_samples` equal readings above `stuck_current_A` (-1: even 0 A)
@z   stop every approach.

## 5. Status

- `state.status` is 0, or bits `PZ_STATUS_...` (header) of what was limited, replaced or faulty in
  this sample. `status_ever` collects them; the first samples may set some, and only `pz_start`
  clears them.
@xy - {XY}A latch sets `LATCHED` and `BLIND`. While latched, `status` has only these two bits; read
@xy   the cause, `BAD_MEASUREMENT` or `STUCK_SENSOR`, from `status_ever`.
@z - Z: a latch sets `LATCHED` and `RETRACTED`; its cause stays in `status` until `pz_reset`.
- After `RESTARTED` the loop goes on by itself.
@xy - {XY}`UNCERTIFIED` is no fault: the reference moves faster than the guaranteed error covers,
@xy   as fast scans do. The guaranteed error holds while `status` is 0. After the start and after
@xy   the last set bit, wait for the transient of the table in section 2: the error of that moment
@xy   decays to 1 % in this time. Sensor noise adds to the guaranteed error.

## 6. Changing parameters

After new recordings or a change of lab.toml: `piezoid fit`. In firmware: copy the structure,
change it, set `copy.checksum = pz_checksum(&copy)`, stop the interrupt, call `pz_start` with the
copy, and pass the same copy to every later `pz_step`; it must stay in RAM.

- You may narrow the range from `voltage_minimum_V` to `voltage_maximum_V`.
@z - Z: keep `retract_voltage_V` within it.
@xy - {XY}You may narrow the range from `reference_minimum_m` to `reference_maximum_m`.
- You may lower `voltage_step_V` to any positive value below the present one, or to any positive
  value if it is 0 (unlimited). At present it is {voltage_steps}.
@xy - {XY}You may lower `reference_step_m` in the same way. At present it is {reference_steps}.

The margins remain valid while no limit acts. Any other change voids margins, bounds and proofs. Do
not edit gains: state limits in design.toml (`[x]`, then `bandwidth_Hz = 120` or
`modulus_margin = 0.6`), then run `piezoid design FOLDER --spec design.toml` and
`piezoid export FOLDER`, where FOLDER is that of the fit.
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
    lateral = [axis for axis in file.axes if axis.method != "rst"]
    has_tip = len(lateral) < len(file.axes)
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
        "README.md": _lines_for(_features_of(file), _README).format(
            name=plain_ascii(file.name),
            samples=SAMPLES,
            axes="\n".join(_axis_row(index, axis) for index, axis in enumerate(file.axes)),
            memory=memory,
            sizes=fill(_sizes(lateral), 98),
            loops=_loop_table(file.axes),
            guards=_guard_table(file.axes),
            XY="X, Y: " if lateral and has_tip else "",
            unit="m (Z: A)" if lateral and has_tip else "A" if has_tip else "m",
            first=file.axes[0].axis.upper(),
            voltage_steps=_limits_per_sample(file.axes, "voltage_step_V"),
            reference_steps=_limits_per_sample(lateral, "reference_step_m"),
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
_START_SHARE = 0.05  # of the output range, by which a start stays inside its limits
_OUTPUT = ("voltage_minimum", "voltage_maximum", "lsb")
_RANGE_m = ("reference_minimum_m", "reference_maximum_m", "m")
_RANGE_A = ("current_floor_A", "current_ceiling_A", "A")


def _features_of(file: ParameterFile) -> set[str]:
    """Return the features of a bundle that select lines of its README.

    xy, z, xy_only       axes without and with the method ``rst``
    rounded, unrounded   axes with and without a converter step
    functions            plays with functions in the place of weights
    mpi_dob, rst, ...    the methods of the axes
    """
    features = {axis.method for axis in file.axes}
    features |= {"z" if method == "rst" else "xy" for method in features}
    if "z" not in features:
        features.add("xy_only")
    for axis in file.axes:
        features.add("rounded" if axis.values["lsb_V"] else "unrounded")
        if axis.values["edge_count"]:
            features.add("functions")
    return features


def _lines_for(features: set[str], template: str) -> str:
    """Return the lines of a template without those of other features."""
    lines = []
    for line in template.splitlines(keepends=True):
        feature, _, content = line.removeprefix("@").partition(" ")
        if not line.startswith("@"):
            lines.append(line)
        elif feature in features:
            lines.append(content)
    return "".join(lines)


def _axis_row(index: int, axis: AxisParameters) -> str:
    """Return the row of an axis in the first table."""
    values = _scalars(axis)
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
    return f"| {' | '.join(map(str, cells))} |"


def _guard_table(axes: Sequence[AxisParameters]) -> str:
    """Return the table of guards, without columns that apply to no axis."""
    tips = {axis.method == "rst" for axis in axes}
    guards = [guard for guard in _GUARDS if guard[2] is None or guard[2] in tips]
    rows = []
    for axis in axes:
        values, is_tip = _scalars(axis), axis.method == "rst"
        blind_s = values["blind_samples"] / values["sampling_rate_Hz"]
        rows.append(
            (
                axis.axis,
                *(
                    text.format(**values, blind_s=blind_s) if only_tip in (None, is_tip) else ""
                    for _, text, only_tip in guards
                ),
            )
        )
    return _table(("axis", *(name for name, _, _ in guards)), rows)


def _loop_table(axes: Sequence[AxisParameters]) -> str:
    """Return the table of margins and guaranteed errors, and of the switch-on of X and Y."""
    headings = ["axis", "delay margin"]
    if any(axis.method != "rst" for axis in axes):
        headings += ["guaranteed error", "transient", "start", "ramp", "jump"]
    rows = []
    for axis in axes:
        margin, *bounds = _robustness_cells(axis.robustness)
        cells = [] if axis.method == "rst" else [*bounds, *_start_cells(axis)]
        rows.append((axis.axis, margin, *(cells or [""] * (len(headings) - 2))))
    return _table(headings, rows)


def _robustness_cells(robustness: Robustness | None) -> tuple[str, str, str]:
    if robustness is None:
        return "unknown", "unknown", "unknown"
    delay_s, error_m = robustness.delay_margin_s, robustness.guaranteed_error_m
    delay, error = "any" if delay_s is None else with_unit(delay_s, "s"), "none"
    if error_m is not None:
        slew = with_unit(robustness.reference_slew_m_per_s, "m/s")
        error = f"{with_unit(error_m, 'm')} up to {slew}"
    cells = (delay, error, with_unit(robustness.transient_s, "s", 2))
    delay, error, transient = (cell.replace("µ", "u") for cell in cells)
    return delay, error, transient


def _start_cells(axis: AxisParameters) -> tuple[str, str, str]:
    """Return voltage and speed of the DAC at power-up, and the largest first jump."""
    values = _scalars(axis)
    low_V, high_V = values["voltage_minimum_V"], values["voltage_maximum_V"]
    inset_V = _START_SHARE * (high_V - low_V)
    start_V = float(np.clip(0.0, low_V + inset_V, high_V - inset_V))
    ramp_V_per_s = values["reference_step_m"] * values["sampling_rate_Hz"]
    ramp_V_per_s /= values["gain_m_per_V"]
    jump_V = 0.0
    for voltage_V, end in product(
        (low_V, high_V), ("displacement_minimum_m", "displacement_maximum_m")
    ):
        controller = Controller(axis.values)
        controller.start(voltage_V, values[end])
        jump_V = max(jump_V, abs(controller.step(values[end], values[end]) - voltage_V))
    ramp = with_unit(ramp_V_per_s, "V/s", 2) if ramp_V_per_s else "unlimited"
    return f"{start_V:.2g} V", ramp, f"{jump_V:.2g} V"


def _limits_per_sample(axes: Sequence[AxisParameters], name: str) -> str:
    """Return the present values of a limit per sample, by axis."""
    unit = name.rpartition("_")[2]
    return ", ".join(f"{float(axis.values[name]):.4g} {unit} ({axis.axis})" for axis in axes)


def _sizes(axes: Sequence[AxisParameters]) -> str:
    """Return the numbers of elements that determine the time of ``pz_step``, by axis."""
    sizes = []
    for axis in axes:
        values = {name: round(value) for name, value in _scalars(axis).items()}
        knots = values["knot_count"] + values["envelope_count"]
        sizes.append(
            f"{axis.axis}: {values['play_count']} plays, {knots} knots, "
            f"{values['relaxation_count']} creep elements, order {values['observer_order']}"
        )
    return f"This bundle has {'; '.join(sizes)}."


def _scalars(axis: AxisParameters) -> dict[str, float]:
    return {name: float(value) for name, value in axis.values.items() if not value.ndim}


def _table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = (headings, ["---"] * len(headings), *rows)
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


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
