"""Robust statistics have known values, and outliers do not change them."""

import numpy as np
import pytest
from scipy import stats

from piezoid.numerics.robust import (
    deviations,
    holm,
    normal_quantile,
    spread_beyond,
    spread_of,
    student_quantile,
    trend_of,
    white_noise_rms,
)

PROBABILITIES = np.array([1e-9, 0.025, 0.5, 0.8, 0.975, 0.9995])


def test_the_spread_of_a_normal_sample_is_its_standard_deviation():
    spread = spread_of(np.random.default_rng(1).normal(3.0, 0.5, 20_000))
    assert spread.median == pytest.approx(3.0, abs=0.02)
    assert spread.sigma == pytest.approx(0.5, rel=0.02)
    assert spread.low == pytest.approx(3.0 - 1.645 * 0.5, abs=0.03)


def test_an_outlier_and_a_missing_value_leave_the_spread():
    values = np.random.default_rng(2).normal(size=101)
    clean = spread_of(values)
    broken = spread_of(np.concatenate([values, [1e9, np.nan]]))
    assert broken.count == clean.count + 1
    assert broken.median == pytest.approx(clean.median, abs=0.05)
    assert broken.sigma == pytest.approx(clean.sigma, rel=0.1)
    assert deviations(np.array([1e9]), broken)[0] > 1e8
    nearly_equal = np.array([1.0] * 20 + [2.0])
    assert np.argmax(np.abs(deviations(nearly_equal, spread_of(nearly_equal)))) == 20
    assert np.all(deviations(np.ones(5), spread_of(np.ones(5))) == 0.0)


@pytest.mark.parametrize("sigma", [0.0, 0.5, 3.0])
def test_the_spread_beyond_individual_errors_is_estimated(sigma):
    rng = np.random.default_rng(4)
    errors = rng.choice([0.2, 1.0, 20.0], 20_000)
    values = 7.0 + sigma * rng.standard_normal(20_000) + errors * rng.standard_normal(20_000)
    spread = spread_beyond(values, errors)
    assert spread.median == pytest.approx(7.0, abs=0.05)
    assert spread.sigma == pytest.approx(sigma, rel=0.06, abs=0.05)
    assert np.std(deviations(values, spread, errors)) == pytest.approx(1.0, rel=0.06)


def test_values_without_an_error_do_not_hide_the_errors_of_others():
    rng = np.random.default_rng(6)
    errors = rng.choice([0.0, 1.0, 20.0], 20_000)
    values = 7.0 + 3.0 * rng.standard_normal(20_000) + errors * rng.standard_normal(20_000)
    assert spread_of(values).sigma > 4.0
    assert spread_beyond(values, errors).sigma == pytest.approx(3.0, rel=0.06)
    assert spread_beyond(values, 0.0 * errors) == spread_of(values)


def test_a_trend_is_estimated_despite_gross_errors():
    x = np.arange(60.0)
    y = 5.0 + 0.25 * x + np.random.default_rng(3).normal(scale=0.5, size=60)
    y[::10] += 40.0
    trend = trend_of(x, y)
    assert trend is not None
    assert trend.ci95[0] < 0.25 < trend.ci95[1]
    assert trend.p_value < 1e-6


@pytest.mark.parametrize("law", ["normal", "heavy", "repeated serials", "steps", "steep"])
def test_the_trend_of_many_samples_agrees_with_that_of_all_pairs(law):
    rng = np.random.default_rng(8)
    x, y = np.arange(1500.0), rng.standard_normal(1500)
    if law == "heavy":
        y = rng.standard_cauchy(1500)
    if law == "repeated serials":
        x = rng.integers(0, 200, 1500).astype(float)
    if law == "steps":
        y = np.round(y)
    if law == "steep":
        y += 1e9 * x
    trend, pairs = trend_of(x, y + 2e-4 * x), stats.theilslopes(y + 2e-4 * x, x, alpha=0.95)
    assert trend is not None
    width = pairs.high_slope - pairs.low_slope + 1e-11 + 4.0 * np.spacing(pairs.slope)
    assert trend.slope == pytest.approx(pairs.slope, abs=width)
    assert trend.ci95 == pytest.approx((pairs.low_slope, pairs.high_slope), abs=width)


def test_noise_has_a_significant_trend_no_more_often_than_stated():
    rng = np.random.default_rng(4)
    trends = [trend_of(np.arange(30.0), rng.normal(size=30)) for _ in range(200)]
    share = np.mean([trend.p_value < 0.05 for trend in trends if trend is not None])
    assert share < 0.09


@pytest.mark.parametrize("height", [1e-9, 1.0, 1e9])
def test_a_straight_line_is_its_own_trend(height):
    x = np.linspace(0.0, 1.0, 8)
    for rise in (height, -height):
        trend = trend_of(x, rise * x)
        assert trend is not None
        assert trend.slope == pytest.approx(rise)
        assert (trend.middle, trend.about) == pytest.approx((0.5 * rise, 0.5))
    for sample in ((x[:7], x[:7]), (np.ones(20), np.arange(20.0)), (np.arange(20.0), np.ones(20))):
        assert trend_of(*sample) is None


def test_holm_is_the_worked_example_and_never_below_the_raw_value():
    raw = np.array([0.01, 0.04, 0.03, 0.005])
    assert holm(raw) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    uniform = np.random.default_rng(5).uniform(size=50)
    assert np.all(holm(uniform) >= uniform)
    assert holm(np.array([0.6, 0.9, 0.7])) == pytest.approx([1.0, 1.0, 1.0])


def test_quantiles_are_those_of_scipy_for_every_freedom_at_once():
    np.testing.assert_allclose(normal_quantile(PROBABILITIES), stats.norm.ppf(PROBABILITIES))
    freedom = np.array([0.7, 2.2, 9.0, 400.0, np.inf, 3.0])
    expected = stats.t.ppf(PROBABILITIES, freedom)
    np.testing.assert_allclose(student_quantile(PROBABILITIES, freedom), expected, rtol=1e-9)


def test_white_noise_is_separated_from_a_smooth_signal_and_jumps(rng):
    k = np.arange(20_000)
    smooth = 5.0 + 1e-4 * (k - 9000.0) ** 2 + np.sin(k / 300)
    noise = 0.3 * rng.standard_normal(len(k))
    jumps = 40.0 * (k > 5000) - 90.0 * (k > 12_000)
    assert white_noise_rms(smooth + noise + jumps) == pytest.approx(0.3, rel=0.02)
    assert white_noise_rms(smooth) < 1e-6
    zigzag = np.array([1.0, -1.0] * 4)
    assert white_noise_rms(zigzag[:7]) == 0.0
    assert white_noise_rms(zigzag) > 1.0
