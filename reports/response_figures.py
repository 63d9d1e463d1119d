"""A measured frequency response beside the modes fitted to it: gain, phase, coherence."""

import numpy as np
from numpy.typing import NDArray

from piezoid.identification.dynamics.distortion import DistortionFound, distortion_of
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
from piezoid_reports.quantities import percent, significant, told

LOOK = (
    "Good: the odd and even lines far below the driven ones, or down at the noise. Bad: odd lines "
    "near the driven ones, which is hysteresis or saturation that a linear model of this level "
    "cannot hold; even lines above the odd ones, which is asymmetry."
)
FLOOR = 0.1  # of the noise: below, an amplitude is drawn as that


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


def distortion_parts(page: Page, axis: AxisModel) -> list[Part]:
    """Return a figure for every multisine with detection lines that drives this axis."""
    return [_figure(axis, found) for found in distortion_of(page.recordings, axis.axis)]


def _figure(axis: AxisModel, found: DistortionFound) -> Figure:
    lines = found.lines
    decades, silent = np.log10(lines.driven_Hz), np.log10(lines.frequency_Hz)
    floor_m = FLOOR * float(lines.noise_level_m()[0])
    driven_dB, silent_dB, noise_dB = (
        decibel(np.maximum(values[:, 0], floor_m))
        for values in (lines.driven_m, lines.amplitude_m, lines.noise_m)
    )
    x = decades_over("frequency", [decades, silent], "Hz")
    y = axis_over("amplitude [dB of 1 m]", [driven_dB, silent_dB, noise_dB], "")
    canvas = Canvas(x=x, y=y)
    return Figure(
        title=f"Axis {axis.axis}: driven and silent lines of {', '.join(found.recordings)}",
        numbers=_numbers(found),
        look=LOOK,
        x=x,
        y=y,
        layers=(
            canvas.line("model", "driven lines", decades, driven_dB)[0],
            canvas.line("zero", "noise", silent, _running(noise_dB))[0],
            canvas.dots("dots", "even lines, silent", *_of(lines.is_even, silent, silent_dB)),
            canvas.dots("odd", "odd lines, silent", *_of(~lines.is_even, silent, silent_dB)),
        ),
    )


def _numbers(found: DistortionFound) -> str:
    lines = found.lines
    driven_m = float(lines.driven_level_m()[0])
    return (
        f"At {told(float(lines.drive_rms_V[0]), 'V')} rms, {lines.realisations} realisations of "
        f"{lines.periods} periods; rms amplitude of one line: driven {told(driven_m, 'm')}; "
        f"{_level(found, driven_m, even=False)}; {_level(found, driven_m, even=True)}; noise "
        f"{told(float(lines.noise_level_m()[0]), 'm')} after averaging."
    )


def _level(found: DistortionFound, driven_m: float, *, even: bool) -> str:
    """One kind of distortion, or what it stays below where noise covers it."""
    name = "even distortion" if even else "odd distortion"
    level_m = float(found.lines.level_m(even=even)[0])
    limit_m = float(found.lines.limit_m(even=even)[0])
    if level_m <= limit_m:
        most_m = float(np.hypot(level_m, limit_m))
        return f"{name} below {told(most_m, 'm')}, covered by noise"
    return f"{name} {told(level_m, 'm')}, {percent(level_m / driven_m)} of that"


def _of(kept: NDArray[np.bool_], across: Array, up: Array) -> tuple[Array, Array]:
    return across[kept], up[kept]


def _running(level_dB: Array, width: int = 9) -> Array:
    """Median over neighbours: a line of noise, not a cloud."""
    padded = np.pad(level_dB, width // 2, mode="edge")
    return np.asarray(np.median(np.lib.stride_tricks.sliding_window_view(padded, width), axis=1))
