"""README.md of the bundle: build, call order, units, limits and changes, for the shipped axes.

The text is ``README.md.j2``; what concerns no axis of the file is left out.
"""

from collections.abc import Iterable, Sequence
from ctypes import sizeof
from importlib.metadata import version
from importlib.resources import files
from itertools import product
from textwrap import fill

import numpy as np

from piezoid.export.c_header import plain_ascii
from piezoid.export.parameter_file import AxisParameters, ParameterFile, Robustness
from piezoid.formatting import with_unit
from piezoid.records.checks.command_range import DRIVE_VOLTAGE_NOTE
from piezoid.runtime.controller import Controller
from piezoid.runtime.library import library

_WIDTH = 98
_METHODS = {
    "mpi_dob": "a disturbance observer on the inverse hysteresis model",
    "dob": "a disturbance observer alone",
    "mpi": "the inverse hysteresis model without feedback",
    "none": "a static gain without feedback",
    "rst": "a controller of the logarithm of a current",
}
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


def readme(file: ParameterFile, *, samples: int, digest: str, source: str) -> str:
    """Return the text for a parameter file.

    samples  of each axis in golden.csv
    digest   of params.json
    source   digest of the runtime's source
    """
    from jinja2 import Environment, StrictUndefined

    environment = Environment(
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    template = environment.from_string(
        files("piezoid.export").joinpath("README.md.j2").read_text()
    )
    lateral = [axis for axis in file.axes if axis.method != "rst"]
    has_tip, has_lateral = len(lateral) < len(file.axes), bool(lateral)
    shipped = {axis.method for axis in file.axes}
    states = [f"{library(name).state_size} ({name})" for name in ("float", "double")]
    sizes = [str(sizeof(library(name).parameters)) for name in ("float", "double")]
    voltage_note = (
        f"- {DRIVE_VOLTAGE_NOTE} Outputs stay within the drive of the recordings, and within the "
        "converter and amplifier of lab.toml."
    )
    decoupled, matrix = [], np.zeros((0, 0))
    if file.decoupled is not None:
        decoupled, matrix = list(map(plain_ascii, file.decoupled.axes)), file.decoupled.matrix
    rows = [
        (name, *(f"{value:.6g}" for value in row))
        for name, row in zip(decoupled, matrix, strict=True)
    ]
    return template.render(
        name=plain_ascii(file.name),
        samples=samples,
        axes="\n".join(_axis_row(index, axis) for index, axis in enumerate(file.axes)),
        unshipped=[
            (plain_ascii(axis), plain_ascii(reason, length=600))
            for axis, reason in file.unshipped.items()
        ],
        methods={name: text for name, text in _METHODS.items() if name in shipped},
        memory=f"{' or '.join(states)} bytes of state and {' or '.join(sizes)} of parameters",
        has_lateral=has_lateral,
        has_tip=has_tip,
        has_functions=any(axis.values["edge_count"] for axis in file.axes),
        is_rounded=any(axis.values["lsb_V"] for axis in file.axes),
        is_unrounded=not all(axis.values["lsb_V"] for axis in file.axes),
        lateral_axes="X, Y: " if has_lateral and has_tip else "",
        unit="m (Z: A)" if has_lateral and has_tip else "A" if has_tip else "m",
        sizes=fill(_sizes(lateral), _WIDTH),
        first=file.axes[0].axis.upper(),
        loops=_loop_table(file.axes),
        guards=_guard_table(file.axes),
        voltage_note=fill(voltage_note, _WIDTH, subsequent_indent="  "),
        voltage_steps=_limits_per_sample(file.axes, "voltage_step_V"),
        reference_steps=_limits_per_sample(lateral, "reference_step_m"),
        decoupled=decoupled,
        decoupling=_table(("", *decoupled), rows),
        version=version("piezoid"),
        digest=digest,
        source=source,
    )


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
        headings += ["guaranteed error", "transient", "start", "jump"]
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


def _start_cells(axis: AxisParameters) -> tuple[str, str]:
    """Return the voltage of the DAC at power-up, and the largest jump of the first output.

    On seven stages no voltage or reading inside these ends has a larger jump.
    """
    values = _scalars(axis)
    low_V, high_V = values["voltage_minimum_V"], values["voltage_maximum_V"]
    inset_V = _START_SHARE * (high_V - low_V)
    start_V = float(np.clip(0.0, low_V + inset_V, high_V - inset_V))
    jump_V = 0.0
    for voltage_V, end in product(
        (low_V, high_V), ("displacement_minimum_m", "displacement_maximum_m")
    ):
        controller = Controller(axis.values)
        controller.start(voltage_V, values[end])
        jump_V = max(jump_V, abs(controller.step(values[end], values[end]) - voltage_V))
    return f"{start_V:.2g} V", f"{jump_V:.2g} V"


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
