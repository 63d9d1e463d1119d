"""Report a drive or displacement that is missing, implausibly large, not measured or held."""

from collections.abc import Sequence

import numpy as np

from piezoid.formatting import with_unit
from piezoid.records.drive_signal import is_mostly_driven
from piezoid.records.lab import Lab
from piezoid.records.recording import Quantity, Recording
from piezoid.records.sample_statistics import MIN_MOTION_NOISE, noise_rms
from piezoid.statement import Statement, finding

# Gain per volt: tubes some nm, stacks 0.1 to 1 um, levers and benders 10 um; an objective 40 um
# per volt at the amplifier's input.
MIN_GAIN_m_per_V, MAX_GAIN_m_per_V = 1e-10, 5e-5
# A sensor is held by feedback or by a fault if block means over a hundredth of the recording stay
# within the noise of single samples, although the drive moves far enough to displace the stage
# visibly at the gain of the rest of the recording.
BLOCKS = 100
MIN_HELD_BLOCKS = 10
MIN_MISSING_NOISE = 5.0  # standard deviations of the noise
# Of the drive's range, if the gain is unknown for lack of motion; 0.57 in the hold of an approach.
MIN_DRIVE_SHARE = 0.3
MIN_THROUGHOUT = 0.9  # of the samples; the loop settles in the others. 0.98 in the same hold


def check_gain(recording: Recording, axis: str) -> list[Statement]:
    """Report an implausible gain: a wrong unit, or a drive recorded at a monitor output.

    gain = range of the displacement / range of the drive; counts have no gain
    """
    displacement_m = recording.displacement_m(axis)
    range_V, range_m = float(np.ptp(recording.voltage_V(axis))), float(np.ptp(displacement_m))
    is_motion = range_m > 0.0 and range_m >= MIN_MOTION_NOISE * noise_rms(displacement_m)
    if recording.counted or not range_V > 0.0 or not is_motion:
        return []
    gain_m_per_V = range_m / range_V
    if MIN_GAIN_m_per_V <= gain_m_per_V <= MAX_GAIN_m_per_V:
        return []
    text = (
        f"{with_unit(range_m, 'm')} for {with_unit(range_V, 'V')} is a gain of "
        f"{with_unit(gain_m_per_V, 'm')} per volt; stages have {with_unit(MIN_GAIN_m_per_V, 'm')} "
        f"to {with_unit(MAX_GAIN_m_per_V, 'm')} per volt. Check the units, and whether the drive "
        "is the output of a monitor."
    )
    return [finding("implausible_gain", text, axis=axis, value=gain_m_per_V, unit="m/V")]


# Share of samples below an earlier one: at least 0.28 in 20 measured or simulated recordings that
# go up and down, 1e-4 in a command on a grid of 12 bits behind a drive of six decimals.
MAX_FALLING = 0.03
MAX_SHIFT = 2  # samples between a command and its output as the drive
MIN_LEVELS = 100  # the hysteresis of a coarser reading may be smaller than a step
MIN_BRANCH = 0.2  # of the samples, rising and falling: the displacement of one branch never falls


def check_commanded_displacement(recording: Recording, axis: str) -> list[Statement]:
    """Report a displacement that is a function of the drive to the last digit.

    Sorted by the drive, a displacement computed from it never falls. A measured one falls because
    of its noise and, between rising and falling branches, its hysteresis.
    """
    drive_V, displacement_m = recording.voltage_V(axis), recording.displacement_m(axis)
    steps = np.diff(drive_V)
    branches = np.mean(steps > 0.0), np.mean(steps < 0.0)
    if min(branches) < MIN_BRANCH or len(np.unique(displacement_m)) < MIN_LEVELS:
        return []
    for shift in range(-MAX_SHIFT, MAX_SHIFT + 1):
        stop = len(drive_V) - abs(shift)
        v, y = drive_V[max(-shift, 0) :][:stop], displacement_m[max(shift, 0) :][:stop]
        sign = np.sign(np.dot(v - v.mean(), y - y.mean()))
        # A stable sort keeps the order in time at equal drive, to show the noise in a hold.
        by_drive = sign * y[np.argsort(v, kind="stable")]
        if np.mean(by_drive < np.maximum.accumulate(by_drive)) < MAX_FALLING:
            gain_m_per_V = float(np.ptp(displacement_m) / np.ptp(drive_V))
            text = (
                "The displacement is a function of the drive to the last digit, about "
                f"{with_unit(gain_m_per_V, 'm')}/V times the drive, rising and falling: it is a "
                "command or was computed from the drive, and nothing was measured."
            )
            return [finding("not_measured", text, axis=axis)]
    return []


_CLOSED_LOOP = {Quantity.VOLTAGE, Quantity.CURRENT, Quantity.REFERENCE}


def check_missing_channels(recording: Recording, _lab: Lab) -> list[Statement]:
    """Report a missing drive and a missing displacement.

    A closed tunnelling loop (drive, current and reference) needs no displacement.
    """
    recorded = {channel.quantity for channel in recording.channels}
    if recorded >= _CLOSED_LOOP:
        return []
    return [
        finding(
            "incomplete",
            f"No {quantity.name.lower()} is recorded; this recording cannot be fitted alone. If a "
            "column without a heading has it, add to its [[recording]] in lab.toml: "
            "columns = { time = 1, voltage = 2, displacement = 3 }",
            place="columns",
        )
        for quantity in (Quantity.VOLTAGE, Quantity.DISPLACEMENT)
        if quantity not in recorded
    ]


def check_feedback(recording: Recording, axis: str) -> list[Statement]:
    """Report the longest span in which the sensor is held constant."""
    span = held_span(recording, axis)
    if span is None:
        return []
    range_V = float(np.ptp(recording.voltage_V(axis)[span]))
    range_m = float(np.ptp(recording.displacement_m(axis)[span]))
    begin_s, end_s = (edge / recording.sampling_rate_Hz for edge in (span.start, span.stop))
    text = (
        f"From {begin_s:.4g} s to {end_s:.4g} s the sensor stays within "
        f"{with_unit(range_m, 'm')} while the drive moves by {with_unit(range_V, 'V')}: recorded "
        "under feedback, or the sensor does not see the motion."
    )
    return [finding("closed_loop", text, axis=axis, value=range_V, unit="V")]


def check_feedback_of_set(recordings: Sequence[Recording]) -> list[Statement]:
    """Report recordings held by feedback throughout, if other recordings of the axis are not."""
    statements = []
    for axis in sorted({r.axis for r in recordings}):
        of_axis = [r for r in recordings if r.axis == axis and axis in r.complete_axes]
        held_throughout = [r.name for r in of_axis if is_held_throughout(r, axis)]
        for name in held_throughout if len(held_throughout) < len(of_axis) else ():
            text = (
                f"{name}: the sensor of axis {axis} stands still while the drive moves (feedback, "
                "or a sensor that does not see the motion). It is used to find creep, not to fit "
                "loops."
            )
            statements.append(finding("held_throughout", text, axis=axis, recording=name))
    return statements


def held_span(recording: Recording, axis: str) -> slice | None:
    """Return the samples in which the sensor is constant while the drive moves, or None."""
    voltage_V, displacement_m = recording.voltage_V(axis), recording.displacement_m(axis)
    size = len(voltage_V) // BLOCKS
    if size < 4 or not np.ptp(voltage_V) > 0.0 or not np.ptp(displacement_m) > 0.0:
        return None
    block_V, block_m = (
        values[: size * BLOCKS].reshape(BLOCKS, size).mean(axis=1)
        for values in (voltage_V, displacement_m)
    )
    noise_m, range_m = noise_rms(displacement_m), float(np.ptp(block_m))
    # The longest run of blocks whose range is within the noise.
    first = stop = begin = 0
    for end in range(1, BLOCKS + 1):
        while np.ptp(block_m[begin:end]) > noise_m:
            begin += 1
        if end - begin > stop - first:
            first, stop = begin, end
    # check_columns reports a channel that is constant throughout.
    if stop - first < MIN_HELD_BLOCKS or not np.ptp(block_m[first:stop]) > 0.0:
        return None
    shows_gain = range_m > MIN_MOTION_NOISE * noise_m
    min_share = MIN_MISSING_NOISE * noise_m / range_m if shows_gain else MIN_DRIVE_SHARE
    if not np.ptp(block_V) > 0.0 or np.ptp(block_V[first:stop]) < min_share * np.ptp(block_V):
        return None
    span = slice(first * size, stop * size)
    # Block means hide a drive that oscillates within a block.
    return None if is_mostly_driven(voltage_V[span], displacement_m[span]) else span


def is_held_throughout(recording: Recording, axis: str) -> bool:
    """Return whether feedback holds the sensor in the whole recording."""
    span = held_span(recording, axis)
    return span is not None and span.stop - span.start > MIN_THROUGHOUT * recording.samples
