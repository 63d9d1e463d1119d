"""Structure of healthy ceramics is in the nuisance class and is named as no effect."""

from dataclasses import replace

import numpy as np

from piezoid.diagnosis.blocked_regression import Null
from piezoid.diagnosis.candidate import structural_candidate
from piezoid.diagnosis.effects import non_congruence
from piezoid.diagnosis.nuisance_columns import CURVED_COUNT, SHARED
from piezoid.diagnosis.nuisance_search import with_best_bouc_wen
from piezoid.diagnosis.residual_view import View, with_bouc_wen, with_tracks
from piezoid.diagnosis.score_test import score_test
from piezoid.diagnosis.selection import search
from piezoid_datasets.virtual_lab.campaign import draw_campaign

from .bench import read_campaign, view_of_recordings

EVERY = 12  # rows: enough for a search of Bouc-Wen states


def healthy_stage(truth: str, seed: int) -> View:
    campaign = draw_campaign(seed, truth=truth, plans=("sweep", "check"))
    return view_of_recordings(*read_campaign(campaign))


def test_a_healthy_wall_pinning_stage_is_represented_down_to_the_noise():
    view = healthy_stage("wall_pinning", 3)
    straight = np.delete(view.null.all_columns, range(SHARED - CURVED_COUNT, SHARED), axis=1)
    assert view.rms < 1.1 * view.noise
    assert Null(columns=straight, response=view.response, block=view.block).rms > 1.14 * view.noise
    assert abs(float(score_test(non_congruence.EFFECT, view).cv.coefficient[0])) < 0.05


def test_one_of_many_products_with_the_drive_is_not_named():
    view = healthy_stage("bouc_wen", 17)
    test = score_test(non_congruence.EFFECT, view)
    assert test.cv.gain > non_congruence.EFFECT.minimum_gain
    assert abs(float(test.cv.coefficient[0])) > non_congruence.MIN_OPENING
    assert not search(view).causes


def test_a_curved_bouc_wen_state_explains_an_apparent_product():
    view = healthy_stage("bouc_wen", 20)
    structural = replace(non_congruence.EFFECT.structural, may_be_bouc_wen=False)
    _, unrestricted = structural_candidate(
        replace(non_congruence.EFFECT, structural=structural), view
    )
    _, alternative = structural_candidate(non_congruence.EFFECT, view)
    assert unrestricted.is_significant
    assert not alternative.is_significant
    assert abs(alternative.cv.gain) < 0.1 * unrestricted.cv.gain


def test_a_bouc_wen_stage_with_a_curved_scale_needs_a_curved_state():
    curved = with_best_bouc_wen(healthy_stage("bouc_wen", 5))
    *law, bend = curved.nuisance.bouc_wen
    assert abs(bend) > 0.1
    assert curved.rms < 1.1 * curved.noise
    assert with_bouc_wen(curved, (*law, 0.0)).rms > 1.2 * curved.noise


def test_a_product_that_no_bouc_wen_state_explains_may_be_named():
    """Loops open with bias by 3 % of the stroke; a Bouc-Wen state leaves a larger residual."""
    campaign = draw_campaign(
        1, truth="jiles_atherton", effects={"non_congruence": 3.0}, plans=("sweep", "check")
    )
    view = view_of_recordings(*read_campaign(campaign))
    thinned_tracks = [
        replace(t, rows=t.rows[::EVERY], block=t.block[::EVERY]) for t in view.tracks
    ]
    view = with_tracks(view, thinned_tracks)
    test, structure = structural_candidate(non_congruence.EFFECT, view)
    assert structure.view is view
    assert structure.may_be_named
    assert test.cv.gain > 0.2
