"""The loading curve with its band: how far the stage moves from rest, whatever came before."""

import numpy as np

from piezoid.identification.model import AxisModel
from piezoid_reports.chart import Canvas, axis_over
from piezoid_reports.page import Figure, Fold, Page, Section, axis_heading
from piezoid_reports.quantities import told, told_between

LOOK_CURVE = (
    "Good: rising and bending upwards, the band no wider than the line. Bad: a band that opens "
    "towards the end, where the data hardly reached."
)
LOOK_BEND = (
    "Good: a smooth bow, deeper than its band is wide. Bad: kinks, or a band wider than the bow "
    "is deep, so that its shape is not known."
)


def render(page: Page) -> Section:
    """Return the curve, and what is left of it without its straight part."""
    return Section(
        anchor="loading-curve",
        title="Loading curve",
        lead="What the model answers to a drive that only rises from the de-poled state. It holds "
        "all weights and thresholds in one line, and is far better known than any of them.",
        parts=tuple(
            part
            for axis in page.axes
            for part in (
                axis_heading(axis),
                _bend(axis),
                Fold(summary="The curve itself", parts=(_curve(axis),)),
            )
        ),
    )


def _curve(axis: AxisModel) -> Figure:
    found = axis.uncertainty
    low_m, high_m = found.loading_m - found.loading_half_m, found.loading_m + found.loading_half_m
    x = axis_over("rise of the drive", [found.reach_V], "V")
    y = axis_over("displacement", [low_m, high_m], "m")
    canvas = Canvas(x=x, y=y)
    line = canvas.line("model", "loading curve", found.reach_V, found.loading_m)
    return Figure(
        title=f"Axis {axis.axis}: loading curve",
        numbers=(
            f"{told_between(float(found.loading_m[-1]), float(found.loading_half_m[-1]), 'm')} at "
            f"{told(float(found.reach_V[-1]), 'V')}; bands are 95 % intervals from leaving out "
            f"each of {found.blocks} blocks of cycles."
        ),
        look=LOOK_CURVE,
        canvas=canvas,
        layers=(
            canvas.band("model-band", "95 % interval", found.reach_V, low_m, high_m),
            line,
        ),
    )


def _bend(axis: AxisModel) -> Figure:
    found = axis.uncertainty
    reach_V = found.reach_V
    chord_m = found.loading_m[-1] * reach_V / reach_V[-1]
    bow_m = found.loading_m - chord_m
    low_m, high_m = bow_m - found.loading_half_m, bow_m + found.loading_half_m
    x = axis_over("rise of the drive", [reach_V], "V")
    y = axis_over("loading curve minus its chord", [low_m, high_m, np.zeros(1)], "m")
    canvas = Canvas(x=x, y=y, height=260)
    line = canvas.line("model", "bow", reach_V, bow_m)
    zero = canvas.line("zero", "no hysteresis", reach_V[[0, -1]], np.zeros(2))
    width_m, half_m = found.loop_width_m
    return Figure(
        title=f"Axis {axis.axis}: how far the loading curve bends",
        numbers=(
            f"The full loop is open by {told_between(width_m, half_m, 'm')} in its middle "
            "(95 % interval)."
        ),
        look=LOOK_BEND,
        canvas=canvas,
        layers=(canvas.band("model-band", "95 % interval", reach_V, low_m, high_m), zero, line),
    )
