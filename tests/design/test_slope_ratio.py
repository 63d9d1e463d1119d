"""The slopes a true envelope has beside the model's, on every stretch the drive reaches."""

from types import SimpleNamespace

import numpy as np
import pytest

from piezoid.design.slope_ratio import _bend
from piezoid.operators.dead_zone import LINEAR, from_slopes


@pytest.mark.parametrize(("reach_V", "least", "most"), [(0.4, 1, 1), (0.6, 1, 5), (4.0, 0.5, 5)])
def test_the_ratio_of_two_envelopes_is_that_of_their_steepest_and_flattest_stretch(
    reach_V, least, most
):
    bent = from_slopes(np.array([-2.0, 0.0, 0.5, 0.8]), np.array([0.5, 1.0, 1.0, 5.0, 1.0]))
    model, truth = SimpleNamespace(envelope=LINEAR), SimpleNamespace(envelope=bent)
    assert _bend(model, truth, reach_V) == pytest.approx((least, most))
    assert _bend(truth, model, reach_V) == pytest.approx((1 / most, 1 / least))
