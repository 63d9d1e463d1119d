"""Friction states and sums of polynomials against what shares no code with them."""

import weakref

import numpy as np
import pytest

from piezoid.operators.library import address
from piezoid.operators.wide_hysteresis import friction_states, sum_of_polynomials

REACH = np.array([0.05, 0.4, 3.0])


def test_friction_solves_its_equation_of_motion() -> None:
    way = np.sin(np.linspace(0.0, 9.0, 40_001)) * np.linspace(1.0, 0.3, 40_001)
    expected = np.zeros((len(way), len(REACH)))
    for k, step in enumerate(np.diff(way)):
        middle = expected[k] + 0.5 * (step - abs(step) * expected[k] / REACH)
        expected[k + 1] = expected[k] + step - abs(step) * middle / REACH
    found = friction_states(way, REACH, np.zeros(len(REACH)))
    np.testing.assert_allclose(found, expected, atol=1e-7)


@pytest.mark.parametrize("power", [2, 3])
def test_friction_of_a_curved_rest_is_what_a_first_order_lag_along_the_way_leaves(power) -> None:
    way = np.sin(np.linspace(0.0, 9.0, 40_001)) * np.linspace(1.0, 0.3, 40_001)
    lagging = np.zeros((len(way), len(REACH)))
    for k, step in enumerate(np.abs(np.diff(way))):
        target = 0.5 * (way[k] ** power + way[k + 1] ** power)
        lagging[k + 1] = lagging[k] + (target - lagging[k]) * -np.expm1(-step / REACH)
    expected = way[:, None] ** power - lagging
    found = friction_states(way, REACH, np.zeros(len(REACH)), power=np.full(len(REACH), power))
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_only_powers_whose_closed_form_is_known_are_followed() -> None:
    with pytest.raises(ValueError, match="expected some of"):
        friction_states(np.zeros(3), REACH, np.zeros(3), power=np.array([1.0, 2.0, 4.0]))


@pytest.mark.parametrize("powers", [2, 3, 4])
def test_sums_of_polynomials_are_what_their_columns_would_give(powers: int) -> None:
    draw = np.random.default_rng(powers)
    states, drive = draw.normal(size=(70, 5)), draw.normal(size=70)
    scale, power = draw.uniform(0.5, 2.0, 5), draw.normal(size=(powers, 5))
    bias = draw.normal(size=(3, 5))
    z = states * scale
    expected = sum(z ** (n + 1) @ power[n] for n in range(powers))
    expected = expected + drive * (z @ bias[0] + z**2 @ bias[2]) + drive**2 * (z @ bias[1])
    found = sum_of_polynomials(states, drive, scale=scale, power=power, bias=bias)
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-12)


def test_a_copy_made_for_a_kernel_lives_until_the_kernel_returns() -> None:
    copy = np.array([1.0, 2.0])
    alive = weakref.ref(copy)
    place = address(copy)
    del copy
    assert alive() is not None
    del place
    assert alive() is None


def test_friction_states_of_one_reach_share_an_exponential_and_nothing_else() -> None:
    way = np.cumsum(np.random.default_rng(4).normal(0.0, 0.01, 2_500))
    reach, power = np.array([0.4, 0.05, 0.4, 3.0, 0.05]), np.array([2.0, 1.0, 1.0, 3.0, 2.0])
    start = np.array([0.1, -0.02, 0.3, 0.0, 0.01])
    together = friction_states(way + 0.7, reach, start, power=power)
    np.testing.assert_array_equal(together[0], start)
    for k in range(len(reach)):
        alone = friction_states(
            way + 0.7, reach[k : k + 1], start[k : k + 1], power=power[k : k + 1]
        )
        np.testing.assert_array_equal(together[:, k], alone[:, 0])
