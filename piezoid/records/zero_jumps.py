"""Lasting jumps of a reading's zero: a stage or mount that slipped, fringes that were lost.

    y(t) = f(t) + sum of J_k for all t_k < t

A jump stands out of the steps around it and out of the drive's, and it lasts: crossings of one
level of the drive in one direction differ from one cycle to the next by the jumps between them.
A step that comes back on the way down, of a dead spot or a converter, fails the second test.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from piezoid.formatting import with_unit
from piezoid.numerics.arrays import Array
from piezoid.records.faults import step_size
from piezoid.records.recording import Quantity, Recording
from piezoid.records.rest import is_at_rest
from piezoid.statement import Statement, finding

# In 294 healthy recordings, and in those of 60 stages of two outsiders, nothing passes both tests.
WIDTHS = (1, 4, 16)  # samples a jump may take, by the filter of its sensor
AROUND = 10  # widths on either side that a jump is compared with
FAR = 10.0  # times the spread of the steps around, and the largest of them twice
CODES = 4.0  # converter steps: fewer are the rounding of one
BEFORE = 16  # samples by which the stage may follow a step of its drive
MOST = 30  # jumps in a recording: what makes more wanders, and pieces of it would be short
SWITCHES = 4  # jumps: of slips either way one set in eight goes up and down in turn by chance
TO_AND_FRO = 0.75  # of successive jumps, of which one may have been overlooked
LEVELS = (0.3, 0.5, 0.7)  # of the drive's range, at which cycles are compared
EXPLAINED = 0.5  # of what cycles differ by: more than that is left where jumps come back
ALIKE = 0.1  # of a fringe: so far may a jump be from a multiple; one in five is by chance
FRINGES = (
    (316.4e-9, "an interferometer with a helium-neon laser"),
    (158.2e-9, "a double-pass interferometer with a helium-neon laser"),
)
MIN_CYCLES = 4  # equal ones: two to compare on either side of a step
STEP_RATIO = 5.0  # mean over the period with the step, over the largest of the others
FLAT = 1.2  # scatter within that period, over that of the others: a step shifts all of it
EQUAL = 0.01  # of a cycle's rms: what equal cycles of the drive differ by
TOLD = 5  # jumps by place and size
BLOCK = 20  # samples of a mean, where the drive rests

Samples = NDArray[np.intp]


@dataclass(frozen=True, kw_only=True)
class Jump:
    """One lasting jump.

    first, last  samples before and behind it
    size         signed, in the unit of the reading
    """

    first: int
    last: int
    size: float


@dataclass(frozen=True, kw_only=True)
class Pairs:
    """Two times at which a stage without jumps would read the same, and by what it differs.

    before, after  (pairs,)  samples, after later
    differs        (pairs,)  reading at the second less reading at the first
    """

    before: Samples
    after: Samples
    differs: Array

    def misses(self, jumps: Sequence[Jump]) -> float:
        """Return the mean size of what jumps leave of the differences."""
        between = np.zeros(len(self.differs))
        for jump in jumps:
            between += jump.size * ((self.before <= jump.first) & (self.after >= jump.last))
        return float(np.abs(self.differs - between).mean())

    def straddling(self, jumps: Sequence[Jump]) -> "Pairs":
        """Return the pairs with a jump between them."""
        here = np.zeros(len(self.differs), dtype=bool)
        for jump in jumps:
            here |= (self.before <= jump.first) & (self.after >= jump.last)
        return Pairs(before=self.before[here], after=self.after[here], differs=self.differs[here])


def lasting_jumps(reading: Array, drive: Array, *, rests: bool = False) -> tuple[Jump, ...]:
    """Return the lasting jumps of a reading that the drive did not make, in their order.

    reading, drive  (samples,)  any unit, without gaps
    rests           whether the drive stands: then any two stretches should read the same

    What switches to and fro between two levels has no zero that lasts, and is none of these.

    What goes wrong: a jump below ten times the spread of single steps passes, and so does one
    after which the drive never comes back to where it was.
    """
    found: list[Jump] = []
    for width in WIDTHS:
        for jump in _standing_out(reading, drive, width):
            if all(jump.last < other.first or jump.first > other.last for other in found):
                found.append(jump)
    if len(found) > MOST:
        return ()
    if not found:
        return _steps_between_cycles(reading, drive)
    found.sort(key=lambda jump: jump.first)
    up = np.array([jump.size > 0.0 for jump in found])
    if len(found) >= SWITCHES and (up[1:] != up[:-1]).mean() >= TO_AND_FRO:
        return ()
    pairs = (_rest_pairs(reading) if rests else _crossing_pairs(reading, drive)).straddling(found)
    # What comes back within a cycle leaves nothing between two, with all jumps or with none.
    if not len(pairs.differs) or pairs.misses(found) > EXPLAINED * pairs.misses(()):
        return ()
    kept = []
    for jump in found:
        near = pairs.straddling((jump,))
        others = [other for other in found if other is not jump]
        if len(near.differs) and near.misses(found) < EXPLAINED * near.misses(others):
            kept.append(jump)
    return tuple(kept)


def _steps_between_cycles(reading: Array, drive: Array) -> tuple[Jump, ...]:
    """Return the step of the zero that equal cycles show, however noisy the reading is.

        d(t) = y(t + P) - y(t) = J   for t_0 - P <= t < t_0,   else 0

    P is the period of the drive and J the step at t_0, so that the mean of d over a period finds
    steps far below the noise of single samples. The first cycle still moves the walls, and is not
    compared. A step lies alone: the means of the other periods differ by much less.
    """
    period = _period(drive)
    if period == 0 or len(drive) < MIN_CYCLES * period:
        return ()
    differs = reading[2 * period :] - reading[period:-period]
    means = np.convolve(differs - np.median(differs), np.full(period, 1.0 / period), "valid")
    best = int(np.argmax(np.abs(means)))
    size, instant = float(means[best]), best + 2 * period
    others = np.concatenate([means[: max(best - period, 0)], means[best + period :]])
    scatter = 1.4826 * float(np.median(np.abs(np.diff(differs)))) / np.sqrt(2.0 * period)
    if not len(others) or abs(size) < STEP_RATIO * max(float(np.abs(others).max()), scatter):
        return ()
    centred = differs - np.median(differs)
    here = np.zeros(len(centred), dtype=bool)
    here[best : best + period] = True
    if _spread(centred[here]) > FLAT * _spread(centred[~here]):
        return ()
    return (Jump(first=instant - 1, last=instant, size=size),)


def _spread(values: Array) -> float:
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))


def _period(drive: Array) -> int:
    """Return the period of a drive that repeats in equal cycles, in samples; 0 otherwise.

    D(P) = sum (u(t + P) - u(t))^2   small against the power of u
    """
    count, centred = len(drive), drive - drive.mean()
    correlation = np.fft.irfft(np.abs(np.fft.rfft(centred, 2 * count)) ** 2)[:count]
    power = np.concatenate([[0.0], np.cumsum(centred**2)])
    lags = np.arange(count // MIN_CYCLES + 1)
    differs = power[count - lags] + power[-1] - power[lags] - 2.0 * correlation[lags]
    variance = differs / (count - lags)
    moves = np.flatnonzero(variance > 0.5 * power[-1] / count)
    if not len(moves):
        return 0
    repeats = moves[0] + np.flatnonzero(variance[moves[0] :] < EQUAL**2 * power[-1] / count)
    if not len(repeats):
        return 0
    first = repeats[: 1 + np.argmax(np.diff(repeats, append=np.inf) > 1)]
    return int(first[np.argmin(variance[first])])


def _standing_out(reading: Array, drive: Array, width: int) -> list[Jump]:
    """Return steps over some samples that stand out of those around them and of the drive's."""
    count = 2 * AROUND * width + 1
    if len(reading) < 2 * count:
        return []
    step = reading[width:] - reading[:-width]
    off = step - median_filter(step, count)
    away = np.abs(off)
    spread = np.maximum(1.4826 * median_filter(away, count), 1e-300)
    code = step_size(reading)
    moved = drive[width:] - drive[:-width]
    moved = np.abs(moved - median_filter(moved, count))
    gain = float(np.ptp(reading)) / max(float(np.ptp(drive)), 1e-300)
    jumps = []
    for k in np.flatnonzero((away > FAR * spread) & (away > CODES * code)).tolist():
        near = slice(max(k - width, 0), k + width + 1)
        if away[k] < away[near].max():
            continue
        around = np.concatenate(
            [
                away[max(k - AROUND * width, 0) : max(k - width, 0)],
                away[k + width + 1 : k + AROUND * width + 1],
            ]
        )
        driven = float(moved[max(k - BEFORE - width, 0) : k + width + 1].max())
        if away[k] > 2.0 * max(float(around.max(initial=0.0)), gain * driven):
            jumps.append(Jump(first=k, last=k + width, size=float(off[k])))
    return jumps


def _crossing_pairs(reading: Array, drive: Array) -> Pairs:
    """Return successive crossings of a level of the drive in one direction."""
    before, after, differs = [], [], []
    low, span = float(drive.min()), float(np.ptp(drive))
    for share in LEVELS if span > 0.0 else ():
        for way in (1.0, -1.0):
            v = way * (drive - (low + share * span))
            places = np.flatnonzero((v[:-1] < 0.0) & (v[1:] >= 0.0))
            part = -v[places] / (v[places + 1] - v[places])
            level = reading[places] + part * (reading[places + 1] - reading[places])
            # a drive that reads its own noise crosses a level many times at once
            far = np.concatenate([[True], np.diff(places) > BLOCK]) if len(places) else places > 0
            for one, two in pairwise(zip(places[far], level[far], strict=True)):
                before.append(one[0])
                after.append(two[0])
                differs.append(two[1] - one[1])
    return Pairs(
        before=np.array(before, dtype=np.intp),
        after=np.array(after, dtype=np.intp),
        differs=np.array(differs),
    )


def _rest_pairs(reading: Array) -> Pairs:
    count = len(reading) // BLOCK
    means = reading[: count * BLOCK].reshape(count, BLOCK).mean(axis=1)
    middle = BLOCK * np.arange(count) + BLOCK // 2
    return Pairs(before=middle[:-2], after=middle[2:], differs=means[2:] - means[:-2])


def told_jumps(recording: Recording) -> tuple[tuple[int, ...], tuple[Statement, ...]]:
    """Return the samples at which lasting jumps begin and end, and what is to be said of them.

    There a piece ends: each has a zero of its own, and what the jump did to the memory is open.
    """
    edges: set[int] = set()
    said = []
    for axis in recording.axes:
        drive = recording.find(Quantity.VOLTAGE, axis)
        response = recording.find(Quantity.DISPLACEMENT, axis)
        if drive is None or response is None:
            continue
        rests = is_at_rest(recording, axis)
        jumps = [
            Jump(first=part.start + one.first, last=part.start + one.last, size=one.size)
            for part in recording.pieces
            for one in lasting_jumps(response.values[part], drive.values[part], rests=rests)
        ]
        if jumps:
            edges.update(k for jump in jumps for k in (jump.first + 1, jump.last))
            said.append(_told(jumps, recording.sampling_rate_Hz, axis))
    return tuple(sorted(edges)), tuple(said)


def _told(jumps: Sequence[Jump], rate_Hz: float, axis: str) -> Statement:
    places = [
        f"by {'+' if jump.size > 0 else ''}{with_unit(jump.size, 'm')} at "
        f"{jump.first / rate_Hz:.4g} s"
        for jump in jumps[:TOLD]
    ]
    more = f" and {len(jumps) - TOLD} more" if len(jumps) > TOLD else ""
    times = "once" if len(jumps) == 1 else f"{len(jumps)} times"
    return finding(
        quantity="zero_jump",
        axis=axis,
        text=f"the displacement of {axis} jumps {times} while its drive does not, and stays "
        f"there, {', '.join(places)}{more}: before and behind lie the same loops, shifted, as "
        f"where {_cause(jumps)}. The parts between are pieces, each with a zero of its own",
        value=max(abs(jump.size) for jump in jumps),
        unit="m",
    )


def _cause(jumps: Sequence[Jump]) -> str:
    """Say what jumps may be: lost fringes have one size, or multiples of it."""
    sizes = np.array([abs(jump.size) for jump in jumps])
    if len(sizes) == 1:
        return "the stage or its mount slipped or the sensor lost its zero; one event cannot tell"
    for unit_m, what in (*FRINGES, (float(sizes.min()), "an interferometer or a counter")):
        times = sizes / unit_m
        if np.all(np.abs(times - np.maximum(np.round(times), 1.0)) < ALIKE):
            return f"{what} loses multiples of {with_unit(unit_m, 'm')}"
    return "the stage or its mount slips or the sensor loses its zero"
