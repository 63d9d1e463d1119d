"""The decay is identified with its interval for any noise, polarity and height."""

import numpy as np
import pytest

from piezoid.identification.tunnelling.barrier_fit import fit_barrier
from piezoid.operators.tunnelling import barrier_of_decay
from tests.identification.tunnelling.sweeps import DECAY_PER_M, OFFSET_A, changed, sweep


def test_decay_and_offset_of_a_sweep_without_noise_are_recovered(rng):
    fit = fit_barrier([sweep(rng, floor_A=0.0, relative=0.0)])
    assert fit.decay_per_m == pytest.approx(DECAY_PER_M, rel=1e-6)  # tolerance of the search
    assert fit.offset_A == pytest.approx(OFFSET_A, rel=1e-3, abs=0.0)
    assert fit.barrier_eV == pytest.approx(barrier_of_decay(DECAY_PER_M), rel=2e-6)


def test_the_interval_covers_the_truth_also_when_residuals_are_correlated(rng):
    covered = 0
    for _ in range(12):
        low, high = fit_barrier([sweep(rng, correlation=0.9)]).decay_interval_per_m
        covered += low <= DECAY_PER_M <= high
    assert covered >= 9  # 11.4 expected, 2.5 standard deviations are 1.9


@pytest.mark.parametrize("polarity", [1.0, -1.0])
def test_either_polarity_gives_the_same_decay(rng, polarity):
    fit = fit_barrier([sweep(rng, polarity=polarity)])
    assert fit.polarity == polarity
    assert fit.decay_per_m == pytest.approx(DECAY_PER_M, rel=0.01)
    assert fit.offset_A == pytest.approx(OFFSET_A, abs=4.0 * fit.offset_standard_A)


def test_an_inverting_amplifier_is_detected(rng):
    original = sweep(rng)
    inverted = fit_barrier([changed(original, -original.current_A)])
    assert inverted.polarity == -fit_barrier([original]).polarity


def test_the_floor_and_the_jitter_of_the_gap_are_estimated(rng):
    fit = fit_barrier([sweep(rng) for _ in range(3)])
    assert fit.floor_A == pytest.approx(0.015e-12, rel=0.2, abs=0.0)  # 240 points below: 5 %
    assert fit.gap_jitter_m == pytest.approx(0.01 / DECAY_PER_M, rel=0.2, abs=0.0)


@pytest.mark.parametrize(("step_A", "rel"), [(0.3e-12, 0.01), (5e-12, 0.1)])
def test_undeclared_steps_of_a_converter_act_as_a_noise_floor(rng, step_A, rel):
    """Steps of 5 pA hide the offset and half of the sweep; the other half shows its decay."""
    curve = sweep(rng, floor_A=0.0)
    fit = fit_barrier([changed(curve, step_A * np.round(curve.current_A / step_A))])
    assert fit.floor_A == pytest.approx(step_A / np.sqrt(12.0), rel=0.1, abs=0.0)
    assert fit.decay_interval_per_m[0] < DECAY_PER_M < fit.decay_interval_per_m[1]
    assert fit.decay_per_m == pytest.approx(DECAY_PER_M, rel=rel)
    assert not fit.weighted.jumps


def test_single_outliers_do_not_move_the_decay(rng):
    complete = sweep(rng)
    current_A = complete.current_A.copy()
    current_A[[20, 90, 140]] *= 3.0
    fit = fit_barrier([changed(complete, current_A)])
    assert fit.decay_per_m == pytest.approx(DECAY_PER_M, rel=0.01)


def test_sweeps_of_drifting_height_share_one_decay(rng):
    curves = [sweep(rng, shift_m=shift) for shift in (0.0, 5e-12, 12e-12)]
    fit = fit_barrier(curves)
    assert fit.decay_per_m == pytest.approx(DECAY_PER_M, rel=0.01)
    assert len(fit.sweep_decay_per_m) == 3
    assert not fit.weighted.jumps
