"""Search without derivatives: kinks, several valleys, a constraint, a limit of evaluations."""

import numpy as np
import pytest

from piezoid.numerics.arrays import Array
from piezoid.numerics.derivative_free import direct_search

BOX = np.full(2, -5.0), np.full(2, 5.0)


def test_a_minimum_at_a_kink_is_found():
    def kinked(x: Array) -> float:
        return float(abs(x[0] - 1.0) + 3.0 * abs(x[1] + x[0]))

    x, value = direct_search(
        kinked, np.zeros(2), BOX, initial_step=0.5, max_evaluations=500, step_tolerance=1e-7
    )
    np.testing.assert_allclose(x, [1.0, -1.0], atol=1e-4)
    assert value == kinked(x)


def test_a_global_search_leaves_a_shallow_valley():
    def valleys(x: Array) -> float:
        return float(min((x[0] - 4.0) ** 2 + 1.0, 4.0 * (x[0] + 3.0) ** 2))

    start, box = np.array([4.0]), (BOX[0][:1], BOX[1][:1])
    local_x, _ = direct_search(valleys, start, box, initial_step=0.1, max_evaluations=100)
    global_x, _ = direct_search(
        valleys, start, box, initial_step=0.1, max_evaluations=100, global_evaluations=50
    )
    assert local_x[0] == pytest.approx(4.0, abs=1e-3)
    assert global_x[0] == pytest.approx(-3.0, abs=1e-3)


def test_a_constraint_is_satisfied():
    x, value = direct_search(
        lambda x: float(-x[0] - x[1]),
        np.full(2, 0.1),
        BOX,
        initial_step=0.5,
        max_evaluations=500,
        constraint=lambda x: float(x @ x - 1.0),
        step_tolerance=1e-8,
    )
    np.testing.assert_allclose(x, np.sqrt(0.5), atol=1e-5)
    assert value == pytest.approx(-np.sqrt(2.0), abs=1e-6)


def test_a_search_keeps_its_limit_of_evaluations():
    points = []

    def bowl(x: Array) -> float:
        points.append(x.copy())
        return float(x @ x)

    direct_search(
        bowl, np.full(2, 3.0), BOX, initial_step=0.5, max_evaluations=17, global_evaluations=11
    )
    assert len(points) == 28
    assert (np.abs(points) <= 5.0).all()
