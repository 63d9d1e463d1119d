"""Whether the recordings of a stage fit each other: sign, gain, range, rate, and copies.

A file in another unit, behind a monitor or of another polarity is no stage with hysteresis; it is
told by its gain beside that of the others, before anything is fitted.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from piezoid.counts import record_in_counts
from piezoid.errors import RecordingError
from piezoid.formatting import significant, with_unit
from piezoid.numerics.arrays import Array
from piezoid.records.faults import noise_rms
from piezoid.records.plausibility import NOISE_ONLY, is_held_throughout
from piezoid.records.recording import Quantity, Recording

STILL = 0.01  # of the widest drive: a recording that moves less says nothing of hysteresis

# The gain is taken at the lowest frequencies, which hold this share of the drive's power: a mode
# is far above them in a sweep, and in a chirp its first tens of hertz.
_POWER = 0.02
# Above so many times the lowest of these frequencies a mode may have turned the sign.
_BAND = 10.0
_SLOW_Hz = 1.0
# A rest longer than this part of a recording is left out. A sine of one period stays within a
# hundredth of its range for 0.06 of it, a step of a staircase mostly for less than a twentieth.
_REST = 0.1
# Below this coherence the drive does not say what the sensor shows.
_COHERENT = 0.8
# Ceramics move up to twice as far per volt over their full range as in small loops, and no stage
# is known that does so three times; a monitor has a fifth at most.
_OTHER_GAIN = 3.0
# A factor of a thousand is told within this, as its logarithm to the base of ten.
_THOUSAND = 0.3
_MONITORS = (5, 10, 15, 20, 25, 30, 40, 50, 100, 200)
# Within this, as a logarithm, a ratio is one of these; loops of other size or speed move otherwise
# per volt (by 1.17 between the sweep and the check of the bundled stage, of nearly one range), and
# then the ratio leaves several.
_MONITOR = 0.03
_OTHER_LOOPS = 0.25
# A copy differs by its printing alone; of two recordings, noise makes 1.4 between them.
_COPY = 0.3
_SAME_DRIVE = 1e-3
_FEW = 1000
_NAMED = 3  # recordings in one remark


@dataclass(frozen=True, kw_only=True)
class Misfit:
    """One recording that does not fit the others.

    name    of the recording
    reason  what was found, and what it looks like
    lines   for its entry in lab.toml
    """

    name: str
    reason: str
    lines: str


@dataclass(frozen=True, kw_only=True, eq=False)
class _Answer:
    """What the drive of an axis does to its sensor at the lowest frequencies.

    gain_m_per_V  in phase
    coherence     0 to 1
    frequency_Hz  at which both are taken, the mean over the drive's power
    range_ratio   m/V, range of the readings over that of the drive
    """

    recording: Recording
    gain_m_per_V: float
    coherence: float
    frequency_Hz: float
    range_ratio: float
    voltage_V: tuple[float, float]


def misfits(recordings: Sequence[Recording]) -> tuple[Misfit, ...]:
    """Return the recordings whose gain contradicts that of the others on the same axis."""
    found: list[Misfit] = []
    for axis in sorted({axis for r in recordings for axis in r.axes}):
        answers = [_answer(r, axis) for r in recordings if _drives(r, axis)]
        clear = [a for a in answers if a is not None and a.coherence > _COHERENT]
        if len(clear) < 2:
            continue
        slowest_Hz = max(min(a.frequency_Hz for a in clear), _SLOW_Hz)
        clear = [a for a in clear if a.frequency_Hz <= _BAND * slowest_Hz]
        usual = _usual(clear)
        found += [_misfit(a, usual) for a in clear if _contradicts(a, usual)]
    return tuple(found)


def refuse_misfits(recordings: Sequence[Recording]) -> None:
    """Refuse recordings that do not fit each other: one model of them would be of no stage."""
    counts = counts_beside_units(recordings)
    if counts:
        blocks = "\n\n".join(
            f"[[recording]]\nfile = {_file(name)}\nscale = {{ ... }}" for name in counts
        )
        raise RecordingError(
            "the recordings do not fit each other: " + "; ".join(counts.values()),
            needed="one unit in all recordings of a stage",
            remedy=f"Write into lab.toml:\n\n{blocks}\n",
        )
    found = record_in_counts(misfits(recordings), counted_in(recordings))
    if not found:
        return
    blocks = "\n\n".join(f"[[recording]]\nfile = {_file(m.name)}\n{m.lines}" for m in found)
    raise RecordingError(
        "the recordings do not fit each other: " + "; ".join(m.reason for m in found),
        needed="recordings of one stage, in true units and with one polarity",
        remedy="Where this is the reason, write into lab.toml what makes them alike (or the like "
        "for the others, if it is they that are wrong); leave a file of another stage out:\n\n"
        f"{blocks}\n",
    )


def counted_in(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Return what is in counts in any recording, of ``displacement`` and ``voltage``."""
    return tuple(sorted({quantity for recording in recordings for quantity in recording.counted}))


def counts_beside_units(recordings: Sequence[Recording]) -> dict[str, str]:
    """Return what is in counts of a converter beside metres or volts: nothing compares the two.

    returned  a sentence by the name of the recording in counts
    """
    found: dict[str, str] = {}
    for quantity in (Quantity.VOLTAGE, Quantity.DISPLACEMENT):
        held = {r.name: c for r in recordings for c in r.channels if c.quantity is quantity}
        known = sorted(name for name, channel in held.items() if not channel.is_counted)
        what, si = quantity.name.lower(), quantity.value
        for name, channel in held.items():
            if channel.is_counted and known:
                found[name] = (
                    f"the {what} of {name} is in counts, that of {', '.join(known[:_NAMED])} in "
                    f"{si} (scale = {{ {what} = ... }} says how many {si} one count is)"
                )
    return found


def copies(recordings: Sequence[Recording]) -> dict[str, str]:
    """Return the recordings that hold the samples of an earlier one, whatever their unit.

    returned  name of the earlier one by name
    """
    found: dict[str, str] = {}
    for one, other in combinations(recordings, 2):
        if one.name not in found and one.name != other.name and _is_copy(one, other):
            found.setdefault(other.name, one.name)
    return found


def remarks_on_set(recordings: Sequence[Recording]) -> tuple[tuple[str, str], ...]:
    """Return what is remarkable about single recordings beside the others: name and sentence."""
    found = [
        (copy, f"{copy} holds the same samples as {original}: it tests nothing that was fitted "
         f"to {original}, and is left out")
        for copy, original in copies(recordings).items()
    ]  # fmt: skip
    odd = {misfit.name for misfit in misfits(recordings)}
    for axis in sorted({r.axis for r in recordings}):
        own = [r for r in recordings if r.axis == axis and _drives(r, axis) and r.name not in odd]
        found += beside_the_widest({r.name: _range(r.voltage_V(axis)) for r in own}, axis)
        found += _of_other_rate(own)
        found += _held_throughout(own, axis)
    return tuple(found)


def beside_the_widest(
    ranges: Mapping[str, tuple[float, float]], axis: str
) -> list[tuple[str, str]]:
    """Return what is remarkable about the ranges of the drive, V: name and sentence."""
    if len(ranges) < 2:
        return []
    widest, (low_V, high_V) = max(ranges.items(), key=lambda item: item[1][1] - item[1][0])
    found = []
    for name, (least_V, most_V) in ranges.items():
        if most_V - least_V <= STILL * (high_V - low_V):
            found.append(
                (name, f"{name}: the drive of axis {axis} moves by "
                 f"{with_unit(most_V - least_V, 'V')}, less than a hundredth of the "
                 f"{with_unit(high_V - low_V, 'V')} of {widest}: nothing is learned of "
                 "the hysteresis from it")
            )  # fmt: skip
        elif least_V > high_V or most_V < low_V:
            found.append(
                (name, f"{name}: the drive of axis {axis} goes from {with_unit(least_V, 'V')} to "
                 f"{with_unit(most_V, 'V')} and never meets that of {widest}, "
                 f"{with_unit(low_V, 'V')} to {with_unit(high_V, 'V')}: is an offset missing? "
                 "(offset = { voltage = ... })")
            )  # fmt: skip
    return found


def _of_other_rate(recordings: Sequence[Recording]) -> list[tuple[str, str]]:
    """Return one remark for each recording beside which others are a thousand times as fast."""
    found = []
    for slow in recordings:
        fast = [
            other.name
            for other in recordings
            if abs(other.sampling_rate_Hz / slow.sampling_rate_Hz / 1000 - 1) < _THOUSAND / 10
        ]
        if fast:
            more = f" and {len(fast) - _NAMED} others" if len(fast) > _NAMED else ""
            found.append(
                (slow.name, f"{slow.name} is sampled at {slow.sampling_rate_Hz:.9g} Hz, "
                 f"{', '.join(fast[:_NAMED])}{more} a thousand times as fast: are the times of "
                 "one in milliseconds?")
            )  # fmt: skip
    return found


def _held_throughout(recordings: Sequence[Recording], axis: str) -> list[tuple[str, str]]:
    held = [r.name for r in recordings if is_held_throughout(r, axis)]
    if len(held) == len(recordings):
        return []
    return [
        (name, f"{name}: the sensor of axis {axis} stands while the drive moves, as under "
         "feedback, or of a sensor that does not see the motion: no loop is fitted to it; the "
         "diagnosis looks for creep in the drive's answer")
        for name in held
    ]  # fmt: skip


def _drives(recording: Recording, axis: str) -> bool:
    pair = (Quantity.VOLTAGE, Quantity.DISPLACEMENT)
    return all(recording.find(quantity, axis) is not None for quantity in pair)


def _range(values: Array) -> tuple[float, float]:
    return float(values.min()), float(values.max())


def _answer(recording: Recording, axis: str) -> _Answer | None:
    """Return the gain at the lowest frequencies of the drive.

    None where the drive does not move, where the sensor shows little but its noise, and where a
    feedback holds it: then it is the drive that answers.
    """
    moves = _moves(recording.voltage_V(axis))
    voltage_V = recording.voltage_V(axis)[moves]
    displacement_m = recording.displacement_m(axis)[moves]
    held = any(p.quantity == "closed_loop" and p.axis == axis for p in recording.statements)
    if held or len(voltage_V) < 8 or not np.ptp(voltage_V) > 0:
        return None
    if not np.ptp(displacement_m) > NOISE_ONLY * noise_rms(displacement_m):
        return None
    # A recording is seldom whole periods: without a window the lines of a multisine leak into the
    # lowest ones, and those near a mode with another sign than they have there. Both are taken
    # about their mean under the window: about another one, offsets leak into the lowest lines.
    window = np.hanning(len(voltage_V) + 2)[1:-1]
    drive = np.fft.rfft(window * (voltage_V - np.average(voltage_V, weights=window)))[1:]
    level_m = np.average(displacement_m, weights=window)
    response = np.fft.rfft(window * (displacement_m - level_m))[1:]
    power = np.abs(drive) ** 2
    # Both neighbours of the last line are taken in: a sine is seldom whole in the recording.
    last = int(np.searchsorted(np.cumsum(power), _POWER * power.sum())) + 2
    drive, response, power = drive[:last], response[:last], power[:last]
    cross = complex(np.vdot(drive, response))
    energy = float(power.sum() * (np.abs(response) ** 2).sum())
    lines_Hz = np.arange(1, last + 1) * recording.sampling_rate_Hz / len(voltage_V)
    return _Answer(
        recording=recording,
        gain_m_per_V=cross.real / float(power.sum()),
        coherence=abs(cross) / math.sqrt(energy) if energy > 0 else 0.0,
        frequency_Hz=float((lines_Hz[: len(power)] * power).sum() / power.sum()),
        range_ratio=float(np.ptp(displacement_m) / np.ptp(voltage_V)),
        voltage_V=_range(voltage_V),
    )


def _moves(voltage_V: Array) -> NDArray[np.bool_]:
    """Tell which rows are in no long rest of the drive, (samples,).

    A stage creeps while its drive rests for minutes: the lowest frequencies of the whole recording
    would show that, with any sign, and a window the motion at its ends not at all.
    """
    length = max(int(_REST * len(voltage_V)), 1)
    range_V = maximum_filter1d(voltage_V, length) - minimum_filter1d(voltage_V, length)
    is_centre = range_V <= STILL * float(np.ptp(voltage_V))
    return np.asarray(~maximum_filter1d(is_centre, length))


def _contradicts(one: _Answer, usual: _Answer) -> bool:
    """Tell whether gain and range are of another stage.

    Between two holds of nearly one level the lowest frequencies show hysteresis and creep more
    than gain; the range of the readings over that of the drive is then the stage's own.
    """
    if one.gain_m_per_V * usual.gain_m_per_V <= 0.0:
        return True
    ratios = (one.gain_m_per_V / usual.gain_m_per_V, one.range_ratio / usual.range_ratio)
    return not any(1 / _OTHER_GAIN < ratio < _OTHER_GAIN for ratio in ratios)


def _usual(answers: Sequence[_Answer]) -> _Answer:
    """Return the answer that most others agree with.

    Among equals one that goes up with the drive, as most stages do, and of these the widest drive.
    """

    def agreeing(one: _Answer) -> tuple[int, bool, float]:
        ratios = [other.gain_m_per_V / one.gain_m_per_V for other in answers]
        alike = sum(1 / _OTHER_GAIN < ratio < _OTHER_GAIN for ratio in ratios)
        return alike, one.gain_m_per_V > 0, one.voltage_V[1] - one.voltage_V[0]

    return max(answers, key=agreeing)


def _misfit(odd: _Answer, usual: _Answer) -> Misfit:
    ratio = odd.gain_m_per_V / usual.gain_m_per_V
    size = abs(ratio)
    spans = [a.voltage_V[1] - a.voltage_V[0] for a in (odd, usual)]
    # What is off is the drive where its range, and not the stroke, is off by as much.
    is_drive = abs(math.log(size * spans[0] / spans[1])) < abs(math.log(spans[0] / spans[1]))
    likely, lines = _reason(ratio, is_drive=is_drive)
    name, other = odd.recording.name, usual.recording.name
    reason = (
        f"{name} moves {_gain(odd)} (drive {_volts(odd)}), {other} {_gain(usual)} (drive "
        f"{_volts(usual)}), {_times(ratio)}: {likely}"
    )
    return Misfit(name=name, reason=reason, lines=lines)


def _reason(ratio: float, *, is_drive: bool) -> tuple[str, str]:
    """Return what a ratio of gains looks like, and the line that would mend it."""
    size, sign = abs(ratio), "-" if ratio < 0 else ""
    turned = " and of the other polarity" if ratio < 0 else ""
    if 1 / _OTHER_GAIN < size < _OTHER_GAIN:
        return (
            "drive or sensor is of the other polarity",
            "scale = { voltage = -1 }   # or displacement = -1",
        )
    thousands = math.log10(size) / 3
    if round(thousands) and abs(thousands - round(thousands)) < _THOUSAND / 3:
        factor = 10.0 ** (3 * round(thousands))
        if is_drive:
            return (
                f"the drive is in another unit{turned}",
                f"scale = {{ voltage = {sign}{factor:g} }}",
            )
        return (
            f"the displacement is in another unit{turned}",
            f"scale = {{ displacement = {sign}{1 / factor:g} }}",
        )
    monitors = _monitors_near(size)
    if is_drive and monitors:
        named = " or ".join(f"1/{monitor}" for monitor in monitors)
        known = len(monitors) == 1 and abs(math.log(size / monitors[0])) < _MONITOR
        scale = f"{sign}{monitors[0]}" if known else "..."
        return (
            f"its drive is the output of a monitor, {named}, or the command in front of the "
            f"amplifier{turned}",
            f"scale = {{ voltage = {scale} }}"
            + ("" if known else f"   # what {sign}1 V of it is at the stage, in volts"),
        )
    return (
        f"it is of another axis, stage or range of the sensor{turned}",
        'axis = "..."   # or scale = { displacement = ... }',
    )


def _monitors_near(size: float) -> tuple[int, ...]:
    """Return the monitors that a ratio of gains may come from: one where it meets one."""
    far = {monitor: abs(math.log(size / monitor)) for monitor in _MONITORS}
    met = tuple(monitor for monitor in _MONITORS if far[monitor] < _MONITOR)
    return met or tuple(monitor for monitor in _MONITORS if far[monitor] < _OTHER_LOOPS)


def _gain(answer: _Answer) -> str:
    return f"{with_unit(answer.gain_m_per_V, 'm')} per volt"


def _volts(answer: _Answer) -> str:
    return " to ".join(with_unit(end, "V") for end in answer.voltage_V)


def _times(ratio: float) -> str:
    if 1 / _OTHER_GAIN < abs(ratio) < _OTHER_GAIN:
        return "the other way"
    size = abs(ratio)
    many = f"{significant(max(size, 1 / size))} times {'as much' if size > 1 else 'less'}"
    return f"{many}, the other way" if ratio < 0 else many


def _file(name: str) -> str:
    """Return the name of the file, of which a recording may be a part."""
    return json.dumps(name.partition(" (part ")[0])


def _is_copy(one: Recording, other: Recording) -> bool:
    kinds = [{(c.quantity, c.axis) for c in r.channels} for r in (one, other)]
    if one.samples != other.samples or kinds[0] != kinds[1] or not _drives(one, one.axis):
        return False
    # A few samples tell most pairs apart, before whole recordings are compared.
    for step in (max(one.samples // _FEW, 1), 1):
        drives = [_standard(r.voltage_V(one.axis)[::step]) for r in (one, other)]
        if _rms(drives[0] - drives[1]) > _SAME_DRIVE:
            return False
    displacement_m = one.displacement_m(one.axis)
    spread_m, other_m = float(displacement_m.std()), float(other.displacement_m(one.axis).std())
    if not (spread_m > 0 and other_m > 0):
        return False
    decades = np.log10(spread_m / other_m)  # a unit that was told wrong is whole powers of ten
    if abs(decades - np.round(decades)) > _SAME_DRIVE:
        return False
    responses = [_standard(r.displacement_m(one.axis)) for r in (one, other)]
    return _rms(responses[0] - responses[1]) <= _COPY * noise_rms(displacement_m) / spread_m


def _standard(values: Array) -> Array:
    spread = float(values.std())
    return np.asarray((values - values.mean()) / spread) if spread > 0 else values - values.mean()


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
