"""What is remarkable about drive and response together: a stage nobody sells, a sensor held."""

import json

import numpy as np

from piezoid.formatting import with_unit
from piezoid.numerics.arrays import Array
from piezoid.records.causality import told_early
from piezoid.records.faults import noise_rms
from piezoid.records.recording import Channel, Quantity, Recording
from piezoid.records.rest import answers
from piezoid.records.standing import standing_tips
from piezoid.statement import Statement, finding

# Tubes move some nm per volt of their electrodes, stacks 0.1 to 1 um, levers and benders 10 um;
# by the command in front of an amplifier up to 40 um (an objective's). Beyond, and below a tenth
# of a nanometre, a unit or a monitor is the likelier reason.
_LEAST_m_per_V, _MOST_m_per_V = 1e-10, 5e-5
# A sensor that shows less than so many times its noise says nothing of a gain.
NOISE_ONLY = 20.0
# Held is a sensor whose means over a hundredth of the recording stay within the noise of single
# samples for at least ten of them, while the drive goes where it would move by five times that
# noise. Where the whole recording shows no motion to know that by, the drive goes through three
# tenths of its range: in the hold of a real approach (30 s, capacitive sensor) it is 0.57.
_BLOCKS = 100
_HELD_BLOCKS = 10
_UNMOVED = 5.0
_DRIVE_SHARE = 0.3
# Loops of the thirteen published laws open by 4.3 to 7.7 % of their box, and by minus as much with
# the columns exchanged; the bundled stage's by 3.4 to 7.8 %. A lag makes them wider still.
_OPEN = 0.01
_NARROW = 0.9  # correlation: that of the laws is 0.986 at least
_THROUGHOUT = 0.9  # of the samples: in the rest the loop settles (0.98 in that real hold)


def remarks_on(recording: Recording) -> tuple[Statement, ...]:
    """Return remarks on every axis that has a drive and a displacement.

    kinds  ``implausible_gain``, ``leads``, ``smoothed``, ``closed_loop``, ``stands``
    """
    found: list[Statement] = []
    for axis in recording.axes:
        drive = recording.find(Quantity.VOLTAGE, axis)
        response = recording.find(Quantity.DISPLACEMENT, axis)
        if drive is None or response is None:
            continue
        if not recording.counted:
            found += _implausible(drive.values, response.values, axis)
        found += _leading(drive, response)
        found += told_early(recording, axis)
        found += _held(recording, axis)
        found += standing_tips(recording, axis)
    return tuple(found)


def _implausible(voltage_V: Array, displacement_m: Array, axis: str) -> list[Statement]:
    drive_V, stroke_m = float(np.ptp(voltage_V)), float(np.ptp(displacement_m))
    if not drive_V > 0 or not stroke_m > 0:
        return []
    gain = stroke_m / drive_V
    # A sensor that shows nothing but noise says nothing of the gain.
    is_noise = stroke_m < NOISE_ONLY * noise_rms(displacement_m)
    if _LEAST_m_per_V <= gain <= _MOST_m_per_V or is_noise:
        return []
    text = (
        f"a drive of {with_unit(drive_V, 'V')} and a displacement of {with_unit(stroke_m, 'm')} "
        f"are {with_unit(gain, 'm')} per volt; stacks, tubes and benders, amplifier included, "
        f"make from {with_unit(_LEAST_m_per_V, 'm')} to {with_unit(_MOST_m_per_V, 'm')}: is a "
        "unit wrong, or the drive a monitor's output?"
    )
    return [finding(quantity="implausible_gain", axis=axis, text=text)]


def _leading(drive: Channel, response: Channel) -> list[Statement]:
    """Tell a loop that turns the other way round: what hysteresis and lag never do.

        A = sgn(r) oint v dy / (range v, range y, number of cycles),    r correlation of v and y

    Slow loops only, which are narrow: behind a resonance any phase is to be expected.
    """
    v, y = _whole_cycles(drive.values, response.values)
    if len(v) == 0 or not np.ptp(v) > 0 or not np.ptp(y) > 0:
        return []
    correlation = float(np.corrcoef(v, y)[0, 1])
    cycles = float(np.abs(np.diff(v)).sum() / (2.0 * np.ptp(v)))
    box = float(np.ptp(v) * np.ptp(y)) * cycles
    area = float(np.sum(0.5 * (v[1:] + v[:-1]) * np.diff(y))) / box
    area *= 1.0 if correlation > 0 else -1.0
    if abs(correlation) < _NARROW or area > -_OPEN:
        return []
    text = (
        f"the displacement leads the drive: their loop turns the other way round, by "
        f"{100 * -area:.2g} % of the box around it. Are the headings of drive and displacement "
        f"exchanged (columns = {{ voltage = {json.dumps(response.label)}, displacement = "
        f"{json.dumps(drive.label)}, ... }}), or is the drive read late?"
    )
    return [finding(quantity="leads", axis=drive.axis, text=text)]


def _whole_cycles(drive: Array, response: Array) -> tuple[Array, Array]:
    """Return both about their means, from the first to the last time that the drive rises."""
    middle = 0.5 * float(drive.max() + drive.min())
    rises = np.flatnonzero((drive[:-1] < middle) & (drive[1:] >= middle))
    whole = slice(int(rises[0]), int(rises[-1]) + 1) if len(rises) > 1 else slice(0, 0)
    v, y = drive[whole], response[whole]
    return (v - v.mean(), y - y.mean()) if len(v) else (v, y)


def held_stretch(recording: Recording, axis: str) -> slice | None:
    """Return the samples in which the sensor stands while the drive moves, or None."""
    voltage_V, displacement_m = recording.voltage_V(axis), recording.displacement_m(axis)
    size = len(voltage_V) // _BLOCKS
    if size < 4 or not np.ptp(voltage_V) > 0 or not np.ptp(displacement_m) > 0:
        return None
    drive_V, response_m = (
        values[: size * _BLOCKS].reshape(_BLOCKS, size).mean(axis=1)
        for values in (voltage_V, displacement_m)
    )
    noise_m, stroke_m = noise_rms(displacement_m), float(np.ptp(response_m))
    first, last = _longest_within(response_m, noise_m)
    share = float(np.ptp(drive_V[first:last]) / np.ptp(drive_V)) if np.ptp(drive_V) > 0 else 0.0
    is_seen = stroke_m > NOISE_ONLY * noise_m
    wanted = _UNMOVED * noise_m / stroke_m if is_seen else _DRIVE_SHARE
    # Of a drive that goes to and fro within a block the means say nothing.
    here = slice(first * size, last * size)
    if answers(voltage_V[here], displacement_m[here]):
        return None
    # What gives the same number for ever is stuck or dead, which is said elsewhere.
    if last - first < _HELD_BLOCKS or share < wanted or not np.ptp(response_m[first:last]) > 0:
        return None
    return here


def is_held_throughout(recording: Recording, axis: str) -> bool:
    """Tell whether a feedback holds the sensor all the time: the drive's answer is the data."""
    stretch = held_stretch(recording, axis)
    return stretch is not None and stretch.stop - stretch.start > _THROUGHOUT * recording.samples


def _held(recording: Recording, axis: str) -> list[Statement]:
    """Tell a sensor that stands while the drive moves: under feedback, or out of order."""
    stretch = held_stretch(recording, axis)
    if stretch is None:
        return []
    moved_V = float(np.ptp(recording.voltage_V(axis)[stretch]))
    within_m = float(np.ptp(recording.displacement_m(axis)[stretch]))
    begin_s, end_s = (edge / recording.sampling_rate_Hz for edge in (stretch.start, stretch.stop))
    text = (
        f"from {begin_s:.4g} s to {end_s:.4g} s the sensor stays within "
        f"{with_unit(within_m, 'm')} while the drive moves by {with_unit(moved_V, 'V')}: recorded "
        "under feedback, it seems, where the drive's answer is the data; or the sensor does not "
        "see the motion"
    )
    return [finding(quantity="closed_loop", axis=axis, text=text)]


def _longest_within(values: Array, span: float) -> tuple[int, int]:
    """Return the longest run, (first, behind the last), that stays within a span."""
    best, first = (0, 0), 0
    for last in range(1, len(values) + 1):
        while np.ptp(values[first:last]) > span:
            first += 1
        if last - first > best[1] - best[0]:
            best = first, last
    return best
