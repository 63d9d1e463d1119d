"""The tunnelling junction: current over height in logarithmic scale, barrier, both directions."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from piezoid.identification.tunnelling.approach import ApproachCurve, Direction
from piezoid.identification.tunnelling.barrier_fit import GapLaw
from piezoid.identification.tunnelling.confidence import Confidence
from piezoid.identification.tunnelling.junction import curves_of
from piezoid.identification.tunnelling.model import TunnellingModel
from piezoid.numerics.arrays import Array
from piezoid_reports.chart import Canvas, Layer, axis_over, decades_over
from piezoid_reports.page import Page
from piezoid_reports.parts import Figure, Part, Prose, Section, Table
from piezoid_reports.quantities import number, percent, with_interval
from piezoid_reports.tunnelling_loop import loop_parts

GUIDE_CURVE = (
    "Good: points on the line over three decades. Bad: two slopes, or a step. "
    "Points at or below zero are fitted but not drawn."
)
GUIDE_RESIDUAL = (
    "Good: no shape about zero. Bad: a bow (creep of the height) or a step (tip changed)."
)
CONFIDENCE = {
    Confidence.HIGH: ("good", "high confidence"),
    Confidence.MEDIUM: ("middling", "medium confidence"),
    Confidence.LOW: ("bad", "low confidence"),
}
POLARITY = {1.0: "positive", -1.0: "negative"}


def render(page: Page) -> Section | None:
    """Return the gap law with its curves and the closed loop, as far as they were recorded."""
    junction = page.model.tunnelling
    if junction is None or (junction.gap_law is None and junction.loop_plant is None):
        return None
    parts: list[Part] = []
    if junction.gap_law is not None:
        law = junction.gap_law
        parts.append(Prose(text=barrier_sentence(law), tone=CONFIDENCE[law.confidence][0]))
        parts += [_table(junction, page), *_shift(junction)]
        parts += _figures(junction, page)
    if junction.loop_plant is not None:
        parts += loop_parts(page, junction, junction.loop_plant)
    return Section(
        anchor="tunnelling",
        title="Tunnelling",
        lead="The current decays exponentially with the height of the tip; the decay gives the "
        "apparent barrier, whose root sets the gain of the height loop.",
        parts=tuple(parts),
    )


def barrier_sentence(law: GapLaw) -> str:
    """Return barrier, interval and confidence of the gap law."""
    barrier = with_interval(law.barrier_eV, law.barrier_interval_eV, "eV")
    unmet = f"; {len(law.reasons)} criteria are not met" if law.reasons else ""
    return f"Apparent barrier {barrier}, {law.confidence.value} confidence{unmet}."


def _figures(
    junction: TunnellingModel,
    page: Page,
    sizes: tuple[tuple[int, int] | None, tuple[int, int] | None] = (None, None),
) -> tuple[Figure, ...]:
    """Draw the first law over its sweeps, and its residual."""
    for law, direction in _laws(junction, page):
        curves = [c for c in curves_of(page.sweeps) if c.direction is direction]
        if curves:
            return _curve(law, curves, sizes[0]), _residual(law, curves, sizes[1])
    return ()


def small_figures(
    page: Page, curve: tuple[int, int], residual: tuple[int, int]
) -> tuple[Figure, ...]:
    """Return the same figures in the sizes of the first screen."""
    junction = page.model.tunnelling
    if junction is None:
        return ()
    figures = _figures(junction, page, (curve, residual))
    return tuple(replace(figure, seen_as=figure.title.partition(",")[0]) for figure in figures)


def _laws(junction: TunnellingModel, page: Page) -> tuple[tuple[GapLaw, Direction], ...]:
    """The laws beside the direction each was found in; a lone law is of the only direction."""
    first = junction.gap_law
    if first is None:
        return ()
    if junction.forward is not None and junction.backward is not None:
        return (junction.forward, Direction.FORWARD), (junction.backward, Direction.BACKWARD)
    directions = {curve.direction for curve in curves_of(page.sweeps)}
    return (
        (first, Direction.BACKWARD if directions == {Direction.BACKWARD} else Direction.FORWARD),
    )


def _decay(law: GapLaw) -> str:
    low, high = law.decay_interval_per_m
    return with_interval(1e-9 * law.decay_per_m, (1e-9 * low, 1e-9 * high), "")


ROWS: tuple[tuple[str, Callable[[GapLaw], str]], ...] = (
    ("barrier", lambda law: with_interval(law.barrier_eV, law.barrier_interval_eV, "eV")),
    ("decay k [1/nm]", _decay),
    ("noise without current, rms", lambda law: number(law.floor_A, "A")),
    ("jitter of the gap, rms at most", lambda law: number(law.gap_jitter_m, "m")),
)


def _table(junction: TunnellingModel, page: Page) -> Table:
    laws = _laws(junction, page)
    columns = [(direction.value, law) for law, direction in laws]
    note = ""
    if len(laws) > 1 and junction.gap_law is not None:
        columns.insert(0, ("both directions", junction.gap_law))
        note = " Only the law of both directions is free of height drift."
    return Table(
        caption="Gap law i = ± I0 exp(\N{MINUS SIGN}k z) + offset, z growing as the tip "
        f"retracts; 95 % intervals. The barrier is (k / 10.246 per nm)², in eV.{note}",
        columns=("", *(heading for heading, _ in columns)),
        rows=tuple((name, *(text(law) for _, law in columns)) for name, text in ROWS),
    )


def _shift(junction: TunnellingModel) -> tuple[Part, ...]:
    shift = junction.shift
    if shift is None:
        return ()
    verdict = "one decay fits both directions" if shift.is_one_decay else "the two decays differ"
    low, high = shift.decay_change_interval
    return (
        Prose(
            text=f"Backward sweeps reach {number(shift.reference_current_A, 'A')} at a height "
            f"that differs from the forward sweeps by "
            f"{with_interval(shift.shift_m, shift.shift_interval_m, 'm')}, because of hysteresis, "
            f"creep and drift. The decay differs by {percent(shift.decay_change)} "
            f"({percent(low)} to {percent(high)}): {verdict}.",
            tone="plain" if shift.is_one_decay else "middling",
        ),
    )


def _modelled(law: GapLaw, height_m: Array) -> Array:
    current_A = law.current_at_zero_height_A * np.exp(-law.decay_per_m * height_m)
    return np.asarray(current_A)


def _measured(law: GapLaw, curve: ApproachCurve) -> tuple[Array, Array]:
    """Height in order, and the current without offset, upright."""
    order = np.argsort(curve.height_m, kind="stable")
    return curve.height_m[order], law.polarity * (curve.current_A[order] - law.offset_A)


def _curve(
    law: GapLaw, curves: list[ApproachCurve], size: tuple[int, int] | None = None
) -> Figure:
    """Draw the positive currents in decades of one picoampere over the height."""
    rows = [_measured(law, curve) for curve in curves]
    heights = np.unique(np.concatenate([height for height, _ in rows]))
    floor = np.log10(law.floor_A / 1e-12)
    logs = [np.log10(np.where(i > 0.0, i, np.nan) / 1e-12) for _, i in rows]
    line = np.log10(_modelled(law, heights) / 1e-12)
    x = axis_over("height", [heights], "m")
    y = decades_over("current", [*logs, np.array([floor])], "pA")
    width, height_px = size or (Canvas.width, Canvas.height)
    canvas = Canvas(x=x, y=y, width=width, height=height_px)
    is_compared = line > floor - 1.0  # far below the noise the law has nothing to be compared with
    layers: list[Layer] = [
        canvas.line("measured", f"sweep {k + 1}", height, log, points=400)
        for k, ((height, _), log) in enumerate(zip(rows, logs, strict=True))
    ]
    layers.append(canvas.line("model", "gap law", heights[is_compared], line[is_compared]))
    layers.append(canvas.line("zero", "noise, rms", heights[[0, -1]], np.full(2, floor)))
    return Figure(
        title=f"Current over height, {len(curves)} sweep{'s' if len(curves) != 1 else ''}",
        caption=f"Polarity {POLARITY[law.polarity]}, offset {number(law.offset_A, 'A')} removed.",
        guide=GUIDE_CURVE,
        canvas=canvas,
        layers=tuple(layers),
        is_small=size is not None,
    )


def _residual(
    law: GapLaw, curves: list[ApproachCurve], size: tuple[int, int] | None = None
) -> Figure:
    rows = [_measured(law, curve) for curve in curves]
    residuals = [(height, current_A - _modelled(law, height)) for height, current_A in rows]
    x = axis_over("height", [height for height, _ in residuals], "m")
    y = axis_over(
        "measured minus gap law", [residual for _, residual in residuals], "A", even=True
    )
    width, height_px = size or (Canvas.width, 260)
    canvas = Canvas(x=x, y=y, width=width, height=height_px)
    rms_A = float(np.sqrt(np.mean(np.concatenate([residual for _, residual in residuals]) ** 2)))
    zero = canvas.line("zero", "gap law", np.array([x.low, x.high]) * x.scale.factor, np.zeros(2))
    return Figure(
        title="Residual of the gap law",
        caption=(
            f"{number(rms_A, 'A')} rms; the noise without current is {number(law.floor_A, 'A')}."
        ),
        guide=GUIDE_RESIDUAL,
        canvas=canvas,
        is_small=size is not None,
        layers=(
            zero,
            *(
                canvas.line("measured", f"sweep {k + 1}", height, residual, points=400)
                for k, (height, residual) in enumerate(residuals)
            ),
        ),
    )
