"""Of any input a play of any threshold needs only the extremes that were not wiped out."""

import numpy as np
import pytest

from piezoid.operators.chain import Chain, Following
from piezoid.operators.dead_zone import LINEAR
from piezoid.operators.play import LastingExtremes


def drives(seed: int) -> np.ndarray:
    """Noise, sums of sines, staircases with plateaus, loops that shrink and loops that grow."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(rng.integers(2, 400)))
    kinds = (
        rng.standard_normal(len(t)),
        np.sin(0.3 * t) + 0.3 * np.sin(2.1 * t + 1.0),
        np.round(2.0 * np.cumsum(rng.choice([-1.0, 0.0, 1.0], len(t)))) / 4.0,
        np.exp(-0.01 * t) * np.cos(0.5 * t),
        np.exp(0.01 * t) * np.cos(0.5 * t),
    )
    return np.asarray(kinds[seed % len(kinds)])


def extremes_of(parts: list[np.ndarray]) -> np.ndarray:
    found = LastingExtremes(room=1)
    for part in parts:
        found.follow(part)
    return found.values


def last_row(chain: Chain, first: float, drive: np.ndarray) -> np.ndarray:
    """Return states and derivatives by every number at the end of a drive, begun at the first."""
    found = np.empty((1, chain.plays + chain.columns), order="F")
    Following(chain, first).rows(drive, np.array([len(drive) - 1]), found)
    return found


@pytest.mark.parametrize("seed", range(40))
def test_states_and_derivatives_at_the_end_are_those_of_the_whole_input(seed: int) -> None:
    rng, drive = np.random.default_rng([seed, 1]), drives(seed)
    threshold = np.sort(np.abs(rng.standard_normal(12)))
    chain = Chain(
        gap=np.diff(threshold, prepend=0.0),
        weight=rng.uniform(0.1, 1.0, 13),
        memory_slope=rng.uniform(-1.0, 1.0, 12),
        zones=LINEAR,
    )
    short = extremes_of([drive])
    assert short[-1] == drive[-1]
    ends = [last_row(chain, float(drive[0]), way) for way in (short, drive)]
    np.testing.assert_array_equal(*ends)
    cuts = np.sort(rng.integers(0, len(drive), 3))
    np.testing.assert_array_equal(extremes_of(np.split(drive, cuts)), short)
    # Of two parts the extremes of each suffice.
    pairs = [extremes_of([part]) for part in np.split(drive, cuts) if len(part)]
    np.testing.assert_array_equal(extremes_of(pairs), short)


def test_a_long_noisy_sine_leaves_few_extremes() -> None:
    t = np.arange(100_000)
    noise = 0.01 * np.random.default_rng(0).standard_normal(len(t))
    assert len(extremes_of([np.sin(1e-3 * t) + noise])) < 40


def test_what_is_kept_is_never_wiped_out() -> None:
    found = LastingExtremes()
    found.follow(np.array([0.0, 3.0, 1.0]))
    found.keep(np.array([1.0, 1.5]))
    found.follow(np.array([9.0, -9.0, 0.0]))
    assert found.values.tolist() == [0.0, 3.0, 1.0, 1.0, 1.5, 9.0, -9.0, 0.0]
