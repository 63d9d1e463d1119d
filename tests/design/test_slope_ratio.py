"""How far a static map lies from a straight line within a reach."""

import numpy as np
import pytest

from piezoid.design.hysteresis_bounds import static_difference
from piezoid.operators.dead_zone import from_slopes


@pytest.mark.parametrize("slope", [0.0, 0.7, 1.5])
@pytest.mark.parametrize("reach", [0.3, 2.0, 5.0])
def test_a_map_is_furthest_from_a_line_at_a_kink_or_an_end(slope, reach):
    bent = from_slopes(np.array([-2.0, 0.0, 0.5]), np.array([0.5, 1.0, 1.2, 0.9]))
    h = np.linspace(-reach, reach, round(20 * reach) + 1)  # every kink is a point of this grid
    assert static_difference(bent, slope, reach) == pytest.approx(
        np.abs(bent.run(h) - slope * h).max()
    )
