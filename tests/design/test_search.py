"""The search: the least cost that keeps its reserve, or the least excess where nothing does."""

import numpy as np
import pytest

from piezoid.design.loop_search import search
from piezoid.numerics.arrays import Array

LOWER, UPPER = np.array([-1.0, 10.0]), np.array([1.0, 30.0])
STARTS = [np.array([0.9, 28.0]), np.array([-0.5, 12.0])]
FOUND = 2e-3  # of the box, where a search stops


def towards(aim: Array, room_dB: float):
    """Cost: the distance from an aim. Excess: 10 dB for each unit of x_0 above 0.3."""

    def judge(x: Array) -> tuple[float, float]:
        return float(np.hypot(*((x - aim) / (UPPER - LOWER)))), 10.0 * (x[0] - 0.3) - room_dB

    return judge


@pytest.mark.parametrize("reserve_dB", [0.1, 2.0])
def test_the_best_point_leaves_the_reserve_and_no_more(reserve_dB):
    judge = towards(np.array([0.8, 20.0]), 0.0)
    found = search(judge, LOWER, UPPER, STARTS, reserve_dB=reserve_dB)
    cost, excess_dB = judge(found)
    edge = 0.3 - reserve_dB / 10.0
    assert excess_dB <= -reserve_dB
    assert edge - 2.0 * FOUND <= found[0] <= edge
    assert cost < 1.03 * 0.5 * (0.8 - edge)  # flat beside the edge


def test_where_nothing_meets_the_limits_the_least_excess_is_found_inside_the_box():
    found = search(towards(np.array([0.8, 20.0]), -50.0), LOWER, UPPER, STARTS)
    assert found[0] == pytest.approx(LOWER[0], abs=2.0 * FOUND)
    assert (found >= LOWER).all()
    assert (found <= UPPER).all()
