"""Random drives, thresholds, memories and models of any size for the laws of this folder.

Numbers on a grid of 1/16 add and subtract without rounding, so that laws hold bit for bit, and
they often coincide. One byte is one number, so that hypothesis draws a whole array at once.
"""

import numpy as np
from hypothesis import strategies as st

from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import LINEAR, DeadZones, from_slopes
from piezoid.operators.prandtl_ishlinskii import ModifiedPrandtlIshlinskii, PrandtlIshlinskii

GRID = 16.0
REACH = 8.0  # drives lie within -8 .. 8, often on top of a threshold
ROUNDING = 1e-12  # a hundred operations on numbers that differ by a factor of 100


def random_walk(rng: np.random.Generator, samples: int, step: float = 0.5) -> Array:
    return np.asarray(np.cumsum(rng.normal(0, step, samples)) * 0.3)


def drives(min_samples: int = 1, max_samples: int = 40) -> st.SearchStrategy[Array]:
    """Draw samples of a drive, with repeats, jumps and values on thresholds."""
    return st.binary(min_size=min_samples, max_size=max_samples).map(
        lambda data: np.frombuffer(data, np.int8) / GRID
    )


def banks(max_plays: int = 40) -> st.SearchStrategy[Array]:
    """Draw thresholds from zero to beyond every drive, more than the lanes of the kernels."""
    return st.binary(min_size=1, max_size=max_plays).map(
        lambda data: np.sort(np.frombuffer(data, np.uint8)) / GRID
    )


def gaps(max_gaps: int = 12) -> st.SearchStrategy[Array]:
    """Draw thresholds of a model: from zero, strictly increasing."""
    return st.binary(max_size=max_gaps).map(
        lambda data: np.cumsum([0.0, *(1 + np.frombuffer(data, np.uint8) % 32) / GRID])
    )


def is_admissible(memory_V: Array, voltage_V: float, threshold_V: Array) -> bool:
    """Tell whether a real input history that ends at ``voltage_V`` can have this memory.

        |z_0 - u| <= r_0  and  |z_i - z_(i-1)| <= r_i - r_(i-1)       [Krejci], discrete form

    A margin of a few rounding errors is allowed.
    """
    nodes_V = np.concatenate([[voltage_V], memory_V])
    gaps_V = np.diff(threshold_V, prepend=0.0)
    slack_V = 8 * np.finfo(float).eps * (np.abs(nodes_V).max() + np.abs(threshold_V).max())
    return bool((np.abs(np.diff(nodes_V)) <= gaps_V + slack_V).all())


def admissible_memory(free: Array, threshold: Array) -> Array:
    """Return the admissible memory nearest to ``free``, whose first value is the last input."""
    memory = free.copy()
    for k, gap in enumerate(np.diff(threshold, prepend=0.0), 1):
        memory[k] = np.clip(memory[k], memory[k - 1] - gap, memory[k - 1] + gap)
    return memory[1:]


def memories(threshold: Array) -> st.SearchStrategy[Array]:
    """Draw admissible states before a first sample."""
    count = len(threshold) + 1
    return drives(count, count).map(lambda free: admissible_memory(free, threshold))


def slopes(count: int) -> st.SearchStrategy[Array]:
    """Draw slopes from 0.1 to 10, so that inverses keep their digits."""
    return st.binary(min_size=count, max_size=count).map(
        lambda data: 10.0 ** (np.frombuffer(data, np.uint8) / 127.5 - 1.0)
    )


@st.composite
def play_sums(draw: st.DrawFn, max_gaps: int = 12) -> PrandtlIshlinskii:
    """Draw weighted plays with an increasing loading curve; single weights may be negative."""
    threshold = draw(gaps(max_gaps))
    return PrandtlIshlinskii(
        threshold=threshold, weight=np.diff(draw(slopes(len(threshold))), prepend=0.0)
    )


@st.composite
def kinked_curves(draw: st.DrawFn) -> DeadZones:
    """Draw increasing curves with up to five kinks on each side of zero."""
    up, down = draw(gaps(5))[1:], -draw(gaps(5))[:0:-1]
    slope = draw(slopes(len(up) + len(down) + 2))
    slope[len(down)] = slope[len(down) + 1]
    return from_slopes(np.concatenate([down, [0.0], up]), slope)


@st.composite
def models(draw: st.DrawFn, unit_V: float = 1.0, unit_m: float = 1.0) -> ModifiedPrandtlIshlinskii:
    """Draw modified models, half of them with an envelope, in units of any size."""
    plays, zones = draw(play_sums()), draw(kinked_curves())
    envelope = draw(st.one_of(st.just(LINEAR), kinked_curves()))
    offset_V, offset_m = draw(drives(2, 2))
    return ModifiedPrandtlIshlinskii(
        plays=PrandtlIshlinskii(
            threshold=plays.threshold * unit_V, weight=plays.weight * (unit_m / unit_V)
        ),
        dead_zones=DeadZones(threshold=zones.threshold * unit_m, weight=zones.weight),
        voltage_offset_V=offset_V * unit_V,
        displacement_offset_m=offset_m * unit_m,
        envelope=DeadZones(threshold=envelope.threshold * unit_V, weight=envelope.weight),
    )


def assert_close(actual: Array, expected: Array, size: float) -> None:
    """Assert equality to the rounding of numbers of this size."""
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=ROUNDING * size)
