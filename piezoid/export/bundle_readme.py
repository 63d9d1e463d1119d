"""README.md of the bundle: build, call order, units, limits and changes, for the shipped axes.

The text is ``README.md.j2``; what concerns no axis of the file is left out.
"""

from collections.abc import Mapping, Sequence
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
# Columns of the tables; one that applies to no axis is left out.
_AXIS = (
    *("axis", "index", "method", "rate, Hz", "preview, samples", "reference", "output, V"),
    *("LSB, V", "codes"),
)
_LOOP = ("axis", "delay margin", "guaranteed error", "transient", "start", "jump")
_GUARDS = (
    *("axis", "`stuck_samples`", "`stuck_voltage_V`", "`blind_samples`"),
    *("displacement limits, m", "`bad_samples`", "`stuck_current_A`", "`trip_limit`"),
    "`retract_voltage_V`",
)
_START_SHARE = 0.05  # of the output range, by which a start stays inside its limits


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
    lateral = [axis for axis in file.axes if not axis.is_tip]
    has_tip, has_lateral = len(lateral) < len(file.axes), bool(lateral)
    shipped = {axis.method for axis in file.axes}
    states = [f"{library(name).state_size} ({name})" for name in ("float", "double")]
    sizes = [str(sizeof(library(name).parameters)) for name in ("float", "double")]
    voltage_note = (
        f"- {DRIVE_VOLTAGE_NOTE} Outputs stay within the drive of the recordings, and within the "
        "converter and amplifier of lab.toml."
    )
    decoupled, matrix = list[str](), np.zeros((0, 0))
    if file.decoupled is not None:
        decoupled, matrix = list(map(plain_ascii, file.decoupled.axes)), file.decoupled.matrix
    coupling = [
        dict(zip(("", *decoupled), (name, *(f"{value:.6g}" for value in row)), strict=True))
        for name, row in zip(decoupled, matrix, strict=True)
    ]
    rows = [_cells(index, axis) for index, axis in enumerate(file.axes)]
    return template.render(
        name=plain_ascii(file.name),
        samples=samples,
        axes=_table(_AXIS, rows),
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
        loops=_table(_LOOP, rows),
        guards=_table(_GUARDS, rows),
        voltage_note=fill(voltage_note, _WIDTH, subsequent_indent="  "),
        voltage_steps=_limits_per_sample(file.axes, "voltage_step_V"),
        reference_steps=_limits_per_sample(lateral, "reference_step_m"),
        decoupled=decoupled,
        decoupling=_table(("", *decoupled), coupling),
        version=version("piezoid"),
        digest=digest,
        source=source,
    )


def _cells(index: int, axis: AxisParameters) -> dict[str, str]:
    """Return the cells of an axis in all tables, by heading."""
    values = _scalars(axis)
    (low_V, high_V), step_V = axis.voltage_range_V, values["lsb_V"]
    codes = ""
    if step_V:
        first_code, last_code = np.ceil(low_V / step_V), np.floor(high_V / step_V)
        codes = f"{first_code:.0f} to {last_code:.0f}"
        low_V, high_V = first_code * step_V, last_code * step_V
    margin, error, transient = _robustness_cells(axis.robustness)
    cells = {
        "axis": axis.axis,
        "index": str(index),
        "method": axis.method,
        "rate, Hz": f"{values['sampling_rate_Hz']:g}",
        "preview, samples": f"{values['preview_samples']:g}",
        "output, V": f"{low_V:.7g} to {high_V:.7g}",
        "LSB, V": f"{step_V:.12g}",
        "codes": codes,
        "delay margin": margin,
        "`stuck_samples`": f"{values['stuck_samples']:.0f}",
        "`stuck_voltage_V`": f"{values['stuck_voltage_V']:.4g}",
    }
    if axis.is_tip:
        low_A, high_A = values["current_floor_A"], values["current_ceiling_A"]
        set_point_A = values["current_reference_A"]
        return cells | {
            "reference": f"{low_A:.7g} to {high_A:.7g} A, set point {set_point_A:.4g}",
            "`bad_samples`": f"{values['bad_samples']:.0f}",
            "`stuck_current_A`": f"{values['stuck_current_A']:.4g}",
            "`trip_limit`": f"{values['trip_limit']:.0f}",
            "`retract_voltage_V`": f"{values['retract_voltage_V']:.4g}",
        }
    low_m, high_m, min_m, max_m = (
        values[f"{quantity}_{end}_m"]
        for quantity in ("reference", "displacement")
        for end in ("minimum", "maximum")
    )
    blind_s = values["blind_samples"] / values["sampling_rate_Hz"]
    start, jump = _start_cells(axis)
    return cells | {
        "reference": f"{low_m:.7g} to {high_m:.7g} m",
        "guaranteed error": error,
        "transient": transient,
        "start": start,
        "jump": jump,
        "`blind_samples`": f"{values['blind_samples']:.0f} ({blind_s:.3g} s)",
        "displacement limits, m": f"{min_m:.4g} to {max_m:.4g}",
    }


def _robustness_cells(robustness: Robustness | None) -> tuple[str, str, str]:
    """Return delay margin, guaranteed error and transient."""
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
    low_V, high_V = axis.voltage_range_V
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


def _table(headings: Sequence[str], rows: Sequence[Mapping[str, str]]) -> str:
    """Return a Markdown table of the columns with a cell in any row."""
    columns = [heading for heading in headings if any(heading in row for row in rows)]
    cells = [[row.get(heading, "") for heading in columns] for row in rows]
    lines = (columns, ["---"] * len(columns), *cells)
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
