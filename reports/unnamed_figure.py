"""The picture of something that has no name: what is left against the coordinate it lives in."""

import numpy as np

from piezoid.diagnosis.diagnosis import Finding
from piezoid_reports.chart import Canvas, axis_over, decades_over
from piezoid_reports.effect_words import words
from piezoid_reports.page import Figure
from piezoid_reports.quantities import percent, told

HEIGHT = 280
DECADES = ("time_since_turn",)
PHASES = "part of a period"


def unnamed_figure(finding: Finding) -> Figure | None:
    """Return the remainder in classes of its coordinate with the fitted curve, None without it."""
    seen = finding.seen
    if seen is None or len(seen.place) < 2:
        return None
    label = PHASES if not seen.unit else finding.coordinate.replace("_", " ")
    place = np.array(seen.place)
    low, median, high, fitted = (
        np.array(one) for one in (seen.low_m, seen.median_m, seen.high_m, seen.fitted_m)
    )
    if finding.coordinate in DECADES:
        place = np.log10(np.maximum(place, 1e-9))
        x = decades_over(label, [place], seen.unit)
    else:
        x = axis_over(label, [place], seen.unit)
    canvas = Canvas(x=x, y=axis_over("what is left", [low, high, fitted], "m"), height=HEIGHT)
    return Figure(
        title=f"{words(finding.effect).capitalize()}: what is left against {_against(finding)}",
        numbers=f"The curve explains {_explained(finding)}; p {finding.p_value:.2g}.",
        look="What hysteresis and every named cause leave, in classes of the coordinate: middle "
        "half and median, and the curve that was fitted to other stretches of the recordings. "
        "Where the curve runs with the median, this is where it lives.",
        x=canvas.x,
        y=canvas.y,
        layers=(
            canvas.band("rising-band", "left over: middle half", place, low, high),
            canvas.line("rising", "left over: median", place, median)[0],
            canvas.line("limit", "fitted curve", place, fitted)[0],
        ),
        flicker=(),
        height=canvas.height,
    )


def _against(finding: Finding) -> str:
    if finding.seen is not None and finding.seen.recording:
        return f"time, in {finding.seen.recording}"
    if finding.parameters:
        name, value = next(iter(finding.parameters.items()))
        quantity, _, unit = name.rpartition("_")
        return f"the {PHASES} ({quantity} {told(value, unit)})"
    return finding.coordinate.replace("_", " ")


def _explained(finding: Finding) -> str:
    share = f"{percent(finding.share)} of the stroke"
    if not finding.size.unit.startswith("nm"):
        return f"{share}, rms"
    return f"{told(finding.size.value * 1e-9, 'm')} rms, {share}"
