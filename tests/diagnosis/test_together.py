"""Effects beside those that look alike: refined together, and not taken for what these leave."""

from types import SimpleNamespace

import pytest

import piezoid.diagnosis.shortlist as candidates
from piezoid.diagnosis.effects import gain_change, lag, slew_limit, thermal_drift
from piezoid.diagnosis.extended import SETTLED, extended
from piezoid.diagnosis.refinement import initial_guess, refined, refined_together
from piezoid.diagnosis.score_test import score_test
from piezoid_datasets.virtual_lab.campaign import draw_campaign

from .bench import recorded, view_of_recordings

NOISE = 1.0


def test_a_limit_and_the_lag_behind_it_are_found_together_and_not_one_after_the_other() -> None:
    sizes = {"slew_limit": 0.5, "lag": 0.3}
    campaign = draw_campaign(12, truth="preisach", plans=("sweep", "rates"), effects=sizes)
    numbers = {effect.name: effect.numbers for effect in campaign.answer.effects}
    clean = view_of_recordings(*recorded(campaign))
    found, view = [], clean
    for effect in (slew_limit.EFFECT, lag.EFFECT):
        seen = score_test(effect, view)
        one = initial_guess(effect, seen.trial, float(seen.cv.coefficient[0]))
        better, view = refined(one, clean, found)
        found.append(better)
    together, left = refined_together(found, clean, [])
    true_s = float(numbers["lag"]["time_constant_s"])
    apart_s, found_s = (pair[1].parameters["time_s"] for pair in (found, together))
    assert abs(found_s / true_s - 1.0) < 0.5 * abs(apart_s / true_s - 1.0)
    assert left.rms < 0.8 * view.rms
    assert left.rms == pytest.approx(extended(clean, together).rms, rel=SETTLED)


def is_rest(monkeypatch, before: float, after: float, gain: float, placebo: float | None) -> bool:
    """Say of a small drift beside a large change of gain whether it is what this leaves over."""
    alternative = SimpleNamespace(effect=gain_change.EFFECT)
    drift = SimpleNamespace(
        effect=thermal_drift.EFFECT,
        share=0.1,
        cv=SimpleNamespace(gain=gain),
        placebo=None if placebo is None else SimpleNamespace(gain=placebo),
        without=SimpleNamespace(rms=before),
        view=SimpleNamespace(rms=after, noise=NOISE),
    )
    monkeypatch.setattr(candidates, "extended", lambda *_: SimpleNamespace(rms=100.0))
    beside = candidates.SelectionContext(clean=None, selected=(alternative,), view=None)
    return candidates._left_over(drift, beside)


@pytest.mark.parametrize(
    ("before", "after", "rest"),
    [
        (1.6, 1.1, False),  # down to the noise
        (1.6, 1.4, True),
        (1.2, 1.02, True),  # hardly more than noise was there
    ],
)
def test_a_small_part_beside_a_rival_is_its_rest_unless_nothing_is_left_after(
    monkeypatch, before, after, rest
) -> None:
    assert is_rest(monkeypatch, before, after, 0.1, None) is rest


@pytest.mark.parametrize(
    ("gain", "placebo", "rest"),
    [
        (0.5, 0.1, False),  # most of the error, and five times what its placebo takes
        (0.5, 0.2, True),  # the placebo takes nearly as much
        (0.5, None, True),  # there is no placebo to tell by
        (0.3, 0.05, True),  # far above the placebo, but little of the error
    ],
)
def test_what_takes_most_of_the_error_and_far_more_than_its_twin_is_nobodys_rest(
    monkeypatch, gain, placebo, rest
) -> None:
    assert is_rest(monkeypatch, 10.0, 10.0 * (1.0 - gain), gain, placebo) is rest
