"""Sections of the page of a batch: verdict, failures, outliers, distributions, all stages."""

from heapq import nsmallest
from itertools import islice
from urllib.parse import quote

import numpy as np

from piezoid.formatting import Scale, count_of
from piezoid_reports.chart import Axis, Canvas, axis_over
from piezoid_reports.fleet.records import (
    CRASHED,
    FAILED,
    PASSED,
    REFUSED,
    STAGES,
    STATES,
    Fleet,
    FleetStage,
)
from piezoid_reports.fleet.statistics import (
    FALSE_ALARMS,
    MIN_STAGES,
    TREND_P,
    Distribution,
    compare_stages,
)
from piezoid_reports.parts import Figure, Heading, Part, Prose, Section, Table, html
from piezoid_reports.quantities import number, significant, with_half_width

NEGLIGIBLE = 1e-3  # of its interval: a smaller slope is rounding
MAX_DOTS = 1000  # stages drawn one by one
SERIAL_BINS = 60  # of a larger batch, drawn as the range from 5 % to 95 %
GUIDE_SPREAD = (
    "Good: one hump inside the dashed lines. Bad: two humps (two batches of ceramics), a long "
    "tail, single stages far away."
)
GUIDE_DRIFT = (
    "Good: dots scatter about a level line. Bad: a slope (tool wear, an ageing reference), a step "
    "(a new batch, a new sensor), single dots far away."
)

HALF_95 = 1.96  # standard errors
MAX_ROWS = 200  # of a table, so that the page of any batch opens quickly


def verdict(fleet: Fleet, distributions: tuple[Distribution, ...]) -> Section:
    """Return the number of stages that passed, the outliers, and the quantities that drift."""
    n_passed, n_stages = fleet.counts.get(PASSED, 0), len(fleet.stages)
    tone = "good" if fleet.passed else "middling" if n_passed >= 0.9 * n_stages else "bad"
    kinds = ((FAILED, "failed a verdict"), (REFUSED, "could not be used"), (CRASHED, "crashed"))
    counts = [f"{n} {word}" for state, word in kinds if (n := fleet.counts.get(state, 0))]
    counted = f"{n_passed} of {n_stages} stages passed; {', '.join(counts)}."
    if fleet.passed:
        counted = f"All {n_stages} stages passed."
    if fleet.without_controller:
        counted += f" {fleet.without_controller} passed without a controller."
    drifting = [f"{row.quantity.label} of axis {row.axis}" for row in distributions if row.drifts]
    trends = ""
    if drifting:
        trends = f"Drift over the serial numbers: {', '.join(drifting)}."
    elif any(row.trend is not None for row in distributions):
        trends = "No quantity drifts over the serial numbers."
    elif distributions:
        trends = "Too few stage names contain a serial number to test for drift."
    outliers = f"Fewer than {MIN_STAGES} stages can be compared, so the spread is not reported."
    if distributions:
        deviations = [
            (abs(float(row.deviation[k])), row.stages[k])
            for row in distributions
            for k in row.outliers
        ]
        names = list(dict.fromkeys(name for _, name in sorted(deviations, reverse=True)))
        omitted = f" and {len(names) - 3} more" if len(names) > 3 else ""
        outliers = f"{count_of(len(names), 'outlier')}: {', '.join(names[:3])}{omitted}."
        outliers = outliers if names else "No stage is an outlier."
    text = " ".join((counted, outliers, trends))
    parts = (Prose(text=text, tone=tone),)
    return Section(anchor="verdict", title="Verdict", lead="", parts=parts)


def failures(fleet: Fleet) -> Section:
    """Return every stage that did not pass, with its reason."""
    failed = list(islice((s for s in fleet.stages if s.state != PASSED), MAX_ROWS))
    table = Table(
        caption="Stages that did not pass."
        + _truncation(len(fleet.stages) - fleet.counts.get(PASSED, 0)),
        columns=("stage", "state", "reason"),
        rows=tuple((s.name, s.state, s.reason) for s in failed),
        links=tuple(_link(s) for s in failed),
        wordy=(2,),
        is_open=True,
    )
    lead = "; ".join(f"{state}: {meaning}" for state, meaning in STATES.items())
    return Section(
        anchor="failures",
        title="Failures",
        lead=f"{lead}.",
        parts=(table if failed else Prose(text="Every stage passed.", tone="good"),),
    )


def outliers(distributions: tuple[Distribution, ...]) -> Section:
    """Return the outliers, largest deviation first."""
    rows = sorted(
        ((row, k) for row in distributions for k in row.outliers),
        key=lambda pair: -abs(pair[0].deviation[pair[1]]),
    )
    limit = min((row.limit for row in distributions), default=0.0)
    lead = (
        f"Outliers deviate by at least {limit:.1f} robust standard deviations (of the logarithm "
        "for quantities with a long tail), including the uncertainty of the value. Expected "
        f"number in a batch without faults: {FALSE_ALARMS:g} at most."
    )
    cells = []
    for row, k in rows[:MAX_ROWS]:
        unit, value = row.quantity.unit, float(row.values[k])
        half = HALF_95 * float(row.errors[k])
        cells.append(
            (
                row.stages[k],
                row.axis,
                row.quantity.label,
                with_half_width(value, half, unit) if half > 0.0 else number(value, unit),
                number(row.spread.median, unit),
                f"{significant(float(row.deviation[k]), 2)} sigma",
                row.quantity.cause,
            )
        )
    table = Table(
        caption="Deviation from the median of all stages, or from the drift."
        + _truncation(len(rows)),
        columns=("stage", "axis", "quantity", "value", "median", "deviation", "possible cause"),
        rows=tuple(cells),
        links=tuple(_report_link(row.stages[k]) for row, k in rows[:MAX_ROWS]),
        is_open=True,
    )
    none = Prose(text="None.", tone="good")
    if not distributions:
        none = Prose(text=f"Not tested: fewer than {MIN_STAGES} stages can be compared.")
    return Section(
        anchor="outliers",
        title="Outliers",
        lead=lead if distributions else "",
        parts=(table if rows else none,),
    )


def stages(fleet: Fleet) -> Section:
    """Return state, error and digests of all stages, or of the worst in a large batch."""

    def badness(stage: FleetStage) -> tuple[bool, float, str]:
        """Sort stages: first those that did not pass, then by error."""
        errors = [axis.values.get("held_out_rms_percent", 0.0) for axis in stage.axes]
        return stage.state == PASSED, -max(errors, default=0.0), stage.name

    rows, title = fleet.stages, "All stages"
    if len(rows) > MAX_ROWS:
        rows = nsmallest(MAX_ROWS, rows, key=badness)
        title = f"The worst {MAX_ROWS} stages"
    return Section(
        anchor="stages",
        title=title,
        lead="The same inputs and version give the same files, byte for byte.",
        parts=(
            Table(
                caption="State, error, and digests of model and parameters."
                + _truncation(len(fleet.stages)),
                columns=("stage", "state", "held-out error", "model.json", "params.json"),
                rows=tuple(
                    (
                        stage.name,
                        stage.state,
                        ", ".join(
                            number(axis.values["held_out_rms_percent"], "%")
                            for axis in stage.axes
                            if "held_out_rms_percent" in axis.values
                        ),
                        *(stage.outputs.get(n, "") for n in ("model.json", "params.json")),
                    )
                    for stage in rows
                ),
                digests=(3, 4),
                links=tuple(_link(stage) for stage in rows),
                is_open=True,
            ),
        ),
    )


def _truncation(rows: int) -> str:
    """Return a sentence about the rows that a table does not show, or empty."""
    if rows <= MAX_ROWS:
        return ""
    return f" {MAX_ROWS} of {rows} rows are shown; parameters.parquet lists all stages."


def _link(stage: FleetStage) -> str:
    return _report_link(stage.name) if stage.state in (PASSED, FAILED) else ""


def _report_link(name: str) -> str:
    """Return the relative address of the report of a stage, quoted against other schemes."""
    return f"./{STAGES}/{quote(name)}/report.html"


def render_fleet(fleet: Fleet) -> str:
    """Return summary.html, which belongs next to the folder of the stages."""
    distributions = compare_stages(fleet)
    sections = (
        verdict(fleet, distributions),
        failures(fleet),
        outliers(distributions),
        spread(distributions),
        stages(fleet),
    )
    return html(f"Batch {fleet.name}", [section for section in sections if section is not None])


def spread(distributions: tuple[Distribution, ...]) -> Section | None:
    """Return a table and, for each quantity, its histogram and its trend over serial numbers."""
    if not distributions:
        return None
    parts: list[Part] = []
    for axis in dict.fromkeys(row.axis for row in distributions):
        rows = [row for row in distributions if row.axis == axis]
        table = Table(
            caption=f"Axis {axis}: spread over the stages, and drift over 100 serial numbers. "
            f"Significance level of a drift: {100 * TREND_P:g} % for all quantities together.",
            columns=("quantity", "stages", "median", "5 % to 95 %", "drift (95 %)", "p"),
            rows=tuple(
                (
                    row.quantity.label,
                    str(row.spread.count),
                    number(row.spread.median, row.quantity.unit),
                    f"{number(row.spread.low, row.quantity.unit)} to "
                    f"{number(row.spread.high, row.quantity.unit)}",
                    _drift(row),
                    "" if row.trend is None else significant(row.trend_p, 2),
                )
                for row in rows
            ),
        )
        parts += [Heading(text=f"Axis {axis}"), table]
        for row in rows:
            if np.ptp(row.values) > 0.0:
                parts.append(_histogram(row))
            if row.trend is not None:
                parts.append(_trend_figure(row))
    return Section(
        anchor="parameters",
        title="Distribution and drift of the parameters",
        lead="All stages to which the model applies, including those that did not pass.",
        parts=tuple(parts),
    )


def _drift(row: Distribution) -> str:
    if row.trend is None:
        return "unknown"
    low, high = (100.0 * end for end in row.trend.ci95)
    unit, slope = row.quantity.unit, 100.0 * row.trend.slope
    middle = slope if abs(slope) > NEGLIGIBLE * (high - low) else 0.0
    return f"{number(middle, unit)} ({number(low, unit)} to {number(high, unit)})"


def _histogram(row: Distribution) -> Figure:
    edges = np.histogram_bin_edges(
        row.values, bins=int(np.clip(2 * len(row.values) ** 0.5, 8, 40))
    )
    counts, _ = np.histogram(row.values, edges)
    across = np.repeat(edges, 2)
    up = np.concatenate([[0.0], np.repeat(counts, 2), [0.0]]).astype(float)
    limits = np.array(row.normal)
    inside = limits[(limits >= edges[0]) & (limits <= edges[-1])]
    y = Axis(label="stages", scale=Scale(factor=1.0, unit=""), low=0.0, high=1.08 * counts.max())
    canvas = Canvas(
        x=axis_over(row.quantity.label, [row.values], row.quantity.unit), y=y, height=200
    )
    layers = [canvas.band("count", "stages", across, np.zeros_like(up), up)]
    for level in inside:
        height = np.array([0.0, y.high])
        layers.append(canvas.line("limit", "limit of outliers", np.full(2, level), height))
    outside = f"{len(row.outliers)} beyond {row.limit:.1f} of them"
    outside += ", in the logarithm" if row.quantity.ratio else ""
    outside += ", including the uncertainty of each value" if row.errors.any() else ""
    return Figure(
        title=f"{row.quantity.label}, axis {row.axis}: distribution",
        caption=f"{row.spread.count} stages, median "
        f"{number(row.spread.median, row.quantity.unit)}, "
        f"robust standard deviation {number(row.spread.sigma, row.quantity.unit)}; "
        f"{outside}.",
        guide=GUIDE_SPREAD,
        canvas=canvas,
        layers=tuple(layers),
    )


def _trend_figure(row: Distribution) -> Figure:
    assert row.trend is not None
    serials = np.array([np.nanmin(row.serials), np.nanmax(row.serials)])
    line = row.trend.middle + row.trend.slope * (serials - row.trend.about)
    x = axis_over("serial number", [row.serials], "")
    canvas = Canvas(
        x=x, y=axis_over(row.quantity.label, [row.values], row.quantity.unit), height=200
    )
    is_outlier = np.zeros(len(row.values), dtype=bool)
    is_outlier[list(row.outliers[:MAX_DOTS])] = True
    layer = canvas.dots("dots", "stages", row.serials[~is_outlier], row.values[~is_outlier])
    numbered = np.flatnonzero(np.isfinite(row.serials))
    if len(numbered) > MAX_DOTS:
        order = numbered[np.argsort(row.serials[numbered], kind="stable")]
        bins = np.array_split(order, SERIAL_BINS)
        middle = np.array([np.median(row.serials[part]) for part in bins])
        low, high = np.array([np.quantile(row.values[p], (0.05, 0.95)) for p in bins]).T
        layer = canvas.band("count", "9 of 10 stages", middle, low, high)
    layers = [layer, canvas.line("trend", "median trend", serials, line)]
    if (is_outlier & np.isfinite(row.serials)).any():
        layers.append(
            canvas.dots("odd", "outliers", row.serials[is_outlier], row.values[is_outlier])
        )
    return Figure(
        title=f"{row.quantity.label}, axis {row.axis} over the serial numbers",
        caption=f"Drift per 100 serial numbers {_drift(row)}, p = {significant(row.trend_p, 2)}: "
        f"{'significant' if row.drifts else 'not distinguishable from chance'}.",
        guide=GUIDE_DRIFT,
        canvas=canvas,
        layers=tuple(layers),
    )
