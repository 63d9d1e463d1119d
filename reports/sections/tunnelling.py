"""Tunnelling junction: current over height, barrier, and the closed loop with its noise."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from piezoid.formatting import count_of
from piezoid.identification.quality import Confidence
from piezoid.identification.tunnelling.approach import Direction
from piezoid.identification.tunnelling.barrier_fit import GapLaw
from piezoid.identification.tunnelling.closed_loop import LoopPlant, LoopSummary
from piezoid.identification.tunnelling.junction import JointBarrier, TunnellingModel, curves_of
from piezoid.identification.tunnelling.loop_files import LoopRecord, LoopRig, is_loop, read_loop
from piezoid.identification.tunnelling.loop_noise import gap_motion, power_density
from piezoid.numerics.arrays import Array
from piezoid_reports.chart import Canvas, Layer, axis_over, decades_over
from piezoid_reports.page import Page
from piezoid_reports.parts import (
    Figure,
    Heading,
    Part,
    Prose,
    Section,
    Table,
    side_by_side,
    with_rows,
)
from piezoid_reports.quantities import number, percent, significant, with_interval

GUIDE_CURVE = (
    "Good: points on the line over three decades. Bad: two slopes, or a step. "
    "Points at or below zero are fitted but not drawn."
)
GUIDE_RESIDUAL = (
    "Good: scatter about zero. Bad: a bow (creep of the height) or a step (the tip changed)."
)
CONFIDENCE = {
    Confidence.HIGH: ("good", "high confidence"),
    Confidence.MEDIUM: ("middling", "medium confidence"),
    Confidence.LOW: ("bad", "low confidence"),
}
POLARITY = {1.0: "positive", -1.0: "negative"}
SOURCES = {
    "shot": "shot noise",
    "johnson": "Johnson noise of the resistor",
    "adc_step": "resolution of the current's converter",
    "drive_step": "resolution of the drive's converter",
    "gap": "motion of the gap",
}
GUIDE_SPECTRA = (
    "Good: below the bandwidth the drive lies on the motion of the gap, with the current far "
    "below. Bad: the current above the motion over a decade, or strong mains lines."
)
MIN_DENSITY_m2_per_Hz = 1e-34  # drawn for a constant signal
LAW_SIZES = (Canvas.width, Canvas.height), (Canvas.width, 260)  # pixels

Curve = tuple[Array, Array]  # height in m and current in A


def render(page: Page) -> Section | None:
    """Return the gap law with its curves and the closed loop, if they were recorded."""
    junction = page.model.tunnelling
    if junction is None or (junction.gap_law is None and junction.loop_plant is None):
        return None
    parts: list[Part] = []
    if junction.gap_law is not None:
        law = junction.gap_law
        parts.append(Prose(text=barrier_sentence(law), tone=CONFIDENCE[law.confidence][0]))
        parts.append(_table(junction, page))
        if junction.shift is not None:
            shift = junction.shift
            is_same = shift.is_one_decay
            verdict = "one decay fits both directions" if is_same else "the two decays differ"
            low, high = shift.decay_change_interval
            text = (
                f"Backward sweeps reach {number(shift.reference_current_A, 'A')} at a height that "
                f"differs from the forward sweeps by "
                f"{with_interval(shift.shift_m, shift.shift_interval_m, 'm')}, because of "
                f"hysteresis, creep and drift. The decay differs by {percent(shift.decay_change)} "
                f"({percent(low)} to {percent(high)}): {verdict}."
            )
            parts.append(Prose(text=text, tone="plain" if is_same else "middling"))
        parts += law_figures(page)
    if junction.loop_plant is not None:
        parts += loop_parts(page, junction, junction.loop_plant)
    return Section(
        anchor="tunnelling",
        title="Tunnelling",
        lead="The current decays exponentially with the height of the tip. The decay gives the "
        "apparent barrier, and the gain of the height loop is proportional to its square root. "
        "Confidence: high if every criterion is met, medium or low otherwise; Limits names the "
        "criteria.",
        parts=tuple(parts),
    )


def barrier_sentence(law: GapLaw) -> str:
    """Return barrier, interval and confidence of the gap law as a sentence."""
    barrier = with_interval(law.barrier_eV, law.barrier_interval_eV, "eV")
    unmet = f"; {len(law.reasons)} criteria are not met" if law.reasons else ""
    return f"Apparent barrier {barrier}, {law.confidence.value} confidence{unmet}."


def law_figures(page: Page, *, sizes: Sequence[tuple[int, int]] = LAW_SIZES) -> tuple[Figure, ...]:
    """Draw the first gap law with sweeps over its sweeps, and its residual.

    sizes  width and height of both figures in pixels
    """
    for law, direction in _laws(page):
        curves = []  # ascending heights, and the current without offset, with positive polarity
        for curve in curves_of(page.sweeps):
            if curve.direction is direction:
                order = np.argsort(curve.height_m, kind="stable")
                current_A = law.polarity * (curve.current_A[order] - law.offset_A)
                curves.append((curve.height_m[order], current_A))
        if curves:
            return _current(law, curves, *sizes[0]), _residual(law, curves, *sizes[1])
    return ()


def _laws(page: Page) -> tuple[tuple[GapLaw, Direction], ...]:
    junction = page.model.tunnelling
    if junction is None or junction.gap_law is None:
        return ()
    if junction.forward is not None and junction.backward is not None:
        return (junction.forward, Direction.FORWARD), (junction.backward, Direction.BACKWARD)
    directions = {curve.direction for curve in curves_of(page.sweeps)}
    direction = Direction.BACKWARD if directions == {Direction.BACKWARD} else Direction.FORWARD
    return ((junction.gap_law, direction),)


def _table(junction: TunnellingModel, page: Page) -> Table:
    laws = _laws(page)
    by_direction = [(direction.value, law) for law, direction in laws]
    note = ""
    if len(laws) > 1 and junction.gap_law is not None:
        by_direction.insert(0, ("both directions", junction.gap_law))
        note = " Only the law of both directions is free of height drift."
    columns = []
    for _, law in by_direction:
        low, high = law.decay_interval_per_m
        column = {
            "barrier": with_interval(law.barrier_eV, law.barrier_interval_eV, "eV"),
            "decay k [1/nm]": with_interval(1e-9 * law.decay_per_m, (1e-9 * low, 1e-9 * high), ""),
            "noise without current, rms": number(law.floor_A, "A"),
            "jitter of the gap, rms at most": number(law.gap_jitter_m, "m"),
        }
        columns.append(column)
    return Table(
        caption="Gap law i = ± I0 exp(\N{MINUS SIGN}k z) + offset, z growing as the tip "
        f"retracts; 95 % intervals. The barrier is (k / 10.246 per nm)², in eV.{note}",
        columns=("", *(heading for heading, _ in by_direction)),
        rows=side_by_side(columns),
    )


def _modelled(law: GapLaw, height_m: Array) -> Array:
    current_A = law.current_at_zero_height_A * np.exp(-law.decay_per_m * height_m)
    return np.asarray(current_A)


def _current(law: GapLaw, curves: Sequence[Curve], width: int, height: int) -> Figure:
    """Draw the positive currents over the height on a logarithmic axis."""
    heights_m = np.unique(np.concatenate([height_m for height_m, _ in curves]))
    floor = np.log10(law.floor_A / 1e-12)
    logs = [np.log10(np.where(i > 0.0, i, np.nan) / 1e-12) for _, i in curves]
    line = np.log10(_modelled(law, heights_m) / 1e-12)
    x = axis_over("height", [heights_m], "m")
    y = decades_over("current", [*logs, np.array([floor])], "pA")
    canvas = Canvas(x=x, y=y, width=width, height=height)
    is_compared = line > floor - 1.0  # no measurement shows currents far below the noise
    return Figure(
        title=f"Current over height, {count_of(len(curves), 'sweep')}",
        caption=f"Polarity {POLARITY[law.polarity]}, offset {number(law.offset_A, 'A')} removed.",
        guide=GUIDE_CURVE,
        canvas=canvas,
        layers=(
            *(
                canvas.line("measured", f"sweep {k + 1}", height_m, log, points=400)
                for k, ((height_m, _), log) in enumerate(zip(curves, logs, strict=True))
            ),
            canvas.line("model", "gap law", heights_m[is_compared], line[is_compared]),
            canvas.line("zero", "noise, rms", heights_m[[0, -1]], np.full(2, floor)),
        ),
    )


def _residual(law: GapLaw, curves: Sequence[Curve], width: int, height: int) -> Figure:
    residuals_A = [current_A - _modelled(law, height_m) for height_m, current_A in curves]
    x = axis_over("height", [height_m for height_m, _ in curves], "m")
    y = axis_over("measured minus gap law", residuals_A, "A", symmetric=True)
    canvas = Canvas(x=x, y=y, width=width, height=height)
    rms_A = float(np.sqrt(np.mean(np.concatenate(residuals_A) ** 2)))
    ends_m = np.array([x.low, x.high]) * x.scale.factor
    return Figure(
        title="Residual of the gap law",
        caption=f"{number(rms_A, 'A')} rms; the noise without current is "
        f"{number(law.floor_A, 'A')}.",
        guide=GUIDE_RESIDUAL,
        canvas=canvas,
        layers=(
            canvas.line("zero", "gap law", ends_m, np.zeros(2)),
            *(
                canvas.line("measured", f"sweep {k + 1}", height_m, residual_A, points=400)
                for k, ((height_m, _), residual_A) in enumerate(
                    zip(curves, residuals_A, strict=True)
                )
            ),
        ),
    )


def loop_parts(page: Page, junction: TunnellingModel, loop: LoopPlant) -> list[Part]:
    """Return plant, barrier and spectra of the closed loop."""
    parts: list[Part] = [Heading(text="Closed loop"), Prose(text=loop_sentence(loop))]
    if junction.joint is not None and junction.gap_law is not None:
        joint = junction.joint
        parts.append(Prose(text=joint_sentence(joint), tone="good" if joint.agree else "bad"))
    parts.append(_plant(loop))
    rows = []
    for record in loop.records:
        barrier = with_interval(record.barrier_eV, record.barrier_interval_eV, "eV")
        # The barrier is proportional to the square of the gain.
        naive_eV = record.barrier_eV * (record.naive_gain / record.gain) ** 2
        gap, drift, unrest = "", "", record.unrest
        if unrest is not None:
            gap = f"{number(unrest.gap_rms_m, 'm')} rms"
            drift = with_interval(unrest.drift_m_per_s, unrest.drift_interval_m_per_s, "m/s")
        dither, naive = percent(record.dither_share), f"{significant(naive_eV, 3)} eV"
        rows.append((record.recording, barrier, naive, dither, gap, drift))
    parts += with_rows(
        Table(
            caption="Results of each recording, 95 % intervals. Naive barrier: from the ratio of "
            "current to drive without the dither as reference, wrong in closed loop and shown for "
            "comparison. Drift is positive if the gap opens.",
            columns=(
                "recording",
                "barrier",
                "naive barrier",
                "dither in the drive",
                "gap",
                "drift",
            ),
            rows=tuple(rows),
        )
    )
    unrest_of = {r.recording: r.unrest for r in loop.records if r.unrest is not None}
    if unrest_of:
        first = next(iter(unrest_of.values()))
        sizes = [[number(source.rms_m, "m") for source in u.sources] for u in unrest_of.values()]
        names = [SOURCES[source.name] for source in first.sources]
        parts.append(
            Table(
                caption="Contributions to the motion of the gap, rms within "
                f"{number(first.bandwidth_Hz, 'Hz')}.",
                columns=("", *unrest_of),
                rows=tuple(zip(names, *sizes, strict=True)),
            )
        )
    summaries = {record.recording: record for record in loop.records}
    fitted = [r for r in page.recordings if is_loop(r) and r.name in summaries]
    if loop.rig is not None and fitted:
        spectra = _spectra(
            loop, loop.rig, summaries[fitted[0].name], read_loop(fitted[0], loop.rig)
        )
        parts.append(spectra)
    return parts


def loop_sentence(loop: LoopPlant) -> str:
    """Return barrier and gain of the closed loop as a sentence."""
    barrier = with_interval(loop.barrier_eV, loop.barrier_interval_eV, "eV")
    gain = with_interval(loop.plant.gain_nepers_per_V, loop.gain_interval, "")
    return (
        f"Closed loop: apparent barrier {barrier}, gain {gain} nepers per volt (change of the "
        f"logarithm of the current), {loop.confidence.value} confidence."
    )


def joint_sentence(joint: JointBarrier) -> str:
    """Return whether sweeps and closed loop agree, and their barrier, as a sentence."""
    if joint.barrier_eV is not None:
        common = with_interval(joint.barrier_eV, joint.barrier_interval_eV, "eV")
        return f"Sweeps and loop agree: weighted barrier {common}."
    low, high = (significant(end, 4) for end in joint.barrier_interval_eV)
    return f"Sweeps and loop disagree: the barrier lies between {low} and {high} eV."


def _plant(loop: LoopPlant) -> Table:
    family = {
        "gain [nepers per V]": [significant(m.gain_nepers_per_V, 4) for m in loop.family],
        "sensor pole": [number(m.sensor_pole_Hz, "Hz") for m in loop.family],
        "delay": [number(m.delay_s, "s") for m in loop.family],
    }
    plant = loop.plant
    identified = {
        "gain [nepers per V]": with_interval(plant.gain_nepers_per_V, loop.gain_interval, ""),
        "sensor pole": with_interval(plant.sensor_pole_Hz, loop.sensor_pole_interval_Hz, "Hz"),
        "delay": with_interval(plant.delay_s, loop.delay_interval_s, "s"),
    }
    rows = []
    for k, (name, text) in enumerate(identified.items()):
        extremes = family[name][1 + 2 * k : 3 + 2 * k]
        rows.append((name, text, *(extremes if len(extremes) == 2 else ("", ""))))
    rows.append(("amplifier pole, declared", number(plant.amplifier_pole_Hz, "Hz"), "", ""))
    is_sampled = loop.family_records > 2
    spread = (
        f"the plant family covers 95 % of other spots, from {loop.family_records} recordings"
        if is_sampled
        else "the plant family covers the uncertainty of one recording; other spots may differ"
    )
    return Table(
        caption=f"Plant from the drive to ln of the current, 95 % intervals; {spread}.",
        columns=("", "identified", "family, from", "to"),
        rows=tuple(rows),
    )


def _spectra(loop: LoopPlant, rig: LoopRig, summary: LoopSummary, record: LoopRecord) -> Figure:
    """Draw current, drive and motion of the gap as displacement densities."""
    from scipy.signal import detrend

    # Role, name, log10 of the frequency in Hz and of the density in pm/√Hz.
    rate_Hz, per_V = record.sampling_rate_Hz, rig.drive_gain_m_per_V
    signals_m = [
        ("before", "current", per_V / summary.gain * record.log_current),
        ("model", "drive", per_V * record.drive_V),
    ]
    if summary.unrest is not None:
        plant = replace(loop.plant, gain_nepers_per_V=summary.gain)
        motion_m = gap_motion(record, plant, summary.gain / per_V)
        signals_m.append(("trend", "motion of the gap", motion_m))
    curves = []
    for role, name, signal_m in signals_m:
        f_Hz, density = power_density(np.asarray(detrend(signal_m)), rate_Hz)
        pm = 0.5 * np.log10(np.maximum(density[1:], MIN_DENSITY_m2_per_Hz)) + 12.0
        curves.append((role, name, np.log10(f_Hz[1:]), np.asarray(pm)))
    x = decades_over("frequency", [f for _, _, f, _ in curves], "Hz")
    y = decades_over("density", [level for *_, level in curves], "pm/√Hz")
    canvas = Canvas(x=x, y=y)
    mains = () if summary.unrest is None else summary.unrest.mains
    caption = "The recording is too short for drift and mains lines."
    if summary.unrest is not None:
        lines = [f"{number(m.frequency_Hz, 'Hz')}: {number(m.amplitude_m, 'm')}" for m in mains]
        caption = f"Mains lines found: {', '.join(lines) or 'none'}."
    height = np.array([y.low, y.high])
    layers: list[Layer] = [
        canvas.line(
            "zero",
            f"mains, {line.frequency_Hz:.0f} Hz",
            np.full(2, np.log10(line.frequency_Hz)),
            height,
        )
        for line in mains
    ]
    layers += [canvas.line(role, name, f, level, points=900) for role, name, f, level in curves]
    return Figure(
        title=f"Spectra in the closed loop: {summary.recording}",
        caption=caption,
        guide=GUIDE_SPECTRA,
        canvas=canvas,
        layers=tuple(layers),
    )
