"""Which effects of a round are refitted: those whose tangents tell, and others where need be."""

from dataclasses import replace

import pytest

from piezoid.diagnosis.effects import effect_named
from piezoid.diagnosis.forward_selection import LEAST_GAIN, SelectionContext, refit_shortlist
from piezoid.diagnosis.score_test import ScoreTest, score_test
from piezoid.numerics.executor import SERIAL

from .played import cycled, forgotten, view_after

PERIODIC, GAIN = "sensor_periodic_error", "gain_change"  # what a memory like this looks like most
SMALL, TINY = ("rate_dependence", "delay"), "slew_limit"


def seen(*names: str) -> dict[str, ScoreTest]:
    """Screen recordings of which the second began from turns that nobody knows."""
    view = view_after(cycled, forgotten, cycled)
    return {name: score_test(effect_named(name), view) for name in names}


def refitted(*screenings: ScoreTest) -> dict[str, bool]:
    """Return what is refitted, in its order, and whether it is evidence then."""
    view = view_after(cycled, forgotten, cycled)
    beside = SelectionContext(clean=view, selected=(), view=view)
    tried = refit_shortlist(screenings, beside, SERIAL)
    return {one.effect.name: one.is_significant for one in tried}


def test_what_tangents_tell_is_large_small_and_tiny_here() -> None:
    gain = {name: one.total_gain for name, one in seen(PERIODIC, GAIN, *SMALL, TINY).items()}
    assert gain[GAIN] > gain[PERIODIC] > 0.3 * gain[GAIN]
    assert all(LEAST_GAIN < gain[name] < 0.1 * gain[GAIN] for name in SMALL)
    assert gain[TINY] < LEAST_GAIN


def test_small_ones_are_not_refitted_where_a_large_one_is_evidence() -> None:
    found = seen(PERIODIC, GAIN, *SMALL)
    assert refitted(*found.values()) == {PERIODIC: True, GAIN: False}


def test_small_ones_are_refitted_where_no_large_one_is_evidence() -> None:
    """Tiny ones are not, nor what physics does not allow, however much it seems to bring."""
    found = seen(GAIN, *SMALL, TINY, PERIODIC)
    found[PERIODIC] = replace(found[PERIODIC], physical=False)
    assert list(refitted(*found.values())) == [GAIN, *SMALL]


@pytest.mark.parametrize(("times", "asked"), [(0.8, False), (1.2, True)])
def test_what_its_placebo_does_better_is_not_refitted(times, asked) -> None:
    (found,) = seen("thermal_drift").values()
    assert not found.trial.free
    assert found.placebo is not None
    other = replace(found, cv=replace(found.cv, gain=times * found.placebo.gain))
    assert ("thermal_drift" in refitted(other)) is asked
