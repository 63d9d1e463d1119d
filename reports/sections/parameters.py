"""Parameters and uncertainty: loading curve, errors, uncertainty budget, and quantities."""

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

from piezoid.identification.displacement_budget import DisplacementBudget, displacement_budget
from piezoid.identification.fit_statements import has_usable_intervals
from piezoid.identification.model import AxisModel
from piezoid.identification.quality import Uncertainty
from piezoid.numerics.robust import student_quantile
from piezoid_reports.chart import Canvas, axis_over
from piezoid_reports.page import Page, SPIRAL_Hz, guarantee, tracking_error
from piezoid_reports.parts import (
    Figure,
    Heading,
    Part,
    Prose,
    Section,
    Table,
    axis_heading,
    count_of,
    folded,
    side_by_side,
    with_rows,
)
from piezoid_reports.quantities import MINUS, number, percent, significant, with_half_width

GUIDE_BOW = (
    "Good: a smooth bow, deeper than the width of its band. Bad: kinks, or a band wider than the "
    "bow."
)
DECLARATIONS = {
    "sensor_gain_relative": "gain of the sensor",
    "sensor_linearity_m": "linearity of the sensor",
    "tilt_rad": "angle between sensor and motion",
    "temperature_range_K": "range of the temperature",
    "expansion_m_per_K": "thermal expansion between sensor and stage",
}
Intervals = Mapping[str, tuple[float, float]]  # value and half 95 % interval by parameter


def render(page: Page) -> Section | None:
    """Return loading curve, uncertainty and parameters of every axis."""
    parts: list[Part] = []
    budgets = []
    for axis in page.axes:
        intervals = intervals_of(axis.uncertainty)
        parts += [axis_heading(axis), _bow(axis)]
        if axis.verdict.applies:
            budgets.append(displacement_budget(axis, page.lab))
        parts += folded("Parameters", [*_functions(axis), *_weights(axis, intervals)])
    if not parts:
        return None
    parts.append(Heading(text="All axes"))
    usable = [b for b in budgets if has_usable_intervals(page.model.axes[b.axis])]
    parts += [*_errors(page, budgets), *_contributions(usable), _quantities(page)]
    missing = dict.fromkeys(name for budget in budgets for name in budget.unknown)
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
    x = axis_over("rise of the drive", [reach_V], "V")
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
    if has_usable_intervals(axis):
        return with_half_width(width_m, half_m, "m")
    return f"{number(width_m, 'm')} (no usable interval)"


def _errors(page: Page, budgets: Sequence[DisplacementBudget]) -> list[Part]:
    """Return the errors of each axis, from the expected errors to the guaranteed limit."""
    columns = []
    for budget in budgets:
        axis, expected = page.model.axes[budget.axis], budget.budget
        held_out = number(axis.quality.held_out_rms_m, "m") if axis.quality.is_tested else ""
        expanded, factor = number(expected.expanded, "m"), significant(expected.coverage_factor)
        largest, tracked = number(expected.largest[1], "m"), tracking_error(page, budget.axis)
        positions = f"±{expanded} (k = {factor})"
        if not has_usable_intervals(axis):
            positions = largest = "no usable interval"
        bound = "no useful bound"
        if axis.quality.is_tested and axis.certificate.bound_m <= axis.quality.range_m:
            bound = number(axis.certificate.bound_m, "m")
            bound += " at the speed of the recordings" if axis.quality.is_lag_ambiguous else ""
        column = {
            "held-out error, rms": held_out,
            f"{SPIRAL_Hz:g} Hz spiral with feedback, simulated, rms": tracked,
            "95 % of positions": positions,
            f"largest of {expected.positions} positions": largest,
            "bound of the hysteresis model alone, 95 %": bound,
            "guaranteed error with feedback": guarantee(page, axis),
        }
        columns.append(column)
    return with_rows(
        Table(
            caption="Errors and their meaning, without feedback unless stated. The last two are "
            "limits for every drive, not expected errors.",
            columns=("error", *(f"axis {budget.axis}" for budget in budgets)),
            rows=side_by_side(columns),
            is_open=True,
        )
    )


def _contributions(budgets: Sequence[DisplacementBudget]) -> list[Part]:
    """Return the uncertainty budgets of all axes, largest contribution of the first axis first."""
    if not budgets:
        return []
    ranked = sorted(budgets[0].budget.contributions, key=lambda c: -c.standard)
    columns = []
    for expected in (budget.budget for budget in budgets):
        cells = dict.fromkeys((c.name for c in ranked), "")
        for c in expected.contributions:
            share = percent(expected.share(c))
            cells[c.name] = f"{number(c.standard, 'm')} ({share})" if c.standard != 0.0 else ""
        columns.append(cells)
    together = [{"together": number(b.budget.combined, "m")} for b in budgets]
    return [
        Table(
            caption="Uncertainty budget of a predicted position at the end of the range: standard "
            "uncertainty and share.",
            columns=("source", *(f"axis {b.axis}" for b in budgets)),
            rows=(*side_by_side(columns), *side_by_side(together)),
        )
    ]


def intervals_of(uncertainty: Uncertainty) -> Intervals:
    """Return value and half 95 % interval of every parameter by name."""
    quantile = float(student_quantile(0.975, max(uncertainty.blocks - 1, 1)))
    half = quantile * np.sqrt(np.maximum(np.diag(uncertainty.covariance), 0.0))
    return {
        name: (float(value), float(spread))
        for name, value, spread in zip(uncertainty.names, uncertainty.values, half, strict=True)
    }


def _functions(axis: AxisModel) -> tuple[Part, ...]:
    if axis.minor_loops is None:
        return ()
    operator = axis.minor_loops.operator
    blocks = len(axis.minor_loops.without_m)
    text = (
        f"Axis {axis.axis} is simulated and inverted with plays whose outputs pass through "
        "functions. The diagnosis uses plays and dead zones."
    )
    return (
        Prose(text=text),
        Table(
            caption=f"Axis {axis.axis}: rise of the functions between edges of the drive about "
            f"{number(operator.voltage_offset_V, 'V', 4)}, and the spread over {blocks} fits that "
            "each leave out one block of time.",
            columns=(
                "play",
                "half-width",
                *(
                    f"{number(low, 'V', 3)} to {number(high, 'V', 3)}"
                    for low, high in pairwise(operator.edge_V.tolist())
                ),
            ),
            rows=tuple(
                (
                    str(i),
                    number(float(operator.threshold_V[i]), "V", 4),
                    *(
                        with_half_width(float(rise_m), float(half_m), "m")
                        for rise_m, half_m in zip(operator.rise_m[i], halves_m, strict=True)
                    ),
                )
                for i, halves_m in enumerate(axis.minor_loops.half_m)
            ),
        ),
    )


def _weights(axis: AxisModel, intervals: Intervals) -> tuple[Figure, ...]:
    """Draw the weights of the plays over their thresholds; model.json lists all numbers."""
    plays = axis.hysteresis.plays
    if len(plays.weight) < 3:
        return ()
    # Play 0 has no memory; its weight is the initial slope of the loading curve.
    threshold_V, weight = plays.threshold[1:], plays.weight[1:]
    names = [f"play_weight_m_per_V[{k}]" for k in range(1, len(plays.weight))]
    half = np.array([intervals.get(name, (0.0, 0.0))[1] for name in names])
    y = axis_over("weight", [weight - half, weight + half, np.zeros(1)], "m/V")
    canvas = Canvas(x=axis_over("threshold", [threshold_V], "V"), y=y, height=240)
    figure = Figure(
        title=f"Axis {axis.axis}: weights of the plays",
        caption=f"{count_of(len(weight), 'play')}, "
        f"{count_of(len(axis.hysteresis.dead_zones.weight) - 1, 'dead zone')}.",
        guide="Weights of neighbouring plays are correlated: each is less certain than the "
        "loading curve.",
        canvas=canvas,
        layers=(
            canvas.band("model-band", "95 % interval", threshold_V, weight - half, weight + half),
            canvas.line("model", "weight", threshold_V, weight),
            canvas.dots("odd", "plays", threshold_V, weight),
        ),
    )
    return (figure,)


def _quantities(page: Page) -> Table:
    """Return the parameters of the fit other than its weights, with one column per axis."""
    columns = []
    for axis in page.axes:
        low_V, high_V = axis.voltage_V
        lag_s = intervals_of(axis.uncertainty).get("lag_s", (axis.lag.time_s, math.nan))
        lag = with_half_width(*lag_s, "s")
        if axis.quality.is_lag_ambiguous and axis.lag.kind != "none":
            lag = "not separable from the loop width at a single speed"
        amplifier_Hz, sensor_Hz = axis.rig.amplifier_bandwidth_Hz, axis.rig.sensor_bandwidth_Hz
        column = {
            "width of the full loop": _loop_width(axis),
            "lag": lag,
            "voltage offset": number(axis.hysteresis.voltage_offset_V, "V", 4),
            "displacement offset": number(axis.hysteresis.displacement_offset_m, "m", 4),
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
