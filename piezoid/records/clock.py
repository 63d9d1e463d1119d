"""The clock of a recording: its rate, and where its time stamps are not those of a uniform one."""

import json
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from piezoid.errors import RecordingError
from piezoid.numerics.arrays import Array
from piezoid.records.time_faults import TimeFaults
from piezoid.statement import Statement, finding

# A stamp this far (in sampling intervals) off its place is jitter worth telling.
JITTER_LIMIT = 0.01
# A robust spread of the steps above this share of their median is no uniform clock at all.
UNIFORM_LIMIT = 0.35
# Steps are averaged over this many samples before the interval is taken: stamps printed with few
# digits repeat and jump, their averages do not.
_WINDOW = 64
# Over fewer samples where lost ones are so many that fewer averages than this agree.
_AGREEING = 0.6
# So many of the steps go back where the newest row stands first; steps back are faults else.
_BACKWARDS = 0.9
# Steps that are no faults sum up to the span of the stamps within this share, the spread of an
# interval told among jitter of a third, and these few at ends and faults.
_UNACCOUNTED = 0.01
_SPARE_STEPS = 3
# Beyond this many units a double rounds too coarsely to tell a printed digit from noise.
_COUNTABLE = 1e12
_RARE = 0.01


# No converter is as fast or as slow; beyond, rates and durations leave the range of numbers.
_LEAST_INTERVAL_s = 1e-15
_MOST_INTERVAL_s = 1e30


@dataclass(frozen=True, kw_only=True)
class Clock:
    """What the stamps say.

    sampling_rate_Hz  of the samples between gaps
    jitter_rms_s      of the stamps about uniform ones, faults left out; 0 within their print
    breaks            first sample after each longer gap or step backwards
    bridged           first sample after each gap of one sample
    statements          ``jitter``, ``gap``, ``duplicate_time``, ``time_reversed``
    """

    sampling_rate_Hz: float
    jitter_rms_s: float
    breaks: tuple[int, ...] = ()
    bridged: tuple[int, ...] = ()
    statements: tuple[Statement, ...] = ()


def read_clock(time_s: Array, name: str, place: Callable[[int], str]) -> Clock:
    """Find the sampling rate and the faults of a column of time stamps.

    time_s  (samples,)  s, finite
    name    of the file, for messages
    place   says where a row stands

    Stamps that a uniform clock would print with these digits are uniform: few digits are no
    jitter. Stamps that share no interval are refused.
    """
    if len(time_s) < 3:
        raise _no_clock(name, f"{len(time_s)} time stamps", "at least three")
    refuse_newest_first(time_s, name, place)
    resolution_s = print_resolution_s(time_s)
    k = np.arange(len(time_s))
    uniform_s = (time_s[-1] - time_s[0]) / k[-1]
    if 0 < uniform_s < _LEAST_INTERVAL_s:
        raise _no_clock(name, f"time stamps {uniform_s:.3g} s apart", "the steps of a clock")
    # Rounding is off by half a unit; the fitted line may be off by a quarter more.
    tolerance_s = 0.75 * resolution_s + 8 * np.spacing(np.abs(time_s).max())
    is_line = uniform_s > 0 and np.abs(time_s - _line(time_s)).max() <= tolerance_s
    if is_line and not _has_rare_jumps(time_s, resolution_s):
        uncertain = 2 * tolerance_s / (time_s[-1] - time_s[0])
        return Clock(
            sampling_rate_Hz=plain_rate_Hz(1 / uniform_s, uncertain),
            jitter_rms_s=0.0,
        )
    return _faulty_clock(time_s, resolution_s, name, place)


def stated_clock(rate_Hz: float, name: str) -> Clock:
    """Return the clock that is stated for a file without time stamps, refusing one of no bench."""
    if not 1 / _MOST_INTERVAL_s <= rate_Hz <= 1 / _LEAST_INTERVAL_s:
        raise RecordingError(
            f"{name}: a sampling rate of {rate_Hz:.3g} Hz is stated",
            needed=f"one from {1 / _MOST_INTERVAL_s:.0e} to {1 / _LEAST_INTERVAL_s:.0e} Hz",
            remedy="Correct it where it is stated, in the file's header or in lab.toml.",
        )
    return Clock(sampling_rate_Hz=plain_rate_Hz(rate_Hz), jitter_rms_s=0.0)


def plain_rate_Hz(rate_Hz: float, uncertainty: float = 0.0) -> float:
    """Return the number of fewest digits within a relative uncertainty of at least 1e-9.

    Two recordings of one rig then have one and the same rate, however their stamps were rounded.
    """
    for digits in range(1, 16):
        plain = float(f"{rate_Hz:.{digits}g}")
        if abs(plain - rate_Hz) <= max(uncertainty, 1e-9) * rate_Hz:
            return plain
    return rate_Hz


def print_resolution_s(time_s: Array) -> float:
    """Return the power of ten all stamps are multiples of, 0 where they are of full precision.

    A thousand stamps spread over the file decide; the later ones carry the fewest decimals.
    """
    stamps = time_s[np.unique(np.linspace(0, len(time_s) - 1, 1000).astype(int))]
    for exponent in range(0, -16, -1):
        scaled = stamps * 10.0**-exponent
        largest = float(np.abs(scaled).max())
        if largest > _COUNTABLE:
            break
        rounding = 8 * np.finfo(float).eps * max(1.0, largest)
        if np.abs(scaled - np.round(scaled)).max() <= rounding:
            return float(10.0**exponent)
    return 0.0


def _line(time_s: Array) -> Array:
    """The uniform clock nearest to the stamps in the middle of their errors."""
    k = np.arange(len(time_s))
    slope, start = np.polyfit(k, time_s - time_s[0], 1)
    error = time_s - time_s[0] - (start + slope * k)
    middle = (error.max() + error.min()) / 2
    line: Array = time_s[0] + start + middle + slope * k
    return line


def _has_rare_jumps(time_s: Array, resolution_s: float) -> bool:
    """Tell a lost sample from rounding where the print resolves no more than the interval.

    Of stamps 1, 2, 3, 5, 6 ms a line is never off by more than half a millisecond. A clock a
    little slower than its print would step by two evenly, again and again; lost samples do not.
    """
    if resolution_s == 0:
        return False
    steps = np.round(np.diff(time_s) / resolution_s).astype(np.int64)
    common = int(np.median(steps))
    jumps = np.flatnonzero(2 * steps >= 3 * common)
    if common < 1 or not len(jumps) or len(jumps) > _RARE * len(steps):
        return False
    return len(jumps) < 3 or bool(np.ptp(np.diff(jumps)) > 1)


def _faulty_clock(
    time_s: Array, resolution_s: float, name: str, place: Callable[[int], str]
) -> Clock:
    steps = np.diff(time_s)
    interval_s = _interval_s(time_s)
    spread_s = 1.4826 * float(np.median(np.abs(steps - np.median(steps))))
    if not interval_s > 0 or spread_s > UNIFORM_LIMIT * interval_s + resolution_s:
        raise _no_clock(
            name,
            f"time steps from {steps.min():.4g} s to {steps.max():.4g} s, median "
            f"{np.median(steps):.4g} s",
            "samples at a uniform rate",
        )
    excess_s = max(0.5 * interval_s, 6 * spread_s) + _rounding_s(interval_s, resolution_s)
    faults = TimeFaults.of(time_s, interval_s, excess_s, resolution_s)
    _refuse_false_clock(time_s, interval_s, faults, name, place)
    jitter_s = _jitter_s(steps, interval_s, excess_s)
    return Clock(
        sampling_rate_Hz=plain_rate_Hz(1 / interval_s, (resolution_s + jitter_s) / np.ptp(time_s)),
        jitter_rms_s=jitter_s,
        breaks=faults.breaks,
        bridged=faults.bridged,
        statements=(
            *faults.statements(time_s, place),
            *_jitter_problem(jitter_s, interval_s, resolution_s),
        ),
    )


def refuse_newest_first(time_s: Array, name: str, place: Callable[[int], str]) -> None:
    """Refuse stamps that run backwards: read so, every loop would open the wrong way."""
    if len(time_s) < 3 or np.mean(np.diff(time_s) < 0) < _BACKWARDS:
        return
    last = len(time_s) - 1
    raise RecordingError(
        f"{name}: time runs backwards, from {time_s[0]:.6g} s in {place(0)} to "
        f"{time_s[-1]:.6g} s in {place(last)}: the newest row stands first",
        needed="rows in the order in which they were recorded",
        remedy="Write into lab.toml, which turns the rows round:\n\n[[recording]]\n"
        f"file = {json.dumps(name)}\nreverse = true\n",
    )


def _refuse_false_clock(
    time_s: Array, interval_s: float, faults: TimeFaults, name: str, place: Callable[[int], str]
) -> None:
    """Refuse a clock whose steps do not sum up to what the stamps say has passed.

    A stamp that stands may be one sample too many, or be made up for when the clock catches up.
    """
    passed = (time_s[-1] - time_s[0]) / interval_s
    steps = len(time_s) - 1 + int(faults.lost.sum()) - int(faults.stepped.sum())
    allowed = _UNACCOUNTED * max(abs(passed), steps) + _SPARE_STEPS
    if steps - len(faults.stands) - allowed <= passed <= steps + allowed:
        return
    odd = np.abs(np.diff(time_s) - interval_s) > 0.25 * interval_s
    first = int(np.argmax(odd)) + 1
    raise _no_clock(
        name,
        f"most time steps are {interval_s:.6g} s, of which {steps} make {steps * interval_s:.6g} "
        f"s, while the stamps span {time_s[-1] - time_s[0]:.6g} s; the first other step is at "
        f"{place(first)}",
        "samples at a uniform rate, or stretches of one rate that are long enough to be told",
    )


def _interval_s(time_s: Array) -> float:
    """The interval between samples: the median step, refined over stretches without faults.

    Where most stretches have lost a sample, shorter ones are taken: their median is right again.
    """
    width = min(_WINDOW, len(time_s) - 1)
    while True:
        spans = time_s[width:] - time_s[:-width]
        rough = float(np.median(spans)) / width
        whole = np.abs(spans - rough * width) < 0.5 * rough
        if width == 1 or whole.mean() > _AGREEING:
            return float(np.mean(spans[whole])) / width if whole.any() else rough
        width //= 2


def _rounding_s(interval_s: float, resolution_s: float) -> float:
    """How much longer than the interval a step may be printed: up to the next multiple."""
    if resolution_s == 0:
        return 0.0
    return math.ceil(interval_s / resolution_s - 1e-6) * resolution_s - interval_s


def _jitter_s(steps: Array, interval_s: float, excess_s: float) -> float:
    """Root mean square of the stamps about uniform ones, from the steps that are neither fault.

    Two independent stamps make one step, hence the root of two.
    """
    errors = steps - interval_s
    regular = np.abs(errors) < excess_s
    return float(np.sqrt(np.mean(errors[regular] ** 2) / 2)) if regular.any() else 0.0


def _jitter_problem(
    jitter_s: float, interval_s: float, resolution_s: float
) -> tuple[Statement, ...]:
    if jitter_s <= JITTER_LIMIT * interval_s or jitter_s <= 0.51 * resolution_s:
        return ()
    text = (
        f"the time stamps scatter by {jitter_s:.3g} s rms about a uniform clock, "
        f"{100 * jitter_s / interval_s:.2g} % of the sampling interval"
    )
    return (finding(quantity="jitter", place="the time column", text=text),)


def _no_clock(name: str, found: str, needed: str) -> RecordingError:
    return RecordingError(
        f"{name}: {found}",
        needed=needed,
        remedy="Record with a hardware clock, or state sampling_rate_Hz for this file in lab.toml "
        "and name no time column if the samples are known to be uniform.",
    )
