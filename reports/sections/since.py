"""What changed since the last calibration, and whether the controller of then still holds."""

import numpy as np

from piezoid.calibration.since import Cause, Curves, Moved, Since
from piezoid.formatting import words
from piezoid.numerics.arrays import Array
from piezoid_reports.chart import Canvas, Layer, axis_over
from piezoid_reports.page import Figure, Listing, Page, Part, Prose, Section, Table
from piezoid_reports.quantities import MINUS, percent, significant, size_of, told, told_between

LOOK = (
    "Good: the line stays inside the band, so that both calibrations agree. Bad: it leaves the "
    "band and grows with the rise (the sensitivity changed), or bends away (the loop did)."
)
SHOWN = 3  # moved quantities that are named in a sentence; the table has all


def render(page: Page) -> Section | None:
    """Return the chapter, where an older calibration was named."""
    found = page.since
    if found is None:
        return None
    text, tone = controller_of_then(found)
    parts: list[Part] = [Prose(text=what_moved(found)), Prose(text=text, tone=tone)]
    parts += [_difference(one) for one in found.curves]
    parts += [_table(found), *_causes(found), *_failed(found)]
    if found.notes:
        parts.append(Listing(items=found.notes))
    return Section(
        anchor="since",
        title="What changed since then",
        lead="Two calibrations of one stage. A quantity moved where the two 95 % intervals have "
        "nothing in common. Single weights are not compared: neighbouring plays share theirs, and "
        "the loading curve holds them all.",
        parts=tuple(parts),
    )


def sentence(found: Since) -> str:
    """Return all of it for the first screen."""
    return f"{what_moved(found)} {controller_of_then(found)[0]}"


def what_moved(found: Since) -> str:
    """Say which quantities moved and which causes came or went."""
    beyond = found.beyond
    judged = sum(one.is_known for one in found.moved)
    if beyond:
        named = "; ".join(_in_words(one) for one in beyond[:SHOWN])
        more = f"; and {len(beyond) - SHOWN} more" if len(beyond) > SHOWN else ""
        said = [
            f"{len(beyond)} of {judged} quantities moved beyond their intervals: {named}{more}."
        ]
    else:
        said = [f"None of {judged} quantities moved beyond its interval."]
    said += [
        f"{verb}: {', '.join(f'{words(one.effect)} (axis {one.axis})' for one in causes)}."
        for verb, causes in (("New causes", found.came), ("No longer named", found.went))
        if causes
    ]
    if found.causes and not (found.came or found.went):
        said.append("The same causes are named.")
    for verb, axes in (("gone", found.only_then), ("new", found.only_now)):
        if axes:
            said.append(f"Axes that are {verb}: {', '.join(axes)}.")
    return " ".join(said)


def controller_of_then(found: Since) -> tuple[str, str]:
    """Return a sentence about the controller of then on the stage of now, and its tone."""
    if found.held is None:
        return f"Whether the controller of then still holds was not run: {found.unheld}", "plain"
    verdicts = found.held.verdicts
    partly = f" Not all of it was run: {found.unheld}" if found.unheld else ""
    failed = [one for one in verdicts if not one.passed]
    if not failed:
        return (
            f"The controller of then still holds: on the stage as it is now it passes all "
            f"{len(verdicts)} verdicts.{partly}",
            "middling" if partly else "good",
        )
    return (
        f"The controller of then no longer holds: on the stage as it is now it fails "
        f"{len(failed)} of {len(verdicts)} verdicts, {failed[0].name} ({failed[0].scenario}) "
        f"first.{partly}",
        "bad",
    )


def _in_words(one: Moved) -> str:
    share = one.ratio - 1.0
    by = "" if not np.isfinite(share) else f" ({'+' if share > 0 else MINUS}{percent(abs(share))})"
    return (
        f"{_whose(one)}{one.name} from {told(one.then.value, one.unit)} to "
        f"{told(one.now.value, one.unit)}{by}"
    )


def _whose(one: Moved) -> str:
    return "" if one.axis == "tip" else f"axis {one.axis}, "


def _table(found: Since) -> Table:
    ordered = sorted(found.moved, key=lambda one: not one.is_moved)
    return Table(
        caption="Every quantity that both calibrations know, those that moved first.",
        columns=("axis", "quantity", "then", "now", "change", ""),
        rows=tuple(
            (
                one.axis,
                one.name,
                _value(one, one.then.value, one.then.high - one.then.value),
                _value(one, one.now.value, one.now.high - one.now.value),
                percent(one.ratio - 1.0) if np.isfinite(one.ratio) else "",
                "moved" if one.is_moved else "within" if one.is_known else "no interval",
            )
            for one in ordered
        ),
    )


def _value(one: Moved, value: float, half: float) -> str:
    if not np.isfinite(half):
        return told(value, one.unit)
    return told_between(value, half, one.unit)


def _causes(found: Since) -> list[Part]:
    if not found.causes:
        return []
    return [
        Table(
            caption="Causes that the diagnosis named, then and now.",
            columns=("axis", "cause", "then", "now"),
            rows=tuple(_cause(one) for one in found.causes),
        )
    ]


def _cause(one: Cause) -> tuple[str, ...]:
    sizes = ("not named" if f is None else size_of(f) for f in (one.then, one.now))
    return (one.axis, words(one.effect), *sizes)


def _failed(found: Since) -> list[Part]:
    failed = () if found.held is None else [v for v in found.held.verdicts if not v.passed]
    if not failed:
        return []
    return [
        Table(
            caption="Verdicts that the controller of then fails on the stage of now.",
            columns=("what", "in", "found", "limit", "unit"),
            rows=tuple(
                (v.name, v.scenario, significant(v.value), significant(v.limit), v.unit)
                for v in failed
            ),
        )
    ]


def _difference(one: Curves) -> Figure:
    apart_m = one.now_m - one.then_m
    reach_m = one.now_half_m + one.then_half_m
    x = axis_over("rise of the drive", [one.rise_V], "V")
    y = axis_over("now minus then", [apart_m, reach_m, -reach_m], "m", even=True)
    canvas = Canvas(x=x, y=y, height=240)
    layers: tuple[Layer, ...] = (
        canvas.band("rising-band", "where both agree", one.rise_V, -reach_m, reach_m),
        canvas.line("model", "now minus then", one.rise_V, apart_m),
        canvas.line("zero", "no change", one.rise_V[[0, -1]], np.zeros(2)),
    )
    return Figure(
        title=f"Axis {one.axis}: how far the same drive moves it now, and then",
        numbers=f"{_signed(apart_m)} at a rise of {told(float(one.rise_V[-1]), 'V')}, where both "
        f"intervals together are ± {told(float(reach_m[-1]), 'm')}.",
        look=LOOK,
        canvas=canvas,
        layers=layers,
    )


def _signed(values: Array) -> str:
    last = float(values[-1])
    return f"{'+' if last > 0 else ''}{told(last, 'm')}"
