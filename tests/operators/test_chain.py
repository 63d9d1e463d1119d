"""The chain with all its derivatives: the same in any chunks, and only where it was asked for."""

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
EVERY = {
    "none": {},
    "delay": {"share": 0.3},
    "lag": {"lag": FirstOrder(time_s=0.03, rate_Hz=RATE_Hz)},
    "sensor": {"share": 0.7, "sensor": FirstOrder(time_s=0.01, rate_Hz=RATE_Hz)},
}


def drawn(rng: np.random.Generator, kind: str, plays: int = 5) -> Chain:
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
    return replace(base, **EVERY[kind])


def rows_at(chain: Chain, drive: Array, wanted: Array, cuts: list[int]) -> Array:
    following = Following(chain, float(drive[0]))
    parts, before = [], 0
    for after in [*cuts, len(drive)]:
        mine = wanted[(wanted >= before) & (wanted < after)] - before
        part = np.empty((len(mine), chain.plays + chain.columns), order="F")
        following.rows(drive[before:after], mine, part)
        parts.append(part)
        before = after
    return np.concatenate(parts)


@pytest.mark.parametrize("kind", EVERY)
def test_chunks_of_any_length_give_the_same_bits(rng: np.random.Generator, kind: str) -> None:
    chain, drive = drawn(rng, kind), random_walk(rng, 900)
    wanted = np.sort(rng.choice(900, 400))
    whole = rows_at(chain, drive, wanted, [])
    np.testing.assert_array_equal(rows_at(chain, drive, wanted, [1, 33, 34, 500, 877]), whole)


@pytest.mark.parametrize("kind", EVERY)
def test_a_row_does_not_depend_on_which_others_were_asked_for(
    rng: np.random.Generator, kind: str
) -> None:
    chain, drive = drawn(rng, kind), random_walk(rng, 500)
    whole = rows_at(chain, drive, np.arange(500), [])
    few = np.array([0, 0, 7, 8, 120, 120, 499])
    np.testing.assert_array_equal(rows_at(chain, drive, few, []), whole[few])


def test_without_filters_the_reading_is_dead_zones_after_plays_after_the_envelope(
    rng: np.random.Generator,
) -> None:
    chain, drive = drawn(rng, "none"), random_walk(rng, 700)
    bent = chain.envelope.run(drive)
    memory = bent[0] + np.cumsum(chain.gap * chain.memory_slope)
    plays, _ = play_columns(bent, np.cumsum(chain.gap), memory)
    h = chain.weight[0] * bent + plays @ chain.weight[1:]
    found = rows_at(chain, drive, np.arange(700), [])
    np.testing.assert_allclose(found[:, -1], chain.zones.run(h), atol=1e-13)
    np.testing.assert_allclose(
        found[:, 2 * chain.plays : 3 * chain.plays + 1],
        chain.zones.run_with_slope(h)[1][:, None] * np.column_stack([bent, plays]),
        atol=1e-13,
    )


def test_a_delay_of_nothing_leaves_the_reading_as_it_is(rng: np.random.Generator) -> None:
    chain, drive = drawn(rng, "none"), random_walk(rng, 200)
    every = np.arange(200)
    late = rows_at(replace(chain, share=0.0), drive, every, [])
    np.testing.assert_array_equal(late[:, -1], rows_at(chain, drive, every, [])[:, -1])


def test_the_memory_is_forgotten_once_every_play_has_moved(rng: np.random.Generator) -> None:
    chain = drawn(rng, "delay")
    drive = np.concatenate([np.zeros(10), np.linspace(0.0, 2 * chain.gap.sum() + 1, 50)])
    drive = np.concatenate([drive, -drive])
    found = rows_at(chain, drive, np.arange(len(drive)), [])
    aware = found[:, : chain.plays].any(axis=1)
    assert aware[:10].all()
    assert not aware[60:].any()


def test_rows_are_written_only_where_they_fit(rng: np.random.Generator) -> None:
    chain, drive = drawn(rng, "none"), random_walk(rng, 50)
    wanted = np.arange(10)
    for out in (np.empty((10, 30)), np.empty((9, 30), order="F"), np.empty((10, 5), order="F")):
        with pytest.raises(TypeError, match="columns"):
            Following(chain, float(drive[0])).rows(drive, wanted, out)
    out = np.empty((2, 40), order="F")
    with pytest.raises(TypeError, match="in order"):
        Following(chain, float(drive[0])).rows(drive, np.array([3, 2]), out)
