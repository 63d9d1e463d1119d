"""The clock of a recording: rounding, jitter, gaps and stops."""

import numpy as np
import pytest

from piezoid.errors import RecordingError
from piezoid.numerics.arrays import Array
from piezoid.records.clock import Clock, read_clock, stated_clock
from piezoid.records.table import rate_of

RATE_Hz = 20000.0
TIME_s = np.arange(5000) / RATE_Hz


def clock_of(time_s: Array) -> Clock:
    return read_clock(time_s, "run.csv", lambda row: f"row {row + 1}")


def quantities_of(clock: Clock) -> set[str]:
    return {problem.quantity for problem in clock.statements}


@pytest.mark.parametrize(
    "time_s",
    [
        TIME_s,
        np.round(TIME_s, 6),
        np.round(TIME_s, 3),  # fifty samples per stamp
        np.array([float(f"{t:.6g}") for t in TIME_s + 1000]),
        TIME_s + 1.7e9,  # seconds of an epoch: a double resolves 2.4e-7 s there
        TIME_s - 0.1,
    ],
    ids=["exact", "microseconds", "milliseconds", "six digits", "epoch", "negative"],
)
def test_rounded_stamps_give_the_exact_rate(time_s):
    clock = clock_of(time_s)
    assert clock.sampling_rate_Hz == RATE_Hz
    assert not clock.statements
    assert not clock.breaks


@pytest.mark.parametrize("share", [0.03, 0.1, 0.2])
def test_jitter_is_reported_with_its_size(share, rng):
    clock = clock_of(TIME_s + rng.normal(0, share / RATE_Hz, len(TIME_s)))
    assert quantities_of(clock) == {"jitter"}
    assert not clock.breaks
    assert clock.statements[0].value == pytest.approx(share / RATE_Hz, rel=0.1)
    assert clock.sampling_rate_Hz == pytest.approx(RATE_Hz, rel=1e-4)


@pytest.mark.parametrize("share", [0.004, 0.015, 0.06])
@pytest.mark.parametrize("digits", [15, 4, 3])
def test_many_missing_samples_keep_the_rate_and_are_counted(share, digits, rng):
    time_s = np.round(np.arange(20000) / 1000, digits)
    missing = 1 + np.flatnonzero(rng.random(19998) < share)
    clock = clock_of(np.delete(time_s, missing))
    assert clock.sampling_rate_Hz == 1000.0
    assert clock.statements[0].value == len(missing)
    assert len(clock.bridged) > 0.8 * len(missing)


def test_a_slightly_slow_clock_has_no_missing_samples():
    clock = clock_of(np.round(np.arange(5000) / 999.0, 3))
    assert not clock.statements
    assert clock.sampling_rate_Hz == pytest.approx(999.0, rel=1e-3)


def test_gaps_and_reversals_are_breaks(rng):
    time_s = TIME_s + rng.normal(0, 0.05 / RATE_Hz, len(TIME_s))
    time_s[3000:] += 0.01
    time_s[2000] += 0.8 / RATE_Hz  # a late stamp is no gap
    assert clock_of(time_s).breaks == (3000,)
    time_s = TIME_s.copy()
    time_s[2500:] -= time_s[2500]
    clock = clock_of(time_s)
    assert quantities_of(clock) == {"time_reversed"}
    assert clock.breaks == (2500,)


def test_repeated_stamps_of_few_digits_are_counted():
    time_s = np.round(np.arange(2000) / 1000, 3)
    time_s[900:905] = time_s[900]
    clock = clock_of(time_s)
    assert not clock.breaks
    (problem,) = clock.statements
    assert (problem.quantity, problem.place, problem.value) == ("duplicate_time", "row 902", 4)
    is_repeated = np.isin(np.arange(2000), np.arange(440, 500))
    (problem,) = clock_of(
        np.round(np.repeat(np.arange(2000) / 1000, 1 + is_repeated), 3)
    ).statements
    assert (problem.quantity, problem.value) == ("duplicate_time", 60)


def test_steps_that_do_not_add_up_to_the_span_are_refused():
    # Short bursts at ten times the rate are neither segments nor faults of stamps.
    steps_s = np.where(np.arange(4000) % 200 < 40, 1e-4, 1e-3)
    with pytest.raises(RecordingError, match=r"make 3\.999 s, while the stamps span 3\.27"):
        clock_of(np.cumsum(steps_s))


@pytest.mark.parametrize("rate_Hz", [np.inf, np.nan, -1.0, 5e-324, 1e-308, 1e16])
def test_an_impossible_rate_is_refused(rate_Hz):
    with pytest.raises(RecordingError, match=r"a sampling rate of .* Hz is stated"):
        stated_clock(rate_Hz, "run.lvm")
    assert stated_clock(1 / 5e-4, "run.lvm").sampling_rate_Hz == 2000.0


@pytest.mark.parametrize("interval_s", [None, 0.0, -1.0, np.nan, np.inf, 5e-324, 1e308])
def test_an_invalid_interval_states_no_rate(interval_s):
    assert rate_of(interval_s) is None
    assert rate_of(5e-4) == 2000.0


@pytest.mark.parametrize(
    "time_s",
    [
        *(np.zeros(100), np.linspace(1, 0, 100), np.array([0.0, 1.0])),
        *(1e24 * np.arange(100), 1e-310 * np.arange(100)),
    ],
)
def test_an_invalid_clock_is_refused(time_s):
    with pytest.raises(RecordingError):
        clock_of(time_s)
