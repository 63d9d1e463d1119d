"""Find the uniform clock of a recording: its rate, and gaps, repeats and steps of its stamps."""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezoid.errors import RecordingError
from piezoid.numerics.arrays import Array, runs_of
from piezoid.records.lab_tables import entry_text
from piezoid.records.sample_statistics import robust_sigma
from piezoid.statement import Statement, finding

Stamps = NDArray[np.int_]
RowName = Callable[[int], str]  # from the index of a stamp to the name of its row in messages

MIN_JITTER = 0.01  # of the sampling interval, rms; less is not reported
MAX_SPREAD = 0.35  # of the interval: the robust spread of the steps of a uniform clock
# Samples over which steps are averaged to find the interval: stamps printed with few digits repeat
# and jump, their averages do not. The number is halved while fewer than MIN_AGREEING of the
# averages agree, because samples are lost.
AVERAGED_STEPS = 64
MIN_AGREEING = 0.6
MIN_BACKWARDS = 0.9  # of the steps, if the newest row is the first
# Steps without faults sum to the span of the stamps within this share, the uncertainty of an
# interval with a jitter of a third, and within a few more steps at ends and faults.
MAX_UNACCOUNTED = 0.01
SPARE_STEPS = 3
MAX_COUNTABLE = 1e12  # units: larger doubles are rounded too coarsely to show printed digits
MAX_RARE = 0.01  # of the steps
MIN_INTERVAL_s, MAX_INTERVAL_s = 1e-13, 1e9  # of any recording
MAX_LOST = 2.0**53  # samples in one gap: a damaged stamp may lie anywhere
_MAX_PLACES = 3  # in a message
CONTROLLER_RATE = "controller_rate"  # quantity of the statement that a file is read at that rate

# Changes of the rate are found in median intervals of blocks of steps; a segment of one rate lasts
# at least three blocks. The median of 64 steps with a jitter of a third of the interval is certain
# to 8 %, and a single block with a gap or a stall is outvoted by its neighbours.
_BLOCK_STEPS = 64
_MIN_BLOCKS = 3
# Recorders change their rate by factors. Intervals of one clock with a jitter of a third differ by
# less than this between two blocks; ``read_clock`` refuses smaller changes.
_MIN_RATE_CHANGE = 1.5
# Resolution of the print, relative to the interval, above which the mean step of a block is used
# in place of the median.
_COARSE_PRINT = 0.2


@dataclass(frozen=True, kw_only=True)
class Clock:
    """Sampling rate and faults of the time stamps.

    sampling_rate_Hz  of the samples between gaps
    breaks            first sample after each longer gap or step backwards
    bridged           first sample after each gap of one sample
    statements        ``jitter``, ``gap``, ``duplicate_time``, ``time_reversed``,
                      ``controller_rate``
    """

    sampling_rate_Hz: float
    breaks: tuple[int, ...] = ()
    bridged: tuple[int, ...] = ()
    statements: tuple[Statement, ...] = ()


def read_clock(time_s: Array, name: str, row_name: RowName) -> Clock:
    """Find the sampling rate and the faults of a column of time stamps.

    time_s    (samples,)  s, finite
    name      of the file, for messages

    row_name  name of the row of a stamp, for messages

    Stamps that a uniform clock would print with the same number of digits are uniform: rounding is
    not jitter. Raises ``RecordingError`` for stamps without a common interval.
    """
    if len(time_s) < 3:
        raise _clock_error(name, f"{len(time_s)} time stamps", "at least three")
    refuse_newest_first(time_s, name, row_name)
    resolution_s = print_resolution_s(time_s)
    uniform_s = (time_s[-1] - time_s[0]) / (len(time_s) - 1)
    if 0 < uniform_s < MIN_INTERVAL_s or uniform_s > MAX_INTERVAL_s:
        raise _clock_error(name, f"time stamps {uniform_s:.3g} s apart", "the steps of a clock")
    # The rounding error is half a unit; that of the fitted line may be a quarter more.
    tolerance_s = 0.75 * resolution_s + 8 * np.spacing(np.abs(time_s).max())
    # The uniform clock nearest to the stamps lies in the middle of their errors.
    k = np.arange(len(time_s))
    slope_s, start_s = np.polyfit(k, time_s - time_s[0], 1)
    error_s = time_s - time_s[0] - (start_s + slope_s * k)
    line_s = time_s[0] + start_s + (error_s.max() + error_s.min()) / 2 + slope_s * k
    is_line = uniform_s > 0 and np.abs(time_s - line_s).max() <= tolerance_s
    has_rare_jumps = False
    if is_line and resolution_s > 0:
        # A line fits the stamps 1, 2, 3, 5, 6 ms to half a millisecond. The steps of a clock
        # slightly slower than its print are doubled at regular distances; lost samples are not.
        steps = np.round(np.diff(time_s) / resolution_s).astype(np.int64)
        typical = int(np.median(steps))
        jumps = np.flatnonzero(2 * steps >= 3 * typical)
        is_rare = typical >= 1 and 0 < len(jumps) <= MAX_RARE * len(steps)
        has_rare_jumps = is_rare and (len(jumps) < 3 or bool(np.ptp(np.diff(jumps)) > 1))
    if is_line and not has_rare_jumps:
        uncertainty = 2 * tolerance_s / (time_s[-1] - time_s[0])
        return Clock(sampling_rate_Hz=rounded_rate_Hz(1 / uniform_s, uncertainty))
    return _clock_with_faults(time_s, resolution_s, name, row_name)


def stated_clock(rate_Hz: float, name: str) -> Clock:
    """Return the clock of a file without time stamps from its stated rate; refuse absurd rates."""
    if not 1 / MAX_INTERVAL_s <= rate_Hz <= 1 / MIN_INTERVAL_s:
        raise RecordingError(
            f"{name}: a sampling rate of {rate_Hz:.3g} Hz is stated",
            needed=f"a rate from {1 / MAX_INTERVAL_s:.0e} to {1 / MIN_INTERVAL_s:.0e} Hz",
            remedy="Correct it where it is stated, in the file's header or in lab.toml.",
        )
    return Clock(sampling_rate_Hz=rounded_rate_Hz(rate_Hz))


def rounded_rate_Hz(rate_Hz: float, uncertainty: float = 0.0) -> float:
    """Round a rate to the fewest digits within its relative uncertainty, which is at least 1e-9.

    Recordings of one rig then have the same rate, independent of the rounding of their stamps.
    """
    for digits in range(1, 16):
        rounded_Hz = float(f"{rate_Hz:.{digits}g}")
        if abs(rounded_Hz - rate_Hz) <= max(uncertainty, 1e-9) * rate_Hz:
            return rounded_Hz
    return rate_Hz


def print_resolution_s(time_s: Array) -> float:
    """Return the power of ten of which all stamps are multiples; 0 for stamps of full precision.

    A thousand stamps spread over the file are tested; the later ones have the fewest decimals.
    """
    stamps = time_s[np.unique(np.linspace(0, len(time_s) - 1, 1000).astype(int))]
    for exponent in range(0, -16, -1):
        scaled = stamps * 10.0**-exponent
        largest = float(np.abs(scaled).max())
        if largest > MAX_COUNTABLE:
            break
        rounding = 8 * np.finfo(float).eps * max(1.0, largest)
        if np.abs(scaled - np.round(scaled)).max() <= rounding:
            return float(10.0**exponent)
    return 0.0


def refuse_newest_first(time_s: Array, name: str, row_name: RowName) -> None:
    """Refuse stamps that run backwards: every loop would have the wrong orientation."""
    if len(time_s) < 3 or np.mean(np.diff(time_s) < 0) < MIN_BACKWARDS:
        return
    raise RecordingError(
        f"{name}: time runs backwards, from {time_s[0]:.6g} s in {row_name(0)} to "
        f"{time_s[-1]:.6g} s in {row_name(len(time_s) - 1)}: the newest row is the first",
        needed="rows in the order in which they were recorded",
        remedy="Write into lab.toml, which reverses the rows:\n\n"
        f"{entry_text(name, 'reverse = true')}\n",
    )


def _clock_with_faults(time_s: Array, resolution_s: float, name: str, row_name: RowName) -> Clock:
    """Return a clock with the faults of its stamps; refuse stamps without a common interval."""
    steps = np.diff(time_s)
    interval_s = _interval_s(time_s)
    spread_s = robust_sigma(steps)
    if not interval_s > 0 or spread_s > MAX_SPREAD * interval_s + resolution_s:
        raise _clock_error(
            name,
            f"time steps from {steps.min():.4g} s to {steps.max():.4g} s, median "
            f"{np.median(steps):.4g} s",
            "samples at a uniform rate",
        )
    # A printed step may be rounded up to the next multiple of the resolution.
    rounding_s = 0.0
    if resolution_s > 0:
        rounding_s = math.ceil(interval_s / resolution_s - 1e-6) * resolution_s - interval_s
    max_excess_s = max(0.5 * interval_s, 6 * spread_s) + rounding_s
    gaps, missing = _find_gaps(time_s, interval_s, max_excess_s)
    repeated = _repeated_stamps(steps, interval_s, resolution_s)
    backward = np.flatnonzero(steps < -max_excess_s) + 1
    set_back = np.round(np.minimum(1.0 - steps[backward - 1] / interval_s, MAX_LOST)).astype(int)
    single = int(np.sum(missing == 1))
    bridged = f"; {single} of single samples, bridged by interpolation" if single else ""
    counts = int(missing.sum()), len(repeated), int(set_back.sum())
    _refuse_unaccounted_time(time_s, interval_s, counts, name, row_name)
    faults = (
        ("gap", "time is missing", gaps, bridged),
        ("duplicate_time", "the time stamp is repeated", repeated, ""),
        ("time_reversed", "the clock steps back", backward, ""),
    )
    statements = [
        finding(
            quantity,
            f"{sentence} at {_places(rows, time_s, row_name)}{addition}",
            place=row_name(int(rows[0])),
            value=float(samples),
            unit="samples",
        )
        for (quantity, sentence, rows, addition), samples in zip(faults, counts, strict=True)
        if len(rows)
    ]
    # The variance of a step is that of two independent stamps.
    errors_s = (steps - interval_s)[np.abs(steps - interval_s) < max_excess_s]
    jitter_s = float(np.sqrt(np.mean(errors_s**2) / 2)) if len(errors_s) else 0.0
    if jitter_s > MIN_JITTER * interval_s and jitter_s > 0.51 * resolution_s:
        text = (
            f"The time stamps jitter by {jitter_s:.3g} s rms about a uniform clock, "
            f"{100 * jitter_s / interval_s:.2g} % of the sampling interval."
        )
        statements.append(
            finding("jitter", text, place="the time column", value=jitter_s, unit="s")
        )
    return Clock(
        sampling_rate_Hz=rounded_rate_Hz(
            1 / interval_s, (resolution_s + jitter_s) / np.ptp(time_s)
        ),
        breaks=tuple(sorted({*gaps[missing > 1].tolist(), *backward.tolist()})),
        bridged=tuple(gaps[missing == 1].tolist()),
        statements=tuple(statements),
    )


def _places(rows: Stamps, time_s: Array, row_name: RowName) -> str:
    """Return the number of the rows of a fault and the first locations."""
    first = [
        f"{row_name(k)}, t = {time_s[k]:.6g} s (step {time_s[k] - time_s[k - 1]:.6g} s)"
        for k in rows[:_MAX_PLACES].tolist()
    ]
    unlisted = len(rows) - _MAX_PLACES
    further = f" and {unlisted} more" if unlisted > 0 else ""
    return f"{len(rows)} places: {'; '.join(first)}{further}"


def _refuse_unaccounted_time(
    time_s: Array, interval_s: float, counts: Sequence[int], name: str, row_name: RowName
) -> None:
    """Refuse stamps whose steps do not sum up to their span.

    counts  samples that are missing, repeated and set back

    A repeated stamp may be a surplus sample, or be compensated when the clock catches up.
    """
    missing, repeated, set_back = counts
    span, expected = (time_s[-1] - time_s[0]) / interval_s, len(time_s) - 1 + missing - set_back
    tolerance = MAX_UNACCOUNTED * max(abs(span), expected) + SPARE_STEPS
    if not expected - repeated - tolerance <= span <= expected + tolerance:
        first = int(np.argmax(np.abs(np.diff(time_s) - interval_s) > 0.25 * interval_s)) + 1
        raise _clock_error(
            name,
            f"most time steps are {interval_s:.6g} s, of which {expected} make "
            f"{expected * interval_s:.6g} s, while the stamps span "
            f"{time_s[-1] - time_s[0]:.6g} s; the first other step is at {row_name(first)}",
            "samples at a uniform rate, or long segments of one rate",
        )


def _interval_s(time_s: Array) -> float:
    """Return the interval between samples: the median step, refined over spans without faults.

    The spans are halved as long as most of them contain a lost sample.
    """
    width = min(AVERAGED_STEPS, len(time_s) - 1)
    while True:
        spans = time_s[width:] - time_s[:-width]
        median_s = float(np.median(spans)) / width
        agrees = np.abs(spans - median_s * width) < 0.5 * median_s
        if width == 1 or agrees.mean() > MIN_AGREEING:
            return float(np.mean(spans[agrees])) / width if agrees.any() else median_s
        width //= 2


def _find_gaps(time_s: Array, interval_s: float, max_excess_s: float) -> tuple[Stamps, Stamps]:
    """Return the first sample after each gap, and the number of samples lost in each.

    A late stamp, or a clock that catches up, is not a gap: the time must also be missing over the
    samples around the step, so spans of several stamps are compared.
    """
    gaps, missing = [], []
    for k in (np.flatnonzero(np.diff(time_s) > interval_s + max_excess_s) + 1).tolist():
        previous = k - 1
        while previous > 0 and time_s[previous - 1] == time_s[previous]:
            previous -= 1
        following = min(k + 1, len(time_s) - 1)
        missing_s = time_s[following] - time_s[previous] - (following - previous) * interval_s
        if missing_s > max_excess_s:
            # A second gap directly behind this one is counted separately.
            missing_before_s = time_s[k] - time_s[previous] - (k - previous) * interval_s
            missing_s = min(missing_s, missing_before_s, MAX_LOST * interval_s)
            gaps.append(k)
            missing.append(max(round(missing_s / interval_s), 1))
    return np.array(gaps, dtype=int), np.array(missing, dtype=int)


def _repeated_stamps(steps: Array, interval_s: float, resolution_s: float) -> Stamps:
    """Return the samples with the stamp of the previous one, unless rounding explains them."""
    is_repeated = np.abs(steps) <= 1e-9 * interval_s
    # A clock faster than its print repeats so many stamps.
    by_rounding = len(steps) * max(0.0, 1.0 - interval_s / resolution_s) if resolution_s else 0.0
    if resolution_s > 0.5 * interval_s and np.count_nonzero(is_repeated) <= 2 * by_rounding + 2:
        max_run = int(np.ceil(resolution_s / interval_s + 1e-6))
        for start, stop in runs_of(is_repeated):
            is_repeated[start:stop] &= stop - start > max_run
    return np.flatnonzero(is_repeated) + 1


def _clock_error(name: str, observed: str, needed: str) -> RecordingError:
    return RecordingError(
        f"{name}: {observed}",
        needed=needed,
        remedy="Record with a hardware clock, or state sampling_rate_Hz for this file in lab.toml "
        "and name no time column if the samples are known to be uniform.",
    )


def constant_rate_segments(time_s: Array) -> tuple[slice, ...]:
    """Split time stamps where the sampling rate changes permanently.

    time_s    (samples,)  s, finite
    returned  adjacent slices that cover all samples
    """
    steps = np.diff(time_s)
    blocks = len(steps) // _BLOCK_STEPS
    if blocks < 2 * _MIN_BLOCKS:
        return (slice(0, len(time_s)),)
    in_blocks = steps[: blocks * _BLOCK_STEPS].reshape(blocks, _BLOCK_STEPS)
    intervals_s = np.median(in_blocks, axis=1)
    if print_resolution_s(time_s) > _COARSE_PRINT * np.median(intervals_s):
        intervals_s = in_blocks.mean(axis=1)
    padded = np.concatenate([intervals_s[:1], intervals_s, intervals_s[-1:]])
    intervals_s = np.median(np.lib.stride_tricks.sliding_window_view(padded, 3), axis=1)
    # The intervals of most files hardly differ, and need no search.
    if not (intervals_s > 0).all() or np.ptp(np.log(intervals_s)) <= np.log(_MIN_RATE_CHANGE):
        return (slice(0, len(time_s)),)
    log_intervals, min_change = np.log(intervals_s), np.log(_MIN_RATE_CHANGE)
    edges: list[int] = []
    begin = 0  # the first block of the segment
    for block in range(1, len(log_intervals) - _MIN_BLOCKS + 1):
        changes_after = log_intervals[block : block + _MIN_BLOCKS] - np.median(
            log_intervals[begin:block]
        )
        is_lasting = np.ptp(changes_after) < min_change / 2
        is_change = is_lasting and abs(changes_after[0]) > min_change
        if block - begin < _MIN_BLOCKS or not is_change:
            continue
        begin = block
        before_s, after_s = intervals_s[block - 1], intervals_s[block]
        first = max((block - 2) * _BLOCK_STEPS, 0)
        nearby_steps_s = steps[first : min((block + 2) * _BLOCK_STEPS, len(steps))]
        log_step = np.log(np.maximum(nearby_steps_s, 1e-9 * min(before_s, after_s)))
        misfit = np.abs(log_step - np.log(before_s)) - np.abs(log_step - np.log(after_s))
        # The change minimises the misfit of the steps before and behind it to their intervals.
        edges.append(first + int(np.argmin(np.concatenate([[0.0], np.cumsum(misfit)]))) + 1)
    return tuple(slice(a, b) for a, b in itertools.pairwise((0, *edges, len(time_s))))
