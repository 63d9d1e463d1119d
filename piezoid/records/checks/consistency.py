"""Report recordings of a stage that are inconsistent in gain, unit or drive range, or copies.

A contradictory gain is caused by another unit, monitor, polarity or stage.

The gain of each recording is estimated at the lowest frequencies of its drive, with a small share
of the drive's power: a mode lies far above them in a sweep, and above tens of hertz in a chirp.
Only recordings with coherent drive and displacement at these frequencies are compared.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Self

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from piezoid.errors import RecordingError
from piezoid.formatting import significant, with_unit
from piezoid.numerics.arrays import Array, runs_of
from piezoid.raw_counts import in_counts
from piezoid.records.checks.plausibility import MAX_GAIN_m_per_V, MIN_GAIN_m_per_V, held_span
from piezoid.records.lab_tables import entry_text
from piezoid.records.recording import Quantity, Recording, counted_in
from piezoid.records.sample_statistics import MIN_MOTION_NOISE, noise_rms
from piezoid.statement import Statement, finding

POWER_SHARE = 0.02  # of the drive, in the lowest lines
MIN_LINES = 10  # the initial state of the stage may dominate the first two or three
# Above this multiple of the lowest of the frequencies a mode may have reversed the sign.
MAX_FREQUENCY_RATIO = 10.0
SLOW_Hz = 1.0
# A rest longer than this share of a recording is left out. A sine of one period stays within a
# hundredth of its range for 0.06 of it, a step of a staircase mostly for less than a twentieth.
MAX_REST = 0.1
MIN_COHERENCE = 0.8
# Ceramics move up to twice as far per volt over their full range as in small loops; the output of
# a monitor is a fifth of the drive at most.
MAX_GAIN_RATIO = 3.0
UNIT_TOLERANCE = 0.1  # decades over three, of a factor of a thousand
MONITORS = (5, 10, 15, 20, 25, 30, 40, 50, 100, 200)
# A ratio of gains is exactly that of a monitor within this (natural logarithm). Loops of other
# size or speed differ more: by 1.17 between sweep and check of the bundled stage.
MONITOR_TOLERANCE = 0.03
LOOP_TOLERANCE = 0.25
MIN_RANGE = 0.01  # of the widest drive; the hysteresis cannot be identified from a smaller one
_MAX_NAMES = 3  # in a message

Range_V = tuple[float, float]


@dataclass(frozen=True, kw_only=True, eq=False)
class LowFrequencyGain:
    """Gain of one recording at the lowest frequencies of its drive.

    name          of the recording
    gain_m_per_V  in phase
    coherence     0 to 1
    frequency_Hz  mean over the power of the drive
    range_ratio   m/V, range of the readings over that of the drive
    voltage_V     lowest and highest drive
    """

    name: str
    gain_m_per_V: float
    coherence: float
    frequency_Hz: float
    range_ratio: float
    voltage_V: Range_V

    @classmethod
    def of(cls, recording: Recording, axis: str) -> Self | None:
        """Estimate the gain; None if the drive rests, or if there is no motion or a feedback."""
        # During a rest of minutes the stage creeps, and the lowest frequencies of the whole
        # recording would show the creep, of either sign.
        voltage_V = recording.voltage_V(axis)
        length = max(int(MAX_REST * len(voltage_V)), 1)
        span_V = maximum_filter1d(voltage_V, length) - minimum_filter1d(voltage_V, length)
        is_centre_of_rest = span_V <= MIN_RANGE * float(np.ptp(voltage_V))
        is_moving = ~maximum_filter1d(is_centre_of_rest, length)
        voltage_V = voltage_V[is_moving]
        displacement_m = recording.displacement_m(axis)[is_moving]
        if len(voltage_V) < 8 or not np.ptp(voltage_V) > 0.0:
            return None
        range_m = float(np.ptp(displacement_m))
        is_motion = range_m > MIN_MOTION_NOISE * noise_rms(displacement_m)
        if not is_motion or held_span(recording, axis) is not None:
            return None
        # A recording seldom has whole periods: without a window the lines of a multisine leak into
        # the lowest ones. The window weights the means as well, since other means would leak.
        window = np.hanning(len(voltage_V) + 2)[1:-1]
        drive, response = (
            np.fft.rfft(window * (values - np.average(values, weights=window)))[1:]
            for values in (voltage_V, displacement_m)
        )
        power = np.abs(drive) ** 2
        # Both neighbours of the last line are included, since a sine seldom has whole periods.
        count = int(np.searchsorted(np.cumsum(power), POWER_SHARE * power.sum())) + 2
        count = max(count, MIN_LINES)
        drive, response, power = drive[:count], response[:count], power[:count]
        cross = complex(np.vdot(drive, response))
        energy = float(power.sum() * (np.abs(response) ** 2).sum())
        lines_Hz = np.arange(1, len(power) + 1) * recording.sampling_rate_Hz / len(voltage_V)
        return cls(
            name=recording.name,
            gain_m_per_V=cross.real / float(power.sum()),
            coherence=abs(cross) / math.sqrt(energy) if energy > 0.0 else 0.0,
            frequency_Hz=float((lines_Hz * power).sum() / power.sum()),
            range_ratio=range_m / float(np.ptp(voltage_V)),
            voltage_V=(float(voltage_V.min()), float(voltage_V.max())),
        )

    @property
    def text(self) -> str:
        """Gain and drive, for messages."""
        low_V, high_V = (with_unit(end, "V") for end in self.voltage_V)
        return f"{with_unit(self.gain_m_per_V, 'm')} per volt (drive {low_V} to {high_V})"


def check_mixed_units(recordings: Sequence[Recording]) -> list[Statement]:
    """Report each recording in counts of a quantity that others have in SI units."""
    statements = []
    for quantity in (Quantity.VOLTAGE, Quantity.DISPLACEMENT):
        channels = [(r.name, c) for r in recordings for c in r.channels if c.quantity is quantity]
        in_si = sorted({name for name, channel in channels if not channel.is_counted})
        in_counts = dict.fromkeys(name for name, channel in channels if channel.is_counted)
        kind, si = quantity.name.lower(), quantity.value
        for name in in_counts if in_si else ():
            text = (
                f"The {kind} of {name} is in counts, that of {', '.join(in_si[:_MAX_NAMES])} in "
                f"{si}: they cannot be compared. Write scale = {{ {kind} = ... }}, {si} per "
                "count, into its [[recording]]."
            )
            statements.append(finding("mixed_units", text, recording=name))
    return statements


def check_drive_ranges(recordings: Sequence[Recording]) -> list[Statement]:
    """Compare the drive of each recording with the widest one of its axis."""
    statements = []
    for axis in sorted({r.axis for r in recordings}):
        drives = {r.name: r.voltage_V(axis) for r in recordings if axis in r.complete_axes}
        if len(drives) < 2:
            continue
        widest = max(drives, key=lambda name: float(np.ptp(drives[name])))
        widest_V = float(np.ptp(drives[widest]))
        for name, drive in drives.items():
            range_V = float(np.ptp(drive))
            if range_V <= MIN_RANGE * widest_V:
                text = (
                    f"{name}: the drive of axis {axis} moves by {with_unit(range_V, 'V')}, less "
                    f"than a hundredth of the {with_unit(widest_V, 'V')} of {widest}; it may show "
                    "the dynamics, but not the hysteresis."
                )
                statements.append(
                    finding(
                        "drive_range", text, axis=axis, recording=name, value=range_V, unit="V"
                    )
                )
    return statements


def check_consistency(recordings: Sequence[Recording]) -> list[Statement]:
    """Report each recording whose gain contradicts that of most others on its axis."""
    return [statement for statement, _ in _inconsistencies(recordings)]


def _inconsistencies(recordings: Sequence[Recording]) -> list[tuple[Statement, str]]:
    """Return each inconsistency with the line of lab.toml that would correct it."""
    statements = []
    for axis in sorted({axis for r in recordings for axis in r.complete_axes}):
        gains = [
            gain
            for r in recordings
            if axis in r.complete_axes and (gain := LowFrequencyGain.of(r, axis)) is not None
        ]
        coherent = [gain for gain in gains if gain.coherence > MIN_COHERENCE]
        if len(coherent) < 2:
            continue
        slowest_Hz = max(min(gain.frequency_Hz for gain in coherent), SLOW_Hz)
        slow = [g for g in coherent if g.frequency_Hz <= MAX_FREQUENCY_RATIO * slowest_Hz]
        # The gain that agrees with most others. Ties are resolved by a plausible gain, then by a
        # positive gain, then by the drive range.
        typical = max(
            slow,
            key=lambda gain: (
                sum(_is_alike(reference.gain_m_per_V / gain.gain_m_per_V) for reference in slow),
                MIN_GAIN_m_per_V <= abs(gain.gain_m_per_V) <= MAX_GAIN_m_per_V,
                gain.gain_m_per_V > 0.0,
                gain.voltage_V[1] - gain.voltage_V[0],
            ),
        )
        # Between two holds of nearly one level the lowest frequencies show hysteresis and creep
        # rather than the gain; the ratio of the ranges is then the better measure.
        statements += [
            inconsistency(gain, typical, axis)
            for gain in slow
            if gain.gain_m_per_V * typical.gain_m_per_V <= 0.0
            or not (
                _is_alike(gain.gain_m_per_V / typical.gain_m_per_V)
                or _is_alike(gain.range_ratio / typical.range_ratio)
            )
        ]
    return statements


def refuse_inconsistent(recordings: Sequence[Recording]) -> None:
    """Refuse recordings that contradict each other, since no single model represents them.

    Raises ``RecordingError`` with the lines of lab.toml that would reconcile them.
    """
    needed = "one unit in all recordings of a stage"
    advice = "Write into lab.toml:"
    contradictions = [(s, "scale = { ... }") for s in check_mixed_units(recordings)]
    counted: tuple[str, ...] = ()
    if not contradictions:
        needed = "recordings of one stage, in true units and with one polarity"
        advice = (
            "Find out which recording is wrong. Correct it in lab.toml, as below if it is the one "
            "named there, or leave out a file of another stage:"
        )
        contradictions, counted = _inconsistencies(recordings), counted_in(recordings)
    if contradictions:
        texts = in_counts(" ".join(statement.text for statement, _ in contradictions), counted)
        # A recording may be a part of its file.
        entries = [entry_text(s.recording.partition(" (part ")[0], x) for s, x in contradictions]
        raise RecordingError(
            f"the recordings contradict each other: {texts.rstrip('.')}",
            needed=needed,
            remedy="\n\n".join([advice, *entries]) + "\n",
        )


def _is_alike(ratio: float) -> bool:
    return 1.0 / MAX_GAIN_RATIO < ratio < MAX_GAIN_RATIO


def inconsistency(
    gain: LowFrequencyGain, typical: LowFrequencyGain, axis: str
) -> tuple[Statement, str]:
    """Return the statement about one recording, and the line of lab.toml that would correct it."""
    ratio = gain.gain_m_per_V / typical.gain_m_per_V
    size, sign = abs(ratio), "-" if ratio < 0.0 else ""
    spans_V = [g.voltage_V[1] - g.voltage_V[0] for g in (gain, typical)]
    # If the range of the drive differs by the same factor as the gain, the drive is wrong.
    is_drive = abs(math.log(size * spans_V[0] / spans_V[1])) < abs(
        math.log(spans_V[0] / spans_V[1])
    )
    comparison = f"{gain.name} moves {significant(max(size, 1.0 / size))} times "
    comparison += "more" if size > 1.0 else "less"
    thousands = math.log10(size) / 3.0
    distances = {monitor: abs(math.log(size / monitor)) for monitor in MONITORS}
    monitors = [m for m in MONITORS if distances[m] < MONITOR_TOLERANCE]
    monitors = monitors or [m for m in MONITORS if distances[m] < LOOP_TOLERANCE]
    if _is_alike(size):
        comparison, cause = "opposite sign", "opposite polarity of drive or sensor"
        line = "scale = { voltage = -1 }   # or displacement = -1"
    elif round(thousands) and abs(thousands - round(thousands)) < UNIT_TOLERANCE:
        factor = 10.0 ** (3 * round(thousands))
        cause, line = "another unit of the drive", f"scale = {{ voltage = {sign}{factor:g} }}"
        if not is_drive:
            cause = "another unit of the displacement"
            line = f"scale = {{ displacement = {sign}{1.0 / factor:g} }}"
    elif is_drive and monitors:
        exact = len(monitors) == 1 and distances[monitors[0]] < MONITOR_TOLERANCE
        names = " or ".join(f"1/{monitor}" for monitor in monitors)
        cause = (
            f"the drive is the output of a monitor ({names}) or the command in front of the "
            "amplifier"
        )
        scale = f"{sign}{monitors[0]}" if exact else "..."
        comment = "" if exact else f"   # volts at the stage for {sign}1 V of the monitor"
        line = f"scale = {{ voltage = {scale} }}{comment}"
    else:
        cause = "another axis, stage or range of the sensor"
        line = 'axis = "..."   # or scale = { displacement = ... }'
    if ratio < 0.0 and not _is_alike(size):
        comparison += ", opposite sign"
        cause += " and opposite polarity"
    text = (
        f"{gain.name} moves {gain.text}, {typical.name} {typical.text}: {comparison}. "
        f"Likely cause: {cause}."
    )
    statement = finding(
        "does_not_fit", text, axis=axis, recording=gain.name, value=ratio, unit="1"
    )
    return statement, line


# A copy differs only in its digits or its unit; two recordings of one drive differ by the noise. A
# part of a file, or an overlapping export, has common rows with it.
MAX_DIFFERENCE = 0.3  # standard deviations of the noise; two recordings differ by 1.4
MIN_ROWS = 100  # noisy readings do not agree in so many rows by chance
MIN_SHARED = 0.5  # of the rows of the shorter recording, which is then left out
SAME_DRIVE = 1e-3  # rms of the difference of the standardised drives
_FIRST_SAMPLES = 1000  # compared before all samples are


def check_copies(recordings: Sequence[Recording]) -> list[Statement]:
    """Report each recording that is a copy or a part of another one."""
    return [
        finding("copy", f"{copy} holds samples of {original} and is left out.", recording=copy)
        for copy, original in copies(recordings).items()
    ]


def copies(recordings: Sequence[Recording]) -> dict[str, str]:
    """Return the name of the original by the name of each copy.

    The copy is the later of two equal recordings, or the shorter of two recordings that share half
    of its rows.
    """
    original_of: dict[str, str] = {}
    for first, second in combinations(recordings, 2):
        if first.name in original_of or first.name == second.name:
            continue
        if is_copy(first, second):
            original_of.setdefault(second.name, first.name)
            continue
        longer, shorter = (first, second) if first.samples >= second.samples else (second, first)
        if shared_rows(longer, shorter) >= MIN_SHARED * shorter.samples:
            original_of.setdefault(shorter.name, longer.name)
    return original_of


def shared_rows(first: Recording, second: Recording) -> int:
    """Return the number of successive rows of two recordings that agree.

    The rows are compared at the offset at which most single rows agree. The result is 0 for fewer
    than ``MIN_ROWS`` rows, and without a drive or a displacement.
    """
    if first.axis != second.axis or not all(
        first.axis in recording.complete_axes for recording in (first, second)
    ):
        return 0
    rows = [
        np.stack([r.voltage_V(r.axis), r.displacement_m(r.axis)], axis=1) for r in (first, second)
    ]
    keys = [np.ascontiguousarray(values).view(np.complex128).ravel() for values in rows]
    unique, position = np.unique(keys[0], return_index=True)
    index = np.minimum(np.searchsorted(unique, keys[1]), len(unique) - 1)
    matches = np.flatnonzero(unique[index] == keys[1])
    if len(matches) < MIN_ROWS:
        return 0
    offsets, counts = np.unique(position[index[matches]] - matches, return_counts=True)
    offset = int(offsets[np.argmax(counts)])
    start, stop = max(0, -offset), min(len(keys[1]), len(keys[0]) - offset)
    equal = keys[0][start + offset : stop + offset] == keys[1][start:stop]
    count = max(stop - start for start, stop in runs_of(equal))
    return count if count >= MIN_ROWS else 0


def is_copy(first: Recording, second: Recording) -> bool:
    """Return whether two recordings have the same samples, in any unit."""
    axis = first.axis
    kinds = [{(c.quantity, c.axis) for c in r.channels} for r in (first, second)]
    if first.samples != second.samples or kinds[0] != kinds[1] or axis not in first.complete_axes:
        return False
    for step in (max(first.samples // _FIRST_SAMPLES, 1), 1):
        if _rms_difference(*(r.voltage_V(axis)[::step] for r in (first, second))) > SAME_DRIVE:
            return False
    displacements = [r.displacement_m(axis) for r in (first, second)]
    spreads = [float(values.std()) for values in displacements]
    if not min(spreads) > 0.0:
        return False
    decades = np.log10(spreads[0] / spreads[1])  # another unit is a whole power of ten
    if abs(decades - np.round(decades)) > SAME_DRIVE:
        return False
    difference = _rms_difference(*displacements)
    return difference <= MAX_DIFFERENCE * noise_rms(displacements[0]) / spreads[0]


def _rms_difference(*signals: Array) -> float:
    """Return the rms of the difference of two signals, each scaled to mean 0 and rms 1."""
    first, second = (
        (values - values.mean()) / (spread if (spread := float(values.std())) > 0 else 1.0)
        for values in signals
    )
    return float(np.sqrt(np.mean((first - second) ** 2)))
