"""Two ways to one decay: by inverse variance, wider where they scatter, nothing from nothing."""

import math

import pytest

from piezoid.identification.tunnelling.junction import join_barriers

WIDE = (0.0, math.inf)


def test_two_ways_known_alike_are_known_better_together_by_the_root_of_two():
    one = (20e9, (19e9, 20e9 * 20 / 19))
    joint = join_barriers(one, one)
    assert joint.agree
    assert joint.decay_per_m == pytest.approx(20e9)
    low, high = joint.decay_interval_per_m
    assert math.log(high / low) == pytest.approx(2 * math.log(20 / 19) / math.sqrt(2), rel=1e-6)


def test_decays_that_differ_by_more_than_their_deviations_widen_their_mean():
    """Birge's ratio: they lie 1.73 standard deviations of their difference apart."""
    widths = []
    for loop_per_m in (20e9, 20e9 * 1.05**1.25):
        loop = (loop_per_m, (loop_per_m / 1.05, loop_per_m * 1.05))
        joint = join_barriers((20e9, (20e9 / 1.05, 20e9 * 1.05)), loop)
        assert joint.agree
        low, high = joint.decay_interval_per_m
        widths.append(math.log(high / low))
    assert widths[1] / widths[0] == pytest.approx(1.25 * 1.96 / math.sqrt(2), rel=1e-3)


def test_what_has_no_end_tells_nothing_and_two_such_nothing_together():
    joint = join_barriers((30e9, WIDE), (20e9, (19e9, 21e9)))
    assert joint.decay_per_m == pytest.approx(20e9, rel=1e-3)
    nothing = join_barriers((30e9, WIDE), (20e9, WIDE))
    assert nothing.decay_interval_per_m == WIDE
    assert nothing.decay_per_m == pytest.approx(math.sqrt(20e9 * 30e9))
