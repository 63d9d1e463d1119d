"""Two estimates of one decay are averaged by inverse variance and widened if they disagree."""

import math

import pytest

from piezoid.identification.tunnelling.junction import join_barriers

WIDE = (0.0, math.inf)


def test_two_equal_estimates_reduce_the_interval_by_the_root_of_two():
    decay = (20e9, (19e9, 20e9 * 20 / 19))
    joint = join_barriers(decay, decay)
    assert joint.agree
    assert joint.decay_per_m == pytest.approx(20e9)
    low, high = joint.decay_interval_per_m
    assert math.log(high / low) == pytest.approx(2 * math.log(20 / 19) / math.sqrt(2), rel=1e-6)


def test_estimates_that_disagree_widen_their_mean():
    """Birge's ratio: they differ by 1.73 standard deviations of the difference."""
    widths = []
    for loop_per_m in (20e9, 20e9 * 1.05**1.25):
        loop = (loop_per_m, (loop_per_m / 1.05, loop_per_m * 1.05))
        joint = join_barriers((20e9, (20e9 / 1.05, 20e9 * 1.05)), loop)
        assert joint.agree
        low, high = joint.decay_interval_per_m
        widths.append(math.log(high / low))
    assert widths[1] / widths[0] == pytest.approx(1.25 * 1.96 / math.sqrt(2), rel=1e-3)


def test_an_unbounded_estimate_has_no_weight_and_two_stay_unbounded():
    joint = join_barriers((30e9, WIDE), (20e9, (19e9, 21e9)))
    assert joint.decay_per_m == pytest.approx(20e9, rel=1e-3)
    unbounded = join_barriers((30e9, WIDE), (20e9, WIDE))
    assert unbounded.decay_interval_per_m == WIDE
    assert unbounded.decay_per_m == pytest.approx(math.sqrt(20e9 * 30e9))
