"""Controllers: margins, sensitivities over the plant family, and guaranteed errors."""

import numpy as np

from piezoid.design.certificate import error_parts_m, guaranteed_error_m, useful_bound_m
from piezoid.design.design import AxisDesign, LoopDesign
from piezoid.design.lateral import describe_mode
from piezoid.design.lateral_task import assumptions_of
from piezoid.design.sensitivity import delay_limit, sensitivities
from piezoid.formatting import count_of
from piezoid.numerics.polynomial import decibel
from piezoid.runtime.schema import METHOD_NAMES
from piezoid_reports.chart import Canvas, Layer, axis_over, decades_over
from piezoid_reports.page import Page, SPIRAL_Hz, spiral_error_m
from piezoid_reports.parts import (
    Figure,
    Heading,
    Part,
    Prose,
    Section,
    Table,
    folded,
    folded_listing,
)
from piezoid_reports.quantities import MINUS, number, significant

GRID = 240  # frequencies
LOWEST_DIVISOR = 300.0  # of the bandwidth; below, the sensitivity is a straight line
MINUS_3_dB = -3.0  # of |Syp|, up to which a loop attenuates disturbances
NYQUIST = 0.499  # of the sampling rate
FUNCTIONS = {
    "Syp": (
        "output sensitivity",
        "Good: the whole band below every dashed line. Bad: a band that widens at one frequency, "
        "where the plant is uncertain.",
    ),
    "Syb": (
        "noise sensitivity",
        "Good: 0 dB up to the bandwidth, then falling. Bad: a hump near the delay limit.",
    ),
}


def render(page: Page) -> Section | None:
    """Return a table of all loops and the sensitivities of each axis."""
    if page.design is None:
        return None
    parts: list[Part] = [loops_table(page)]
    conditions: list[str] = []  # of guaranteed errors and plant families
    is_named = len(page.axis_designs) > 1
    for axis in page.axis_designs:
        loop = axis.recommended
        parts += [Heading(text=f"Axis {axis.axis}"), *recommendation(page, axis)]
        parts.append(_figure(axis, loop, "Syp"))
        parts += folded("Noise sensitivity: 1 figure", [_figure(axis, loop, "Syb")])
        mode = describe_mode(loop)
        parts += [Prose(text=mode)] if mode else []
        model, certificate = page.model.axes.get(axis.axis), loop.certificate
        if model is None:
            continue
        prefix = f"axis {axis.axis}: " if is_named else ""
        is_useful = page.ships(axis.axis) and useful_bound_m(certificate, model) is not None
        if certificate is not None and is_useful:
            sizes_m = {name: m for name, m in error_parts_m(certificate).items() if m > 0.0}
            terms = ", ".join(f"{number(m, 'm')} from {name}" for name, m in sizes_m.items())
            text = (
                f"Axis {axis.axis}: guaranteed error "
                f"{number(certificate.guaranteed_error_m, 'm')} ({terms}); small gain "
                f"{significant(certificate.small_gain)} (below 1: the loop is stable for every "
                "hysteresis within the conditions); sensor noise adds "
                f"{number(certificate.noise_error_m, 'm')} (three standard deviations)."
            )
            parts.append(Prose(text=text))
            conditions += [f"{prefix}{condition}" for condition in certificate.conditions]
        conditions += [f"{prefix}{assumption}" for assumption in assumptions_of(model)]
    parts += folded_listing("Conditions of margins and guarantees", dict.fromkeys(conditions))
    return Section(
        anchor="controllers",
        title="Controllers",
        lead="Margins and guaranteed errors hold for the plant family: all plants that are "
        "consistent with the recordings. Syp is the response of the displacement to a disturbance "
        "of it, Syb to the noise of the sensor, both with feedback.",
        parts=tuple(parts),
    )


def recommendation(page: Page, axis: AxisDesign) -> list[Part]:
    """Return why the recommended loop ships although another has a smaller guaranteed error."""
    model, first = page.model.axes.get(axis.axis), axis.recommended
    if model is None:
        return []
    bound_m, error_m = useful_bound_m(first.certificate, model), spiral_error_m(page, first.method)
    bounds_m = {loop.method: useful_bound_m(loop.certificate, model) for loop in axis.loops[1:]}
    useful_m = {method: limit_m for method, limit_m in bounds_m.items() if limit_m is not None}
    method = min(useful_m, key=lambda name: useful_m[name], default="")
    alternative_m = spiral_error_m(page, method)
    if error_m is None or alternative_m is None or (bound_m or np.inf) <= useful_m[method]:
        return []
    limit = "no useful bound"
    if bound_m is not None:
        limit = f"a guaranteed error of {number(bound_m, 'm')}"
    text = (
        f"{METHOD_NAMES[first.method].capitalize()} is recommended wherever it can be designed: "
        "the inverse removes most of the hysteresis before the feedback acts. Its simulated error "
        f"on a {SPIRAL_Hz:g} Hz spiral is {number(error_m, 'm')}, that of {METHOD_NAMES[method]} "
        f"{number(alternative_m, 'm')}. It has {limit}; {METHOD_NAMES[method]} guarantees "
        f"{number(useful_m[method], 'm')}."
    )
    return [Prose(text=text)]


def loops_table(page: Page) -> Table:
    """Return every loop of every axis with its worst margins; the first loop is recommended."""
    rows = []
    for axis in page.axis_designs:
        model = page.model.axes.get(axis.axis)
        is_verified = page.ships(axis.axis) or page.verification is None
        for loop in axis.loops:
            delay_s = loop.worst_delay_margin_s
            bound_m: float | str = "none"
            if model is not None:
                bound_m = guaranteed_error_m(loop.certificate, model, is_verified=is_verified)
            rows.append(
                (
                    axis.axis,
                    METHOD_NAMES[loop.method],
                    number(loop.bandwidth_Hz, "Hz"),
                    significant(loop.worst_modulus_margin),
                    "any" if delay_s is None else number(delay_s, "s"),
                    bound_m if isinstance(bound_m, str) else number(bound_m, "m"),
                )
            )
    return Table(
        caption="The first loop of an axis is recommended and exported. Bandwidth: specified for "
        "the feedback, which attenuates disturbances by at least 3 dB up to this frequency; the "
        "feedforward follows references faster. Modulus margin: smallest distance of the Nyquist "
        f"curve from {MINUS}1. Delay margin: tolerated additional delay.",
        columns=(
            *("axis", "loop", "bandwidth", "modulus margin", "delay margin"),
            "guaranteed error",
        ),
        rows=tuple(rows),
        is_open=True,
    )


def _figure(axis: AxisDesign, loop: LoopDesign, function: str) -> Figure:
    """Draw one sensitivity function: nominal curve, band of the plant family, and limits."""
    rate_Hz = loop.members[0].sampling_rate_Hz
    frequency_Hz = np.geomspace(loop.bandwidth_Hz / LOWEST_DIVISOR, NYQUIST * rate_Hz, GRID)
    level_dB = np.stack(
        [
            decibel(getattr(sensitivities(member, loop.R, loop.S, frequency_Hz), function))
            for member in loop.members
        ]
    )
    # Name and limit in dB over the frequencies; NaN where no limit applies.
    specification = axis.specification
    limits = [
        (t.name, t.limit_dB(frequency_Hz))
        for t in specification.all_templates
        if t.function == function
    ]
    if function == "Syp":
        peak_dB = float(decibel(1.0 / specification.modulus_margin))
        limits.append(("modulus margin", np.full(GRID, peak_dB)))
    else:
        limit_dB = decibel(delay_limit(frequency_Hz, specification.delay_margin_s))
        limits.append(("delay margin", limit_dB))
    limits = [
        (name, np.where(np.isfinite(level) & (level < 40.0), level, np.nan))
        for name, level in limits
    ]
    decades = np.log10(frequency_Hz)
    x = decades_over("frequency", [decades], "Hz")
    family_dB = np.maximum(level_dB, -80.0)
    y = axis_over(f"|{function}| [dB]", [family_dB.ravel(), *(level for _, level in limits)], "")
    canvas = Canvas(x=x, y=y)
    low_dB, high_dB = family_dB.min(axis=0), family_dB.max(axis=0)
    layers: list[Layer] = [
        canvas.band("model-band", "plant family", decades, low_dB, high_dB),
        canvas.line("model", "nominal", decades, family_dB[0]),
    ]
    layers += [
        canvas.line("zero" if "margin" in name else "limit", name, decades, limit)
        for name, limit in limits
    ]
    worst_dB = level_dB.max(axis=0)
    crossing = ""
    above = np.flatnonzero(worst_dB > MINUS_3_dB)
    if function == "Syp" and len(above) and above[0] > 0:
        crossing_Hz = number(float(frequency_Hz[above[0] - 1]), "Hz")
        crossing = (
            f" All plants attenuate disturbances by 3 dB or more up to {crossing_Hz}; the "
            f"specified bandwidth is {number(loop.bandwidth_Hz, 'Hz')}."
        )
    name, guide = FUNCTIONS[function]
    largest_dB = f"{round(float(worst_dB.max()), 2) + 0.0:.2f} dB".replace("-", MINUS)
    return Figure(
        title=f"Axis {axis.axis}: {name} |{function}|",
        caption=f"Largest value of {count_of(len(loop.members), 'plant')}: {largest_dB} at "
        f"{number(float(frequency_Hz[worst_dB.argmax()]), 'Hz')}.{crossing}",
        guide=guide,
        canvas=canvas,
        layers=tuple(layers),
    )
