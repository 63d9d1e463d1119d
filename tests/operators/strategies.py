"""What the laws of this folder are tried on: drives, thresholds, memories and models of any size.

Numbers on a grid of 1/16 add and subtract without rounding, so that laws hold bit for bit there,
and meet often enough. One byte is one number: hypothesis draws all of an array at once.
"""

import numpy as np
from hypothesis import strategies as st

from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import LINEAR, DeadZones, from_slopes
from piezoid.operators.modified_prandtl_ishlinskii import ModifiedPrandtlIshlinskii
from piezoid.operators.prandtl_ishlinskii import PrandtlIshlinskii

GRID = 16.0
REACH = 8.0  # drives lie within -8 .. 8, often on top of a threshold
ROUNDING = 1e-12  # a hundred operations on numbers of which the steepest is 100 times the flattest


def random_walk(rng: np.random.Generator, samples: int, step: float = 0.5) -> Array:
    return np.asarray(np.cumsum(rng.normal(0, step, samples)) * 0.3)


def drives(least: int = 1, most: int = 40) -> st.SearchStrategy[Array]:
    """Samples of a drive; repeats, jumps and values on thresholds come up by themselves."""
    return st.binary(min_size=least, max_size=most).map(
        lambda found: np.frombuffer(found, np.int8) / GRID
    )


def banks(most: int = 40) -> st.SearchStrategy[Array]:
    """Thresholds from zero to beyond every drive, equal ones too, more than the kernels' lanes."""
    return st.binary(min_size=1, max_size=most).map(
        lambda found: np.sort(np.frombuffer(found, np.uint8)) / GRID
    )


def gaps(most: int = 12) -> st.SearchStrategy[Array]:
    """Thresholds of a model: from zero, strictly increasing."""
    return st.binary(max_size=most).map(
        lambda found: np.cumsum([0.0, *(1 + np.frombuffer(found, np.uint8) % 32) / GRID])
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


def nested(free: Array, threshold: Array) -> Array:
    """The admissible memory next to any numbers, the first of which is the last input."""
    memory = free.copy()
    for k, gap in enumerate(np.diff(threshold, prepend=0.0), 1):
        memory[k] = np.clip(memory[k], memory[k - 1] - gap, memory[k - 1] + gap)
    return memory[1:]


def memories(threshold: Array) -> st.SearchStrategy[Array]:
    """Admissible states before a first sample."""
    count = len(threshold) + 1
    return drives(count, count).map(lambda free: nested(free, threshold))


def slopes(count: int) -> st.SearchStrategy[Array]:
    """Slopes from a tenth to ten: steep against flat, yet with an inverse that keeps digits."""
    return st.binary(min_size=count, max_size=count).map(
        lambda found: 10.0 ** (np.frombuffer(found, np.uint8) / 127.5 - 1.0)
    )


@st.composite
def play_sums(draw: st.DrawFn, most: int = 12) -> PrandtlIshlinskii:
    """Weighted plays whose loading curve increases; single weights may be negative."""
    threshold = draw(gaps(most))
    return PrandtlIshlinskii(
        threshold=threshold, weight=np.diff(draw(slopes(len(threshold))), prepend=0.0)
    )


@st.composite
def kinked_curves(draw: st.DrawFn) -> DeadZones:
    """Increasing curves with up to five kinks on each side of zero."""
    up, down = draw(gaps(5))[1:], -draw(gaps(5))[:0:-1]
    slope = draw(slopes(len(up) + len(down) + 2))
    slope[len(down)] = slope[len(down) + 1]
    return from_slopes(np.concatenate([down, [0.0], up]), slope)


@st.composite
def models(draw: st.DrawFn, unit_V: float = 1.0, unit_m: float = 1.0) -> ModifiedPrandtlIshlinskii:
    """Modified models, half of them with an envelope, in units of any size."""
    plays, zones = draw(play_sums()), draw(kinked_curves())
    envelope = draw(st.one_of(st.just(LINEAR), kinked_curves()))
    middle_V, middle_m = draw(drives(2, 2))
    return ModifiedPrandtlIshlinskii(
        plays=PrandtlIshlinskii(
            threshold=plays.threshold * unit_V, weight=plays.weight * (unit_m / unit_V)
        ),
        dead_zones=DeadZones(threshold=zones.threshold * unit_m, weight=zones.weight),
        voltage_offset_V=middle_V * unit_V,
        displacement_offset_m=middle_m * unit_m,
        envelope=DeadZones(threshold=envelope.threshold * unit_V, weight=envelope.weight),
    )


def close(found: Array, wanted: Array, size: float) -> None:
    """Equal to the rounding of numbers of this size."""
    np.testing.assert_allclose(found, wanted, rtol=0.0, atol=ROUNDING * size)
