"""The chain and its derivatives do not depend on chunks or on the selection of rows."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.numerics.arrays import Array
from piezoid.operators.chain import Chain, Following
from piezoid.operators.dead_zone import from_slopes
from piezoid.operators.filters import FirstOrder
from piezoid.operators.play import play_columns
from tests.operators.strategies import random_walk

RATE_Hz = 100.0
FILTERS = {
    "none": {},
    "delay": {"share": 0.3},
    "lag": {"lag": FirstOrder(time_s=0.03, rate_Hz=RATE_Hz)},
    "sensor": {"share": 0.7, "sensor": FirstOrder(time_s=0.01, rate_Hz=RATE_Hz)},
}


def random_chain(rng: np.random.Generator, kind: str, plays: int = 5) -> Chain:
    gap = rng.uniform(0.1, 0.5, plays)
    base = Chain(
        gap=gap,
        weight=rng.uniform(0.1, 1.0, plays + 1),
        memory_slope=rng.uniform(-1.0, 1.0, plays),
        zones=from_slopes(np.array([-1.0, 0.0, 0.5, 2.0]), np.array([0.5, 1.0, 1.0, 1.2, 0.9])),
        envelope=from_slopes(
            np.array([-2.0, -1.0, 0.0, 1.0, 2.0]), np.array([0.8, 0.9, 1.0, 1.0, 1.1, 1.3])
        ),
        rate_Hz=RATE_Hz,
    )
    return replace(base, **FILTERS[kind])


def chain_columns(chain: Chain, drive: Array, rows: Array, cuts: list[int]) -> Array:
    following = Following(chain, float(drive[0]))
    blocks, start = [], 0
    for stop in [*cuts, len(drive)]:
        rows_here = rows[(rows >= start) & (rows < stop)] - start
        block = np.empty((len(rows_here), chain.plays + chain.columns), order="F")
        following.rows(drive[start:stop], rows_here, block)
        blocks.append(block)
        start = stop
    return np.concatenate(blocks)


@pytest.mark.parametrize("kind", FILTERS)
def test_rows_in_any_chunks_and_selection_have_the_same_bits(rng, kind):
    chain, drive = random_chain(rng, kind), random_walk(rng, 900)
    expected = chain_columns(chain, drive, np.arange(900), [])
    rows = np.sort(rng.choice(900, 400))
    for chunks in ([], [1, 33, 34, 500, 877]):
        np.testing.assert_array_equal(chain_columns(chain, drive, rows, chunks), expected[rows])


def test_without_filters_the_reading_is_dead_zones_after_plays_after_the_envelope(rng):
    chain, drive = random_chain(rng, "none"), random_walk(rng, 700)
    envelope_V = chain.envelope.run(drive)
    memory = envelope_V[0] + np.cumsum(chain.gap * chain.memory_slope)
    plays, _ = play_columns(envelope_V, np.cumsum(chain.gap), memory)
    h = chain.weight[0] * envelope_V + plays @ chain.weight[1:]
    columns = chain_columns(chain, drive, np.arange(700), [])
    np.testing.assert_allclose(columns[:, -1], chain.zones.run(h), atol=1e-13)
    np.testing.assert_allclose(
        columns[:, 2 * chain.plays : 3 * chain.plays + 1],
        chain.zones.run_with_slope(h)[1][:, None] * np.column_stack([envelope_V, plays]),
        atol=1e-13,
    )


def test_a_delay_of_zero_changes_nothing(rng):
    chain, drive = random_chain(rng, "none"), random_walk(rng, 200)
    rows = np.arange(200)
    delayed = chain_columns(replace(chain, share=0.0), drive, rows, [])
    np.testing.assert_array_equal(delayed[:, -1], chain_columns(chain, drive, rows, [])[:, -1])


def test_the_memory_is_forgotten_once_every_play_has_moved(rng):
    chain = random_chain(rng, "delay")
    drive = np.concatenate([np.zeros(10), np.linspace(0.0, 2 * chain.gap.sum() + 1, 50)])
    drive = np.concatenate([drive, -drive])
    columns = chain_columns(chain, drive, np.arange(len(drive)), [])
    depends_on_memory = columns[:, : chain.plays].any(axis=1)
    assert depends_on_memory[:10].all()
    assert not depends_on_memory[60:].any()


def test_an_output_of_the_wrong_shape_or_order_is_refused(rng):
    chain, drive = random_chain(rng, "none"), random_walk(rng, 50)
    rows = np.arange(10)
    for out in (np.empty((10, 30)), np.empty((9, 30), order="F"), np.empty((10, 5), order="F")):
        with pytest.raises(TypeError, match="columns"):
            Following(chain, float(drive[0])).rows(drive, rows, out)
    out = np.empty((2, 40), order="F")
    with pytest.raises(TypeError, match="in order"):
        Following(chain, float(drive[0])).rows(drive, np.array([3, 2]), out)
