"""A measured frequency response beside the modes fitted to it: gain, phase, coherence."""

import numpy as np
from numpy.typing import NDArray

from piezoid.identification.dynamics.frequency_response import ComplexArray
from piezoid.identification.dynamics.modal import LinearDynamics
from piezoid.identification.dynamics.response_fit import measured_response
from piezoid.identification.dynamics.response_record import ResponseFit
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.numerics.frequency import decibel
from piezoid.records.frequency_response import LEAST_COHERENCE, FrequencyResponseRecord
from piezoid_reports.chart import Axis, Canvas, Layer, axis_over, decades_over
from piezoid_reports.page import Figure, Page, Part, Prose
from piezoid_reports.quantities import significant, told


def response_parts(
    page: Page, axis: AxisModel, dynamics: LinearDynamics, fitted: ResponseFit
) -> list[Part]:
    """Return what was said of the response, and its figures where the file was given."""
    parts: list[Part] = [Prose(text=remark) for remark in axis.dynamics_remarks[:1]]
    record = next((r for r in page.responses if r.name == fitted.name), None)
    if record is None:
        return parts
    record = record if record.axis_is_named else record.renamed(axis.axis)
    path = record.path(axis.axis, axis.axis)
    if path is None:
        return parts
    f = record.frequency_Hz
    used = path.is_coherent & ~np.isin(f, fitted.left_out_Hz)
    measured = fitted.factor * measured_response(record, axis.axis, dynamics.declared)
    model = dynamics.response(f)[:, 0, 0]
    if fitted.slow is not None:
        model = model * fitted.slow.response(f)
    x = decades_over("frequency", [np.log10(f)], "Hz")
    parts += [
        _gain(axis, fitted, record, (measured, model), used, x),
        _phase(axis, f, (measured, model), used, x),
    ]
    if path.coherence is not None:
        parts.append(_coherence(axis, f, path.coherence, used, x))
    return parts


def _gain(
    axis: AxisModel,
    fitted: ResponseFit,
    record: FrequencyResponseRecord,
    curves: tuple[ComplexArray, ComplexArray],
    used: NDArray[np.bool_],
    x: Axis,
) -> Figure:
    measured_dB, model_dB = (decibel(np.abs(curve)) for curve in curves)
    decades = np.log10(record.frequency_Hz)
    y = axis_over("gain [dB of 1 m/V]", [measured_dB, model_dB], "")
    return Figure(
        title=f"Axis {axis.axis}: gain as measured, {record.name}",
        numbers=f"{fitted.used} of {fitted.lines} lines are fitted; those without coherence and "
        "single lines of interference are grey. At its worst the model leaves "
        f"{significant(100.0 * fitted.left_relative, 2)} % of the response, at "
        f"{told(fitted.left_Hz, 'Hz')}; one line is known to "
        f"{significant(100.0 * fitted.noise_relative, 2)} % at low frequency.",
        look="Good: the model runs through the measured lines. Bad: peaks it passes by.",
        x=x,
        y=y,
        layers=_layers(Canvas(x=x, y=y), decades, measured_dB, model_dB, used),
    )


def _phase(
    axis: AxisModel,
    frequency_Hz: Array,
    curves: tuple[ComplexArray, ComplexArray],
    used: NDArray[np.bool_],
    x: Axis,
) -> Figure:
    measured, model = curves
    model_deg = np.degrees(np.unwrap(np.angle(axis.polarity * model)))
    # Each line beside the model: turns between distant lines are the model's.
    measured_deg = model_deg + np.degrees(np.angle(measured / model))
    y = axis_over("phase [degrees]", [model_deg, measured_deg], "")
    canvas = Canvas(x=x, y=y, height=260)
    return Figure(
        title=f"Axis {axis.axis}: phase as measured",
        numbers="Lines that are not fitted are grey.",
        look="Good: both fall together. Bad: they part towards high frequency, which is a delay "
        "that was not found.",
        x=x,
        y=y,
        height=canvas.height,
        layers=_layers(canvas, np.log10(frequency_Hz), measured_deg, model_deg, used),
    )


def _layers(
    canvas: Canvas, decades: Array, measured: Array, model: Array, used: NDArray[np.bool_]
) -> tuple[Layer, ...]:
    left_out = [canvas.dots("left-out", "not fitted", decades[~used], measured[~used])]
    return (
        *(left_out if not used.all() else []),
        canvas.line("measured", "measured", decades, np.where(used, measured, np.nan))[0],
        canvas.line("model", "model", decades, model)[0],
    )


def _coherence(
    axis: AxisModel, frequency_Hz: Array, coherence: Array, used: NDArray[np.bool_], x: Axis
) -> Figure:
    decades = np.log10(frequency_Hz)
    y = axis_over("coherence", [np.array([0.0, 1.0])], "")
    canvas = Canvas(x=x, y=y, height=200)
    return Figure(
        title=f"Axis {axis.axis}: coherence as measured",
        numbers=f"{int(used.sum())} of {len(decades)} lines are used; the least coherence that is "
        f"is {significant(LEAST_COHERENCE, 2)}.",
        look="Good: near 1 over the band that is fitted. Bad: holes, which are noise, "
        "interference or what is not linear.",
        x=x,
        y=y,
        height=canvas.height,
        layers=(
            canvas.line("measured", "coherence", decades, coherence)[0],
            canvas.line("limit", "least used", decades[[0, -1]], np.full(2, LEAST_COHERENCE))[0],
        ),
    )
