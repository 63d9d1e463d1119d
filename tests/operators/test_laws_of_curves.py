"""Laws of play sums and kinked curves: inverses, memory, composition, areas, distances."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import from_slopes
from piezoid.operators.prandtl_ishlinskii import worst_case
from tests.operators.strategies import (
    GRID,
    REACH,
    ROUNDING,
    assert_close,
    drives,
    is_admissible,
    kinked_curves,
    memories,
    play_sums,
)


@given(st.data(), play_sums(), drives())
def test_the_inverse_memory_is_the_map_of_the_memory_at_every_time(data, plays, drive):
    memory = data.draw(memories(plays.threshold))
    inverse, backward = plays.inverse(), plays.inverse_memory(memory)
    y, final_memory = plays.run(drive, memory)
    _, inverse_memory = inverse.run(y, backward)
    reach = plays.slope.max() * (REACH + plays.threshold[-1])
    assert_close(inverse_memory, plays.inverse_memory(final_memory), reach)
    assert is_admissible(memory, memory[0], plays.threshold)
    gap = np.diff(inverse.threshold)
    assert (np.abs(np.diff(backward)) <= gap + ROUNDING * reach).all()


@given(play_sums())
def test_the_inverse_of_the_inverse_is_the_operator(plays):
    twice = plays.inverse().inverse()
    assert_close(twice.threshold, plays.threshold, 100 * (1 + plays.threshold[-1]))
    assert_close(twice.slope, plays.slope, 100 * plays.slope.max())


@given(kinked_curves(), drives(max_samples=80))
def test_a_kinked_curve_is_the_sum_of_its_dead_zones(zones, drive):
    values, local = zones.run_with_slope(drive)
    size = zones.slope.max() * (REACH + np.abs(zones.threshold).max())
    assert_close(values, zones.columns(drive) @ zones.weight, 10 * size)
    outward_values, _ = zones.run_with_slope(drive + np.copysign(1 / GRID / 4, drive))
    # Kinks lie on the grid, so a quarter step outward passes none.
    outward_slope = (outward_values - values) / np.copysign(1 / GRID / 4, drive)
    inside = ~np.isin(drive, zones.threshold)
    np.testing.assert_allclose(local[inside], outward_slope[inside], rtol=1e-9)
    inner = np.isin(drive, zones.threshold[zones.threshold != 0.0])
    inward_slope = (values - zones.run(drive * (1 - 1e-6))) / (drive * 1e-6 + (drive == 0))
    np.testing.assert_allclose(local[inner], inward_slope[inner], rtol=1e-5)


@given(kinked_curves(), drives())
def test_a_kinked_curve_and_its_inverse_undo_each_other(zones, drive):
    inverse = zones.inverse()
    size = zones.slope.max() * (REACH + np.abs(zones.threshold).max()) / zones.slope.min()
    assert_close(inverse.run(zones.run(drive)), drive, size)
    assert_close(zones.run(inverse.run(drive)), drive, size * zones.slope.max())
    np.testing.assert_allclose(inverse.slope, 1.0 / zones.slope, rtol=1e-9)
    np.testing.assert_allclose(
        from_slopes(zones.threshold, zones.slope).weight, zones.weight, atol=1e-12
    )


@given(play_sums(), play_sums(), play_sums(), st.integers(1, 128), drives())
def test_the_worst_case_is_a_distance_that_only_its_own_drive_attains(
    first, second, third, top, drive
):
    reach = top / GRID
    distance, extrema = worst_case(first, second, reach)
    slack = ROUNDING * (first.slope.max() + second.slope.max()) * 100

    def gap(u: Array) -> Array:
        outputs = [plays.run(u, plays.virgin_memory())[0] for plays in (first, second)]
        return np.abs(outputs[0] - outputs[1])

    assert (gap(np.clip(drive, -reach, reach)) <= distance + slack).all()
    assert gap(extrema)[-1] == pytest.approx(distance, rel=1e-9, abs=slack)
    assert worst_case(second, first, reach)[0] == pytest.approx(distance, rel=1e-12)
    detour = worst_case(first, third, reach)[0] + worst_case(third, second, reach)[0]
    assert distance <= detour + slack
    assert worst_case(first, first, reach)[0] == 0.0
