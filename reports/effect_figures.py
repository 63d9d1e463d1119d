"""Figure of one finding: residuals without and with the effect, and the look-alike.

The look-alike is the residual of a healthy stage with that effect. If the model contains the
effect as an extension, the residual without the effect is the measurement minus the model without
that extension. For all other effects the tangent columns are fitted to the residual together with
the Jacobian of the model. The residual without such an effect is then the remaining residual plus
the contribution of the effect.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezoid.diagnosis.diagnosis import SOMETHING_ELSE, Diagnosis, Finding
from piezoid.diagnosis.drive_response import driven_recording, null_columns, rows_of
from piezoid.diagnosis.effect import Appearance, over_time
from piezoid.diagnosis.effects import effect_named
from piezoid.diagnosis.planning.open_questions import suspect_of
from piezoid.diagnosis.planning.separation import basis_of, block_of, scale_of
from piezoid.formatting import p_value, words
from piezoid.identification.model import AxisModel
from piezoid.identification.simulation import simulate_recording
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Channel, Quantity
from piezoid_reports.chart import Axis, Canvas, Layer, axis_over, bins_of, decades_over
from piezoid_reports.page import Trace, rms
from piezoid_reports.parts import Figure
from piezoid_reports.quantities import number, percent

ROWS = 3000  # of each recording
MIN_SHARE = 1e-6  # of the stroke: a smaller effect is not simulated
MAX_RECORDINGS = 6  # with the largest residuals

# Tangents fitted to one recording: indices of the samples, residual with every tangent fitted
# (rows,), and by effect the contribution that the parameters of the model cannot imitate (rows,)
# and the total contribution (samples,).
TangentFit = tuple[NDArray[np.int_], Array, Mapping[str, Array], Mapping[str, Array]]


@dataclass(frozen=True, kw_only=True, eq=False)
class EffectSimulation:
    """Residuals of one recording without and with an effect.

    rows         (rows,)  indices of the samples
    without_m    (rows,)  residual without the effect in the model
    with_m       (rows,)  residual with the effect in the model
    lookalike_m  (rows,)  residual of a healthy stage to which the effect and noise are added
    """

    trace: Trace
    rows: NDArray[np.int_]
    without_m: Array
    with_m: Array
    lookalike_m: Array


def compare_effects(
    axis: AxisModel, traces: Sequence[Trace], diagnosis: Diagnosis
) -> dict[str, tuple[EffectSimulation, ...]]:
    """Return by effect the residuals without and with it, largest residual first."""
    worst = traces[:MAX_RECORDINGS]
    if not worst:
        return {}
    effects = [f for f in diagnosis.findings if f.effect != SOMETHING_ELSE]
    missing = [
        f for f in effects if effect_named(f.effect).without(axis, worst[0].recording) is None
    ]
    fits = _fit_tangents(axis, worst, missing, diagnosis.stroke_m)
    comparisons = {}
    for finding in effects:
        simulations = [
            _simulate(axis, finding.effect, trace, fit)
            for trace, fit in zip(worst, fits, strict=True)
        ]
        # The look-alike gets the sign of the effect.
        correlation = 0.0
        for simulation in simulations:
            lookalike_m = simulation.lookalike_m - simulation.lookalike_m.mean()
            change_m = simulation.without_m - simulation.with_m
            correlation += float(np.nansum(change_m * lookalike_m))
        sign = -1.0 if correlation < 0.0 else 1.0
        comparisons[finding.effect] = tuple(
            replace(simulation, lookalike_m=sign * simulation.lookalike_m)
            for simulation in simulations
        )
    return comparisons


def _simulate(axis: AxisModel, name: str, trace: Trace, fit: TangentFit) -> EffectSimulation:
    rows, with_m, parts_m, totals_m = fit
    effect = effect_named(name)
    # Contribution of the extension of the model, minus its mean.
    without = effect.without(axis, trace.recording)
    extension_m = np.zeros(len(trace.time_s))
    if without is not None:
        part_m = trace.modelled_m - simulate_recording(without, trace.recording)
        extension_m = part_m - np.nanmean(part_m)
    if effect.shows.kind == "spectrum":
        rows = np.flatnonzero(np.isfinite(trace.modelled_m))
        linear_m = totals_m[name][rows] if name in totals_m else np.zeros(len(rows))
        part_m = linear_m + extension_m[rows]
        with_m = trace.residual_m[rows] - linear_m
    else:
        part_m = parts_m[name] if name in parts_m else extension_m[rows]
    # The residual of a healthy stage with this effect of this size.
    measured_m = trace.recording.displacement_m(axis.axis)
    healthy_m = np.where(np.isfinite(trace.modelled_m), trace.modelled_m, measured_m)
    channels = tuple(
        Channel(quantity=c.quantity, axis=c.axis, values=healthy_m, label=c.label)
        if c.quantity is Quantity.DISPLACEMENT and c.axis == axis.axis
        else c
        for c in trace.recording.channels
    )
    healthy = replace(trace.recording, channels=channels, axis=axis.axis)
    share = rms(part_m) / max(float(np.ptp(healthy_m)), 1e-30)
    faulty_m = healthy_m
    if share > MIN_SHARE:
        faulty_m = effect.inject(healthy, share).displacement_m(axis.axis)
    count = min(len(faulty_m), len(healthy_m))
    change_m = np.zeros(len(healthy_m))
    change_m[:count] = faulty_m[:count] - healthy_m[:count]
    noise = np.random.default_rng(len(healthy_m)).standard_normal(len(healthy_m))
    lookalike_m = change_m - change_m.mean() + axis.quality.noise_rms_m * noise
    return EffectSimulation(
        trace=trace,
        rows=rows,
        without_m=with_m + part_m,
        with_m=with_m,
        lookalike_m=lookalike_m[rows],
    )


def _fit_tangents(
    axis: AxisModel, traces: Sequence[Trace], missing: Sequence[Finding], stroke_m: float
) -> list[TangentFit]:
    """Fit the tangents of all effects that the model lacks to its residual in each recording."""
    finite = [np.flatnonzero(np.isfinite(trace.modelled_m)) for trace in traces]
    rows = [np.asarray(samples[rows_of(len(samples), ROWS)]) for samples in finite]
    residuals_m = [trace.residual_m[k] for trace, k in zip(traces, rows, strict=True)]
    suspects = [(f, suspect_of(f, stroke_m)) for f in missing]
    pairs = [(f, suspect) for f, suspect in suspects if suspect is not None]
    if not pairs:
        return [(k, residual_m, {}, {}) for k, residual_m in zip(rows, residuals_m, strict=True)]
    drives = [
        replace(driven_recording(axis, trace.recording), selected_rows=k)
        for trace, k in zip(traces, rows, strict=True)
    ]
    null = basis_of(
        null_columns(drives, lag=not any(suspect.tangent.lags for _, suspect in pairs))
    )
    scales = [scale_of(suspect, drives) for _, suspect in pairs]
    blocks = [
        block_of(suspect.tangent, scale, drives)
        for (_, suspect), scale in zip(pairs, scales, strict=True)
    ]
    free = [block - null @ (null.T @ block) for block in blocks]
    residual_m = np.concatenate(residuals_m)
    residual_m = residual_m - null @ (null.T @ residual_m)
    columns = np.hstack(free)
    size = np.maximum(np.linalg.norm(columns, axis=0), 1e-30)
    strength = np.linalg.lstsq(columns / size, residual_m, rcond=1e-9)[0] / size
    shares = np.split(strength, np.cumsum([block.shape[1] for block in free])[:-1])
    totals = [block @ share for block, share in zip(free, shares, strict=True)]
    cuts = np.cumsum([len(k) for k in rows])[:-1]
    remaining_m = np.split(residual_m - np.sum(totals, axis=0), cuts)
    split = [np.split(total, cuts) for total in totals]
    fits: list[TangentFit] = []
    for k, drive in enumerate(drives):
        totals_m = {}
        for (f, suspect), scale, share in zip(pairs, scales, shares, strict=True):
            columns = suspect.tangent.columns(drive, scale)
            width = columns.shape[1]
            start = k * width if suspect.tangent.per_drive else 0
            totals_m[f.effect] = np.asarray(columns @ share[start : start + width])
        parts_m = {f.effect: part[k] for (f, _), part in zip(pairs, split, strict=True)}
        fits.append((rows[k], remaining_m[k], parts_m, totals_m))
    return fits


LOG_COORDINATES = ("time_since_turn",)
PHASE_LABEL = "part of a period"

CLASSES = 48
MIN_ROWS = 12  # in a class
MIN_DECADES = 1.5  # fewer decades show no law
BANDS = 160  # of a spectrum, evenly spaced over the decades
MIN_CHANGE = 1e-3  # of the residual: a smaller change is not visible
HEIGHT = 280


Drawing = tuple[Canvas, tuple[Layer, ...]]


def figure_of(finding: Finding, simulations: tuple[EffectSimulation, ...]) -> Figure | None:
    """Draw the residual without and with an effect; None if no recording shows a difference."""
    effect = effect_named(finding.effect)
    appearance, is_fault = effect.shows, effect.fault is not None
    is_visible = any(not np.array_equal(s.without_m, s.with_m) for s in simulations)
    if not simulations or not (is_visible or is_fault):
        return None
    clearest = max(simulations, key=lambda s: rms(s.without_m) - rms(s.with_m))
    drawing: Drawing | None = None
    plotted: tuple[EffectSimulation, ...] = (clearest,)
    without_m, with_m = rms(clearest.without_m), rms(clearest.with_m)
    if appearance.kind == "spectrum":
        # The rows that the fit leaves out may contain the resonance.
        if abs(without_m - with_m) > MIN_CHANGE * without_m:
            drawing = _spectrum(appearance, clearest)
        if drawing is None:
            return None
    elif appearance.kind != "time":
        coordinate, residuals_m = _residuals_along(appearance, simulations)
        drawing = _in_classes(appearance, coordinate, residuals_m)
        if drawing is not None:
            plotted, is_finite = simulations, np.isfinite(coordinate)
            without_m, with_m = (rms(residual_m[is_finite]) for residual_m in residuals_m[:2])
    if drawing is None:
        appearance = appearance if appearance.kind == "time" else over_time(appearance)
        coordinate, residuals_m = _residuals_along(appearance, plotted)
        drawing = _over_time(appearance, coordinate, residuals_m)
        without_m, with_m = (rms(residual_m) for residual_m in residuals_m[:2])
    canvas, layers = drawing
    name = plotted[0].trace.recording.name
    recordings = name if len(plotted) == 1 else f"{len(plotted)} recordings"
    return Figure(
        title=f"{words(finding.effect).capitalize()}, {recordings}: "
        f"residual against {appearance.label}",
        caption=f"Residual of the samples drawn: {number(with_m, 'm')} rms with the final model, "
        f"{number(without_m, 'm')} after removal of the effect without a new fit.",
        guide=appearance.reading,
        canvas=canvas,
        layers=layers,
    )


def _residuals_along(
    appearance: Appearance, simulations: Sequence[EffectSimulation]
) -> tuple[Array, list[Array]]:
    """Return coordinate and residuals of all samples: without the effect, with it, look-alike."""
    along = [appearance.along(simulation.trace.recording) for simulation in simulations]
    rows = [simulation.rows for simulation in simulations]
    coordinate, sign = (
        np.concatenate([values[k] for values, k in zip(part, rows, strict=True)])
        for part in zip(*along, strict=True)
    )
    residuals_m = [
        sign * np.concatenate([getattr(simulation, name) for simulation in simulations])
        for name in ("without_m", "with_m", "lookalike_m")
    ]
    return coordinate, residuals_m


def _axis(appearance: Appearance, coordinate: Array) -> Axis:
    make_axis = decades_over if appearance.decades else axis_over
    return make_axis(appearance.label, [coordinate], appearance.unit)


def _over_time(appearance: Appearance, coordinate: Array, residuals_m: list[Array]) -> Drawing:
    y = axis_over("residual", residuals_m, "m", symmetric=True)
    canvas = Canvas(x=_axis(appearance, coordinate), y=y, height=HEIGHT)
    without, with_effect, lookalike = residuals_m
    # A running mean shows slow changes under the noise.
    width = max(len(lookalike) // 150, 1)
    padded = np.pad(lookalike, (width // 2, width - 1 - width // 2), mode="edge")
    slow = np.convolve(padded, np.full(width, 1.0 / width), mode="valid")
    return canvas, (
        canvas.range_over_time("before", "without it", coordinate, without),
        canvas.range_over_time("model", "with it", coordinate, with_effect),
        canvas.line("limit", "look-alike", coordinate, slow),
    )


def _in_classes(
    appearance: Appearance, coordinate: Array, residuals_m: list[Array]
) -> Drawing | None:
    classes = [_classes(coordinate, values) for values in residuals_m]
    if any(len(curve) < 2 for curve in classes):
        return None
    if appearance.decades and np.ptp(classes[0][:, 0]) < MIN_DECADES:
        return None
    without, with_effect, lookalike = classes
    curves = [without[:, 1:], with_effect[:, 1:], lookalike[:, 2]]
    y = axis_over("residual", curves, "m", symmetric=True)
    canvas = Canvas(x=_axis(appearance, coordinate), y=y, height=HEIGHT)
    return canvas, (
        *canvas.quantiles("rising", "without it", "middle half", without),
        *canvas.quantiles("falling", "with it", "middle half", with_effect),
        canvas.line("limit", "look-alike: median", lookalike[:, 0], lookalike[:, 2]),
    )


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
    """Draw the largest amplitude density in each band; None for less than two bands."""
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
    return canvas, tuple(
        canvas.line(role, name, c[:, 0], c[:, 1])
        for (role, name), c in zip(roles, curves, strict=True)
    )


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
