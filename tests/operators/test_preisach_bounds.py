"""Distances of two sums of plays behind functions: never exceeded, and attained."""

import numpy as np
import pytest

from piezoid.numerics.arrays import Array
from piezoid.operators.prandtl_ishlinskii import PrandtlIshlinskii, worst_case
from piezoid.operators.preisach_plays import (
    PreisachPlays,
    farthest_apart_m,
    farthest_from_line_m,
    slope_ratios,
)

REACH_V = 8.0
PLAYS, EDGES, STEPS = 8, 5, 4


def drawn(rng: np.random.Generator, *, straight: bool = False) -> PreisachPlays:
    edge_V = STEPS * (np.arange(EDGES) - EDGES // 2).astype(float)
    line = PreisachPlays(step_V=1.0, edge_V=edge_V, value_m=np.tile(edge_V, (PLAYS, 1)))
    shape = (PLAYS, 1 if straight else EDGES - 1)
    return line.with_rises(np.broadcast_to(rng.uniform(0.2, 1.0, shape), (PLAYS, EDGES - 1)))


def drives(rng: np.random.Generator) -> Array:
    """Turning points that close in, from a de-poled stage, in small steps and in large ones."""
    turns = np.sort(rng.uniform(0.0, REACH_V, 8))[::-1] * (-1.0) ** np.arange(8)
    levels = np.concatenate([[0.0], turns, rng.uniform(-REACH_V, REACH_V, 8)])
    grid = np.linspace(0.0, 1.0, int(rng.integers(2, 30)), endpoint=False)
    return np.asarray((levels[:-1, None] + np.diff(levels)[:, None] * grid).ravel())


def test_no_drive_takes_two_operators_farther_apart_and_some_come_close(rng):
    model, other = drawn(rng), drawn(rng)
    bound_m = farthest_apart_m(model, [other], REACH_V)[0]
    low, high = slope_ratios(model, [other], REACH_V)[0]
    least, greatest, ratios = 0.0, 0.0, [1.0]
    for _ in range(1000):
        u = drives(rng)
        own, others = (one.run(u, one.virgin_memory())[0] for one in (model, other))
        least = min(least, float((others - own).min()))
        greatest = max(greatest, float((others - own).max()))
        moved = np.abs(np.diff(own)) > 1e-6
        ratio = np.diff(others)[moved] / np.diff(own)[moved]
        ratios += [float(ratio.min()), float(ratio.max())]
    assert 0.9 * bound_m < 0.5 * (greatest - least) <= bound_m * (1.0 + 1e-12)
    assert low * (1.0 - 1e-9) <= min(ratios) < 1.02 * low
    assert 0.98 * high < max(ratios) <= high * (1.0 + 1e-9)


def test_of_straight_functions_it_is_the_integral_over_the_slopes(rng):
    """B(R) = int |W_t - W_m| dr, of plays with weights [Brokate & Sprekels 1996]."""
    model, other = drawn(rng, straight=True), drawn(rng, straight=True)
    plays = [
        PrandtlIshlinskii(threshold=one.threshold_V, weight=one.rise_m[:, 0] / STEPS)
        for one in (model, other)
    ]
    expected_m = worst_case(plays[1], plays[0], REACH_V).bound
    assert farthest_apart_m(model, [other], REACH_V)[0] == pytest.approx(expected_m, rel=1e-12)
    line = PrandtlIshlinskii(threshold=np.zeros(1), weight=np.array([0.7]))
    expected_m = worst_case(plays[0], line, REACH_V).bound
    assert farthest_from_line_m(model, 0.7, REACH_V) == pytest.approx(expected_m, rel=1e-12)


def test_operators_on_two_lattices_are_refused(rng):
    model = drawn(rng)
    moved = PreisachPlays(step_V=1.0, edge_V=model.edge_V + 1.0, value_m=model.value_m)
    with pytest.raises(ValueError, match="one lattice"):
        farthest_apart_m(model, [moved], REACH_V)
