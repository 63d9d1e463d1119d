"""The target `nanonis`: sensitivity, limits, hysteresis tables and drift for a Nanonis controller.

Such a controller moves a scanner without a displacement sensor. It divides positions by a
sensitivity, and corrects the voltages by one hysteresis table for the fast axis and one for the
slow axis. We assume that a table is a polyline:

    voltage = middle + sign y(sign s) / sensitivity,   s = displacement - middle

with sign +1 on forward lines, and -1 on backward lines if the controller mirrors the table. The
curve is the forward branch of the inverse of the identified hysteresis for this frame.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import zip_longest

import numpy as np

from piezoid.errors import ParameterFileError
from piezoid.export.c_header import plain_ascii
from piezoid.export.parameter_file import AxisParameters
from piezoid.formatting import with_unit
from piezoid.numerics.arrays import Array
from piezoid.targets.target_inputs import (
    Errors,
    TargetInputs,
    error_rows,
    exported_position_m,
    worst_errors,
)
from piezoid.targets.waveform import check_range, half_range, inverse_V, last_period
from piezoid.verification.scenarios import raster

_LINE_Hz = 1.0  # to and fro
_DENSE = 4096  # points of a branch
_CREEP_s = (10.0, 100.0)  # after a move: the duration of a frame
_MAX_RESIDUAL = 0.1  # of a table, relative to the nonlinearity of the branch
_AXES = ("X", "Y", "Z")
COLUMNS = ("straight", "table", "exported", "back", "mirrored")

_SEND = '''\
"""Send nanonis.json to a controller: python3 send.py HOST PORT. Needs SPECS' nanonis_spm.

A value of null keeps what the controller has. Read the file first: it changes what a metre is.
"""

import json
import pathlib
import socket
import sys

import nanonis_spm

calls = json.loads((pathlib.Path(__file__).parent / "nanonis.json").read_text())["calls"]
with socket.create_connection((sys.argv[1], int(sys.argv[2]))) as connection:
    nanonis = nanonis_spm.Nanonis(connection)
    for name, arguments in calls.items():
        values = list(arguments.values())
        if None in values:
            held = getattr(nanonis, name.removesuffix("Set") + "Get")()[2]
            values = [h if v is None else v for v, h in zip(values, held)]
        print(name, getattr(nanonis, name)(*values)[0])
'''

_README = """\
# {name}: settings for a Nanonis controller

| file | content |
| --- | --- |
| `nanonis.json` | methods of SPECS' Python package nanonis_spm 1.0.9, with their arguments |
| `AXIS.csv` | the table of an axis, m about the middle: where to be, where to go without a bend |
| `send.py` | sends them with that package |

They set sensitivity, limits, hysteresis tables and drift. {voltages} {fast}

{axes}
Errors are rms about the mean, of lines at {line}; *straight* is the sensitivity alone. Tables
and sensitivities are rounded to single precision, as they are sent. Drift compensation is off in
the file: its speeds are what a stage creeps after a move by half the frame towards larger
displacements, between {crept}; scale them by your move, turn their sign with it, and switch it
on (1).

Tested: names and order of arguments against that package; tables on the identified plant and
others that the recordings allow, with hysteresis, creep, noise and dynamics. Not tested, because
no such controller was at hand: whether it joins points by straight lines, whether it mirrors a
table on backward lines (then the last column holds, else *back*), the unit of its points (here m;
its document names none), how many it holds, whether its limits are volts before or behind its
amplifier.
"""

_AXIS = """\
## Axis {axis}: +-{half} about {centre}, {count} points

{sensitivity} m/V; {low:.4f} V to {high:.4f} V at the ends of the frame. {loss}.

| plant | straight | table, forward | exported controller | back, not mirrored | back, mirrored |
| --- | --- | --- | --- | --- | --- |
{rows}

{drift}.
"""


@dataclass(frozen=True, kw_only=True, eq=False)
class Table:
    """Sensitivity and hysteresis table of one axis.

    sensitivity_m_per_V  of the command, signed
    middle_V, centre_m   of the frame
    half_m               half range of the frame
    x_m, y_m             (points,)  relative to the middle, single precision
    ends_V               of the whole loop
    """

    axis: str
    sensitivity_m_per_V: float
    middle_V: float
    centre_m: float
    half_m: float
    x_m: Array
    y_m: Array
    ends_V: tuple[float, float]

    def voltage_V(self, wanted_m: Array, sign: Array | float = 1.0) -> Array:
        """Return the output that the controller is assumed to compute, (samples,)."""
        s_m = np.asarray(sign) * (wanted_m - self.centre_m)
        corrected_m = np.asarray(sign) * np.interp(s_m, self.x_m, self.y_m)
        return np.asarray(self.middle_V + corrected_m / self.sensitivity_m_per_V)


def nanonis_files(inputs: TargetInputs) -> tuple[Mapping[str, bytes], tuple[str, ...]]:
    """Return the folder's files by name, and one sentence about the error of each axis.

    Raises ``ParameterFileError`` for a frame that the stage cannot reach.
    """
    notes = [f"axis {axis} has no table in nanonis/: it follows a surface" for axis in inputs.tips]
    if not inputs.lateral:
        return {}, tuple(notes)
    tables = [hysteresis_table(inputs, axis) for axis in inputs.lateral]
    files: dict[str, str] = {"nanonis.json": settings_json(inputs, tables), "send.py": _SEND}
    sections = []
    for axis, table in zip(inputs.lateral, tables, strict=True):
        errors_m = line_errors_m(inputs, axis, table)
        worst = worst_errors(errors_m)
        loss = (
            f"error on forward lines with a table of {len(table.x_m)} points {worst['table']} "
            f"rms, with the sensitivity alone {worst['straight']}, with the exported controller "
            f"{worst['exported']}; worst of {len(errors_m)} plants"
        )
        notes.append(f"axis {axis.axis}: {loss}")
        sections.append(_section(inputs, table, errors_m, loss))
        rows = (f"{x:.9g},{y:.9g}" for x, y in zip(table.x_m, table.y_m, strict=True))
        files[f"{axis.axis}.csv"] = "\n".join(["x_m,y_m", *rows, ""])
    is_declared = all(inputs.amplifier_V_per_V.get(table.axis) for table in tables)
    files["README.md"] = _README.format(
        name=plain_ascii(inputs.file.name),
        voltages="Volts and m/V are those behind the amplifier that lab.toml declares."
        if is_declared
        else "Volts and m/V are those of the command: lab.toml declares no gain_V_per_V of the "
        "amplifier for every axis. Multiply volts by yours, divide m/V by it.",
        fast=f"Axis {tables[0].axis} is taken for the fast one"
        + (f", axis {tables[1].axis} for the slow one." if len(tables) > 1 else "."),
        axes="\n".join(sections),
        line=with_unit(_LINE_Hz, "Hz"),
        crept=f"{_CREEP_s[0]:g} s and {_CREEP_s[1]:g} s after it",
    )
    return {name: text.encode() for name, text in files.items()}, tuple(notes)


def hysteresis_table(inputs: TargetInputs, axis: AxisParameters) -> Table:
    """Return sensitivity and table of one axis for a frame in the middle of its references."""
    plant, points = inputs.family(axis.axis)[0], inputs.hardware.table_points
    key = "frame_half_range_m of [nanonis]"
    centre_m, half_m = half_range(axis, inputs.hardware.frame_half_range_m, key)
    forward_m = np.linspace(-half_m, half_m, _DENSE)
    loop_V = inverse_V(plant, centre_m + np.concatenate([forward_m, forward_m[::-1]]))
    ends_V = (float(loop_V.min()), float(loop_V.max()))
    check_range(axis.axis, loop_V, axis.voltage_range_V, half_m, "frame_half_range_m", "[nanonis]")
    branch_V = loop_V[:_DENSE]
    sensitivity = _single(2.0 * half_m / float(branch_V[-1] - branch_V[0]))
    middle_V = 0.5 * (ends_V[0] + ends_V[1])
    y_m = sensitivity * (branch_V - middle_V)
    knot_m, fitted_m, residual_m = _fit_polyline(forward_m, y_m, points)
    nonlinearity_m = float(np.std(y_m - forward_m))
    allowed_m = _MAX_RESIDUAL * nonlinearity_m
    if residual_m > allowed_m:
        candidates = range(points, _DENSE)
        needed = next(n for n in candidates if _fit_polyline(forward_m, y_m, n)[2] <= allowed_m)
        raise ParameterFileError(
            f"axis {axis.axis}: a table of {points} points has a residual of "
            f"{with_unit(residual_m, 'm')} rms, of {with_unit(nonlinearity_m, 'm')} without it",
            needed=f"a residual of at most {with_unit(allowed_m, 'm')}",
            remedy=f"Set table_points = {needed} or more in [nanonis] of box.toml.",
        )
    return Table(
        axis=axis.axis,
        sensitivity_m_per_V=sensitivity,
        middle_V=middle_V,
        centre_m=centre_m,
        half_m=half_m,
        x_m=knot_m.astype(np.float32).astype(np.float64),
        y_m=np.maximum.accumulate(fitted_m).astype(np.float32).astype(np.float64),
        ends_V=ends_V,
    )


def _fit_polyline(x_m: Array, y_m: Array, points: int) -> tuple[Array, Array, float]:
    """Return knots and values of the least-squares polyline, and the rms of its residual, m."""
    knot_m = np.linspace(x_m[0], x_m[-1], points)
    basis = np.stack([np.interp(x_m, knot_m, unit) for unit in np.eye(points)], axis=1)
    fitted_m = np.asarray(np.linalg.lstsq(basis, y_m)[0], dtype=np.float64)
    return knot_m, fitted_m, float(np.sqrt(np.mean((basis @ fitted_m - y_m) ** 2)))


def line_errors_m(
    inputs: TargetInputs, axis: AxisParameters, table: Table
) -> dict[str, dict[str, float]]:
    """Return the error on lines by plant and by ``COLUMNS``, rms in m.

    The last two columns are backward lines, with the same table and with the mirrored table.
    """
    errors_m = {}
    for plant in inputs.family(axis.axis):
        unit = raster(plant.sampling_rate_Hz, _LINE_Hz, 1.0).x
        wanted_m = table.centre_m + table.half_m * unit
        is_forward = np.gradient(unit) > 0.0
        straight_V = table.middle_V + (wanted_m - table.centre_m) / table.sensitivity_m_per_V
        mirrored_V = table.voltage_V(wanted_m, np.where(is_forward, 1.0, -1.0))
        table_m = last_period(plant, table.voltage_V(wanted_m))
        exported_m = exported_position_m(axis, plant, np.tile(wanted_m, 3))[-len(wanted_m) :]
        lines = (
            (last_period(plant, straight_V), is_forward),
            (table_m, is_forward),
            (exported_m, is_forward),
            (table_m, ~is_forward),
            (last_period(plant, mirrored_V), ~is_forward),
        )
        errors_m[plant.label] = {
            name: float(np.std((position_m - wanted_m)[rows]))
            for name, (position_m, rows) in zip(COLUMNS, lines, strict=True)
        }
    return errors_m


def settings_json(inputs: TargetInputs, tables: list[Table]) -> str:
    """Return the settings of the controller by the names of its published interface.

    A value of null keeps the controller's own value.
    """
    is_declared = all(inputs.amplifier_V_per_V.get(table.axis) for table in tables)
    sensitivities: dict[str, float | None] = {}
    limits: dict[str, float | int | None] = {"Enable_limits": 1}
    drift: dict[str, float] = {}
    for letter, table in zip_longest(_AXES, tables[:2]):
        sensitivity, low_V, high_V, speed = None, None, None, 0.0
        if table is not None:
            gain = inputs.amplifier_V_per_V[table.axis] if is_declared else 1.0
            sensitivity = _single(table.sensitivity_m_per_V / gain)
            ends_V = [gain * end_V for end_V in inputs.file.axis(table.axis).voltage_range_V]
            low_V, high_V = map(_single, sorted(ends_V))
            speed = _single(-creep_after_move(inputs, table)[0])
        sensitivities[f"Calibration_{letter}_mPerV"] = sensitivity
        limits |= {f"Limit_{letter}_low_V": low_V, f"Limit_{letter}_high_V": high_V}
        drift[f"V{letter.lower()}_m_s"] = speed
    points: dict[str, int | list[float]] = {}
    for axis, table in zip_longest(("Fast", "Slow"), tables[:2]):
        x, y = 2 * ([-1.0, 1.0],) if table is None else (table.x_m.tolist(), table.y_m.tolist())
        # nanonis_spm has two underscores in one of the names
        points[f"{axis}_axis_{'_' if axis == 'Fast' else ''}number_points_X"] = len(x)
        points[f"{axis}_axis_points_X"] = x
        points[f"{axis}_axis_number_points_Y"] = len(y)
        points[f"{axis}_axis_points_Y"] = y
    calls = {
        "Piezo_SensSet": sensitivities,
        "Piezo_XYZLimitsSet": limits,
        "Piezo_HystValsSet": points,
        "Piezo_HystOnOffSet": {"On_Off": 1},
        "Piezo_DriftCompSet": {
            "Compensation_on_off": 2,
            **drift,
            "Sat_Lim": inputs.hardware.drift_limit_percent,
        },
    }
    return json.dumps({"schema": "piezoid.nanonis/1", "calls": calls}, indent=1) + "\n"


def creep_after_move(inputs: TargetInputs, table: Table) -> tuple[float, float, float]:
    """Return mean speed and distance of the creep after a move by half the frame.

    The third number is the largest deviation from that mean speed, m. The creep is
    y sum of share_i (1 - exp(-t / tau_i)), with the elements that ship.
    """
    axis = inputs.file.axis(table.axis)
    rate = np.asarray(axis.values["relaxation_rate"], dtype=np.float64)
    share = np.asarray(axis.values["relaxation_share"], dtype=np.float64)
    rate, share = rate[rate > 0.0], share[rate > 0.0]
    tau_s = -1.0 / (np.log1p(-rate) * axis.sampling_rate_Hz)
    time_s = np.linspace(*_CREEP_s, 200)
    creep_m = table.half_m * np.sum(share * (1.0 - np.exp(-time_s[:, None] / tau_s)), axis=1)
    distance_m = float(creep_m[-1] - creep_m[0])
    speed = distance_m / (_CREEP_s[1] - _CREEP_s[0])
    residual_m = creep_m - creep_m[0] - speed * (time_s - time_s[0])
    return speed, distance_m, float(np.abs(residual_m).max())


def _section(inputs: TargetInputs, table: Table, errors_m: Errors, loss: str) -> str:
    speed, distance_m, residual_m = creep_after_move(inputs, table)
    drift = (
        f"After a move by {with_unit(table.half_m, 'm')} it creeps by "
        f"{with_unit(distance_m, 'm')} between {_CREEP_s[0]:g} s and {_CREEP_s[1]:g} s; "
        f"{with_unit(speed, 'm')} a second leave at most {with_unit(residual_m, 'm')}"
        if distance_m
        else "No creep ships with this axis, so there is no speed to compensate"
    )
    return _AXIS.format(
        axis=table.axis,
        half=with_unit(table.half_m, "m"),
        centre=with_unit(table.centre_m, "m"),
        count=len(table.x_m),
        sensitivity=f"{table.sensitivity_m_per_V:.6g}",
        low=table.ends_V[0],
        high=table.ends_V[1],
        loss=loss[0].upper() + loss[1:],
        rows=error_rows(errors_m),
        drift=drift,
    )


def _single(value: float) -> float:
    return float(np.float32(value))
