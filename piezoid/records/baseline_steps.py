"""Split recordings where the zero of the sensor steps: a slip of stage or mount, lost fringes.

    y(t) = f(t) + sum of J_k for all t_k < t

A step is larger than the changes around it and than the response to changes of the drive, and it
lasts: crossings of one level of the drive in one direction differ from cycle to cycle by the steps
between them. A jump that returns on the way down (a dead spot, a converter) fails the second test.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from piezoid.formatting import with_unit
from piezoid.numerics.arrays import Array
from piezoid.records.drive_signal import is_at_rest
from piezoid.records.recording import Recording
from piezoid.records.sample_statistics import robust_sigma, step_size
from piezoid.statement import Statement, finding

# With these values no step is found in 294 healthy recordings, nor in those of 60 stages of two
# other simulators.
WIDTHS = (1, 4, 16)  # samples of a step, by the filter of the sensor
NEIGHBOUR_WIDTHS = 10  # on either side of a step: the changes to compare it with
MIN_SPREADS = 10.0  # times the spread of the changes around it; also twice the largest of them
MIN_CODES = 4.0  # converter steps
MAX_RESPONSE = 16  # samples: largest delay of the response to a step of the drive
MAX_STEPS = 30  # in a recording; a zero with more steps wanders, and the pieces would be short
MIN_TELEGRAPH_STEPS = 4  # one in eight sets of four random signs alternates by chance
TELEGRAPH_SHARE = 0.75  # of alternating steps; one step may have been missed
LEVELS = (0.3, 0.5, 0.7)  # of the drive's range, at which cycles are compared
MAX_UNEXPLAINED = 0.5  # of the differences between cycles
REST_BLOCK = 20  # samples of a mean at constant drive; also the shortest time between crossings
# Ratio of the mean difference between cycles at a step to that of any other period.
MIN_STEP_RATIO = 5.0
MIN_CYCLES = 4  # equal cycles: two to compare on either side of a step
MAX_SCATTER_RATIO = 1.2  # in the period of the step, over that of others: a step shifts all of it
MAX_CYCLE_DIFFERENCE = 0.01  # of a cycle's rms, between equal cycles of the drive
FRINGE_TOLERANCE = 0.1  # of a fringe; one in five steps meets a multiple by chance
FRINGES = (
    (316.4e-9, "an interferometer with a helium-neon laser"),
    (158.2e-9, "a double-pass interferometer with a helium-neon laser"),
)
MAX_PLACES = 5  # in the message

Samples = NDArray[np.intp]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class BaselineStep:
    """One lasting step of the zero.

    first, last  samples before and behind it
    size         signed, in the unit of the reading
    """

    first: int
    last: int
    size: float


def find_baseline_steps(recording: Recording) -> tuple[tuple[int, ...], list[Statement]]:
    """Return the breaks of a recording and those at steps of a sensor's zero, with statements.

    Each piece has a separate zero, and the state of the hysteresis behind a step is unknown.
    """
    breaks, statements = set(recording.breaks), []
    for axis in recording.complete_axes:
        drive, reading = recording.voltage_V(axis), recording.displacement_m(axis)
        is_constant = is_at_rest(drive, reading)
        steps = [
            BaselineStep(first=part.start + s.first, last=part.start + s.last, size=s.size)
            for part in recording.pieces
            for s in baseline_steps(reading[part], drive[part], is_drive_constant=is_constant)
        ]
        if not steps:
            continue
        breaks.update(k for step in steps for k in (step.first + 1, step.last))
        descriptions = [
            f"{'+' if step.size > 0 else ''}{with_unit(step.size, 'm')} at "
            f"{step.first / recording.sampling_rate_Hz:.4g} s"
            for step in steps[:MAX_PLACES]
        ]
        further = f" and {len(steps) - MAX_PLACES} more" if len(steps) > MAX_PLACES else ""
        # Lost fringes have multiples of one size.
        sizes_m = np.array([abs(step.size) for step in steps])
        cause = "slips of the stage or its mount, or a sensor that loses its zero"
        if len(steps) == 1:
            cause = (
                "a slip of the stage or its mount, or a lost zero of the sensor (one step only)"
            )
        smallest = (float(sizes_m.min()), "an interferometer or a counter")
        for unit_m, sensor in (*FRINGES, smallest) if len(steps) > 1 else ():
            multiples = sizes_m / unit_m
            error = np.abs(multiples - np.maximum(np.round(multiples), 1.0))
            if np.all(error < FRINGE_TOLERANCE):
                cause = f"{sensor} loses multiples of {with_unit(unit_m, 'm')}"
                break
        times = "once" if len(steps) == 1 else f"{len(steps)} times"
        text = (
            f"The zero of the displacement steps {times} while the drive does not: "
            f"{', '.join(descriptions)}{further}. Likely cause: {cause}. The spans "
            "between are fitted with separate zeros."
        )
        largest_m = float(sizes_m.max())
        statements.append(finding("zero_jump", text, axis=axis, value=largest_m, unit="m"))
    return tuple(sorted(breaks)), statements


def baseline_steps(
    reading: Array, drive: Array, *, is_drive_constant: bool = False
) -> tuple[BaselineStep, ...]:
    """Return the lasting steps of a reading that the drive did not cause, in their order.

    reading, drive     (samples,)  any unit, without gaps
    is_drive_constant  any two spans should then read the same

    A reading that switches back and forth between two levels has no steps.

    Limits: a step below ten times the spread of single changes is missed, and so is one after
    which the drive never returns to an earlier level.
    """
    candidates: list[BaselineStep] = []
    for width in WIDTHS:
        for step in _outstanding_steps(reading, drive, width):
            if all(step.last < c.first or step.first > c.last for c in candidates):
                candidates.append(step)
    if len(candidates) > MAX_STEPS:
        return ()
    if not candidates:
        return _step_between_cycles(reading, drive)
    candidates.sort(key=lambda step: step.first)
    is_up = np.array([step.size > 0.0 for step in candidates])
    alternating = (is_up[1:] != is_up[:-1]).mean() if len(candidates) > 1 else 0.0
    if len(candidates) >= MIN_TELEGRAPH_STEPS and alternating >= TELEGRAPH_SHARE:
        return ()
    earlier, later, difference = _repeated_readings(reading, drive, is_drive_constant)
    spans: Mask = np.array([(earlier <= step.first) & (later >= step.last) for step in candidates])
    contributions = np.array([[step.size] for step in candidates]) * spans

    def mean_residual(used: Mask, pairs: Mask) -> float:
        explained = contributions[used].sum(axis=0)
        return float(np.abs(difference - explained)[pairs].mean())

    # A jump that returns within a cycle explains no difference between two cycles.
    is_spanned, numbers = np.asarray(spans.any(axis=0)), np.arange(len(candidates))
    every_step = numbers >= 0
    if not is_spanned.any() or mean_residual(
        every_step, is_spanned
    ) > MAX_UNEXPLAINED * mean_residual(~every_step, is_spanned):
        return ()
    return tuple(
        step
        for k, step in enumerate(candidates)
        if (pairs := np.asarray(spans[k])).any()
        and mean_residual(every_step, pairs) < MAX_UNEXPLAINED * mean_residual(numbers != k, pairs)
    )


def _step_between_cycles(reading: Array, drive: Array) -> tuple[BaselineStep, ...]:
    """Return the step of the zero between equal cycles, averaged over noise.

        d(t) = y(t + P) - y(t) = J   for t_0 - P <= t < t_0,   else 0

    P is the period of the drive and J the step at t_0. The mean of d over a period shows steps far
    below the noise of single samples; the means over other periods must be much smaller. The first
    cycle has another initial state and is not compared.

    A drive repeats after P if the sum of (u(t + P) - u(t))^2 is small against its power.
    """
    count, centred = len(drive), drive - drive.mean()
    correlation = np.fft.irfft(np.abs(np.fft.rfft(centred, 2 * count)) ** 2)[:count]
    power = np.concatenate([[0.0], np.cumsum(centred**2)])
    lags = np.arange(count // MIN_CYCLES + 1)
    squares = power[count - lags] + power[-1] - power[lags] - 2.0 * correlation[lags]
    variance, drive_variance = squares / (count - lags), power[-1] / count
    moving = np.flatnonzero(variance > 0.5 * drive_variance)
    if not len(moving):
        return ()
    is_equal = variance[moving[0] :] < MAX_CYCLE_DIFFERENCE**2 * drive_variance
    repeats = moving[0] + np.flatnonzero(is_equal)
    if not len(repeats):
        return ()
    first = repeats[: 1 + np.argmax(np.diff(repeats, append=np.inf) > 1)]
    period = int(first[np.argmin(variance[first])])
    if period == 0 or len(drive) < MIN_CYCLES * period:
        return ()
    difference = reading[2 * period :] - reading[period:-period]
    difference -= np.median(difference)
    means = np.convolve(difference, np.full(period, 1.0 / period), "valid")
    start = int(np.argmax(np.abs(means)))
    size, instant = float(means[start]), start + 2 * period
    other_means = np.concatenate([means[: max(start - period, 0)], means[start + period :]])
    scatter = 1.4826 * float(np.median(np.abs(np.diff(difference)))) / np.sqrt(2.0 * period)
    if not len(other_means):
        return ()
    if not abs(size) > MIN_STEP_RATIO * max(float(np.abs(other_means).max()), scatter):
        return ()
    in_period = np.zeros(len(difference), dtype=bool)
    in_period[start : start + period] = True
    other_scatter = robust_sigma(difference[~in_period])
    if robust_sigma(difference[in_period]) > MAX_SCATTER_RATIO * other_scatter:
        return ()
    return (BaselineStep(first=instant - 1, last=instant, size=size),)


def _outstanding_steps(reading: Array, drive: Array, width: int) -> list[BaselineStep]:
    """Return the changes over ``width`` samples that exceed those around them and the drive's."""
    count = 2 * NEIGHBOUR_WIDTHS * width + 1
    if len(reading) < 2 * count:
        return []
    change = reading[width:] - reading[:-width]
    excess = change - median_filter(change, count)
    size = np.abs(excess)
    spread = np.maximum(1.4826 * median_filter(size, count), 1e-300)
    driven = drive[width:] - drive[:-width]
    driven = np.abs(driven - median_filter(driven, count))
    gain = float(np.ptp(reading)) / max(float(np.ptp(drive)), 1e-300)
    is_large = (size > MIN_SPREADS * spread) & (size > MIN_CODES * step_size(reading))
    steps = []
    for k in np.flatnonzero(is_large).tolist():
        if size[k] < size[max(k - width, 0) : k + width + 1].max():
            continue
        earlier = size[max(k - NEIGHBOUR_WIDTHS * width, 0) : max(k - width, 0)]
        later = size[k + width + 1 : k + NEIGHBOUR_WIDTHS * width + 1]
        largest = max(float(earlier.max(initial=0.0)), float(later.max(initial=0.0)))
        response = gain * float(driven[max(k - MAX_RESPONSE - width, 0) : k + width + 1].max())
        if size[k] > 2.0 * max(largest, response):
            steps.append(BaselineStep(first=k, last=k + width, size=float(excess[k])))
    return steps


def _repeated_readings(
    reading: Array, drive: Array, is_drive_constant: bool
) -> tuple[Samples, Samples, Array]:
    """Pair samples at which a stage with a constant zero would read the same.

    These are successive crossings of the same level of the drive in the same direction; at
    constant drive, the means of each block and of the next block but one.

    Returns:
        The earlier and the later samples, and the later readings less the earlier ones.
    """
    if is_drive_constant:
        count = len(reading) // REST_BLOCK
        means = reading[: count * REST_BLOCK].reshape(count, REST_BLOCK).mean(axis=1)
        middle = REST_BLOCK * np.arange(count) + REST_BLOCK // 2
        return middle[:-2], middle[2:], means[2:] - means[:-2]
    no_samples = np.empty(0, dtype=np.intp)
    pairs: list[tuple[Samples, Samples, Array]] = [(no_samples, no_samples, np.empty(0))]
    low, range_ = float(drive.min()), float(np.ptp(drive))
    for share, direction in product(LEVELS if range_ > 0.0 else (), (1.0, -1.0)):
        v = direction * (drive - (low + share * range_))
        samples = np.flatnonzero((v[:-1] < 0.0) & (v[1:] >= 0.0))
        part = -v[samples] / (v[samples + 1] - v[samples])
        level = reading[samples] + part * (reading[samples + 1] - reading[samples])
        # A drive with read-back noise crosses a level several times in succession.
        is_first = np.diff(samples, prepend=-REST_BLOCK - 1) > REST_BLOCK
        samples, level = samples[is_first], level[is_first]
        pairs.append((samples[:-1], samples[1:], np.diff(level)))
    earlier, later, difference = zip(*pairs, strict=True)
    return np.concatenate(earlier), np.concatenate(later), np.concatenate(difference)
