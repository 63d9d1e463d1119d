"""Order selection chooses the smallest adequate shape, with plausible weights."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from piezoid.identification.hysteresis.estimate import estimate_axis
from piezoid.identification.hysteresis.order_selection import folds_of
from piezoid.identification.hysteresis.pieces import Rig, pieces_of, scales_of
from piezoid.identification.model import AxisModel
from tests.identification.hysteresis.stages import decaying, play_sum, recording
from tests.laws import swept_um, triangles

NOISE_m = 45e-9
LOOP_THRESHOLD = np.linspace(0.0, 1.0, 6)
LOOP_WEIGHT = np.array([12.0, 0.12, 0.12, 0.12, 0.12, 0.12]) * 1e-6
DISTINCT_LAWS = ("preisach", "dahl", "plays")  # erasing memory, friction, the model class


@cache
def thin_loop() -> AxisModel:
    """Fit a stage of 12 um/V, with a loop of 2 % of its stroke of 50 um and noise of 45 nm."""
    drive = 2.0 * triangles(10, 400, 0.08)
    clean_m = play_sum(drive, LOOP_THRESHOLD, LOOP_WEIGHT, np.full(6, drive[0]))
    noise_m = np.random.default_rng(1).normal(0.0, NOISE_m, len(drive))
    return estimate_axis([recording(drive, clean_m + noise_m)], "x", Rig())


@cache
def law_model(law: str) -> AxisModel:
    field, reading_um = swept_um(law)
    return estimate_axis([recording(5.0 * field, 1e-6 * reading_um)], "x", Rig())


def test_a_thin_loop_gets_a_small_shape_with_an_error_near_the_noise():
    model = thin_loop()
    assert len(model.hysteresis.plays.weight) - 1 <= 5
    assert len(model.hysteresis.dead_zones.weight) - 1 <= 3
    assert model.quality.held_out_rms_m < 1.05 * NOISE_m
    assert model.certificate.bound_m < 0.01 * model.quality.range_m
    min_slope = model.hysteresis.plays.weight[0] * model.hysteresis.dead_zones.slope.min()
    max_slope = model.hysteresis.plays.weight.sum() * model.hysteresis.dead_zones.slope.max()
    assert 11e-6 < min_slope < max_slope < 14e-6  # m/V; true values 12 and 12.6


@pytest.mark.parametrize("law", DISTINCT_LAWS)
def test_weights_are_nonnegative_and_plausible(law):
    model = law_model(law)
    mean = model.quality.range_m / np.ptp(model.voltage_V)
    plays = model.hysteresis.plays
    assert (plays.weight >= 0.0).all()
    assert plays.weight[0] > 0.2 * mean
    assert plays.weight.sum() < 4.2 * mean
    assert plays.threshold[-1] < 0.5 * np.ptp(model.voltage_V)
    assert (model.hysteresis.dead_zones.slope > 0.0).all()


@pytest.mark.parametrize("law", DISTINCT_LAWS)
def test_the_selected_order_is_nearly_the_best(law):
    quality = law_model(law).quality
    min_error_m = min(order.held_out_rms_m for order in quality.orders)
    assert quality.held_out_rms_m < 1.15 * min_error_m


@pytest.mark.usefixtures("one_order")
def test_the_recording_of_largest_amplitude_is_predicted_from_its_half():
    rng = np.random.default_rng(3)
    wide = np.tile(decaying(12, per_unit=20), 2)
    recordings = []
    for name, drive in (("wide", wide), ("small", 0.01 * wide), ("smaller", 0.005 * wide)):
        clean_m = play_sum(drive, LOOP_THRESHOLD, LOOP_WEIGHT * 2.0, np.full(6, drive[0]))
        noise_m = rng.normal(0.0, 5e-8, len(drive))
        recordings.append(recording(drive, clean_m + noise_m, f"{name}.csv"))
    quality = estimate_axis(recordings, "x", Rig(), orders=((2, 0), (8, 2))).quality
    assert quality.held_out_kind == "other recordings, second half of the widest"
    for order in quality.orders:
        assert order.held_out_rms_m < 0.02 * quality.range_m


@pytest.mark.usefixtures("one_order")
def test_only_the_piece_of_largest_amplitude_is_halved_for_validation():
    """Other pieces of that recording are held out completely."""
    rng = np.random.default_rng(4)
    wide = decaying(12, per_unit=20)
    recordings = []
    for name, drive, breaks in (
        ("wide", np.concatenate([0.5 * wide, wide]), (len(wide),)),
        ("small", 0.6 * wide, ()),
        ("smaller", 0.5 * wide, ()),
    ):
        clean_m = play_sum(drive, LOOP_THRESHOLD, LOOP_WEIGHT * 2.0, np.full(6, drive[0]))
        noise_m = rng.normal(0.0, 5e-8, len(drive))
        recordings.append(
            replace(recording(drive, clean_m + noise_m, f"{name}.csv"), breaks=breaks)
        )
    pieces = pieces_of(recordings, "x", scales_of(recordings, "x"), Rig())
    folds = [fold for fold in folds_of(pieces) if fold.halved]
    assert [(fold.halved, len(fold.testing)) for fold in folds] == [(1, 2)]
    assert len(folds[0].held_out_samples(0)) == pytest.approx(len(wide) / 2, abs=1)
    assert len(folds[0].held_out_samples(1)) == len(wide)
    quality = estimate_axis(recordings, "x", Rig(), orders=((2, 0), (8, 2))).quality
    assert quality.held_out_rms_m < 0.02 * quality.range_m
