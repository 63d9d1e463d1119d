"""The smallest shape that the error cannot tell from the best, with weights a stage can have."""

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
DISTINCT_LAWS = ("preisach", "dahl", "plays")  # wiping out, saturating friction, of the class


@cache
def thin_loop() -> AxisModel:
    """Fit a stage of 12 um/V whose loop is 2 % of its stroke of 50 um, in noise of 45 nm."""
    drive = 2.0 * triangles(10, 400, 0.08)
    clean_m = play_sum(drive, LOOP_THRESHOLD, LOOP_WEIGHT, np.full(6, drive[0]))
    noise_m = np.random.default_rng(1).normal(0.0, NOISE_m, len(drive))
    return estimate_axis([recording(drive, clean_m + noise_m)], "x", Rig())


@cache
def law_fitted(law: str) -> AxisModel:
    field, reading_um = swept_um(law)
    return estimate_axis([recording(5.0 * field, 1e-6 * reading_um)], "x", Rig())


def test_a_thin_loop_gets_a_small_shape_and_is_as_near_as_the_noise_allows():
    model = thin_loop()
    assert len(model.hysteresis.plays.weight) - 1 <= 5
    assert len(model.hysteresis.dead_zones.weight) - 1 <= 3
    assert model.quality.held_out_rms_m < 1.05 * NOISE_m
    assert model.certificate.bound_m < 0.01 * model.quality.range_m
    least = model.hysteresis.plays.weight[0] * model.hysteresis.dead_zones.slope.min()
    most = model.hysteresis.plays.weight.sum() * model.hysteresis.dead_zones.slope.max()
    assert 11e-6 < least < most < 14e-6  # m/V; true are 12 and 12.6


@pytest.mark.parametrize("law", DISTINCT_LAWS)
def test_weights_are_a_positive_density_within_what_drive_and_data_allow(law):
    model = law_fitted(law)
    mean = model.quality.range_m / np.ptp(model.voltage_V)
    plays = model.hysteresis.plays
    assert (plays.weight >= 0.0).all()
    assert plays.weight[0] > 0.2 * mean
    assert plays.weight.sum() < 4.2 * mean
    assert plays.threshold[-1] < 0.5 * np.ptp(model.voltage_V)
    assert (model.hysteresis.dead_zones.slope > 0.0).all()


@pytest.mark.parametrize("law", DISTINCT_LAWS)
def test_the_choice_is_as_good_as_the_best_of_all_that_was_tried(law):
    quality = law_fitted(law).quality
    least_m = min(order.held_out_rms_m for order in quality.orders)
    assert quality.held_out_rms_m < 1.15 * least_m


@pytest.mark.usefixtures("one_order")
@pytest.mark.parametrize("small", [0.01, 0.4])
def test_a_recording_that_goes_further_than_all_others_cannot_blow_up(small):
    rng = np.random.default_rng(3)
    wide = np.tile(decaying(12, per_unit=20), 2)
    made = []
    for name, drive in (("wide", wide), ("small", small * wide), ("smaller", 0.5 * small * wide)):
        clean_m = play_sum(drive, LOOP_THRESHOLD, LOOP_WEIGHT * 2.0, np.full(6, drive[0]))
        noise_m = rng.normal(0.0, 5e-8, len(drive))
        made.append(recording(drive, clean_m + noise_m, f"{name}.csv"))
    quality = estimate_axis(made, "x", Rig(), orders=((2, 0), (8, 2))).quality
    assert quality.held_out_kind == "other recordings, second half of the widest"
    for order in quality.orders:
        assert order.held_out_rms_m < 0.02 * quality.range_m


@pytest.mark.usefixtures("one_order")
def test_a_recording_whose_parts_go_unequally_far_is_held_out_by_its_parts():
    """Only the part of the widest recording that goes furthest is trained on by half."""
    rng = np.random.default_rng(4)
    wide = decaying(12, per_unit=20)
    made = []
    for name, drive, breaks in (
        ("wide", np.concatenate([0.5 * wide, wide]), (len(wide),)),
        ("small", 0.6 * wide, ()),
        ("smaller", 0.5 * wide, ()),
    ):
        clean_m = play_sum(drive, LOOP_THRESHOLD, LOOP_WEIGHT * 2.0, np.full(6, drive[0]))
        noise_m = rng.normal(0.0, 5e-8, len(drive))
        made.append(replace(recording(drive, clean_m + noise_m, f"{name}.csv"), breaks=breaks))
    pieces = pieces_of(made, "x", scales_of(made, "x"), Rig())
    folds = [fold for fold in folds_of(pieces) if fold.halved]
    assert [(fold.halved, len(fold.testing)) for fold in folds] == [(1, 2)]
    assert len(folds[0].held_out_samples(0)) == pytest.approx(len(wide) / 2, abs=1)
    assert len(folds[0].held_out_samples(1)) == len(wide)
    quality = estimate_axis(made, "x", Rig(), orders=((2, 0), (8, 2))).quality
    assert quality.held_out_rms_m < 0.02 * quality.range_m
