"""What a round of the search takes in, and beside which initial states faults are looked for."""

import numpy as np
import pytest

from piezoid.diagnosis.initial_state_search import is_shared_state_as_good
from piezoid.diagnosis.selection import repair_faults
from piezoid.diagnosis.signals import with_displacement
from piezoid.numerics.executor import SERIAL
from piezoid.records.lab import Lab

from .bench import view_of_recordings
from .played import (
    NOISE,
    at_rest,
    cycled,
    cycled_the_other_way,
    forgotten,
    recordings_after,
    view_after,
)


@pytest.mark.parametrize(
    ("before", "is_shared"),
    [
        ((at_rest,) * 3, True),
        ((cycled_the_other_way,) * 3, True),
        ((cycled, forgotten, cycled), False),  # no shared one is beyond doubt
        ((forgotten,) * 3, False),  # nor this, and beside cycled drives a clock seems to slip
        ((cycled,) * 3, False),
    ],
    ids=["at rest", "the other way", "one forgotten", "all forgotten", "cycled"],
)
def test_faults_are_looked_for_beside_the_memory_that_leaves_least(before, is_shared) -> None:
    """Nothing is wrong with the data; only a shared initial state that is evident stays."""
    view = view_after(*before)
    clean, faults, known = repair_faults(view, SERIAL)
    assert faults == {}
    assert known is not None
    shared = known[0].nuisance.reversals
    assert clean.nuisance.reversals == (shared if is_shared else view.nuisance.reversals)
    assert not clean.nuisance.free


def test_a_shared_initial_state_is_not_evident_where_it_leaves_most_of_the_error() -> None:
    """Six times the noise hides how much better it does than drives that were cycled."""
    chance, noisy = np.random.default_rng(5), []
    for one in recordings_after(*(cycled_the_other_way,) * 3):
        moved_m = one.displacement_m()
        noise_m = 6.0 * NOISE * float(np.ptp(moved_m)) * chance.normal(size=one.samples)
        noisy.append(with_displacement(one, moved_m + noise_m))
    view = view_of_recordings(tuple(noisy), Lab())
    clean, _, known = repair_faults(view, SERIAL)
    assert known is not None
    shared, own = known
    assert 0.5 * view.rms < shared.rms < 0.9 * view.rms
    assert is_shared_state_as_good(shared, own, view)
    assert clean.nuisance.reversals == view.nuisance.reversals
