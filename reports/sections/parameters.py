"""The parameters with their intervals, limits and bounds."""

from collections.abc import Mapping
from itertools import pairwise

import numpy as np

from piezoid.identification.model import AxisModel
from piezoid.identification.quality import Uncertainty
from piezoid.numerics.robust import student_quantile
from piezoid_reports.page import Page, Part, Prose, Section, Table, axis_heading
from piezoid_reports.quantities import MINUS, told, told_between

EDGE = 0.97  # of half the drive's range: a play this wide moves for a moment only
Known = Mapping[str, tuple[float, float]]


def render(page: Page) -> Section:
    """Return tables of plays, dead zones and the rest for every axis."""
    parts: list[Part] = []
    for axis in page.axes:
        known = known_of(axis.uncertainty)
        parts += [
            axis_heading(axis),
            *_functions(axis),
            _plays(axis, known),
            _dead_zones(axis, known),
            *_envelope(axis, known),
            _rest(axis, known),
        ]
    return Section(
        anchor="parameters",
        title="Parameters",
        lead="Intervals are 95 %, from refits that leave out one block of cycles each, with "
        "Student's quantile. Neighbouring plays share their weight: single weights are known less "
        "well than the loading curve they add up to.",
        parts=tuple(parts),
    )


def known_of(found: Uncertainty) -> Known:
    """Return value and half interval of every parameter by name."""
    quantile = float(student_quantile(0.975, max(found.blocks - 1, 1)))
    half = quantile * np.sqrt(np.maximum(np.diag(found.covariance), 0.0))
    return {
        name: (float(value), float(spread))
        for name, value, spread in zip(found.names, found.values, half, strict=True)
    }


def _functions(axis: AxisModel) -> tuple[Part, ...]:
    if axis.minor_loops is None:
        return ()
    operator = axis.minor_loops.operator
    blocks = len(axis.minor_loops.without_m)
    text = (
        f"Axis {axis.axis} is simulated and inverted by plays behind functions; the plays with "
        "dead zones further below are what the diagnosis compares with."
    )
    return (
        Prose(text=text),
        Table(
            caption=f"Axis {axis.axis}: what the functions rise from edge to edge, with edges of "
            f"the drive about {told(operator.voltage_offset_V, 'V', 4)}, and the spread over "
            f"{blocks} fits without one block of time each.",
            columns=(
                "play",
                "half-width",
                *(
                    f"{told(low, 'V', 3)} to {told(high, 'V', 3)}"
                    for low, high in pairwise(operator.edge_V.tolist())
                ),
            ),
            rows=tuple(
                (
                    str(i),
                    told(float(operator.threshold_V[i]), "V", 4),
                    *(
                        told_between(float(rise_m), float(half_m), "m")
                        for rise_m, half_m in zip(operator.rise_m[i], halves_m, strict=True)
                    ),
                )
                for i, halves_m in enumerate(axis.minor_loops.half_m)
            ),
        ),
    )


def _plays(axis: AxisModel, known: Known) -> Table:
    plays, limits = axis.hysteresis.plays, axis.uncertainty.upper_limit
    return Table(
        caption=f"Axis {axis.axis}: play operators. Play 0 is the elastic part, without memory.",
        columns=("play", "threshold", "weight", "remark"),
        rows=tuple(
            (
                str(i),
                _shown(f"play_threshold_V[{i}]", float(plays.threshold[i]), known, "V"),
                _shown(f"play_weight_m_per_V[{i}]", float(plays.weight[i]), known, "m/V"),
                _on_play(axis, i, known, limits),
            )
            for i in range(len(plays.weight))
        ),
    )


def _dead_zones(axis: AxisModel, known: Known) -> Table:
    zones = axis.hysteresis.dead_zones
    return Table(
        caption=f"Axis {axis.axis}: dead zones, in the gauge where the one at 0 has weight 1.",
        columns=("dead zone", "threshold", "weight", "remark"),
        rows=tuple(
            (
                str(j),
                _shown(f"dead_zone_threshold_m[{j}]", float(zones.threshold[j]), known, "m"),
                _shown(f"dead_zone_weight[{j}]", float(zones.weight[j]), known, ""),
                "by the gauge" if j == zones.zero else _sign_of(f"dead_zone_weight[{j}]", known),
            )
            for j in range(len(zones.weight))
        ),
    )


def _envelope(axis: AxisModel, known: Known) -> tuple[Table, ...]:
    envelope = axis.hysteresis.envelope
    if len(envelope.threshold) == 1:
        return ()
    return (
        Table(
            caption=f"Axis {axis.axis}: envelope of the drive in front of the plays, piecewise "
            "linear; it keeps the range of the drive.",
            columns=("bend", "kink, from the voltage offset", "weight", "remark"),
            rows=tuple(
                (
                    str(j),
                    told(float(envelope.threshold[j]), "V", 4),
                    _shown(f"envelope_weight[{j}]", float(envelope.weight[j]), known, ""),
                    _sign_of(f"envelope_weight[{j}]", known),
                )
                for j in range(len(envelope.threshold))
            ),
        ),
    )


def _rest(axis: AxisModel, known: Known) -> Table:
    width_m, half_m = axis.uncertainty.loop_width_m
    low_V, high_V = axis.voltage_V
    rows = [
        ("width of the full loop", told_between(width_m, half_m, "m"), ""),
        ("lag", *_lag(axis, known)),
        ("voltage offset", told(axis.hysteresis.voltage_offset_V, "V", 4), "middle of the drive"),
        (
            "displacement offset",
            told(axis.hysteresis.displacement_offset_m, "m", 4),
            "mean zero of the recordings",
        ),
        ("valid drive", f"{told(low_V, 'V')} to {told(high_V, 'V')}", "outside it extrapolates"),
        (
            "polarity",
            "+1" if axis.polarity > 0 else f"{MINUS}1",
            "rises with the drive" if axis.polarity > 0 else "falls as the drive rises",
        ),
    ]
    rig = (
        ("amplifier bandwidth", axis.rig.amplifier_bandwidth_Hz),
        ("sensor bandwidth", axis.rig.sensor_bandwidth_Hz),
    )
    rows += [(name, told(value, "Hz"), "declared") for name, value in rig if value is not None]
    return Table(
        caption=f"Axis {axis.axis}: everything else.",
        columns=("quantity", "value", "remark"),
        rows=tuple(rows),
    )


def _shown(name: str, value: float, known: Known, unit: str) -> str:
    if name not in known:
        return told(value, unit, 4)
    return told_between(value, known[name][1], unit)


def _on_play(axis: AxisModel, i: int, known: Known, limits: Mapping[str, float]) -> str:
    name = f"play_weight_m_per_V[{i}]"
    reach_V = (axis.voltage_V[1] - axis.voltage_V[0]) / 2
    if name in limits:
        return f"on its bound 0; below {told(limits[name], 'm/V')} (95 %)"
    if axis.hysteresis.plays.threshold[i] >= EDGE * reach_V:
        return "hardly moved by this drive"
    return _sign_of(name, known)


def _sign_of(name: str, known: Known) -> str:
    value, half = known.get(name, (0.0, 0.0))
    return "interval holds 0" if half > 0.0 and abs(value) <= half else ""


def _lag(axis: AxisModel, known: Known) -> tuple[str, str]:
    if axis.quality.lag_is_open and axis.lag.kind != "none":
        return "not told", "a width of the loop or a lag: the rate was never varied"
    return _shown("lag_s", axis.lag.time_s, known, "s"), _on_lag(axis)


def _on_lag(axis: AxisModel) -> str:
    if axis.lag.kind == "none":
        return "none fitted"
    if axis.lag.time_s <= 0.0:
        return "on its bound 0"
    return axis.lag.kind.replace("_", "-")
