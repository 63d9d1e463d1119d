"""Faults of a sweep are detected, allowed for and stated; unusable sweeps are refused."""

import re

import numpy as np
import pytest

from piezoid.errors import ExcitationError, RecordingError
from piezoid.identification.quality import Confidence
from piezoid.identification.tunnelling.approach import Direction, read_approach
from piezoid.identification.tunnelling.barrier_fit import fit_barrier
from tests.identification.tunnelling.sweeps import DECAY_PER_M, HEIGHT_M, OFFSET_A, changed, sweep


def test_rows_without_numbers_are_counted_and_lower_the_confidence(rng):
    complete = sweep(rng)
    current_A = complete.current_A.copy()
    current_A[rng.permutation(200)[:134]] = np.nan
    fit, reference = fit_barrier([changed(complete, current_A)]), fit_barrier([complete])
    assert fit.confidence is Confidence.LOW
    assert "134 of 200 rows contain no number" in fit.reasons[0]
    width, narrow = (np.ptp(f.decay_interval_per_m) for f in (fit, reference))
    assert width > 1.2 * narrow  # a third of the points: sqrt(3) expected, itself uncertain
    assert fit.decay_interval_per_m[0] < DECAY_PER_M < fit.decay_interval_per_m[1]


@pytest.mark.parametrize("remaining", ["a weak sweep", "the far end", "no current"])
def test_a_sweep_near_its_noise_has_a_wide_interval_and_states_the_reason(rng, remaining):
    curve = sweep(rng, peak_A=0.7e-12, floor_A=0.05e-12)
    if remaining == "the far end":
        complete = sweep(rng)
        curve = changed(complete, np.where(HEIGHT_M < 0.26e-9, np.nan, complete.current_A))
    elif remaining == "no current":
        curve = changed(curve, OFFSET_A + 0.015e-12 * rng.standard_normal(200))
    fit = fit_barrier([curve])
    assert fit.confidence is Confidence.LOW
    assert np.ptp(fit.barrier_interval_eV) > 0.2 * fit.barrier_eV
    assert fit.decay_interval_per_m[0] < DECAY_PER_M < fit.decay_interval_per_m[1]
    assert any("decades above three times its noise" in reason for reason in fit.reasons)
    if remaining == "no current":
        assert fit.decay_interval_per_m[1] == np.inf


@pytest.mark.parametrize("nepers", [0.3, -0.3])
def test_a_tip_jump_is_detected_allowed_for_and_stated(rng, nepers):
    fit = fit_barrier([sweep(rng, jump_nepers=nepers)])
    (jump,) = fit.weighted.jumps
    assert jump.height_m == pytest.approx(0.0, abs=4e-12)  # the step of the height
    assert jump.nepers == pytest.approx(nepers, rel=0.15)
    assert fit.decay_per_m == pytest.approx(DECAY_PER_M, rel=0.01)
    assert fit.confidence is Confidence.MEDIUM
    assert "tip jump" in fit.reasons[0]


def test_a_quiet_sweep_shows_neither_tip_jumps_nor_outliers(rng):
    for _ in range(4):
        fit = fit_barrier([sweep(rng, correlation=0.5)])
        assert not fit.weighted.jumps
        assert not any("outliers" in reason for reason in fit.reasons)


def test_an_unstable_tip_gets_low_confidence(rng):
    fit = fit_barrier([sweep(rng, relative=0.4, correlation=0.5)])
    assert fit.confidence is Confidence.LOW
    assert any("unstable tip" in reason for reason in fit.reasons)


@pytest.mark.parametrize("factor", [3.0, 0.3])
def test_outliers_are_counted_on_either_side(rng, factor):
    complete = sweep(rng)
    current_A = complete.current_A.copy()
    current_A[10:130:10] *= factor
    fit = fit_barrier([changed(complete, current_A)])
    (share,) = re.findall(r"(\S+) % of the points are outliers", " ".join(fit.reasons))
    assert 6.0 <= float(share) < 8.0


@pytest.mark.parametrize("decay_ratio", [1.15, 0.85])
def test_a_decay_that_changes_with_the_height_is_stated_with_its_sign(rng, decay_ratio):
    """The change is in the middle of the usable range: 9.6 nepers, two thirds of the sweep."""
    above_m = HEIGHT_M - HEIGHT_M[0]
    scaled_m = above_m + (decay_ratio - 1.0) * np.maximum(above_m - 0.23e-9, 0.0)
    jitter, dark = 0.03 * rng.standard_normal(200), 0.015e-12 * rng.standard_normal(200)
    current_A = -750e-12 * np.exp(jitter - DECAY_PER_M * scaled_m) + OFFSET_A + dark
    fit = fit_barrier([changed(sweep(rng), current_A)])
    (percent,) = re.findall(r"weaker half differs by (\S+) %", " ".join(fit.reasons))
    # Both halves include the transition.
    assert float(percent) == pytest.approx(100.0 * (decay_ratio - 1.0), rel=0.25)


def test_a_saturated_amplifier_is_excluded_and_stated(rng):
    complete = sweep(rng)
    clipped = changed(complete, np.maximum(complete.current_A, -200e-12))
    fit = fit_barrier([clipped])
    at_limit = np.count_nonzero(complete.current_A <= -200e-12)
    near_limit = np.count_nonzero(complete.current_A <= -140e-12)
    assert at_limit <= clipped.saturated <= near_limit
    assert fit.decay_interval_per_m[0] < DECAY_PER_M < fit.decay_interval_per_m[1]
    assert fit.confidence is Confidence.MEDIUM
    assert "at the amplifier's limit" in fit.reasons[0]


def test_a_height_of_the_other_sign_is_refused(rng):
    with pytest.raises(ExcitationError, match="grows with the height"):
        fit_barrier([changed(sweep(rng), height_sign=-1.0)])


@pytest.mark.parametrize(
    ("height_m", "current_A", "match"),
    [
        (np.zeros(20), np.ones(20), "all heights are"),
        (np.arange(20.0), np.full(20, np.nan), "0 rows contain both"),
        (np.arange(20.0), np.ones(19), "shape"),
    ],
)
def test_unusable_columns_are_refused(height_m, current_A, match):
    with pytest.raises(RecordingError, match=match):
        read_approach(
            height_m, current_A, bias_V=0.1, direction=Direction.FORWARD, label="unusable"
        )
