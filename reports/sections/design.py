"""The controllers: sensitivities with their templates over the family, margins, what is proven."""

import numpy as np

from piezoid.design.damping import told_of_mode
from piezoid.design.design import AxisDesign, LoopDesign, Member
from piezoid.design.lateral_task import assumptions_of
from piezoid.design.sensitivity import closed_loop_polynomial, sensitivities
from piezoid.design.templates import delay_limit
from piezoid.numerics.arrays import Array
from piezoid.numerics.frequency import Response, decibel, polynomial_response, unit_circle
from piezoid.numerics.polynomial import roots_of
from piezoid_reports.chart import Canvas, Layer, axis_over, decades_over
from piezoid_reports.held_back import held_back
from piezoid_reports.page import Figure, Fold, Heading, Listing, Page, Part, Prose, Section, Table
from piezoid_reports.quantities import MINUS, significant, told

SQUARE = 440
POINTS = 300
SEEN = {"real": np.array([-2.2, 1.2]), "imaginary": np.array([-1.7, 1.7])}
CIRCLE = np.linspace(0.0, 2.0 * np.pi, 181)
APART = np.array([np.nan])

GRID = 240
LOWEST = 300.0  # parts of the bandwidth: below, attenuation is only a straight line
NYQUIST = 0.499
FUNCTIONS = {
    "Syp": (
        "what remains of a disturbance of the output",
        "Good: the whole band below every dashed line. Bad: a peak at the modulus limit, or a "
        "band that opens at one frequency: there the plant is not well enough known.",
    ),
    "Syb": (
        "what sensor noise does to the output",
        "Good: 0 dB up to the bandwidth, then falling clear of the delay limit. Bad: a hump near "
        "the limit: a little more delay would make the loop ring.",
    ),
}
METHODS = {
    "mpi_dob": "disturbance observer on the inverse of the hysteresis",
    "dob": "disturbance observer with an affine map",
    "rst": "R, S, T on the logarithm of the current",
}


def render(page: Page) -> Section | None:
    """Return every axis' loops, or why there are none."""
    if page.design is None and not page.undesigned:
        return None
    parts: list[Part] = []
    for axis in () if page.design is None else page.design.axes:
        parts += [*_axis(axis), *_proven_of(page, axis)]
        parts += _assumed(page, axis)
    for remark in () if page.design is None else page.design.remarks:
        parts.append(Prose(text=f"Not designed: {remark}", tone="middling"))
    for name, reason in page.unshipped.items():
        parts.append(Prose(text=f"Axis {name} does not ship: {reason}", tone="bad"))
    if page.undesigned:
        what = "Not designed" if page.design is None else "Designed, but not exported"
        parts.append(Prose(text=f"{what}: {page.undesigned}", tone="middling"))
    return Section(
        anchor="design",
        title="Controllers",
        lead="Margins are computed anew from R, S and each member of the plant family, however "
        "the gains were found. The family holds what the identification leaves open.",
        parts=tuple(parts),
    )


def _axis(axis: AxisDesign) -> list[Part]:
    loop = axis.recommended
    rate = told(loop.members[0].sampling_rate_Hz, "Hz", 4)
    return [
        Heading(text=f"Axis {axis.axis}: {METHODS[loop.method]}, at {rate}"),
        _figure(axis, loop, "Syp"),
        Fold(
            summary="Sensor noise, open loop in the complex plane, poles: 3 figures",
            parts=(_figure(axis, loop, "Syb"), nyquist(axis, loop), pole_map(axis, loop)),
        ),
        *((Prose(text=mode),) if (mode := told_of_mode(loop)) else ()),
        _margins(axis, loop),
        _rejections(axis, loop),
        _loops(axis),
    ]


def _ships(page: Page, axis: AxisDesign) -> bool:
    """Tell whether the axis is among those whose own verification passed."""
    found = page.verification
    return found is not None and found.passed and axis.axis in found.methods


def _assumed(page: Page, axis: AxisDesign) -> tuple[Part, ...]:
    if axis.axis not in page.model.axes:
        return ()
    said = assumptions_of(page.model.axes[axis.axis])
    held = held_back(page, axis)
    return (
        *((Prose(text=f"No bandwidth above {held[0]} was tried: {held[1]}."),) if held else ()),
        Fold(
            summary=f"What the plant family takes for granted: {_counted(said)}",
            parts=(Listing(items=said),),
        ),
    )


def _counted(conditions: tuple[str, ...]) -> str:
    return "1 condition" if len(conditions) == 1 else f"{len(conditions)} conditions"


def _figure(axis: AxisDesign, loop: LoopDesign, function: str) -> Figure:
    """One sensitivity: its nominal line, the band of the family, the limits it had to keep."""
    rate_Hz = loop.members[0].sampling_rate_Hz
    frequency_Hz = np.geomspace(loop.bandwidth_Hz / LOWEST, NYQUIST * rate_Hz, GRID)
    level_dB = np.stack(
        [
            decibel(getattr(sensitivities(member, loop.R, loop.S, frequency_Hz), function))
            for member in loop.members
        ]
    )
    limits = _limits(axis, function, frequency_Hz)
    decades = np.log10(frequency_Hz)
    x = decades_over("frequency", [decades], "Hz")
    shown = [np.maximum(level_dB, -80.0), *(limit for _, limit in limits)]
    y = axis_over(f"|{function}| [dB]", [part.ravel() for part in shown], "")
    canvas = Canvas(x=x, y=y)
    layers: list[Layer] = [
        canvas.band(
            "model-band", "plant family", decades, shown[0].min(axis=0), shown[0].max(axis=0)
        ),
        canvas.line("model", "nominal", decades, shown[0][0]),
    ]
    layers += [canvas.line("limit", name, decades, limit) for name, limit in limits]
    what, look = FUNCTIONS[function]
    return Figure(
        title=f"Axis {axis.axis}: {what}, |{function}|",
        numbers=(
            f"{len(loop.members)} members; greatest "
            f"{_decibels(float(level_dB.max()))} at "
            f"{told(float(frequency_Hz[level_dB.max(axis=0).argmax()]), 'Hz')}. Bandwidth "
            f"{told(loop.bandwidth_Hz, 'Hz')}: every member attenuates by 3 dB there."
        ),
        look=look,
        canvas=canvas,
        layers=tuple(layers),
    )


def _decibels(level: float) -> str:
    """Return a level to a hundredth of a decibel: below, a curve is flat."""
    return f"{round(level, 2) + 0.0:.2f} dB".replace("-", MINUS)


def _limits(axis: AxisDesign, function: str, frequency_Hz: Array) -> list[tuple[str, Array]]:
    """Named limits in dB over the grid, NaN where there is none."""
    asked = axis.specification
    limits = [
        (t.name, t.limit_dB(frequency_Hz)) for t in asked.all_templates if t.function == function
    ]
    if function == "Syp":
        peak_dB = float(decibel(1.0 / asked.modulus_margin))
        limits.append(("modulus margin", np.full(len(frequency_Hz), peak_dB)))
    if function == "Syb":
        limits.append(("delay margin", decibel(delay_limit(frequency_Hz, asked.delay_margin_s))))
    return [
        (name, np.where(np.isfinite(level) & (level < 40.0), level, np.nan))
        for name, level in limits
    ]


def _margins(axis: AxisDesign, loop: LoopDesign) -> Table:
    asked = axis.specification
    return Table(
        caption=f"Axis {axis.axis}: margins of every member; asked for are a modulus margin of "
        f"{significant(asked.modulus_margin)} and a delay margin of "
        f"{told(asked.delay_margin_s, 's')}.",
        columns=("member", "modulus margin", "at", "delay margin", "largest pole"),
        rows=tuple(
            (
                m.label,
                significant(m.modulus_margin),
                told(m.modulus_Hz, "Hz"),
                "no delay destabilises it"
                if m.delay_margin_s is None
                else told(m.delay_margin_s, "s"),
                significant(m.spectral_radius, 4),
            )
            for m in loop.margins
        ),
    )


def _rejections(axis: AxisDesign, loop: LoopDesign) -> Table:
    return Table(
        caption=f"Axis {axis.axis}: what remains of a disturbance, as a share of it.",
        columns=("frequency", "nominal", "worst member", "which"),
        rows=tuple(
            (
                told(r.frequency_Hz, "Hz"),
                told(100.0 * r.nominal, "%"),
                told(100.0 * r.worst, "%"),
                r.worst_member,
            )
            for r in loop.rejections
        ),
    )


def _loops(axis: AxisDesign) -> Table:
    return Table(
        caption=f"Axis {axis.axis}: every way it was designed. Chosen within a loop is what meets "
        f"the limits with the least figure: {_figure_names(axis)}.",
        columns=("loop", "bandwidth", "way", "meets every limit", "figure", "chosen"),
        rows=tuple(
            (
                METHODS[loop.method],
                told(loop.bandwidth_Hz, "Hz"),
                candidate.name,
                "yes" if candidate.is_feasible else "no",
                _told_figure(axis, candidate.figure),
                "yes" if candidate.is_chosen else "",
            )
            for loop in axis.loops
            for candidate in loop.candidates
        ),
    )


def _figure_names(axis: AxisDesign) -> str:
    names = dict.fromkeys(one.figure_name for loop in axis.loops for one in loop.candidates)
    return "; ".join(names)


def _told_figure(axis: AxisDesign, figure: float) -> str:
    """Return what a choice minimises, a length on an axis that is controlled in metres."""
    return told(figure, "m") if axis.output_unit == "m" else significant(figure)


def _proven_of(page: Page, axis: AxisDesign) -> tuple[Part, ...]:
    """Return what is proven, or that the bound is wider than the stroke and so says nothing."""
    proven = axis.recommended.certificate
    model = page.model.axes.get(axis.axis)
    is_verified = _ships(page, axis)
    if model is None or proven is None or not (proven.is_guaranteed and is_verified):
        return _proven(axis, is_verified=is_verified)
    if proven.guaranteed_error_m <= model.quality.range_m:
        return _proven(axis, is_verified=is_verified)
    return (
        Prose(
            text=f"Small gain is {significant(proven.small_gain)}, below 1: hysteresis cannot "
            "destabilise the loop. There is no useful bound of its error: what can be proven is "
            f"wider than the whole range, {told(model.quality.range_m, 'm')}.",
            tone="middling",
        ),
    )


def _proven(axis: AxisDesign, *, is_verified: bool) -> tuple[Part, ...]:
    loop = axis.recommended
    proven = loop.certificate
    if loop.method == "rst":
        return ()  # regulates a current, behind no hysteresis that a model knows
    if proven is None:
        return (
            Prose(
                text="No bound of the hysteresis is known for this loop, so nothing is proven of "
                "it beyond the margins of its linear part.",
                tone="middling",
            ),
        )
    if not proven.is_guaranteed:
        return (
            Prose(
                text=f"Small gain is {significant(proven.small_gain)}, not below 1: that "
                "hysteresis cannot make this loop oscillate is not proven.",
                tone="bad",
            ),
        )
    if not is_verified:
        return (
            Prose(
                text=f"Small gain is {significant(proven.small_gain)}, below 1. A bound of the "
                "error is told of a loop that has passed its own verification; this one has not.",
                tone="middling",
            ),
        )
    text = (
        f"Small gain is {significant(proven.small_gain)}, below 1: hysteresis cannot destabilise "
        f"the loop. The error against the delayed reference never exceeds "
        f"{told(proven.guaranteed_error_m, 'm')}: {told(proven.hysteresis_error_m, 'm')} from "
        f"hysteresis, {told(proven.reference_error_m, 'm')} from the reference, "
        f"{told(proven.converter_error_m, 'm')} from the converter, "
        f"{told(proven.disturbance_error_m, 'm')} from what acts beside them. Sensor noise adds "
        f"{told(proven.noise_error_m, 'm')} (three standard deviations).{_against_plain(axis)}"
    )
    on = f"On these conditions: {_counted(proven.conditions)}"
    return Prose(text=text, tone="good"), Fold(
        summary=on, parts=(Listing(items=proven.conditions),)
    )


def _against_plain(axis: AxisDesign) -> str:
    """Say why the loop that ships may promise less than the plain observer, where it does."""
    own = axis.recommended.certificate
    plain = next((one.certificate for one in axis.loops if one.method == "dob"), None)
    if own is None or plain is None or axis.recommended.method == "dob":
        return ""
    if not plain.is_guaranteed or plain.guaranteed_error_m >= own.guaranteed_error_m:
        return ""
    parts = (
        ("hysteresis", "hysteresis_error_m"),
        ("the reference", "reference_error_m"),
        ("the converter", "converter_error_m"),
        ("what acts beside them", "disturbance_error_m"),
    )
    excess_m = {name: getattr(own, key) - getattr(plain, key) for name, key in parts}
    most = max(excess_m, key=lambda name: excess_m[name])
    return (
        f" The plain observer would promise less, {told(plain.guaranteed_error_m, 'm')}: most of "
        f"the difference is {told(excess_m[most], 'm')} more from {most}. A guarantee adds up the "
        "worst cases of every part, and the inverse adds parts of its own; which loop ships is "
        "chosen by its error in the verification, not by its guarantee. Where the guarantee is "
        "what counts, export the plain observer."
    )


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
