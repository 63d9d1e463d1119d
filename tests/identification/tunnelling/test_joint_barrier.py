"""Two ways to one decay: by inverse variance, wider where they scatter, nothing from nothing."""

import math

import pytest

from piezoid.identification.tunnelling.joint_barrier import join_barriers

WIDE = (0.0, math.inf)


def test_two_ways_known_alike_are_known_better_together_by_the_root_of_two() -> None:
    one = (20e9, (19e9, 20e9 * 20 / 19))
    found = join_barriers([one], one)
    assert found.agree
    assert found.decay_per_m == pytest.approx(20e9)
    assert found.decay_interval_per_m is not None
    low, high = found.decay_interval_per_m
    assert math.log(high / low) == pytest.approx(2 * math.log(20 / 19) / math.sqrt(2), rel=1e-6)


def test_sweeps_that_scatter_more_than_their_intervals_widen_their_mean() -> None:
    apart = [(18e9, (17.9e9, 18.1e9)), (22e9, (21.8e9, 22.2e9))]
    near = [(20e9, (19.9e9, 20.1e9)), (20e9, (19.8e9, 20.2e9))]
    loop = (20e9, WIDE)
    widths = []
    for sweeps in (apart, near):
        low, high = join_barriers(sweeps, loop).decay_interval_per_m or WIDE
        widths.append(math.log(high / low))
    assert widths[0] > 5.0 * widths[1]


def test_what_has_no_end_tells_nothing_and_two_such_nothing_together() -> None:
    found = join_barriers([(30e9, WIDE)], (20e9, (19e9, 21e9)))
    assert found.decay_per_m == pytest.approx(20e9, rel=1e-3)
    nothing = join_barriers([(30e9, WIDE)], (20e9, WIDE))
    assert nothing.decay_interval_per_m == WIDE
    assert nothing.decay_per_m == pytest.approx(math.sqrt(20e9 * 30e9))
