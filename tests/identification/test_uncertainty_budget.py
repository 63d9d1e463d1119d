"""Uncertainty budgets against closed forms and the worked example of the Guide."""

import math

import numpy as np
import pytest
from scipy.stats import norm
from scipy.stats import t as student

from piezoid.identification.displacement_budget import (
    Contribution,
    budget_of,
    half_width,
    tail_of,
)


def normal(standard: float, freedom: float = math.inf, *, is_shared: bool = True) -> Contribution:
    return Contribution(
        name="n", kind="A", standard=standard, freedom=freedom, is_shared=is_shared
    )


def heavy(tail: float, *, is_shared: bool = True) -> Contribution:
    return Contribution(
        name="h", kind="A", standard=1.0, shape="heavy", tail=tail, is_shared=is_shared
    )


def test_degrees_of_freedom_follow_the_guide():
    # JCGM 100:2008, H.1: contributions in nm and their degrees of freedom; k there is for 99 %.
    gauge = [normal(25.0, 18), normal(9.7, 25.6), normal(2.9, 50), normal(16.6, 2)]
    budget = budget_of(gauge, draws=1000)
    assert budget.combined == pytest.approx(31.7, abs=0.1)
    assert budget.freedom == pytest.approx(16.7, abs=0.1)
    assert budget_of([normal(3.0, 1)], draws=1000).freedom == pytest.approx(1.0)
    assert budget_of([normal(3.0, 7)], draws=1000).freedom == pytest.approx(7.0)
    budget = budget_of([normal(3.0), normal(4.0)], draws=1000)
    assert budget.freedom == math.inf
    assert budget.positions == 1000  # the default
    assert budget.expanded == pytest.approx(norm.ppf(0.975) * 5.0)


@pytest.mark.parametrize(
    ("contributions", "half"),
    [
        ([half_width("r", 1.0)], 0.95),
        ([half_width("r", 1.0), half_width("s", 1.0)], 2 * (1 - math.sqrt(0.05))),  # a triangle
        ([normal(1.0)], norm.ppf(0.975)),
        ([normal(1.0, 4.0)], 2.7764),  # Student's t at 4
        ([normal(0.6), normal(0.8, is_shared=False)], norm.ppf(0.975)),
        ([heavy(4.0)], 2.7764 * math.sqrt(0.5)),  # Student's t at 4, scaled to variance 1
        ([heavy(4.0, is_shared=False)], 2.7764 * math.sqrt(0.5)),
    ],
)
def test_draws_give_the_interval_that_can_be_written_down(contributions, half):
    assert budget_of(contributions).propagated == pytest.approx(half, rel=0.01)


@pytest.mark.parametrize(
    ("contribution", "law", "positions"),
    [
        *((normal(2.0, is_shared=False), norm(0.0, 2.0), n) for n in (2, 100, 10_000)),
        (heavy(4.0, is_shared=False), student(4.0, 0.0, math.sqrt(0.5)), 1000),
    ],
)
def test_the_largest_of_many_errors_is_its_closed_form(contribution, law, positions):
    budget = budget_of([contribution], positions=positions)
    for probability, reached in zip((0.025, 0.975), budget.largest, strict=True):
        exact = law.ppf((1 + probability ** (1 / positions)) / 2)
        assert reached == pytest.approx(exact, rel=0.02)


def test_the_largest_error_equals_that_of_drawing_every_position():
    rng = np.random.default_rng(1)
    independent = rng.standard_normal((20_000, 50))
    largest = np.abs(1.5 * rng.standard_normal(20_000)[:, None] + independent).max(axis=1)
    budget = budget_of([normal(1.5), normal(1.0, is_shared=False)], positions=50)
    assert budget.largest == pytest.approx(np.quantile(largest, (0.025, 0.975)), rel=0.02)
    for contribution in (normal(1.0, is_shared=False), heavy(4.0, is_shared=False)):
        budget = budget_of([contribution], positions=10**18, draws=1000)
        assert np.isfinite(budget.largest[1])
        assert budget.largest[0] > 5.0


def test_shares_are_fractions_of_the_variance_of_any_size():
    contributions = [normal(3e-12), normal(0.0), normal(4e-12)]
    budget = budget_of(contributions, draws=1000)
    assert [budget.share(contribution) for contribution in contributions] == pytest.approx(
        [0.36, 0.0, 0.64]
    )
    empty = budget_of([normal(0.0)], draws=1000)
    assert empty.share(normal(0.0)) == 0.0


@pytest.mark.parametrize("tail", [2.5, 4.0, 12.0])
def test_a_heavy_tail_is_estimated_from_its_quantile(tail):
    sample = np.random.default_rng(2).standard_t(tail, 400_000) * math.sqrt((tail - 2) / tail)
    ratio = float(np.quantile(np.abs(sample), 0.999))
    estimate = tail_of(ratio)
    assert estimate == pytest.approx(tail, rel=0.15)
    heavy_budget, normal_budget = (
        budget_of([contribution])
        for contribution in (heavy(estimate, is_shared=False), normal(1.0, is_shared=False))
    )
    assert heavy_budget.largest[1] > normal_budget.largest[1]


def test_a_light_tail_is_normal_and_an_extreme_tail_is_bounded():
    assert tail_of(3.0) == math.inf
    assert 2.0 < tail_of(50.0) < 4.0
