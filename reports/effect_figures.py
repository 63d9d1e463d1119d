"""Figure of one finding: residual without and with the effect, and the look-alike."""

import numpy as np

from piezoid.diagnosis.diagnosis import Finding
from piezoid.diagnosis.effect import Appearance, over_time
from piezoid.diagnosis.effects import effect_named
from piezoid.formatting import p_value, words
from piezoid.numerics.arrays import Array
from piezoid_reports.chart import Axis, Canvas, Layer, axis_over, bins_of, decades_over
from piezoid_reports.effect_comparison import EffectSimulation
from piezoid_reports.page import rms
from piezoid_reports.parts import Figure
from piezoid_reports.quantities import number, percent

LOG_COORDINATES = ("time_since_turn",)
PHASE_LABEL = "part of a period"

CLASSES = 48
MIN_ROWS = 12  # in a class
BANDS = 160  # of a spectrum, evenly spaced over the decades
MIN_CHANGE = 1e-3  # of the residual: a smaller change is not visible
HEIGHT = 280


# Canvas, layers, name of the recording, and rms error without and with the effect.
Drawing = tuple[Canvas, tuple[Layer, ...], str, float, float]


def figure_of(finding: Finding, simulations: tuple[EffectSimulation, ...]) -> Figure | None:
    """Draw the residual without and with an effect; None if no recording shows a difference."""
    effect = effect_named(finding.effect)
    appearance, is_fault = effect.shows, effect.fault is not None
    is_visible = any(not np.array_equal(s.without_m, s.with_m) for s in simulations)
    if not simulations or not (is_visible or is_fault):
        return None
    clearest = max(simulations, key=lambda s: rms(s.without_m) - rms(s.with_m))
    drawing = None
    if appearance.kind == "spectrum":
        drawing = _spectrum(appearance, clearest)
        if drawing is None:
            return None
    elif appearance.kind != "time":
        drawing = _in_classes(appearance, simulations)
    if drawing is None:
        appearance = appearance if appearance.kind == "time" else over_time(appearance)
        drawing = _over_time(appearance, clearest)
    canvas, layers, recording, without_m, with_m = drawing
    return Figure(
        title=f"{words(finding.effect).capitalize()}, {recording}: "
        f"residual against {appearance.label}",
        caption=f"Residual, nothing refitted: {number(without_m, 'm')} rms without the effect, "
        f"{number(with_m, 'm')} with it.",
        guide=appearance.reading,
        canvas=canvas,
        layers=layers,
    )


def _axis(appearance: Appearance, coordinate: Array) -> Axis:
    make_axis = decades_over if appearance.decades else axis_over
    return make_axis(appearance.label, [coordinate], appearance.unit)


def _over_time(appearance: Appearance, simulation: EffectSimulation) -> Drawing:
    coordinate, sign = (
        values[simulation.rows] for values in appearance.along(simulation.trace.recording)
    )
    residuals_m = (simulation.without_m, simulation.with_m, simulation.lookalike_m)
    curves = [sign * residual_m for residual_m in residuals_m]
    y = axis_over("residual", curves, "m", symmetric=True)
    canvas = Canvas(x=_axis(appearance, coordinate), y=y, height=HEIGHT)
    without, with_effect, lookalike = curves
    # A running mean shows slow changes under the noise.
    width = max(len(lookalike) // 150, 1)
    padded = np.pad(lookalike, (width // 2, width - 1 - width // 2), mode="edge")
    slow = np.convolve(padded, np.full(width, 1.0 / width), mode="valid")
    layers = (
        canvas.range_over_time("before", "without it", coordinate, without),
        canvas.range_over_time("model", "with it", coordinate, with_effect),
        canvas.line("limit", "look-alike", coordinate, slow),
    )
    return canvas, layers, simulation.trace.recording.name, rms(without), rms(with_effect)


def _in_classes(
    appearance: Appearance, simulations: tuple[EffectSimulation, ...]
) -> Drawing | None:
    coordinates, signs = zip(
        *(appearance.along(simulation.trace.recording) for simulation in simulations), strict=True
    )
    rows = [simulation.rows for simulation in simulations]
    coordinate = np.concatenate([c[k] for c, k in zip(coordinates, rows, strict=True)])
    sign = np.concatenate([s[k] for s, k in zip(signs, rows, strict=True)])
    without, with_effect, lookalike = (
        sign * np.concatenate([getattr(simulation, name) for simulation in simulations])
        for name in ("without_m", "with_m", "lookalike_m")
    )
    classes = [_classes(coordinate, values) for values in (without, with_effect, lookalike)]
    if any(len(curve) < 2 for curve in classes):
        return None
    y = axis_over(
        "residual", [classes[0][:, 1:], classes[1][:, 1:], classes[2][:, 2]], "m", symmetric=True
    )
    canvas = Canvas(x=_axis(appearance, coordinate), y=y, height=HEIGHT)
    layers: list[Layer] = []
    layers += canvas.quantiles("rising", "without it", "middle half", classes[0])
    layers += canvas.quantiles("falling", "with it", "middle half", classes[1])
    layers.append(canvas.line("limit", "look-alike: median", classes[2][:, 0], classes[2][:, 2]))
    name = simulations[0].trace.recording.name
    if len(simulations) > 1:
        name = f"{len(simulations)} recordings"
    is_finite = np.isfinite(coordinate)
    return canvas, tuple(layers), name, rms(without[is_finite]), rms(with_effect[is_finite])


def _classes(coordinate: Array, values: Array) -> Array:
    """Return median coordinate and quartiles by class; edges: equal counts and equal widths."""
    is_finite = np.isfinite(coordinate) & np.isfinite(values)
    coordinate, values = coordinate[is_finite], values[is_finite]
    if len(coordinate) < 4 * MIN_ROWS:
        return np.zeros((0, 4))
    share = np.linspace(0.0, 1.0, CLASSES // 2 + 1)
    equal_width = coordinate.min() + share * np.ptp(coordinate)
    edges = np.unique(np.concatenate([np.quantile(coordinate, share), equal_width]))
    rows = [
        [float(np.median(coordinate[k])), *np.quantile(values[k], [0.25, 0.5, 0.75]).tolist()]
        for _, k in bins_of(coordinate, edges, MIN_ROWS)
    ]
    return np.array(rows).reshape(-1, 4)


def _spectrum(appearance: Appearance, simulation: EffectSimulation) -> Drawing | None:
    """Draw the largest amplitude density in each band; None if the effect does not show."""
    without_m, with_m = rms(simulation.without_m), rms(simulation.with_m)
    # The rows that the fit leaves out may contain the resonance.
    if abs(without_m - with_m) <= MIN_CHANGE * without_m:
        return None
    rate_Hz = simulation.trace.recording.sampling_rate_Hz
    curves = []
    for values in (simulation.without_m, simulation.with_m, simulation.lookalike_m):
        window = np.hanning(len(values))
        spectrum = np.fft.rfft((values - values.mean()) * window)
        density = np.abs(spectrum) * np.sqrt(2.0 / (rate_Hz * np.sum(window**2)))
        decades = np.log10(np.fft.rfftfreq(len(values), 1.0 / rate_Hz)[1:])
        edges = np.linspace(decades[0], decades[-1], BANDS + 1)
        level = np.log10(np.maximum(density[1:], 1e-15) / 1e-9)
        rows = [
            [float(np.mean(decades[k])), float(level[k].max())]
            for _, k in bins_of(decades, edges, 1)
        ]
        curves.append(np.array(rows).reshape(-1, 2))
    if len(curves[0]) < 2:
        return None
    y = decades_over("amplitude density", [c[:, 1] for c in curves], "nm/√Hz")
    canvas = Canvas(x=_axis(appearance, curves[0][:, 0]), y=y, height=HEIGHT)
    roles = (("before", "without it"), ("model", "with it"), ("limit", "look-alike"))
    layers = tuple(
        canvas.line(role, name, c[:, 0], c[:, 1])
        for (role, name), c in zip(roles, curves, strict=True)
    )
    return canvas, layers, simulation.trace.recording.name, without_m, with_m


def unnamed_figure(finding: Finding) -> Figure | None:
    """Draw an unexplained residual in classes of its coordinate, with the fitted curve."""
    classes = finding.seen
    if classes is None or len(classes.place) < 2:
        return None
    label = PHASE_LABEL if not classes.unit else words(finding.coordinate)
    coordinate = np.array(classes.place)
    quartiles_m = np.array((classes.low_m, classes.median_m, classes.high_m))
    fitted_m = np.array(classes.fitted_m)
    if finding.coordinate in LOG_COORDINATES:
        coordinate = np.log10(np.maximum(coordinate, 1e-9))
        x = decades_over(label, [coordinate], classes.unit)
    else:
        x = axis_over(label, [coordinate], classes.unit)
    y = axis_over("residual", [quartiles_m[0], quartiles_m[2], fitted_m], "m")
    canvas = Canvas(x=x, y=y, height=HEIGHT)
    bins = np.column_stack((coordinate, *quartiles_m))
    against = words(finding.coordinate)
    if classes.recording:
        against = f"time, in {classes.recording}"
    elif finding.parameters:
        name, value = next(iter(finding.parameters.items()))
        quantity, _, unit = name.rpartition("_")
        against = f"the {PHASE_LABEL} ({quantity} {number(value, unit)})"
    explained = f"{percent(finding.share)} of the stroke"
    if finding.size.unit.startswith("nm"):
        explained = f"{number(finding.size.value * 1e-9, 'm')} rms, {explained}"
    else:
        explained += ", rms"
    return Figure(
        title=f"{words(finding.effect).capitalize()}: residual against {against}",
        caption=f"The curve explains {explained}; p {p_value(finding.p_value)}.",
        guide="Residual in classes of the coordinate: median and middle half. The curve is fitted "
        "to other parts of the recordings; if it follows the median, the residual depends on the "
        "coordinate.",
        canvas=canvas,
        layers=(
            *canvas.quantiles("rising", "residual", "middle half", bins),
            canvas.line("limit", "fitted curve", coordinate, fitted_m),
        ),
    )
