"""Parameters and uncertainty: loading curve, errors, uncertainty budget, and quantities."""

from collections.abc import Mapping

import numpy as np

from piezoid.identification.displacement_budget import Budget, displacement_budget
from piezoid.identification.fit_statements import has_usable_intervals
from piezoid.identification.model import AxisModel
from piezoid_reports.chart import Canvas, axis_over
from piezoid_reports.page import Page, SPIRAL_Hz, guarantee, moving_axes, tracking_error
from piezoid_reports.parts import (
    Figure,
    Heading,
    Part,
    Prose,
    Section,
    Table,
    axis_heading,
    side_by_side,
    with_rows,
)
from piezoid_reports.quantities import MINUS, number, percent, significant, with_half_width

GUIDE_BOW = (
    "Good: a smooth bow, deeper than the width of its band. Bad: kinks, or a band wider than the "
    "bow."
)
FUNCTIONS = (
    "Simulated and inverted with plays whose outputs pass through functions. The diagnosis uses "
    "plays and dead zones."
)
DECLARATIONS = {
    "sensor_gain_relative": "gain of the sensor",
    "sensor_linearity_m": "linearity of the sensor",
    "tilt_rad": "angle between sensor and motion",
    "temperature_range_K": "range of the temperature",
    "expansion_m_per_K": "thermal expansion between sensor and stage",
}


def render(page: Page) -> Section | None:
    """Return loading curve, uncertainty and parameters of every axis."""
    parts: list[Part] = []
    budgets: dict[str, Budget] = {}
    for axis in page.axes:
        parts += [axis_heading(axis), _bow(axis)]
        if axis.verdict.applies:
            budgets[axis.axis] = displacement_budget(axis, page.lab)
        if axis.minor_loops is not None:
            parts.append(Prose(text=FUNCTIONS))
    if not parts:
        return None
    parts.append(Heading(text="All axes"))
    usable = {n: b for n, b in budgets.items() if has_usable_intervals(page.model.axes[n])}
    parts += _errors(page, budgets)
    if usable:
        first = next(iter(usable.values()))
        ranked = sorted(first.contributions, key=lambda c: -c.standard)
        columns = []
        for expected in usable.values():
            cells = {
                c.name: f"{number(c.standard, 'm')} ({percent(expected.share(c))})"
                for c in expected.contributions
                if c.standard
            }
            columns.append({**dict.fromkeys((c.name for c in ranked), ""), **cells})
        together = [{"together": number(b.combined, "m")} for b in usable.values()]
        parts.append(
            Table(
                caption="Uncertainty budget of a predicted position at the end of the range: "
                "standard uncertainty and share.",
                columns=("source", *(f"axis {name}" for name in usable)),
                rows=(*side_by_side(columns), *side_by_side(together)),
            )
        )
    parts.append(_quantities(page))
    missing = dict.fromkeys(name for budget in budgets.values() for name in budget.unknown)
    if missing:
        names = ", ".join(f"{DECLARATIONS[name]} ({name})" for name in missing)
        parts.append(Prose(text=f"Not declared under [uncertainty] in lab.toml: {names}."))
    return Section(
        anchor="parameters",
        title="Parameters and uncertainty",
        lead="95 % intervals, from refits that each leave out one block of cycles.",
        parts=tuple(parts),
    )


def _bow(axis: AxisModel) -> Figure:
    """Draw the loading curve (depoled stage, rising drive) minus its chord."""
    uncertainty = axis.uncertainty
    reach_V, half_m = uncertainty.reach_V, uncertainty.loading_half_m
    if not has_usable_intervals(axis):
        half_m = np.zeros_like(half_m)
    bow_m = uncertainty.loading_m - uncertainty.loading_m[-1] * reach_V / reach_V[-1]
    x = axis_over("rise of the drive from the middle", [reach_V], "V")
    curves = [bow_m - half_m, bow_m + half_m, np.zeros(1)]
    canvas = Canvas(x=x, y=axis_over("loading curve minus chord", curves, "m"), height=260)
    return Figure(
        title=f"Axis {axis.axis}: loading curve without its chord",
        caption=f"Width of the full loop: {_loop_width(axis)}.",
        guide=GUIDE_BOW,
        canvas=canvas,
        layers=(
            canvas.band("model-band", "95 % interval", reach_V, bow_m - half_m, bow_m + half_m),
            canvas.line("zero", "no hysteresis", reach_V[[0, -1]], np.zeros(2)),
            canvas.line("model", "loading curve", reach_V, bow_m),
        ),
    )


def _loop_width(axis: AxisModel) -> str:
    width_m, half_m = axis.uncertainty.loop_width_m
    if axis.quality.is_lag_ambiguous and axis.lag.kind != "none":
        return (
            f"{number(width_m, 'm')} beside a lag of {number(axis.lag.time_s, 's')}, which loops "
            "at a single speed do not separate from it"
        )
    if has_usable_intervals(axis):
        return with_half_width(width_m, half_m, "m")
    return f"{number(width_m, 'm')} (no usable interval)"


def _errors(page: Page, budgets: Mapping[str, Budget]) -> list[Table]:
    """Return the errors of each axis, from the expected errors to the guaranteed limit."""
    columns, spiral_axes = [], moving_axes(page.verification)
    for name, expected in budgets.items():
        axis = page.model.axes[name]
        held_out = number(axis.quality.held_out_rms_m, "m") if axis.quality.is_tested else ""
        expanded, factor = number(expected.expanded, "m"), significant(expected.coverage_factor)
        largest, tracked = number(expected.largest[1], "m"), tracking_error(page, name)
        positions = f"±{expanded} (k = {factor})"
        if not has_usable_intervals(axis):
            positions = largest = "no usable interval"
        bound = "no useful bound"
        if axis.quality.is_tested and axis.certificate.bound_m <= axis.quality.range_m:
            bound = number(axis.certificate.bound_m, "m")
            bound += " at the speed of the recordings" if axis.quality.is_lag_ambiguous else ""
        column = {
            "held-out error, rms": held_out,
            f"{SPIRAL_Hz:g} Hz spiral with feedback, simulated, rms, {spiral_axes}": tracked,
            "predicted position at the end of the range, 95 %": positions,
            f"largest error of {expected.positions} predicted positions": largest,
            "bound of the hysteresis model alone, 95 %": bound,
            "guaranteed error with feedback": guarantee(page, axis),
        }
        columns.append(column)
    return with_rows(
        Table(
            caption="Errors and their meaning, without feedback unless stated. The last two are "
            "limits for every drive, not expected errors. The last one can exceed the other: it "
            "assumes the time course of the hysteresis error that the loop amplifies most.",
            columns=("error", *(f"axis {name}" for name in budgets)),
            rows=side_by_side(columns),
            is_open=True,
        )
    )


def _quantities(page: Page) -> Table:
    columns = []
    for axis in page.axes:
        low_V, high_V = axis.voltage_V
        amplifier_Hz, sensor_Hz = axis.rig.amplifier_bandwidth_Hz, axis.rig.sensor_bandwidth_Hz
        uncertainty = axis.uncertainty
        lag = number(axis.lag.time_s, "s")
        if axis.quality.is_lag_ambiguous and axis.lag.kind != "none":
            lag = "not separable from the loop width at a single speed"
        elif "lag_s" in uncertainty.names:
            first_s = float(uncertainty.values[uncertainty.names.index("lag_s")])
            half_s = uncertainty.coverage * uncertainty.standard_error("lag_s")
            lag = with_half_width(first_s, half_s, "s")
        column = {
            "width of the full loop": _loop_width(axis),
            "lag of the first fit, without effects": lag,
            "centre of the model, voltage": number(axis.hysteresis.voltage_offset_V, "V", 4),
            "centre of the model, displacement": number(
                axis.hysteresis.displacement_offset_m, "m", 4
            ),
            "valid drive": f"{number(low_V, 'V')} to {number(high_V, 'V')}",
            "polarity": "+1" if axis.polarity > 0 else f"{MINUS}1",
            "amplifier bandwidth": "" if amplifier_Hz is None else number(amplifier_Hz, "Hz"),
            "sensor bandwidth": "" if sensor_Hz is None else number(sensor_Hz, "Hz"),
        }
        columns.append(column)
    return Table(
        caption="Other quantities.",
        columns=("quantity", *(f"axis {axis.axis}" for axis in page.axes)),
        rows=side_by_side(columns),
    )
