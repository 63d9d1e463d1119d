"""Report a drive or a displacement that is missing, implausibly large, or was not measured."""

import numpy as np

from piezoid.formatting import with_unit
from piezoid.records.lab import Lab
from piezoid.records.recording import Quantity, Recording
from piezoid.records.sample_statistics import MIN_MOTION_NOISE, noise_rms
from piezoid.statement import Statement, finding

# Gain per volt: tubes some nm, stacks 0.1 to 1 um, levers and benders 10 um; an objective 40 um
# per volt at the amplifier's input.
MIN_GAIN_m_per_V, MAX_GAIN_m_per_V = 1e-10, 5e-5


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
            f"No {quantity.name.lower()} is recorded; this recording cannot be fitted alone.",
            place="columns",
        )
        for quantity in (Quantity.VOLTAGE, Quantity.DISPLACEMENT)
        if quantity not in recorded
    ]
