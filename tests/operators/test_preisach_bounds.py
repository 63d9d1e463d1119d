"""Largest distances of two sums of plays behind functions."""

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


def random_plays(rng: np.random.Generator, *, straight: bool = False) -> PreisachPlays:
    edge_V = STEPS * (np.arange(EDGES) - EDGES // 2).astype(float)
    line = PreisachPlays(step_V=1.0, edge_V=edge_V, value_m=np.tile(edge_V, (PLAYS, 1)))
    shape = (PLAYS, 1 if straight else EDGES - 1)
    return line.with_rises(np.broadcast_to(rng.uniform(0.2, 1.0, shape), (PLAYS, EDGES - 1)))


def drives(rng: np.random.Generator) -> Array:
    """Return converging turning points from a de-poled stage, in small and large steps."""
    turns = np.sort(rng.uniform(0.0, REACH_V, 8))[::-1] * (-1.0) ** np.arange(8)
    levels = np.concatenate([[0.0], turns, rng.uniform(-REACH_V, REACH_V, 8)])
    grid = np.linspace(0.0, 1.0, int(rng.integers(2, 30)), endpoint=False)
    return np.asarray((levels[:-1, None] + np.diff(levels)[:, None] * grid).ravel())


def test_no_drive_exceeds_the_bounds_and_some_drives_approach_them(rng):
    model, other_model = random_plays(rng), random_plays(rng)
    bound_m = farthest_apart_m(model, [other_model], REACH_V)[0]
    low, high = slope_ratios(model, [other_model], REACH_V)[0]
    min_difference_m, max_difference_m, ratios = 0.0, 0.0, [1.0]
    for _ in range(1000):
        u = drives(rng)
        model_m, other_m = (
            operator.run(u, operator.virgin_memory())[0] for operator in (model, other_model)
        )
        min_difference_m = min(min_difference_m, float((other_m - model_m).min()))
        max_difference_m = max(max_difference_m, float((other_m - model_m).max()))
        is_moving = np.abs(np.diff(model_m)) > 1e-6
        ratio = np.diff(other_m)[is_moving] / np.diff(model_m)[is_moving]
        ratios += [float(ratio.min()), float(ratio.max())]
    assert 0.9 * bound_m < 0.5 * (max_difference_m - min_difference_m) <= bound_m * (1.0 + 1e-12)
    assert low * (1.0 - 1e-9) <= min(ratios) < 1.02 * low
    assert 0.98 * high < max(ratios) <= high * (1.0 + 1e-9)


def test_the_bound_of_linear_plays_is_the_integral_over_the_slopes(rng):
    """B(R) = int |W_t - W_m| dr, of plays with weights [Brokate & Sprekels 1996]."""
    model, other_model = random_plays(rng, straight=True), random_plays(rng, straight=True)
    plays = [
        PrandtlIshlinskii(threshold=operator.threshold_V, weight=operator.rise_m[:, 0] / STEPS)
        for operator in (model, other_model)
    ]
    expected_m, _ = worst_case(plays[1], plays[0], REACH_V)
    assert farthest_apart_m(model, [other_model], REACH_V)[0] == pytest.approx(
        expected_m, rel=1e-12
    )
    line = PrandtlIshlinskii(threshold=np.zeros(1), weight=np.array([0.7]))
    expected_m, _ = worst_case(plays[0], line, REACH_V)
    assert farthest_from_line_m(model, 0.7, REACH_V) == pytest.approx(expected_m, rel=1e-12)


def test_operators_on_two_lattices_are_refused(rng):
    model = random_plays(rng)
    shifted = PreisachPlays(step_V=1.0, edge_V=model.edge_V + 1.0, value_m=model.value_m)
    with pytest.raises(ValueError, match="one lattice"):
        farthest_apart_m(model, [shifted], REACH_V)
