"""What ceramics do by themselves is in the nuisance class, and is named as no effect."""

from dataclasses import replace

import numpy as np

from piezoid.diagnosis.blocked_regression import Null
from piezoid.diagnosis.bouc_wen_search import with_best_bouc_wen
from piezoid.diagnosis.candidate import structural_candidate
from piezoid.diagnosis.effects import non_congruence
from piezoid.diagnosis.nuisance_columns import CURVED_COUNT, SHARED
from piezoid.diagnosis.residual_view import View, with_bouc_wen, with_tracks
from piezoid.diagnosis.score_test import score_test
from piezoid.diagnosis.selection import search
from piezoid_datasets.virtual_lab.campaign import draw_campaign

from .bench import recorded, view_of_recordings

EVERY = 12  # rows: a search for the best of all Bouc-Wen states needs no more


def sound_stage(truth: str, seed: int) -> View:
    campaign = draw_campaign(seed, truth=truth, plans=("sweep", "check"))
    return view_of_recordings(*recorded(campaign))


def test_walls_drawn_to_a_curved_rest_are_followed_to_the_noise_and_open_by_nothing():
    view = sound_stage("wall_pinning", 3)
    straight = np.delete(view.null.all_columns, range(SHARED - CURVED_COUNT, SHARED), axis=1)
    assert view.rms < 1.1 * view.noise
    assert Null(columns=straight, response=view.response, block=view.block).rms > 1.14 * view.noise
    assert abs(float(score_test(non_congruence.EFFECT, view).cv.coefficient[0])) < 0.05


def test_one_of_many_products_with_the_drive_that_a_ceramic_misses_is_not_named():
    view = sound_stage("bouc_wen", 17)
    found = score_test(non_congruence.EFFECT, view)
    assert found.cv.gain > non_congruence.EFFECT.minimum_gain
    assert abs(float(found.cv.coefficient[0])) > non_congruence.MIN_OPENING
    assert not search(view).causes


def test_a_bent_bouc_wen_state_does_what_a_product_seemed_to_do():
    view = sound_stage("bouc_wen", 20)
    never = replace(non_congruence.EFFECT.structural, may_be_bouc_wen=False)
    _, alone = structural_candidate(replace(non_congruence.EFFECT, structural=never), view)
    _, beside = structural_candidate(non_congruence.EFFECT, view)
    assert alone.is_significant
    assert not beside.is_significant
    assert abs(beside.cv.gain) < 0.1 * alone.cv.gain


def test_a_bouc_wen_ceramic_behind_a_bent_scale_is_followed_by_a_bent_state_only():
    bent = with_best_bouc_wen(sound_stage("bouc_wen", 5))
    *law, bend = bent.nuisance.bouc_wen
    assert abs(bend) > 0.1
    assert bent.rms < 1.1 * bent.noise
    assert with_bouc_wen(bent, (*law, 0.0)).rms > 1.2 * bent.noise


def test_a_part_that_no_bouc_wen_state_does_as_well_is_judged_without_one():
    """Loops that open with bias by 3 % of the stroke; beside a state that leaves more, nothing."""
    campaign = draw_campaign(
        1, truth="jiles_atherton", effects={"non_congruence": 3.0}, plans=("sweep", "check")
    )
    view = view_of_recordings(*recorded(campaign))
    few = [replace(t, rows=t.rows[::EVERY], block=t.block[::EVERY]) for t in view.tracks]
    view = with_tracks(view, few)
    found, structure = structural_candidate(non_congruence.EFFECT, view)
    assert structure.view is view
    assert structure.may_be_named
    assert found.cv.gain > 0.2
