"""The Bouc-Wen state, and walls that climb by thermal activation, against other solvers."""

import itertools

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from piezoid.operators.wide_hysteresis import bouc_wen_states


def solved(drive: np.ndarray, beta: float, gamma: float, exponent: float) -> float:
    """Return z at the end of a path of straight parts, by a solver of differential equations."""
    z = 0.0
    for here, there in itertools.pairwise(drive):
        way = np.sign(there - here)

        def slope(_, state, way=way):
            grip = gamma + beta * np.sign(state * way)
            return way * (1.0 - grip * np.abs(state) ** exponent)

        z = solve_ivp(slope, (0.0, abs(there - here)), [z], rtol=1e-10, atol=1e-12).y[0, -1]
    return float(z)


@pytest.mark.parametrize(("gamma", "exponent"), [(0.0, 1.0), (0.6, 1.0), (-0.3, 1.7), (0.8, 2.5)])
def test_the_state_follows_its_differential_equation(gamma: float, exponent: float) -> None:
    drive = np.array([0.0, 0.9, -0.4, 0.3, -1.0, 0.2])
    found = bouc_wen_states(drive, 1.6, gamma, exponent)
    assert found[-1] == pytest.approx(solved(drive, 1.6, gamma, exponent), abs=2e-5)


def test_the_state_begins_where_it_is_told_and_a_rest_changes_nothing() -> None:
    assert np.all(bouc_wen_states(np.full(5, 0.4), 1.0, 0.2, 1.3, start=0.25) == 0.25)
