"""Worked example of a small model, exact to the printed digits."""

import numpy as np
import pytest

from piezoid.errors import NotInvertibleError
from piezoid.operators.dead_zone import DeadZones
from piezoid.operators.prandtl_ishlinskii import ModifiedPrandtlIshlinskii, PrandtlIshlinskii
from tests.operators.strategies import is_admissible

EXACT = 1e-12
U = np.array([0, 3, -1, 2, -4, 4, 0, 1.5, -0.5])
Y = np.array([0, 2.4575, -0.35, 1.52, -2.605, 3.5075, 0.65, 1.52, 0.2])
PLAYS = PrandtlIshlinskii(
    threshold=np.array([0.0, 1, 2, 3]), weight=np.array([0.5, 0.25, 0.15, 0.10])
)
ZONES = DeadZones(
    threshold=np.array([-2.0, -1, 0, 1, 2]), weight=np.array([-0.1, -0.2, 1, 0.3, -0.25])
)
MODEL = ModifiedPrandtlIshlinskii(plays=PLAYS, dead_zones=ZONES)


def test_slopes_outputs_and_inverse_are_those_printed():
    np.testing.assert_allclose(PLAYS.slope, [0.5, 0.75, 0.9, 1.0], atol=EXACT)
    np.testing.assert_allclose(ZONES.slope, [0.7, 0.8, 1, 1, 1.3, 1.05], atol=EXACT)
    h, _ = PLAYS.run(U, np.zeros(4))
    expected = [0, 2.15, -0.35, 1.4, -3.15, 3.15, 0.65, 1.4, 0.2]
    np.testing.assert_allclose(h, expected, atol=EXACT)
    np.testing.assert_allclose(MODEL.run(U, np.zeros(4))[0], Y, atol=EXACT)
    inverse = PLAYS.inverse()
    np.testing.assert_allclose(inverse.threshold, [0, 0.5, 1.25, 2.15], atol=EXACT)
    np.testing.assert_allclose(inverse.weight, [2, -2 / 3, -2 / 9, -1 / 9], atol=EXACT)
    zones = ZONES.inverse()
    np.testing.assert_allclose(zones.threshold, [-1.8, -1, 0, 1, 2.3], atol=EXACT)
    np.testing.assert_allclose(
        zones.weight, [0.17857142857, 0.25, 1, -0.23076923077, 0.18315018315], atol=1e-11
    )


def test_a_start_that_is_not_virgin_maps_to_the_printed_inverse_memory():
    memory = np.array([0.5, 1.0, 1.5, 1.0])
    assert is_admissible(memory, 0.5, PLAYS.threshold)
    np.testing.assert_allclose(PLAYS.inverse_memory(memory), [0.825, 1.075, 1.45, 1.0])
    y, _ = MODEL.run(U, memory)
    expected = [0.575, 2.64125, -0.25, 1.65, -2.605, 3.5075, 0.65, 1.52, 0.2]
    np.testing.assert_allclose(y, expected, atol=EXACT)
    np.testing.assert_allclose(MODEL.inverse_run(y, memory)[0], U, atol=1e-14)


def test_threshold_zero_is_required_of_both_parts():
    with pytest.raises(ValueError, match="expected 0"):
        PrandtlIshlinskii(threshold=np.array([0.1, 1]), weight=np.ones(2))
    with pytest.raises(ValueError, match="no 0"):
        DeadZones(threshold=np.array([-1.0, 1]), weight=np.ones(2))


@pytest.mark.parametrize(
    ("part", "weight", "message"),
    [(PrandtlIshlinskii, -0.7, "W_1 is -0.2"), (DeadZones, -1.0, "0.5"), (DeadZones, -0.5, "0")],
)
def test_a_slope_that_is_not_positive_has_no_inverse(part, weight, message):
    with pytest.raises(NotInvertibleError, match=message):
        part(threshold=np.array([0.0, 1]), weight=np.array([0.5, weight])).inverse()
    part(threshold=np.array([0.0, 1]), weight=np.array([0.5, -0.499])).inverse()
