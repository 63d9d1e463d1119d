"""Where the joint fit begins: the memory that a drive leaves which was cycled over its range."""

import numpy as np
import pytest

from piezoid.identification.hysteresis.coordinates import Scaled
from piezoid.identification.joint.vector import _cycled
from piezoid.operators.dead_zone import LINEAR, DeadZones, from_slopes
from piezoid.operators.play import play_columns

GAP = np.array([0.2, 0.5, 0.4, 0.5])  # the last two thresholds: 1.1 and 1.6
STEEPER_BELOW = from_slopes(np.array([-0.5, 0.0, 0.5]), np.array([2.0, 1.0, 1.0, 0.6]))


@pytest.mark.parametrize("envelope", [LINEAR, STEEPER_BELOW])
@pytest.mark.parametrize("first", [-1.0, -0.3, 0.6])
def test_another_cycle_over_the_range_leaves_the_same_memory(
    envelope: DeadZones, first: float
) -> None:
    operator = Scaled(
        gap=GAP,
        threshold=np.cumsum(GAP),
        weight=np.ones(5),
        knot=np.zeros(1),
        slope=np.ones(2),
        zero=0,
        lag_s=0.0,
        envelope=envelope,
    )
    slopes = _cycled(operator, first)
    way = envelope.run(np.array([first, -1.0, 1.0, first]))
    memory = way[0] + np.cumsum(GAP * slopes)
    again = play_columns(way, operator.threshold, memory)[1]
    np.testing.assert_allclose(again, memory, atol=1e-12)
    assert (np.abs(slopes) <= 1.0 + 1e-12).all()
