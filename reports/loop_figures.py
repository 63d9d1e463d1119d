"""Figures of one loop in the complex plane: the Nyquist curve and the poles."""

import numpy as np

from piezoid.design.design import AxisDesign, LoopDesign, Member
from piezoid.design.sensitivity import closed_loop_polynomial
from piezoid.numerics.arrays import Array
from piezoid.numerics.frequency import Response, polynomial_response, unit_circle
from piezoid.numerics.polynomial import roots_of
from piezoid_reports.chart import Canvas, Layer, axis_over
from piezoid_reports.page import Figure
from piezoid_reports.quantities import significant

SQUARE = 440
POINTS = 300
LOWEST = 300.0  # parts of the bandwidth where the curve begins, far outside the figure
NYQUIST = 0.499
SEEN = {"real": np.array([-2.2, 1.2]), "imaginary": np.array([-1.7, 1.7])}
CIRCLE = np.linspace(0.0, 2.0 * np.pi, 181)
APART = np.array([np.nan])


def nyquist(axis: AxisDesign, loop: LoopDesign) -> Figure:
    """Draw B R / (A S) of the family, and the circle of the modulus margin around -1."""
    x, y = (axis_over(name, [seen], "") for name, seen in SEEN.items())
    canvas = Canvas(x=x, y=y, width=SQUARE, height=SQUARE)
    rate_Hz = loop.members[0].sampling_rate_Hz
    highest_Hz = NYQUIST * rate_Hz
    frequency_Hz = np.union1d(
        np.geomspace(loop.bandwidth_Hz / LOWEST, highest_Hz, POINTS),
        np.linspace(loop.bandwidth_Hz, highest_Hz, POINTS),
    )
    curves = [_open_loop(member, loop, frequency_Hz) for member in loop.members]
    margin = axis.specification.modulus_margin
    others = [np.concatenate([curve, APART]) for curve in curves[1:]]
    layers: list[Layer] = [
        *(
            [canvas.line("before", "other members", *_inside(np.concatenate(others)))]
            if others
            else []
        ),
        canvas.line("model", "nominal", *_inside(curves[0])),
        _ring(canvas, "limit", "asked modulus margin", margin),
        canvas.dots("odd", "the point -1", np.array([-1.0]), np.array([0.0])),
    ]
    nearest = min(float(np.abs(1.0 + curve).min()) for curve in curves)
    return Figure(
        title=f"Axis {axis.axis}: the open loop in the complex plane",
        numbers=f"Nearest to the point -1 any of the {len(curves)} members comes is "
        f"{significant(nearest)}; asked for is {significant(margin)}.",
        look="Good: every curve stays outside the dashed circle and leaves -1 on its left. Bad: a "
        "curve that cuts the circle; one that goes round -1 is an unstable loop.",
        canvas=canvas,
        layers=tuple(layers),
    )


def pole_map(axis: AxisDesign, loop: LoopDesign) -> Figure:
    """Draw the closed-loop poles of every member inside the unit circle."""
    ends = np.array([-1.05, 1.05])
    x, y = axis_over("real", [ends], ""), axis_over("imaginary", [ends], "")
    canvas = Canvas(x=x, y=y, width=SQUARE, height=SQUARE)
    poles = [roots_of(closed_loop_polynomial(m, loop.R, loop.S)) for m in loop.members]
    others = np.concatenate([np.zeros(0), *poles[1:]])
    layers: list[Layer] = [
        canvas.line("limit", "unit circle", np.cos(CIRCLE), np.sin(CIRCLE)),
        canvas.dots("dots", "other members", others.real, others.imag),
        canvas.dots("odd", "nominal", poles[0].real, poles[0].imag),
    ]
    largest = max(float(np.abs(found).max()) for found in poles)
    return Figure(
        title=f"Axis {axis.axis}: poles of the closed loop in the z plane",
        numbers=f"{len(poles[0])} poles of each of {len(poles)} members; the largest magnitude is "
        f"{significant(largest, 4)}.",
        look="Good: all inside the circle, and the members close together. Bad: poles that wander "
        "towards the circle for some member: that plant decays slowly, or rings.",
        canvas=canvas,
        layers=tuple(layers),
    )


def _open_loop(member: Member, loop: LoopDesign, frequency_Hz: Array) -> Response:
    q = unit_circle(frequency_Hz, member.sampling_rate_Hz)
    B, R = polynomial_response(member.B, q), polynomial_response(loop.R, q)
    A, S = polynomial_response(member.A, q), polynomial_response(loop.S, q)
    return B * R / (A * S)


def _inside(curve: Response) -> tuple[Array, Array]:
    """Return real and imaginary part, NaN far outside the figure."""
    near = np.abs(curve + 1.0) < 4.0
    return np.where(near, curve.real, np.nan), np.where(near, curve.imag, np.nan)


def _ring(canvas: Canvas, role: str, name: str, radius: float) -> Layer:
    x, y = -1.0 + radius * np.cos(CIRCLE), radius * np.sin(CIRCLE)
    return canvas.line(role, name, x, y)
