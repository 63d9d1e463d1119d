"""The play operator follows its definition for all drives and thresholds."""

import itertools

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from piezoid.numerics.arrays import Array
from piezoid.operators.play import forgetting_sample, play_blocks, play_columns
from tests.operators.strategies import banks, drives, memories, random_walk

ANY_SIZE = st.floats(allow_nan=False, allow_infinity=False, min_value=-1e150, max_value=1e150)


def by_definition(drive: Array, threshold: Array, memory: Array) -> Array:
    """Return z[k] = max(u - r, min(u + r, z[k-1])), one column for each threshold."""
    states, state = np.empty((len(drive), len(threshold))), memory
    for k, value in enumerate(drive):
        state = np.maximum(value - threshold, np.minimum(value + threshold, state))
        states[k] = state
    return states


@given(st.data(), banks(), drives(min_samples=2))
def test_play_states_follow_their_definition_in_any_chunks_and_sampling(data, threshold, drive):
    memory, cut = data.draw(memories(threshold)), data.draw(st.integers(0, len(drive)))
    expected = by_definition(drive, threshold, memory)
    first, middle_memory = play_columns(drive[:cut], threshold, memory)
    second, final_memory = play_columns(drive[cut:], threshold, middle_memory)
    np.testing.assert_array_equal(np.vstack([first, second]), expected)
    np.testing.assert_array_equal(final_memory, expected[-1])
    rows = data.draw(st.integers(1, 50))
    starts, blocks = zip(*play_blocks(drive, threshold, memory, rows), strict=True)
    assert starts == tuple(range(0, len(drive), rows))
    np.testing.assert_array_equal(np.vstack(blocks), expected)
    denser = [np.linspace(a, b, 4)[1:] for a, b in itertools.pairwise(drive)]
    finer, _ = play_columns(np.concatenate([drive[:1], *denser]), threshold, memory)
    np.testing.assert_array_equal(finer[::3], expected)


def test_banks_of_any_size_follow_a_long_drive(rng):
    drive = random_walk(rng, 500)
    for plays in (1, 7, 31, 32, 33, 70):
        threshold, memory = np.sort(rng.uniform(0, 3, plays)), rng.normal(0, 1, plays)
        expected = by_definition(drive, threshold, memory)
        np.testing.assert_array_equal(play_columns(drive, threshold, memory)[0], expected)


@given(st.data(), st.lists(ANY_SIZE, min_size=1, max_size=20))
def test_a_play_of_any_size_is_followed(data, values):
    threshold = np.sort(np.abs(data.draw(st.lists(ANY_SIZE, min_size=1, max_size=12))))
    memory = np.zeros(len(threshold))
    states, _ = play_columns(np.array(values), threshold, memory)
    np.testing.assert_array_equal(states, by_definition(np.array(values), threshold, memory))


@given(banks(), drives())
def test_the_initial_memory_matters_only_before_the_forgetting_sample(threshold, drive):
    low, high = (
        play_columns(drive, threshold, np.full(len(threshold), start))[0] for start in (-99, 99)
    )
    index = np.arange(len(drive))[:, None]
    np.testing.assert_array_equal(low == high, index >= forgetting_sample(drive, threshold))
