"""How far two static maps lie apart, and how steep one is beside the other, within a reach."""

from types import SimpleNamespace

import numpy as np
import pytest

from piezoid.design.slope_ratio import _bend, static_difference
from piezoid.operators.dead_zone import LINEAR, from_slopes


@pytest.mark.parametrize(("reach_V", "least", "most"), [(0.4, 1, 1), (0.6, 1, 5), (4.0, 0.5, 5)])
def test_the_ratio_of_two_envelopes_is_that_of_their_steepest_and_flattest_stretch(
    reach_V, least, most
):
    bent = from_slopes(np.array([-2.0, 0.0, 0.5, 0.8]), np.array([0.5, 1.0, 1.0, 5.0, 1.0]))
    model, truth = SimpleNamespace(envelope=LINEAR), SimpleNamespace(envelope=bent)
    assert _bend(model, truth, reach_V) == pytest.approx((least, most))
    assert _bend(truth, model, reach_V) == pytest.approx((1 / most, 1 / least))


@pytest.mark.parametrize("slope", [0.0, 0.7, 1.5])
@pytest.mark.parametrize("reach", [0.3, 2.0, 5.0])
def test_two_maps_lie_apart_on_either_side_and_most_at_a_kink_or_an_end(slope, reach):
    one = from_slopes(np.array([-2.0, 0.0, 0.5]), np.array([0.5, 1.0, 1.2, 0.9]))
    other = from_slopes(np.array([-1.0, 0.0, 3.0]), np.array([1.4, 0.8, 1.0, 2.0]))
    # Every kink is a point of this grid.
    h = np.linspace(-reach, reach, round(20 * reach) + 1)
    apart = np.abs(one.run(h) - other.run(h) - slope * h).max()
    assert static_difference(one, other, slope, reach) == pytest.approx(apart)
    assert static_difference(other, one, -slope, reach) == pytest.approx(apart)
    alone = np.abs(one.run(h) - slope * h).max()
    assert static_difference(one, None, slope, reach) == pytest.approx(alone)
