"""Figures of a measured frequency response with its model."""

import numpy as np
from numpy.typing import NDArray

from piezoid.identification.dynamics.modal import LinearDynamics, ResponseFit
from piezoid.identification.dynamics.response_fit import measured_response
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.numerics.polynomial import decibel
from piezoid.records.frequency_response import MIN_COHERENCE
from piezoid_reports.chart import Canvas, Layer, axis_over, decades_over
from piezoid_reports.page import Page
from piezoid_reports.parts import Figure, Part
from piezoid_reports.quantities import number, significant

KINDS = {  # label of the axis, height of the figure in pixels, guide
    "gain": (
        "gain [dB of 1 m/V]",
        Canvas.height,
        "Good: the model runs through the measured band. Bad: peaks that the model misses.",
    ),
    "phase": (
        "phase [degrees]",
        260,
        "Good: both fall together. Bad: they part at high frequency (a delay is missing).",
    ),
}


def response_parts(
    page: Page, axis: AxisModel, dynamics: LinearDynamics, fit: ResponseFit
) -> list[Part]:
    """Return gain, phase and coherence of a measured response, if its file is available."""
    parts: list[Part] = []
    record = next((r for r in page.responses if r.name == fit.name), None)
    if record is None:
        return parts
    record = record if record.axis_is_named else record.renamed(axis.axis)
    path = record.path(axis.axis, axis.axis)
    if path is None:
        return parts
    f = record.frequency_Hz
    is_used = path.is_coherent & ~np.isin(f, fit.left_out_Hz)
    measured = fit.factor * measured_response(record, axis.axis, dynamics.declared)
    model = dynamics.response(f)
    if fit.slow is not None:
        model = model * fit.slow.response(f)
    decades = np.log10(f)
    model_deg = np.degrees(np.unwrap(np.angle(axis.polarity * model)))
    # Unwrap the measured phase with the model: lines may be too far apart to unwrap it directly.
    measured_deg = model_deg + np.degrees(np.angle(measured / model))
    parts += [
        response_figure(
            "gain",
            f"Axis {axis.axis}: gain as measured, {record.name}",
            f"{fit.used} of {fit.lines} lines are fitted; largest residual "
            f"{significant(100.0 * fit.left_relative, 2)} % at {number(fit.left_Hz, 'Hz')}.",
            decades,
            (decibel(np.abs(measured)), decibel(np.abs(model))),
            is_used=is_used,
        ),
        response_figure(
            "phase",
            f"Axis {axis.axis}: phase as measured",
            "Lines outside the fit are grey.",
            decades,
            (measured_deg, model_deg),
            is_used=is_used,
        ),
    ]
    if path.coherence is not None:
        title = f"Axis {axis.axis}: coherence as measured"
        numbers = (
            f"{int(is_used.sum())} of {len(f)} lines are used; minimum coherence "
            f"{significant(MIN_COHERENCE, 2)}."
        )
        parts.append(coherence_figure(title, numbers, decades, path.coherence, MIN_COHERENCE))
    return parts


def response_figure(
    kind: str,
    title: str,
    numbers: str,
    decades: Array,
    curves: tuple[Array, Array],
    *,
    is_used: NDArray[np.bool_] | None = None,
    band: tuple[Array, Array] | None = None,
) -> Figure:
    """Draw a measured response and the model over decades of frequency.

    kind     ``gain`` or ``phase``
    curves   measured and modelled, (lines,) each
    is_used  lines that are fitted, None for all; other lines are grey dots
    band     95 % interval of the measurement
    """
    label, height, guide = KINDS[kind]
    measured, model = curves
    x = decades_over("frequency", [decades], "Hz")
    canvas = Canvas(x=x, y=axis_over(label, [*(band or curves[:1]), model], ""), height=height)
    layers: list[Layer] = []
    if band is not None:
        layers.append(canvas.band("rising-band", "measured, 95 %", decades, *band))
    if is_used is not None and not is_used.all():
        layers.append(canvas.dots("left-out", "not fitted", decades[~is_used], measured[~is_used]))
    fitted_points = measured if is_used is None else np.where(is_used, measured, np.nan)
    layers.append(canvas.line("measured", "measured", decades, fitted_points))
    layers.append(canvas.line("model", "model", decades, model))
    return Figure(
        title=title,
        caption=numbers,
        guide=guide,
        canvas=canvas,
        layers=tuple(layers),
    )


def coherence_figure(
    title: str, numbers: str, decades: Array, coherence: Array, min_coherence: float
) -> Figure:
    """Draw coherence over decades of frequency, with the minimum for the fit."""
    x = decades_over("frequency", [decades], "Hz")
    canvas = Canvas(x=x, y=axis_over("coherence", [np.array([0.0, 1.0])], ""), height=200)
    return Figure(
        title=title,
        caption=numbers,
        guide="Good: near 1 over the fitted band. Bad: holes (noise, interference, nonlinearity).",
        canvas=canvas,
        layers=(
            canvas.line("measured", "coherence", decades, coherence),
            canvas.line("limit", "minimum", decades[[0, -1]], np.full(2, min_coherence)),
        ),
    )
