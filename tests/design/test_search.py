"""Search for the least cost that keeps a reserve, or for the least excess."""

import numpy as np
import pytest

from piezoid.design.loop_search import search
from piezoid.numerics.arrays import Array

LOWER, UPPER = np.array([-1.0, 10.0]), np.array([1.0, 30.0])
STARTS = [np.array([0.9, 28.0]), np.array([-0.5, 12.0])]
TOLERANCE = 2e-3  # of the box, where a search stops


def distance_to(optimum: Array, reserve_dB: float):
    """Return a judge: cost is the distance from an optimum, excess 10 dB per unit of x_0."""

    def judge(x: Array) -> tuple[float, float]:
        return float(np.hypot(*((x - optimum) / (UPPER - LOWER)))), 10.0 * (
            x[0] - 0.3
        ) - reserve_dB

    return judge


@pytest.mark.parametrize("reserve_dB", [0.1, 2.0])
def test_the_optimum_keeps_exactly_the_reserve(reserve_dB):
    judge = distance_to(np.array([0.8, 20.0]), 0.0)
    point = search(judge, LOWER, UPPER, STARTS, reserve_dB=reserve_dB)
    cost, excess_dB = judge(point)
    edge = 0.3 - reserve_dB / 10.0
    assert excess_dB <= -reserve_dB
    assert edge - 2.0 * TOLERANCE <= point[0] <= edge
    assert cost < 1.03 * 0.5 * (0.8 - edge)  # the cost is flat along the edge


def test_an_infeasible_search_returns_the_smallest_excess_inside_the_box():
    point = search(distance_to(np.array([0.8, 20.0]), -50.0), LOWER, UPPER, STARTS)
    assert point[0] == pytest.approx(LOWER[0], abs=2.0 * TOLERANCE)
    assert (point >= LOWER).all()
    assert (point <= UPPER).all()
