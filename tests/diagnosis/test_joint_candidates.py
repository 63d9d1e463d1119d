"""Two effects that stand for each other are found at once, or not at all."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from piezoid.diagnosis import joint_candidates
from piezoid.diagnosis.candidate import Candidate, judged
from piezoid.diagnosis.effect import Effect
from piezoid.diagnosis.effects import (
    creep,
    delay,
    lag,
    non_congruence,
    rate_dependence,
    resonance,
)
from piezoid.diagnosis.refinement import initial_guess, refined
from piezoid.diagnosis.score_test import score_test
from piezoid.diagnosis.shortlist import SelectionContext
from piezoid.diagnosis.view import View
from piezoid_datasets.virtual_lab.campaign import draw_campaign

from .bench import recorded, view_of_recordings


def tried(effect, *, left: float, gain: float = 0.6, z: float = 10.0, sound: bool = False):
    return SimpleNamespace(
        effect=effect,
        selected=effect.name,
        view=SimpleNamespace(rms=left),
        cv=SimpleNamespace(gain=gain, z=z),
        physical=sound,
    )


def taken(monkeypatch, *tried_ones, lone: str = "") -> tuple[str, ...]:
    """Return the pair that is taken where all but one effect are needed beside any other."""

    def pair(one, other, *_) -> tuple[tuple[str, str], SimpleNamespace] | None:
        both, left = (one[0], other[0]), one[1].rms * other[1].rms
        return None if lone in both else (both, SimpleNamespace(rms=left))

    monkeypatch.setattr(joint_candidates, "_pair", pair)
    return joint_candidates.pair_of(
        tried_ones, SelectionContext(clean=None, selected=(), view=None)
    )


LAG = tried(lag.EFFECT, left=0.4)
DELAY = tried(delay.EFFECT, left=0.3)
RATE = tried(rate_dependence.EFFECT, left=0.2)


def test_of_the_pairs_in_which_both_are_needed_the_one_that_leaves_least_is_taken(
    monkeypatch,
) -> None:
    assert taken(monkeypatch, LAG, RATE) == ("rate_dependence", "lag")
    assert taken(monkeypatch, LAG, DELAY, RATE) == ("rate_dependence", "delay")
    assert taken(monkeypatch, LAG, DELAY, RATE, lone="delay") == ("rate_dependence", "lag")
    assert taken(monkeypatch, LAG, RATE, lone="lag") == ()
    assert taken(monkeypatch) == ()


@pytest.mark.parametrize("change", [{"gain": 0.2}, {"z": 5.0}, {"sound": True}])
def test_no_pair_is_looked_for_where_the_best_takes_little_is_unsure_or_possible_alone(
    monkeypatch, change
) -> None:
    assert taken(monkeypatch, LAG, tried(rate_dependence.EFFECT, left=0.2, **change)) == ()


@pytest.mark.parametrize("other", [creep.EFFECT, resonance.EFFECT, non_congruence.EFFECT])
def test_what_looks_like_something_else_or_rings_or_is_structure_is_no_partner(
    monkeypatch, other
) -> None:
    assert taken(monkeypatch, tried(other, left=0.4), RATE) == ()


def in_place(monkeypatch, *selected, left: float = 1.2, wide: str = "rate_dependence"):
    """Return what is selected after one of them may be two; only one effect is wide."""

    def alone(effect, *_) -> tuple[str, SimpleNamespace] | None:
        return (effect.name, SimpleNamespace(rms=1.5)) if effect.name == wide else None

    def pair(one, other, *_) -> tuple[tuple[object, str], SimpleNamespace]:
        return (one[0], other[0]), SimpleNamespace(rms=0.9)

    monkeypatch.setattr(joint_candidates, "extended", lambda *_: None)
    monkeypatch.setattr(joint_candidates, "_alone", alone)
    monkeypatch.setattr(joint_candidates, "_pair", pair)
    view = SimpleNamespace(rms=left, noise=1.0)
    return joint_candidates.pair_in_place(
        SelectionContext(clean=None, selected=selected, view=view)
    )


def at_work(effect, *, struck: bool = False) -> SimpleNamespace:
    return SimpleNamespace(effect=effect, free={"time_s": 1.8}, from_jumps=struck)


def test_one_that_was_accepted_for_both_keeps_its_place_beside_the_other(monkeypatch) -> None:
    late, slow = at_work(lag.EFFECT), at_work(creep.EFFECT)
    assert in_place(monkeypatch, late, slow) == (slow, late, "rate_dependence")


def test_nothing_is_put_beside_what_leaves_the_noise_was_struck_or_has_its_other_half_already(
    monkeypatch,
) -> None:
    late, rate = at_work(lag.EFFECT), at_work(rate_dependence.EFFECT)
    assert in_place(monkeypatch, late, left=1.05) == ()
    assert in_place(monkeypatch, at_work(lag.EFFECT, struck=True)) == ()
    assert in_place(monkeypatch, late, rate) == ()
    assert in_place(monkeypatch, late, wide="resonance") == ()


@pytest.mark.parametrize(
    ("speaks", "z", "gain", "needed"),
    [
        (True, 5.0, 0.06, True),
        (False, 5.0, 0.06, False),
        (True, 3.9, 0.06, False),
        (True, 5.0, 0.02, False),
    ],
)
def test_one_of_two_is_needed_where_it_speaks_and_the_other_alone_surely_leaves_more(
    monkeypatch, speaks, z, gain, needed
) -> None:
    monkeypatch.setattr(joint_candidates, "score_test", lambda *_: "seen")
    monkeypatch.setattr(
        joint_candidates, "judged", lambda *_, **__: SimpleNamespace(is_significant=speaks)
    )
    monkeypatch.setattr(joint_candidates, "compared", lambda *_: SimpleNamespace(z=z, gain=gain))
    one, view = SimpleNamespace(effect=lag.EFFECT), SimpleNamespace(null=None, rms=1.0, noise=0.1)
    assert joint_candidates._is_needed(one, view, view, view) is needed


def test_a_lag_and_a_rate_dependence_are_a_pair_and_a_lag_alone_is_none() -> None:
    for sizes, found in (({"rate_dependence": 0.4, "lag": 0.3}, True), ({"lag": 0.3}, False)):
        clean = campaign_of(12, ("sweep", "rates"), sizes)
        both = [alone(effect, clean) for effect in (rate_dependence.EFFECT, lag.EFFECT)]
        pair = joint_candidates.pair_of(
            both, SelectionContext(clean=clean, selected=(), view=clean)
        )
        assert [one.effect.name for one in pair] == (list(sizes) if found else [])


def campaign_of(seed: int, plans: tuple[str, ...], effects: dict[str, float]) -> View:
    campaign = draw_campaign(seed, truth="preisach", plans=plans, effects=effects)
    return view_of_recordings(*recorded(campaign))


def alone(effect: Effect, clean: View) -> Candidate:
    """Return an effect that was refitted alone, and that physics is said not to allow there."""
    seen = score_test(effect, clean)
    one, view = refined(
        initial_guess(effect, seen.trial, float(seen.cv.coefficient[0])), clean, []
    )
    return replace(judged(one, view, clean, seen=seen), physical=False)
