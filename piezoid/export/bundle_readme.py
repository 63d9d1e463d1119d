"""README.md of the bundle: build, call order, units, limits and changes, for the shipped axes.

The text is ``README.md.j2``; what concerns no axis of the file is left out.
"""

from collections.abc import Mapping, Sequence
from ctypes import sizeof
from importlib.metadata import version
from importlib.resources import files
from itertools import product
from textwrap import fill, indent
from typing import TYPE_CHECKING

import numpy as np

from piezoid.export.c_header import plain_ascii
from piezoid.export.parameter_file import AxisParameters, ParameterFile, Robustness
from piezoid.formatting import with_unit
from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import DeadZones
from piezoid.operators.preisach_plays import straight_between
from piezoid.records.checks.command_range import DRIVE_VOLTAGE_NOTE
from piezoid.runtime.controller import Controller
from piezoid.runtime.library import library

if TYPE_CHECKING:
    from jinja2 import Template

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
    *("axis", "index", "method", "rate, Hz", "preview, samples", "working range", "output, V"),
    *("LSB, V", "codes"),
)
_COST = ("axis", "plays", "knots", "creep elements", "observer order", "instructions")
_LOOP = (
    *("axis", "delay margin", "safe delay", "lag", "guaranteed error", "transient", "start"),
    "jump",
)
_READING = (
    *("axis", "reading at the lowest output", "at the highest output"),
    "centre of the model",
)
_GUARDS = (
    *("axis", "`stuck_samples`", "`stuck_voltage_V`", "`blind_samples`"),
    *("displacement limits, m", "`bad_samples`", "`stuck_current_A`", "`trip_limit`"),
    "`retract_voltage_V`",
)
_USELESS = "no useful bound"  # as in the report
_START_SHARE = 0.05  # of the output range, by which a start stays inside its limits
_RAMP_STEPS = 1001
# Additional delay as a share of the delay margin. On 27 loops of fitted stages, the worst modulus
# margin then keeps 65 to 87 % of its value, and 0.34 to 0.64 (docs/guide/runtime.md).
_SAFE_DELAY = 0.3
# Instructions of a step on an emulated Cortex-M4 (float), fitted to six axes and 18 variants of
# two of them (docs/guide/runtime.md).
_OBSERVER_COST, _INVERSE_COST = 375, 115
_PLAY_COST, _KNOT_COST, _CREEP_COST, _SECTION_COST = 41, 30, 20, 25
_ORDER_COSTS = (35, 6)  # of each state, and of each of its squares


def readme(file: ParameterFile, *, samples: int, digest: str, source: str) -> str:
    """Return the text for a parameter file.

    samples  of each axis in golden.csv
    digest   of params.json
    source   digest of the runtime's source
    """
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
    first = (lateral or file.axes)[0].axis
    bounds = {axis.axis: _error_bound(axis) for axis in lateral}
    return _template().render(
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
        lateral_axes="Position axis: " if has_lateral and has_tip else "",
        tip_axes="Tip axis: " if has_lateral and has_tip else "",
        unit="m (tip axis: A)" if has_lateral and has_tip else "A" if has_tip else "m",
        total_samples=samples * len(file.axes),
        costs=_table(_COST, [row for row in rows if "instructions" in row]),
        readings=indent(_table(_READING, [row for row in rows if _READING[1] in row]), "  "),
        dac_ranges=_dac_ranges(file.axes),
        has_guarantee=any(
            axis.robustness and axis.robustness.guaranteed_error_m for axis in lateral
        ),
        has_certified_step=any(axis.values["certified_step_m"] for axis in lateral),
        useless_bounds=[name for name, bound in bounds.items() if bound == _USELESS],
        first=first.upper(),
        first_axis=first,
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


def _template() -> "Template":
    from jinja2 import Environment, StrictUndefined

    environment = Environment(
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    source = files("piezoid.export").joinpath("README.md.j2").read_text()
    return environment.from_string(source)


def _cells(index: int, axis: AxisParameters) -> dict[str, str]:
    """Return the cells of an axis in all tables, by heading."""
    values = _scalars(axis)
    (low_V, high_V), step_V = axis.voltage_range_V, values["lsb_V"]
    codes = ""
    if step_V:
        first_code, last_code = np.ceil(low_V / step_V), np.floor(high_V / step_V)
        codes = f"{first_code:.0f} to {last_code:.0f}"
        low_V, high_V = first_code * step_V, last_code * step_V
    margin, _, _ = _robustness_cells(axis.robustness)
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
    return cells | (_tip_cells(axis) if axis.is_tip else _position_cells(axis))


def _tip_cells(axis: AxisParameters) -> dict[str, str]:
    values = _scalars(axis)
    low_A, high_A = values["current_floor_A"], values["current_ceiling_A"]
    return {
        "working range": f"{low_A:.7g} to {high_A:.7g} A, set point "
        f"{values['current_reference_A']:.4g}",
        "`bad_samples`": f"{values['bad_samples']:.0f}",
        "`stuck_current_A`": f"{values['stuck_current_A']:.4g}",
        "`trip_limit`": f"{values['trip_limit']:.0f}",
        "`retract_voltage_V`": f"{values['retract_voltage_V']:.4g}",
    }


def _position_cells(axis: AxisParameters) -> dict[str, str]:
    values = _scalars(axis)
    _, safe_delay, transient = _robustness_cells(axis.robustness)
    _, at_lowest, at_highest, centre = _READING
    low_m, high_m, min_m, max_m = (
        values[f"{quantity}_{end}_m"]
        for quantity in ("reference", "displacement")
        for end in ("minimum", "maximum")
    )
    blind_s = values["blind_samples"] / values["sampling_rate_Hz"]
    start, jump = _start_cells(axis)
    low_V, high_V = axis.voltage_range_V
    return {
        "plays": f"{values['play_count']:.0f}",
        "knots": f"{values['knot_count'] + values['envelope_count']:.0f}",
        "creep elements": f"{values['relaxation_count']:.0f}",
        "observer order": f"{values['observer_order']:.0f}",
        "instructions": _instructions(axis),
        "working range": f"{low_m:.7g} to {high_m:.7g} m",
        at_lowest: _end_cell(axis, low_V, 1, opposite=low_V >= 0.0),
        at_highest: _end_cell(axis, high_V, -1, opposite=high_V <= 0.0),
        centre: f"{values['displacement_offset_m']:.4g} m at {values['voltage_offset_V']:.4g} V",
        "safe delay": safe_delay,
        "lag": _lag(axis),
        "guaranteed error": _error_bound(axis),
        "transient": transient,
        "start": start,
        "jump": jump,
        "`blind_samples`": f"{values['blind_samples']:.0f} ({blind_s:.3g} s)",
        "displacement limits, m": f"{min_m:.4g} to {max_m:.4g}",
    }


def _robustness_cells(robustness: Robustness | None) -> tuple[str, str, str]:
    """Return delay margin, safe additional delay and transient."""
    if robustness is None:
        return "unknown", "unknown", "unknown"
    delay_s, delays = robustness.delay_margin_s, ("any", "any")
    if delay_s is not None:
        delays = (_plain(delay_s, "s"), _plain(_SAFE_DELAY * delay_s, "s", 2))
    return *delays, _plain(robustness.transient_s, "s", 2)


def _error_bound(axis: AxisParameters) -> str:
    """Return the guaranteed error of a position axis, or why there is none."""
    if axis.robustness is None:
        return "unknown"
    if axis.robustness.guaranteed_error_m is None:
        return _USELESS if axis.values["certified_step_m"] else "none"
    error = _plain(axis.robustness.guaranteed_error_m, "m")
    return f"{error} up to {_plain(axis.robustness.reference_slew_m_per_s, 'm/s')}"


def _plain(number: float, unit: str, digits: int = 3) -> str:
    return with_unit(number, unit, digits).replace("µ", "u")


def _lag(axis: AxisParameters) -> str:
    """Return the lag of the reading behind a slow ramp of the output, by the observer's model.

        sum of j g_j / sum of g_j = C (1 - A)^-2 B / C (1 - A)^-1 B   samples

    g_j is the pulse response of the model.
    """
    order = int(axis.values["observer_order"])
    if not order:
        return "unknown"
    transition = axis.values["observer_A"][:order, :order]
    output, rest = axis.values["observer_C"][:order], axis.values["observer_rest"][:order]
    sums = np.linalg.solve(np.eye(order) - transition, rest)
    samples = float(output @ sums) / float(output @ rest)
    return _plain(samples / axis.sampling_rate_Hz, "s")


def _start_cells(axis: AxisParameters) -> tuple[str, str]:
    """Return the end of the ramp at power-up, and the largest jump of the first output.

    The ramp ends a share of the output range beyond the voltage at which the model's outermost
    branch, that of a stage at rest, enters the working range. On seven stages no voltage or
    reading inside both ranges has a larger jump.
    """
    values = _scalars(axis)
    low_V, high_V = axis.voltage_range_V
    inset_V = _START_SHARE * (high_V - low_V)
    start_V = float(np.clip(0.0, low_V + inset_V, high_V - inset_V))
    if start_V != 0.0:
        end_V, side = (high_V, -1) if start_V > 0.0 else (low_V, 1)
        ramp_V = np.linspace(float(np.clip(0.0, low_V, high_V)), end_V, _RAMP_STEPS)
        reading_m = _branch_m(axis, ramp_V, side)
        limits_m = values["reference_minimum_m"], values["reference_maximum_m"]
        is_within = np.clip(reading_m, *limits_m) == reading_m
        start_V = float(ramp_V[int(np.argmax(is_within.all(axis=0)))]) - side * inset_V
    jump_V = 0.0
    for voltage_V, end in product(
        (low_V, high_V), ("displacement_minimum_m", "displacement_maximum_m")
    ):
        controller = Controller(axis.values)
        controller.start(voltage_V, values[end])
        jump_V = max(jump_V, abs(controller.step(values[end], values[end]) - voltage_V))
    return f"{start_V:.2g} V", f"{jump_V:.2g} V"


def _end_cell(axis: AxisParameters, voltage_V: float, side: int, opposite: bool) -> str:
    """Return the readings at an end of the output: of the branch towards it, of both at rest."""
    sides = (side, -side) if opposite else (side,)
    reading_m = np.concatenate([_branch_m(axis, np.array([voltage_V]), s) for s in sides])
    span_m = dict.fromkeys(f"{end_m:.4g}" for end_m in (reading_m.min(), reading_m.max()))
    return f"{' to '.join(span_m)} m"


def _branch_m(axis: AxisParameters, ramp_V: Array, side: int) -> Array:
    """Return the model's readings on an outermost branch, without and with all creep, (2, rows).

    side  -1: all plays at u - r, as on a rise from the lowest state; 1: all at u + r
    """

    def mapped(x: Array, count: str, *names: str) -> Array:
        threshold, weight = (axis.values[name][: int(axis.values[count])] for name in names)
        return DeadZones(threshold=threshold, weight=weight).run(x) if len(weight) else x

    values, plays = axis.values, slice(int(axis.values["play_count"]))
    threshold_V, edges = values["play_threshold_V"][plays], int(values["edge_count"])
    centred_V = ramp_V - values["voltage_offset_V"]
    input_V = mapped(centred_V, "envelope_count", "envelope_knot_V", "envelope_weight")
    state_V = input_V[:, None] + side * threshold_V
    if edges:
        edge_V = values["edge_V"] + values["edge_steps"] * threshold_V[1] * np.arange(edges)
        pairs = zip(state_V.T, values["play_value_m"][plays, :edges], strict=True)
        sum_m = np.sum([straight_between(z, edge_V, value_m) for z, value_m in pairs], axis=0)
    else:
        sum_m = state_V @ values["play_weight_m_per_V"][plays]
    moved_m = mapped(sum_m, "knot_count", "knot_m", "knot_weight")
    creep = np.outer([1.0, 1.0 + values["relaxation_share"].sum()], moved_m)
    return np.asarray(values["displacement_offset_m"] + values["polarity"] * creep)


def _limits_per_sample(axes: Sequence[AxisParameters], name: str) -> str:
    """Return the present values of a limit per sample, by axis."""
    unit = name.rpartition("_")[2]
    return ", ".join(f"{float(axis.values[name]):.4g} {unit} ({axis.axis})" for axis in axes)


def _dac_ranges(axes: Sequence[AxisParameters]) -> str:
    """Return the full range of a DAC of 16 bits with the step of each axis."""
    names: dict[float, list[str]] = {}
    for axis in axes:
        names.setdefault(float(axis.values["lsb_V"]), []).append(axis.axis)
    return ", ".join(
        f"{2**16 * step_V:.7g} V ({', '.join(group)})" for step_V, group in names.items() if step_V
    )


def _instructions(axis: AxisParameters) -> str:
    """Return the estimated number of instructions of ``pz_step`` on a Cortex-M4."""
    values = _scalars(axis)
    order, has_plays = values["observer_order"], axis.method == "mpi_dob"
    if axis.method not in ("dob", "mpi_dob") or (has_plays and values["edge_count"]):
        return "not measured"
    sections = values["reference_section_count"] + values["command_section_count"]
    cost = _OBSERVER_COST + _SECTION_COST * sections + _CREEP_COST * values["relaxation_count"]
    cost += _ORDER_COSTS[0] * order + _ORDER_COSTS[1] * order**2
    if has_plays:
        knots = values["knot_count"] + values["envelope_count"]
        cost += _INVERSE_COST + _PLAY_COST * values["play_count"] + _KNOT_COST * knots
    return f"{round(cost, -1):.0f}"


def _scalars(axis: AxisParameters) -> dict[str, float]:
    return {name: float(value) for name, value in axis.values.items() if not value.ndim}


def _table(headings: Sequence[str], rows: Sequence[Mapping[str, str]]) -> str:
    """Return a Markdown table of the columns with a cell in any row."""
    columns = [heading for heading in headings if any(heading in row for row in rows)]
    cells = [[row.get(heading, "") for heading in columns] for row in rows]
    lines = (columns, ["---"] * len(columns), *cells)
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
