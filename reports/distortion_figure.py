"""Driven and silent lines of a multisine: the response, what bends it, and the noise."""

import numpy as np
from numpy.typing import NDArray

from piezoid.identification.dynamics.distortion import DistortionFound, distortion_of
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.numerics.frequency import decibel
from piezoid_reports.chart import Canvas, axis_over, decades_over
from piezoid_reports.page import Figure, Page, Part
from piezoid_reports.quantities import percent, told

LOOK = (
    "Good: the odd and even lines far below the driven ones, or down at the noise. Bad: odd lines "
    "near the driven ones, which is hysteresis or saturation that a linear model of this level "
    "cannot hold; even lines above the odd ones, which is asymmetry."
)
FLOOR = 0.1  # of the noise: below, an amplitude is drawn as that


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
