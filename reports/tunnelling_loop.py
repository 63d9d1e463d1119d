"""The closed tunnelling loop: plant, barrier, spectra, and the noise that limits it."""

from dataclasses import replace

import numpy as np

from piezoid.identification.tunnelling.loop_files import LoopRecord, LoopRig, is_loop, read_loop
from piezoid.identification.tunnelling.loop_model import LoopPlant, LoopSummary
from piezoid.identification.tunnelling.loop_noise import gap_motion, power_density
from piezoid.identification.tunnelling.model import JointBarrier, TunnellingModel
from piezoid.numerics.arrays import Array
from piezoid_reports.chart import Canvas, Layer, decades_over
from piezoid_reports.page import Page
from piezoid_reports.parts import Figure, Heading, Part, Prose, Table, with_rows
from piezoid_reports.quantities import number, percent, significant, with_interval

SOURCES = {
    "shot": "shot noise",
    "johnson": "Johnson noise of the resistor",
    "adc_step": "step of the current's converter",
    "drive_step": "step of the drive's converter",
    "gap": "motion of the gap",
}
GUIDE_SPECTRA = (
    "Good: below the bandwidth the drive lies on the motion of the gap, the current far below. "
    "Bad: the current above the motion over a decade, or strong mains lines."
)
LEAST_m2_per_Hz = 1e-34  # what a still column shows


def loop_parts(page: Page, junction: TunnellingModel, loop: LoopPlant) -> list[Part]:
    """Return plant, barrier and spectra of the closed loop."""
    parts: list[Part] = [Heading(text="Closed loop"), Prose(text=loop_sentence(loop))]
    if junction.joint is not None and junction.gap_law is not None:
        joint = junction.joint
        parts.append(Prose(text=joint_sentence(joint), tone="good" if joint.agree else "bad"))
    return [
        *parts,
        _plant(loop),
        *with_rows(_records(loop)),
        *_sources(loop),
        *_figures(page, loop),
    ]


def loop_sentence(loop: LoopPlant) -> str:
    """Return barrier and gain of the closed loop."""
    barrier = with_interval(loop.barrier_eV, loop.barrier_interval_eV, "eV")
    gain = with_interval(loop.plant.gain_nepers_per_V, loop.gain_interval, "")
    return (
        f"Closed loop: apparent barrier {barrier}, gain {gain} nepers per volt, "
        f"{loop.confidence.value} confidence."
    )


def joint_sentence(joint: JointBarrier) -> str:
    """Return whether sweeps and closed loop agree, with the common barrier."""
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
    rows.append(("amplifier's pole, declared", number(plant.amplifier_pole_Hz, "Hz"), "", ""))
    is_sampled = loop.family_records > 2
    spread = (
        f"the plant family covers 95 % of further spots, from {loop.family_records} records"
        if is_sampled
        else "the plant family covers the uncertainty of one record; other spots may differ"
    )
    return Table(
        caption=f"Plant from drive to ln of the current, 95 % intervals; {spread}.",
        columns=("", "identified", "family, from", "to"),
        rows=tuple(rows),
    )


def _records(loop: LoopPlant) -> Table:
    return Table(
        caption="Record by record, 95 % intervals. Drift is positive where the gap opens.",
        columns=("recording", "barrier", "naive barrier", "dither in the drive", "gap", "drift"),
        rows=tuple(
            (
                record.recording,
                with_interval(record.barrier_eV, record.barrier_interval_eV, "eV"),
                # the barrier goes with the square of the gain
                f"{significant(record.barrier_eV * (record.naive_gain / record.gain) ** 2, 3)} eV",
                percent(record.dither_share),
                "" if record.unrest is None else f"{number(record.unrest.gap_rms_m, 'm')} rms",
                _drift(record),
            )
            for record in loop.records
        ),
    )


def _drift(record: LoopSummary) -> str:
    if record.unrest is None:
        return ""
    drift = record.unrest.drift_m_per_s
    return with_interval(drift, record.unrest.drift_interval_m_per_s, "m/s")


def _sources(loop: LoopPlant) -> tuple[Part, ...]:
    unrest_of_loops = [(r.recording, r.unrest) for r in loop.records if r.unrest is not None]
    if not unrest_of_loops:
        return ()
    sources = [
        [number(source.rms_m, "m") for source in unrest.sources] for _, unrest in unrest_of_loops
    ]
    rows = [
        (SOURCES[source.name], *(column[row] for column in sources))
        for row, source in enumerate(unrest_of_loops[0][1].sources)
    ]
    return (
        Table(
            caption="Contributions to the motion of the gap, rms within "
            f"{number(unrest_of_loops[0][1].bandwidth_Hz, 'Hz')}.",
            columns=("", *(name for name, _ in unrest_of_loops)),
            rows=tuple(rows),
        ),
    )


def _figures(page: Page, loop: LoopPlant) -> list[Part]:
    """Return the spectra of the first recording of the fit."""
    if loop.rig is None:
        return []
    fitted = {record.recording: record for record in loop.records}
    figures = [
        _spectra(loop, loop.rig, fitted[recording.name], read_loop(recording, loop.rig))
        for recording in page.recordings
        if is_loop(recording) and recording.name in fitted
    ]
    return list(figures[:1])


def _spectra(loop: LoopPlant, rig: LoopRig, summary: LoopSummary, record: LoopRecord) -> Figure:
    """Draw current, drive and motion of the gap as displacement densities."""
    curves = _curves(loop, rig, summary, record)
    x = decades_over("frequency", [f for _, _, f, _ in curves], "Hz")
    y = decades_over("density", [level for *_, level in curves], "pm/√Hz")
    canvas = Canvas(x=x, y=y)
    mains = () if summary.unrest is None else summary.unrest.mains
    caption = "The record is too short for drift and mains lines."
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


def _curves(
    loop: LoopPlant, rig: LoopRig, summary: LoopSummary, record: LoopRecord
) -> list[tuple[str, str, Array, Array]]:
    """Return role, name, log10 of the frequency in Hz and of the density in pm/√Hz."""
    from scipy.signal import detrend

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
        pm = 0.5 * np.log10(np.maximum(density[1:], LEAST_m2_per_Hz)) + 12.0
        curves.append((role, name, np.log10(f_Hz[1:]), np.asarray(pm)))
    return curves
