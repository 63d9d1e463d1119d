"""The parts of the fit, each held to what it promises."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from piezoid.identification.hysteresis.coordinates import Shape, operator_of, to_si_units
from piezoid.identification.hysteresis.gauss_newton import HysteresisFit, rms_of
from piezoid.identification.hysteresis.pieces import Rig, Scales, pieces_of, scales_of
from piezoid.identification.hysteresis.search import Settings, prune, search
from piezoid.identification.hysteresis.uncertainty import (
    adversarial_drives,
    distance_terms,
    jackknife,
    loop_width_m,
    max_difference_m,
)
from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import LINEAR
from tests.identification.hysteresis.stages import decaying, play_sum, recording

THRESHOLD = np.array([0.0, 0.7, 1.5, 2.6])
WEIGHT = np.array([2.0, 0.5, 0.3, 0.2]) * 1e-6
SETTINGS = Settings(longest_lag_s=0.02, follow_zero=False)
SHAPE = Shape(plays=6, below=1, above=1)


def stage(drive: Array, seed: int, noise_m: float = 2e-8) -> Array:
    clean = play_sum(drive, THRESHOLD, WEIGHT, np.full(4, drive[0]))
    return clean + np.random.default_rng(seed).normal(0, noise_m, len(drive))


@cache
def fitted(seed: int = 0, noise_m: float = 2e-8) -> tuple[HysteresisFit, Scales]:
    drive = np.concatenate([decaying(24, per_unit=20)] * 2)
    one = recording(drive, stage(drive, seed, noise_m))
    scales = scales_of([one], "x")
    return search(pieces_of([one], "x", scales, Rig()), SHAPE, SETTINGS), scales


def test_loop_width_is_that_of_a_simulated_full_loop():
    found, scales = fitted()
    model = to_si_units(found.operator, scales)
    full = scales.voltage_V * np.concatenate(
        [np.linspace(0, 1, 50), np.linspace(1, -1, 201), np.linspace(-1, 1, 201)]
    )
    y, _ = model.run(model.voltage_offset_V + full, model.virgin_memory())
    falling, rising = y[50 + 100], y[50 + 201 + 100]
    width = loop_width_m(found.theta, found.task.coordinates, scales)
    assert width == pytest.approx(falling - rising, rel=1e-9)


def test_intervals_have_the_size_of_the_scatter_over_new_noise():
    def width(vector: Array, found: HysteresisFit, scales: Scales) -> Array:
        return np.array([loop_width_m(vector, found.task.coordinates, scales)])

    estimates, half_widths = [], []
    for seed in range(6):
        found, scales = fitted(seed)
        spread = jackknife(found.theta, found.task)
        estimates.append(width(found.theta, found, scales)[0])
        half = spread.half_width(lambda v, found=found, scales=scales: width(v, found, scales))  # type: ignore[misc]
        half_widths.append(half[0])
    scatter = 2 * float(np.std(estimates, ddof=1))
    assert 0.5 * scatter < np.median(half_widths) < 4 * scatter


def test_simplification_drops_parts_without_use_and_is_as_good():
    found, _ = fitted(noise_m=1e-10)
    theta = found.theta.copy()
    weight = found.task.coordinates.slices["weight"]
    theta[weight.stop - 1] = 0.0
    idle = replace(found, theta=theta, rms=rms_of(theta, found.task))
    simple = prune(idle, iterations=30)
    assert simple.shape.plays < found.shape.plays
    assert simple.rms <= 1.002 * idle.rms


def test_distance_of_two_models_bounds_what_any_drive_reaches(rng):
    found, scales = fitted()
    model = to_si_units(found.operator, scales)
    drives_V = adversarial_drives(scales.voltage_V, 1)
    for _ in range(20):
        theta = found.theta.copy()
        shared = slice(0, found.task.coordinates.shared)
        theta[shared] *= 1 + 0.05 * rng.standard_normal(shared.stop)
        other = to_si_units(operator_of(theta, found.task.coordinates), scales)
        plays_m, zones_m = distance_terms(model, other, scales.voltage_V)
        reached_m = max_difference_m(model, other, drives_V, scales.voltage_V)
        assert 0 < reached_m <= plays_m + zones_m
    same = distance_terms(model, model.rescaled(3.0), scales.voltage_V)
    np.testing.assert_allclose(same, 0.0, atol=1e-18)


def test_without_dead_zones_the_bound_is_attained():
    found, scales = fitted()
    model = to_si_units(found.operator, scales)
    plays = replace(model.plays, weight=model.plays.weight * np.linspace(0.9, 1.1, 7))
    model = replace(model, dead_zones=LINEAR)
    other = replace(model, plays=plays)
    end = np.array([scales.voltage_V])
    ratio = float(model.plays.loading_curve(end)[0] / other.plays.loading_curve(end)[0])
    other = other.rescaled(ratio)
    other = replace(other, dead_zones=model.dead_zones)
    plays_m, zones_m = distance_terms(model, other, scales.voltage_V)
    none = np.zeros(1)
    reached_m = max_difference_m(model, other, none, scales.voltage_V)
    assert zones_m == pytest.approx(0.0, abs=1e-18)
    assert reached_m == pytest.approx(plays_m, rel=1e-9)
