"""Every shape that was tried, and why this one was kept."""

from piezoid.identification.model import AxisModel
from piezoid_reports.page import Page, Section, Table
from piezoid_reports.quantities import percent, told


def render(page: Page) -> Section:
    """Return a table of orders for each axis."""
    return Section(
        anchor="orders",
        title="Orders tried",
        lead="More plays and dead zones always fit better; the held-out error decides. Good: it "
        "falls and levels off. Bad: it still falls at the last order, or rises at the second.",
        parts=tuple(part for axis in page.axes for part in (_table(axis), *_functions(axis))),
    )


def _functions(axis: AxisModel) -> tuple[Table, ...]:
    """Return what another class leaves: plays behind functions."""
    if not axis.function_orders:
        return ()
    return (
        Table(
            caption=f"Axis {axis.axis}: plays behind rising functions, which follow minor loops "
            "of any shape, on rows left out once what was before a recording is forgotten. "
            + (
                "They simulate and ship."
                if axis.minor_loops is not None
                else "They would ship if they predicted better by half."
            ),
            columns=("plays", "pieces", "numbers", "left out", "plays with dead zones, fitted"),
            rows=tuple(
                (
                    str(order.plays),
                    str(order.pieces),
                    str(order.plays * order.pieces + 1),
                    told(order.held_out_rms_m, "m"),
                    told(order.plain_rms_m, "m"),
                )
                for order in axis.function_orders
            ),
        ),
    )


def _table(axis: AxisModel) -> Table:
    quality = axis.quality
    least_m = min((order.held_out_rms_m for order in quality.orders), default=0.0)
    alone = len({start.recording for start in axis.starts}) == 1
    kind = "the second half of the only recording" if alone else "recordings left out in turn"
    if not quality.is_tested:
        kind = "the rows of the fit itself, for one loop leaves nothing to test on"
    return Table(
        caption=(
            f"Axis {axis.axis}: free-run error on {kind}. After the choice the final fit uses "
            "every row, and drops plays and dead zones it does not need; the error in the verdict "
            f"is on {quality.held_out_words}."
        ),
        columns=(
            "plays",
            "dead zones",
            "envelope bends",
            "lag",
            "held-out rms",
            "of the range",
            "",
        ),
        rows=tuple(
            (
                str(order.plays),
                str(order.dead_zones),
                str(order.bends),
                order.lag.replace("_", "-"),
                told(order.held_out_rms_m, "m"),
                percent(order.held_out_rms_m / quality.range_m),
                "least" if order.held_out_rms_m == least_m else "",
            )
            for order in quality.orders
        ),
    )
