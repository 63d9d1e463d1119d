"""What a search may choose: poles where they were asked for, starts within their limits."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.design.feasibility import rounded_down
from piezoid.design.plant import Section, plant_from_chain
from piezoid.design.rst import observer_poles, sampled_poles, slow_and_fast
from piezoid.design.tuning import search_box
from piezoid.numerics.polynomial import roots_of
from tests.design.rig import RATE_Hz, lateral_chain


def closest(found, wanted):
    """How far the farthest of the wanted poles is from any that was found."""
    return max(np.abs(np.asarray(found) - pole).min() for pole in wanted)


def test_an_observer_has_the_poles_it_was_asked_for_and_the_fast_ones_a_little_faster():
    plant = plant_from_chain(lateral_chain())
    observer = Section(frequency_Hz=1200.0, damping=0.8)
    found = observer_poles(plant, observer, 800.0, (50.0,))
    slow, fast = slow_and_fast(plant)
    assert len(found) == len(slow) + len(fast) + 1 + 2
    assert closest(found, roots_of(sampled_poles(observer, RATE_Hz))) < 1e-12
    assert closest(found, [np.exp(-2 * np.pi * 800.0 / RATE_Hz)]) < 1e-12
    assert closest(found, fast**1.05) < 1e-12
    (turning,) = (pole for pole in found if 0.0 < np.angle(pole) < 2 * np.pi * 100.0 / RATE_Hz)
    assert np.abs(np.log(turning)) * RATE_Hz == pytest.approx(2 * np.pi * 50.0)


@pytest.mark.parametrize("slowest_Hz", [1.0, 630.0, 1e5])
def test_starts_are_multiples_of_the_slowest_pole_as_far_as_the_limits_let_them(slowest_Hz):
    chain = replace(lateral_chain(), sections=(Section(frequency_Hz=slowest_Hz),))
    box = search_box(plant_from_chain(chain), "placed")
    assert (box.lower < box.upper).all()
    for name, highest_Hz, multiples in (
        ("feedback_Hz", 2e3, (1.0, 1.0, 0.6)),
        ("observer_Hz", 4e3, (1.9, 1.2, 0.9)),
        ("disturbance_Hz", 4e3, (1.27, 0.5, 0.3)),
    ):
        k = box.names.index(name)
        assert box.upper[k] == highest_Hz
        expected = np.clip(slowest_Hz * np.array(multiples), box.lower[k], highest_Hz)
        assert box.starts[:, k] == pytest.approx(expected)


def test_a_search_starts_with_the_published_tuning_and_then_with_slower_observers():
    box = search_box(plant_from_chain(lateral_chain()), "placed")
    published = {
        **{"feedback_Hz": 630.0, "feedback_damping": 0.9},
        **{"observer_Hz": 1200.0, "observer_damping": 0.8, "disturbance_Hz": 800.0},
    }
    assert dict(zip(box.names, box.starts[0], strict=True)) == pytest.approx(published, rel=5e-3)
    for name in ("observer_Hz", "disturbance_Hz"):
        assert (np.diff(box.starts[:3, box.names.index(name)]) < 0.0).all()
    assert (box.lower < box.starts).all()  # room to either side
    assert (box.starts < box.upper).all()


def test_what_is_advised_has_three_digits_and_is_never_more():
    for exact, said in ((123.9, 123.0), (0.012349, 0.0123), (99.96, 99.9), (120.0, 120.0)):
        assert rounded_down(exact) == pytest.approx(said, rel=1e-12)
