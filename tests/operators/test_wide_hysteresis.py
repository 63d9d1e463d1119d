"""The wide class of hysteresis and its states, against independent implementations."""

import itertools

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from piezoid.operators.wide_hysteresis import (
    EDGES,
    WIDTHS,
    HysteresisStates,
    bouc_wen_states,
    class_columns,
    coefficients,
    friction_states,
    smooth_columns,
    smooth_response,
    sum_of_polynomials,
)

DRIVE = np.sin(np.linspace(0.0, 20.0, 400)) * np.linspace(1.0, 0.2, 400)
PATH = np.sin(np.linspace(0.0, 9.0, 40_001)) * np.linspace(1.0, 0.3, 40_001)
REACH = np.array([0.05, 0.4, 3.0])


def test_a_drive_in_chunks_leaves_the_same_states():
    expected = HysteresisStates((-1.0, 0.5)).follow(DRIVE)
    states = HysteresisStates((-1.0, 0.5))
    parts = [states.follow(part) for part in np.array_split(DRIVE, 7)]
    for k, table in enumerate(expected):
        assert np.array_equal(np.concatenate([part[k] for part in parts]), table)


def test_columns_do_not_depend_on_speed():
    slow = np.interp(np.arange(0, 399.01, 0.25), np.arange(400), DRIVE)
    columns, slow_columns = (
        class_columns(u, HysteresisStates(()).follow(u)) for u in (DRIVE, slow)
    )
    assert slow_columns[::4] == pytest.approx(columns, abs=2e-4)


def test_coefficients_of_all_columns_become_a_density_and_a_smooth_response():
    states = HysteresisStates((-1.0, 0.5)).follow(DRIVE)
    columns = class_columns(DRIVE, states)
    weights = np.random.default_rng(0).standard_normal(columns.shape[1])
    density, smooth = coefficients(weights)
    assert density.shape == (len(WIDTHS), len(EDGES) - 1)
    smooth_part = smooth_columns(DRIVE, states) @ smooth
    assert smooth_response(DRIVE, states, smooth) == pytest.approx(smooth_part, abs=1e-12)
    cells = np.clip(states[0][:, :, None], EDGES[:-1], EDGES[1:])
    cells = cells - np.clip(DRIVE[:, None, None], EDGES[:-1], EDGES[1:])
    response = np.einsum("kwc,wc->k", cells, density) + smooth_part
    assert response == pytest.approx(columns @ weights, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(("gamma", "exponent"), [(0.0, 1.0), (0.6, 1.0), (-0.3, 1.7), (0.8, 2.5)])
def test_the_bouc_wen_state_follows_its_differential_equation(gamma, exponent):
    drive, z = np.array([0.0, 0.9, -0.4, 0.3, -1.0, 0.2]), 0.0
    for start, end in itertools.pairwise(drive):
        direction = np.sign(end - start)

        def slope(_, state, direction=direction):
            grip = gamma + 1.6 * np.sign(state * direction)
            return direction * (1.0 - grip * np.abs(state) ** exponent)

        z = solve_ivp(slope, (0.0, abs(end - start)), [z], rtol=1e-10, atol=1e-12).y[0, -1]
    assert bouc_wen_states(drive, 1.6, gamma, exponent)[-1] == pytest.approx(z, abs=2e-5)


def test_a_constant_drive_keeps_the_start_and_an_unknown_power_is_refused():
    assert np.all(bouc_wen_states(np.full(5, 0.4), 1.0, 0.2, 1.3, start=0.25) == 0.25)
    with pytest.raises(ValueError, match="expected some of"):
        friction_states(np.zeros(3), REACH, np.zeros(3), power=np.array([1.0, 2.0, 4.0]))


def test_friction_solves_its_equation_of_motion():
    expected = np.zeros((len(PATH), len(REACH)))
    for k, step in enumerate(np.diff(PATH)):
        middle = expected[k] + 0.5 * (step - abs(step) * expected[k] / REACH)
        expected[k + 1] = expected[k] + step - abs(step) * middle / REACH
    states = friction_states(PATH, REACH, np.zeros(len(REACH)))
    np.testing.assert_allclose(states, expected, atol=1e-7)


@pytest.mark.parametrize("power", [2, 3])
def test_friction_of_a_power_is_a_first_order_lag_along_the_path(power):
    lagging = np.zeros((len(PATH), len(REACH)))
    for k, step in enumerate(np.abs(np.diff(PATH))):
        target = 0.5 * (PATH[k] ** power + PATH[k + 1] ** power)
        lagging[k + 1] = lagging[k] + (target - lagging[k]) * -np.expm1(-step / REACH)
    expected = PATH[:, None] ** power - lagging
    states = friction_states(PATH, REACH, np.zeros(len(REACH)), power=np.full(len(REACH), power))
    np.testing.assert_allclose(states, expected, atol=1e-6)


def test_friction_states_of_equal_reach_are_independent():
    path = 0.7 + np.cumsum(np.random.default_rng(4).normal(0.0, 0.01, 2_500))
    reach, power = np.array([0.4, 0.05, 0.4, 3.0, 0.05]), np.array([2.0, 1.0, 1.0, 3.0, 2.0])
    start = np.array([0.1, -0.02, 0.3, 0.0, 0.01])
    states = friction_states(path, reach, start, power=power)
    np.testing.assert_array_equal(states[0], start)
    for k in range(len(reach)):
        column = slice(k, k + 1)
        single = friction_states(path, reach[column], start[column], power=power[column])
        np.testing.assert_array_equal(states[:, k], single[:, 0])


@pytest.mark.parametrize("powers", [2, 3, 4])
def test_sums_of_polynomials_are_what_their_columns_would_give(powers):
    draw = np.random.default_rng(powers)
    states, drive = draw.normal(size=(70, 5)), draw.normal(size=70)
    scale, power = draw.uniform(0.5, 2.0, 5), draw.normal(size=(powers, 5))
    bias = draw.normal(size=(3, 5))
    z = states * scale
    expected = sum(z ** (n + 1) @ power[n] for n in range(powers))
    expected = expected + drive * (z @ bias[0] + z**2 @ bias[2]) + drive**2 * (z @ bias[1])
    total = sum_of_polynomials(states, drive, scale=scale, power=power, bias=bias)
    np.testing.assert_allclose(total, expected, rtol=1e-10, atol=1e-12)
