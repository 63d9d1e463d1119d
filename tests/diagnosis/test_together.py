"""Effects beside those that look alike: refined together, and not taken for what these leave."""

import pytest

from piezoid.diagnosis.effects import lag, slew_limit
from piezoid.diagnosis.refinement import initial_guess, refine, refine_together
from piezoid.diagnosis.refitted_view import SETTLED, with_effects
from piezoid.diagnosis.score_test import score_test
from piezoid_datasets.virtual_lab.campaign import draw_campaign

from .bench import recorded, view_of_recordings


def test_a_limit_and_the_lag_behind_it_are_found_together_and_not_one_after_the_other() -> None:
    sizes = {"slew_limit": 0.5, "lag": 0.3}
    campaign = draw_campaign(12, truth="preisach", plans=("sweep", "rates"), effects=sizes)
    numbers = {effect.name: effect.numbers for effect in campaign.answer.effects}
    clean = view_of_recordings(*recorded(campaign))
    found, view = [], clean
    for effect in (slew_limit.EFFECT, lag.EFFECT):
        seen = score_test(effect, view)
        one = initial_guess(effect, seen.trial, float(seen.cv.coefficient[0]))
        better, view = refine(one, clean, found)
        found.append(better)
    together, left = refine_together(found, clean, [])
    true_s = float(numbers["lag"]["time_constant_s"])
    apart_s, found_s = (pair[1].parameters["time_s"] for pair in (found, together))
    assert abs(found_s / true_s - 1.0) < 0.5 * abs(apart_s / true_s - 1.0)
    assert left.rms < 0.8 * view.rms
    assert left.rms == pytest.approx(with_effects(clean, together).rms, rel=SETTLED)
