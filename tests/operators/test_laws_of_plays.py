"""The laws of the play operator, tried on drives and thresholds of every kind."""

import itertools

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from piezoid.numerics.arrays import Array
from piezoid.operators.play import forgetting_sample, play_blocks, play_columns
from tests.operators.strategies import GRID, REACH, banks, drives, gaps, is_admissible, memories

ANY_SIZE = st.floats(allow_nan=False, allow_infinity=False, min_value=-1e150, max_value=1e150)


def end_of(drive: Array, threshold: Array, memory: Array) -> Array:
    return play_columns(drive, threshold, memory)[1]


def dominant(drive: Array) -> Array:
    """The turning points that no later swing reaches over: swings are struck out as they close."""
    kept: list[float] = []
    for value in drive:
        kept.append(value)
        while len(kept) > 2 and (kept[-2] - kept[-3]) * (kept[-1] - kept[-2]) >= 0:
            del kept[-2]
        while len(kept) > 3 and abs(kept[-1] - kept[-2]) >= abs(kept[-2] - kept[-3]):
            del kept[-3:-1]
    return np.array(kept)


@given(st.data(), banks(), drives(least=2))
def test_only_the_path_counts_and_not_how_often_it_is_sampled(
    data: st.DataObject, threshold: Array, drive: Array
) -> None:
    parts = np.frombuffer(data.draw(st.binary(min_size=len(drive), max_size=len(drive))), np.uint8)
    dense, places = [drive[0]], [0]
    for (a, b), more in zip(itertools.pairwise(drive), parts % 4, strict=False):
        dense.extend(np.linspace(a, b, more + 2)[1:])
        places.append(len(dense) - 1)
    memory = data.draw(memories(threshold))
    sparse, after = play_columns(drive, threshold, memory)
    finer, after_finer = play_columns(np.array(dense), threshold, memory)
    np.testing.assert_array_equal(finer[places], sparse)
    np.testing.assert_array_equal(after_finer, after)


@given(st.data(), banks(), drives(), st.integers(1, 50))
def test_blocks_of_states_are_the_states(
    data: st.DataObject, threshold: Array, drive: Array, rows: int
) -> None:
    memory = data.draw(memories(threshold))
    first, blocks = zip(*play_blocks(drive, threshold, memory, rows), strict=True)
    assert first == tuple(range(0, len(drive), rows))
    np.testing.assert_array_equal(np.vstack(blocks), play_columns(drive, threshold, memory)[0])


@given(banks(), drives())
def test_inner_swings_are_wiped_out_by_wider_ones(threshold: Array, swings: Array) -> None:
    # A swing over everything first, so that no starting memory is left to remember.
    drive = np.concatenate([[REACH, -REACH], swings])
    virgin = np.zeros(len(threshold))
    np.testing.assert_array_equal(
        end_of(dominant(drive), threshold, virgin), end_of(drive, threshold, virgin)
    )


@given(banks(), drives(most=20), st.integers(-64, 64), st.integers(1, 64))
def test_loops_between_the_same_ends_are_equal_after_every_history(
    threshold: Array, history: Array, low: int, span: int
) -> None:
    ends = np.array([low, low + span]) / GRID
    loop = np.concatenate([np.linspace(*ends, 9), np.linspace(*ends[::-1], 9)])
    shapes = []
    for past in (history, np.zeros(1)):
        states, _ = play_columns(
            np.concatenate([past, loop, loop]), threshold, np.zeros(len(threshold))
        )
        shapes.append(states[-len(loop) :] - states[-len(loop)])
    np.testing.assert_array_equal(shapes[0], shapes[1])


@given(st.data(), banks(), drives(least=2))
def test_a_drive_in_parts_is_the_drive_as_a_whole(
    data: st.DataObject, threshold: Array, drive: Array
) -> None:
    cut = data.draw(st.integers(0, len(drive)))
    memory = data.draw(memories(threshold))
    whole, end = play_columns(drive, threshold, memory)
    first, between = play_columns(drive[:cut], threshold, memory)
    second, after = play_columns(drive[cut:], threshold, between)
    np.testing.assert_array_equal(np.vstack([first, second]), whole)
    np.testing.assert_array_equal(after, end)


@given(st.data(), st.lists(ANY_SIZE, min_size=1, max_size=20), st.integers(-60, 60))
def test_a_play_of_any_size_stays_in_its_gap_and_scales_with_it(
    data: st.DataObject, values: list[float], power: int
) -> None:
    drive = np.array(values)
    threshold = np.sort(np.abs(data.draw(st.lists(ANY_SIZE, min_size=1, max_size=12))))
    memory = np.zeros(len(threshold))
    states, _ = play_columns(drive, threshold, memory)
    low, high = drive[:, None] - threshold, drive[:, None] + threshold
    assert ((low <= states) & (states <= high)).all()
    if np.abs(np.concatenate([drive, threshold])).min() > 1e-200:  # nothing becomes denormal
        unit = 2.0**power
        scaled, _ = play_columns(drive * unit, threshold * unit, memory)
        np.testing.assert_array_equal(scaled, states * unit)


@given(st.data(), gaps(), drives())
def test_no_drive_leads_out_of_the_admissible_memories(
    data: st.DataObject, threshold: Array, drive: Array
) -> None:
    states, _ = play_columns(drive, threshold, data.draw(memories(threshold)))
    assert all(is_admissible(z, u, threshold) for z, u in zip(states, drive, strict=True))


@given(banks(), drives())
def test_from_the_forgetting_sample_on_every_start_gives_the_same_and_not_before(
    threshold: Array, drive: Array
) -> None:
    low, high = (
        play_columns(drive, threshold, np.full(len(threshold), start))[0] for start in (-99, 99)
    )
    index = np.arange(len(drive))[:, None]
    np.testing.assert_array_equal(low == high, index >= forgetting_sample(drive, threshold))
