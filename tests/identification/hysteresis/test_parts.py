"""Loop width, intervals, pruning, and the distance of two models."""

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
    sweep = recording(drive, stage(drive, seed, noise_m))
    scales = scales_of([sweep], "x")
    return search(pieces_of([sweep], "x", scales, Rig()), SHAPE, SETTINGS), scales


def test_the_loop_width_agrees_with_a_simulated_full_loop():
    fit, scales = fitted()
    model = to_si_units(fit.operator, scales)
    full_loop_V = scales.voltage_V * np.concatenate(
        [np.linspace(0, 1, 50), np.linspace(1, -1, 201), np.linspace(-1, 1, 201)]
    )
    y, _ = model.run(model.voltage_offset_V + full_loop_V, model.virgin_memory())
    falling, rising = y[50 + 100], y[50 + 201 + 100]
    width = loop_width_m(fit.theta, fit.task.coordinates, scales)
    assert width == pytest.approx(falling - rising, rel=1e-9)


def test_intervals_agree_with_the_scatter_over_noise():
    def width(vector: Array, fit: HysteresisFit, scales: Scales) -> Array:
        return np.array([loop_width_m(vector, fit.task.coordinates, scales)])

    estimates, half_widths = [], []
    for seed in range(6):
        fit, scales = fitted(seed)
        spread = jackknife(fit.theta, fit.task)
        estimates.append(width(fit.theta, fit, scales)[0])
        half_width = spread.half_width(lambda v, fit=fit, scales=scales: width(v, fit, scales))
        half_widths.append(half_width[0])
    scatter = 2 * float(np.std(estimates, ddof=1))
    assert 0.5 * scatter < np.median(half_widths) < 4 * scatter


def test_pruning_removes_idle_parts_without_loss():
    fit, _ = fitted(noise_m=1e-10)
    theta = fit.theta.copy()
    weight = fit.task.coordinates.slices["weight"]
    theta[weight.stop - 1] = 0.0
    idle = replace(fit, theta=theta, rms=rms_of(theta, fit.task))
    simple = prune(idle, iterations=30)
    assert simple.shape.plays < fit.shape.plays
    assert simple.rms <= 1.002 * idle.rms


def test_the_distance_of_two_models_bounds_their_difference_under_any_drive(rng):
    fit, scales = fitted()
    model = to_si_units(fit.operator, scales)
    drives_V = adversarial_drives(scales.voltage_V, 1)
    for _ in range(20):
        theta = fit.theta.copy()
        shared = slice(0, fit.task.coordinates.shared)
        theta[shared] *= 1 + 0.05 * rng.standard_normal(shared.stop)
        perturbed = to_si_units(operator_of(theta, fit.task.coordinates), scales)
        plays_m, zones_m = distance_terms(model, perturbed, scales.voltage_V)
        reached_m = max_difference_m(model, perturbed, drives_V, scales.voltage_V)
        assert 0 < reached_m <= plays_m + zones_m
    rescaled = distance_terms(model, model.rescaled(3.0), scales.voltage_V)
    np.testing.assert_allclose(rescaled, 0.0, atol=1e-18)


def test_without_dead_zones_the_bound_is_attained():
    fit, scales = fitted()
    model = to_si_units(fit.operator, scales)
    plays = replace(model.plays, weight=model.plays.weight * np.linspace(0.9, 1.1, 7))
    model = replace(model, dead_zones=LINEAR)
    perturbed = replace(model, plays=plays)
    end = np.array([scales.voltage_V])
    ratio = float(model.plays.loading_curve(end)[0] / perturbed.plays.loading_curve(end)[0])
    perturbed = perturbed.rescaled(ratio)
    perturbed = replace(perturbed, dead_zones=model.dead_zones)
    plays_m, zones_m = distance_terms(model, perturbed, scales.voltage_V)
    zero_V = np.zeros(1)
    reached_m = max_difference_m(model, perturbed, zero_V, scales.voltage_V)
    assert zones_m == pytest.approx(0.0, abs=1e-18)
    assert reached_m == pytest.approx(plays_m, rel=1e-9)
