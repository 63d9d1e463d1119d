"""What a search may choose: poles where they were asked for, starts within their limits."""

import numpy as np
import pytest

from piezoid.design.chain import Section, plant_from_chain
from piezoid.design.feasibility import rounded_down
from piezoid.design.rst import PoleChoice, observer_poles, sampled_poles, slow_and_fast
from piezoid.design.tuning import _frequency, _placed_choices
from piezoid.numerics.polynomial import roots_of
from tests.design.rig import RATE_Hz, lateral_chain


def closest(found, wanted):
    """How far the farthest of the wanted poles is from any that was found."""
    return max(np.abs(np.asarray(found) - pole).min() for pole in wanted)


def test_an_observer_has_the_poles_it_was_asked_for_and_the_fast_ones_a_little_faster():
    plant = plant_from_chain(lateral_chain())
    choice = PoleChoice(
        feedback=Section(frequency_Hz=630.0, damping=0.9),
        observer=Section(frequency_Hz=1200.0, damping=0.8),
        disturbance_Hz=800.0,
    )
    found = observer_poles(plant, choice, (50.0,))
    slow, fast = slow_and_fast(plant)
    assert len(found) == len(slow) + len(fast) + 1 + 2
    assert closest(found, roots_of(sampled_poles(choice.observer, RATE_Hz))) < 1e-12
    assert closest(found, [np.exp(-2 * np.pi * 800.0 / RATE_Hz)]) < 1e-12
    assert closest(found, fast**1.05) < 1e-12
    (turning,) = (pole for pole in found if 0.0 < np.angle(pole) < 2 * np.pi * 100.0 / RATE_Hz)
    assert np.abs(np.log(turning)) * RATE_Hz == pytest.approx(2 * np.pi * 50.0)


@pytest.mark.parametrize("slowest_Hz", [1.0, 630.0, 1e5])
def test_starts_are_multiples_of_the_slowest_pole_as_far_as_the_limits_let_them(slowest_Hz):
    choice = _frequency("f", slowest_Hz, 2e3, (1.9, 0.5, 1e-3))
    assert 0.0 < choice.lowest < choice.highest == 2e3
    expected = np.clip(slowest_Hz * np.array([1.9, 0.5, 1e-3]), choice.lowest, choice.highest)
    assert choice.starts == pytest.approx(expected)


def test_a_search_starts_with_the_published_tuning_and_then_with_slower_observers():
    choices = {
        choice.name: choice for choice in _placed_choices(plant_from_chain(lateral_chain()))
    }
    published = {
        **{"feedback_Hz": 630.0, "feedback_damping": 0.9},
        **{"observer_Hz": 1200.0, "observer_damping": 0.8, "disturbance_Hz": 800.0},
    }
    first = {name: choice.starts[0] for name, choice in choices.items()}
    assert first == pytest.approx(published, rel=5e-3)
    for name in ("observer_Hz", "disturbance_Hz"):
        assert (np.diff(choices[name].starts[:3]) < 0.0).all()
    assert all(
        choice.lowest < start < choice.highest  # room to either side
        for choice in choices.values()
        for start in choice.starts
    )


def test_what_is_advised_has_three_digits_and_is_never_more():
    for exact, said in ((123.9, 123.0), (0.012349, 0.0123), (99.96, 99.9), (120.0, 120.0)):
        assert rounded_down(exact) == pytest.approx(said, rel=1e-12)
