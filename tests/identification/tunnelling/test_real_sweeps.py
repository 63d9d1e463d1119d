"""Recorded Z spectroscopy: three sweeps in each direction, without selection."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from piezoid.identification.quality import Confidence
from piezoid.identification.tunnelling.approach import Direction
from piezoid.identification.tunnelling.barrier_fit import BarrierFit, fit_barrier
from piezoid.identification.tunnelling.junction import compare_directions
from tests.identification.tunnelling.sweeps import real_sweep, real_table, sweep

# The published fits of the two averages, in decays per nanometre.
PUBLISHED_PER_M = {Direction.FORWARD: 20.60e9, Direction.BACKWARD: 20.76e9}


@cache
def _fit(realdata: Path, direction: Direction, *numbers: str) -> BarrierFit:
    table = real_table(realdata)
    return fit_barrier([real_sweep(table, number, direction) for number in numbers])


@pytest.mark.parametrize("direction", list(Direction))
def test_the_published_decay_lies_in_the_interval_and_three_sweeps_agree_with_it(
    realdata, direction
):
    fit = _fit(realdata, direction, "AVG")
    low, high = fit.decay_interval_per_m
    assert low < PUBLISHED_PER_M[direction] < high
    assert fit.decay_per_m == pytest.approx(PUBLISHED_PER_M[direction], rel=0.005)
    assert (high - low) / fit.decay_per_m < 0.03
    assert 3.9 < fit.barrier_interval_eV[0] < fit.barrier_interval_eV[1] < 4.3
    joint_fit = _fit(realdata, direction, "00001", "00002", "00003")
    assert joint_fit.decay_per_m == pytest.approx(fit.decay_per_m, rel=0.003)
    assert np.ptp(joint_fit.sweep_decay_per_m) < 0.003 * joint_fit.decay_per_m
    assert joint_fit.confidence is Confidence.HIGH


def test_the_negative_polarity_and_the_offset_are_found(realdata):
    fit = _fit(realdata, Direction.FORWARD, "AVG")
    assert fit.polarity == -1.0
    assert -0.05e-12 < fit.offset_A < -0.01e-12  # -0.036 pA at the far end


def test_the_directions_differ_by_a_few_picometres(realdata):
    fits = [_fit(realdata, direction, "00001", "00002", "00003") for direction in Direction]
    shift = compare_directions(*fits)
    low, high = shift.shift_interval_m
    assert -5e-12 < low < shift.shift_m < high < 0.0
    assert shift.is_one_decay


def test_a_known_shift_between_directions_is_found(rng):
    forward = fit_barrier([sweep(rng) for _ in range(3)])
    backward = fit_barrier(
        [sweep(rng, shift_m=10e-12, direction=Direction.BACKWARD) for _ in range(3)]
    )
    shift = compare_directions(forward, backward)
    assert shift.shift_m == pytest.approx(10e-12, abs=0.5e-12)  # jitter is 0.5 pm a point
    assert shift.shift_interval_m[0] < 10e-12 < shift.shift_interval_m[1]
