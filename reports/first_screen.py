"""What stands on the first screen of an axis: its loop, its residual in time, one row of facts."""

from dataclasses import replace

import numpy as np

from piezoid.design.design import AxisDesign, LoopDesign
from piezoid.identification.model import AxisModel
from piezoid.identification.quality import (
    BLOCKS,
    OTHER_RECORDINGS,
    SECOND_HALF,
    WIDEST_HALVED,
)
from piezoid.verification.scenarios import spiral_speed_m_per_s
from piezoid_reports.held_back import held_back
from piezoid_reports.junction_words import told_interval
from piezoid_reports.page import Card, Figure, Page
from piezoid_reports.quantities import percent, told
from piezoid_reports.sections import loops, residual_over_time, tunnelling
from piezoid_reports.traces import Trace

LOOP, RESIDUAL = (300, 122), (440, 122)  # points on the page, beside each other
LEFT_OUT = {
    OTHER_RECORDINGS: "Error, whole recordings left out",
    WIDEST_HALVED: "Error, recordings left out, half of the widest",
    SECOND_HALF: "Error, second half left out",
    BLOCKS: "Error, blocks of recordings left out",
}
IN_SAMPLE = "Error, in sample: nothing left out"
TRACKED_Hz = 10.0  # of the spirals that verification compares
WAYS = {
    "mpi_dob": "observer on the inverse",
    "dob": "plain observer",
    "mpi": "inverse, no feedback",
    "none": "static gain",
    "rst": "R, S, T on ln i",
}


def figures(page: Page, axis: AxisModel) -> tuple[Figure, ...]:
    """Return the loop without its line and the residual of the recording fitted worst, linked."""
    traces = page.traces.get(axis.axis, ())
    if not traces:
        return ()
    worst = traces[0]
    link = f"axis-{list(page.model.axes).index(axis.axis)}"
    residual = residual_over_time.after(worst, axis, size=RESIDUAL)
    span = float(worst.time_s[-1]) / residual.canvas.x.scale.factor
    return (
        replace(
            loops.opened(page, axis, worst, canvas_size=LOOP),
            link=link,
            seen_as=f"{worst.recording.name}: loop",
        ),
        replace(
            residual,
            link=link,
            span=span,
            seen_as=f"{worst.recording.name}: residual",
        ),
    )


def facts(page: Page, axis: AxisModel) -> tuple[tuple[str, str], ...]:
    """Return names and values of the row beside the figures."""
    quality = axis.quality
    loop = _loop(page, axis.axis)
    return (
        (
            LEFT_OUT.get(quality.held_out_kind, IN_SAMPLE),
            f"{told(quality.held_out_rms_m, 'm')} rms, "
            f"{percent(quality.held_out_rms_m / quality.range_m)}",
        ),
        ("Sensor noise", f"{quality.noise_bound}{told(quality.noise_rms_m, 'm')} rms"),
        _speed(page, axis.axis, loop),
        ("Guaranteed error", _guarantee(page, loop, quality.range_m)),
        ("Ships", ships(page, axis.axis)),
    )


def _speed(page: Page, name: str, loop: LoopDesign | None) -> tuple[str, str]:
    """Return the bandwidth, and what verification leaves on its spiral where it has run."""
    if loop is None:
        return "Bandwidth", "none"
    bandwidth, found = told(loop.bandwidth_Hz, "Hz"), page.verification
    held = next((held_back(page, one) for one in _axes(page) if one.axis == name), None)
    if held:
        bandwidth += f", of at most {held[0]} while no mode is known"
    method = None if found is None else found.methods.get(name)
    rows = () if found is None else found.comparison
    for row in rows:
        if row.method == method and row.frequency_Hz == TRACKED_Hz:
            label = f"Bandwidth; tracking error at {TRACKED_Hz:g} Hz"
            return label, f"{bandwidth}; {told(row.rms_m, 'm')} rms"
    return "Bandwidth", bandwidth


def left_out(traces: tuple[Trace, ...]) -> tuple[int, int]:
    """Return how many samples the fit left out, and of how many."""
    total = sum(len(trace.time_s) for trace in traces)
    return total - sum(trace.counted for trace in traces), total


def ships(page: Page, name: str) -> str:
    """Say whether the axis ships, and how or why not, in a few words."""
    if name in page.unshipped:
        return f"no: {page.unshipped[name]}"
    axis = page.model.axes.get(name)
    if axis is not None and not axis.verdict.applies:
        return "no: the model does not apply"
    if page.design is None:
        return f"no: {page.undesigned}" if page.undesigned else "no: not designed"
    if _loop(page, name) is None:
        return "no: no controller was designed"
    found = page.verification
    if found is None:
        return f"no: {page.undesigned}" if page.undesigned else "no: not verified yet"
    if name not in found.methods:
        return "no: not among what was verified"
    way = WAYS[found.methods[name]]
    return f"yes: {way}" if found.passed else f"no: verification failed ({way})"


def tip_cards(page: Page) -> tuple[Card, ...]:
    """Return the card of the tunnelling tip, where a junction or its loop was recorded."""
    junction = page.model.tunnelling
    if junction is None or (junction.gap_law is None and junction.loop_plant is None):
        return ()
    known = junction.gap_law or junction.loop_plant
    assert known is not None
    found = ((a, a.recommended) for a in _axes(page) if a.recommended.method == "rst")
    loop = next(found, None)
    name = "z" if loop is None else loop[0].axis
    tone, said = tunnelling.CONFIDENCE[known.confidence]
    barrier = [
        (f"Barrier, {way}", told_interval(m.barrier_eV, m.barrier_interval_eV, "eV"))
        for way, m in (("sweeps", junction.gap_law), ("closed loop", junction.loop_plant))
        if m is not None
    ]
    return (
        Card(
            title="Tip",
            score=None,
            tone=tone,
            word=said,
            why="Judged by the rules of the chapter on the junction.",
            remedy="See the chapters on the junction and its loop.",
            figures=tunnelling.small_figures(page, LOOP, RESIDUAL),
            facts=(
                *barrier,
                ("Bandwidth", "none" if loop is None else told(loop[1].bandwidth_Hz, "Hz")),
                ("Guaranteed error", "none: it regulates a current"),
                ("Ships", ships(page, name)),
            ),
        ),
    )


def _loop(page: Page, name: str) -> LoopDesign | None:
    return next((axis.recommended for axis in _axes(page) if axis.axis == name), None)


def _axes(page: Page) -> tuple[AxisDesign, ...]:
    return () if page.design is None else page.design.axes


def _guarantee(page: Page, loop: LoopDesign | None, range_m: float) -> str:
    if loop is None:
        return "none: no controller"
    if loop.certificate is None:
        return "none: no bound of the hysteresis is known"
    if not loop.certificate.is_guaranteed:
        return "none: small gain not proven"
    if page.verification is None or not page.verification.passed:
        return "none: not verified"
    proven = loop.certificate
    speed_m_per_s = spiral_speed_m_per_s(TRACKED_Hz, page.verification.radius_m)
    most_m, slow_m = proven.guaranteed_error_m, proven.guaranteed_at(speed_m_per_s)
    if not np.isfinite(most_m):
        return "none: not bounded"
    if min(slow_m, most_m) > range_m:
        return "none of use: wider than the stroke"
    at_most = f"{told(most_m, 'm')} at most" if most_m <= range_m else "none of use at the fastest"
    return f"{told(slow_m, 'm')} at {TRACKED_Hz:g} Hz, {at_most}" if slow_m < most_m else at_most
