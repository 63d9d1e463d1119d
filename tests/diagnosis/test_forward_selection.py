"""What a round of the search takes in, and which view faults are looked for in; with stand-ins."""

from types import SimpleNamespace

import pytest

from piezoid.diagnosis import forward_selection, search
from piezoid.diagnosis.effect import Fault
from piezoid.diagnosis.initial_state_search import AS_GOOD, NEARLY, shared_does_as_well
from piezoid.numerics.executor import SERIAL

CYCLED, HABIT, OWN = "cycled", "habit", "own"


def of_memory(reversals: str, rms: float, noise: float = 0.1) -> SimpleNamespace:
    return SimpleNamespace(
        rms=rms, noise=noise, nuisance=SimpleNamespace(reversals=reversals), tracks=()
    )


def taken(monkeypatch, *, own: float, tried=(), noise: float = 0.4) -> str | None:
    """Return what a round takes in that begins with an error of 1."""
    view = of_memory(CYCLED, 1.0, noise)
    stand_ins = {
        "refit_shortlist": lambda *_: list(tried),
        "with_shared_initial_state": lambda *_: of_memory(HABIT, own, noise),
        "with_own_initial_states": lambda *_: of_memory(OWN, own, noise),
        "with_best_bouc_wen": lambda *_: view,
        "with_reversals": lambda _, reversals: reversals,
        "with_free_memory": lambda reversals: reversals,
    }
    for name, what in stand_ins.items():
        monkeypatch.setattr(forward_selection, name, what)
    state = forward_selection.SelectionState(clean=CYCLED, selected=(), faults={}, screened={})
    next_state = forward_selection._next_state(state, view, SERIAL)
    return None if next_state is None else next_state.clean


@pytest.mark.parametrize(("own", "took"), [(0.5, OWN), (0.94, None)])
def test_other_initial_states_are_taken_in_where_they_leave_clearly_less(
    monkeypatch, own, took
) -> None:
    assert taken(monkeypatch, own=own) == took


def test_initial_states_that_are_known_are_not_searched_again(monkeypatch) -> None:
    """Nothing but them has changed: what the step before found of them still holds."""
    assert taken(monkeypatch, own=0.94) is None
    monkeypatch.delattr(forward_selection, "with_own_initial_states")
    known = of_memory(HABIT, 0.9), of_memory(OWN, 0.5)
    state = forward_selection.SelectionState(
        clean=CYCLED, selected=(), faults={}, screened={}, initial=known
    )
    following = forward_selection._next_state(state, of_memory(CYCLED, 1.0, 0.4), SERIAL)
    assert following is not None
    assert (following.clean, following.initial) == (OWN, known)


def test_a_habit_does_as_well_where_it_leaves_little_more() -> None:
    first, own = of_memory(CYCLED, 1.0), of_memory(OWN, 0.3, noise=0.2)
    close, state = (0.3 * (1.0 + s * (AS_GOOD - 1.0)) ** 0.5 for s in (0.9, 1.1))
    assert shared_does_as_well(of_memory(HABIT, close), own, first)
    assert not shared_does_as_well(of_memory(HABIT, state), own, first)
    much = (0.3**2 + 1.1 * NEARLY * (1.0 - 0.3**2)) ** 0.5
    assert not shared_does_as_well(of_memory(HABIT, much), own, first)


@pytest.mark.parametrize(
    ("shared", "own", "looked_at", "left_with"),
    [
        (0.40, 0.40, HABIT, HABIT),  # evident
        (0.40, 0.30, OWN, CYCLED),  # initial states fitted one by one do far better
        (
            0.60,
            0.60,
            OWN,
            CYCLED,
        ),  # no shared initial state is beyond doubt; faults are looked for beside initial states
        (0.98, 0.95, CYCLED, CYCLED),
    ],
)
def test_faults_are_looked_for_beside_the_memory_that_leaves_least(
    monkeypatch, shared, own, looked_at, left_with
) -> None:
    seen = []

    def fault(view) -> Fault | None:
        seen.append(view.nuisance.reversals)

    effect = SimpleNamespace(name="timestamp_fault", fault=fault)
    monkeypatch.setattr(search, "every_effect", lambda: (effect,))
    monkeypatch.setattr(search, "with_shared_initial_state", lambda *_: of_memory(HABIT, shared))
    monkeypatch.setattr(search, "with_own_initial_states", lambda *_: of_memory(OWN, own))
    monkeypatch.setattr(search, "with_shared_reversals", lambda _, reversals: reversals)
    clean, faults, _ = search.repaired(of_memory(CYCLED, 1.0), SERIAL)
    assert (seen, clean, faults) == ([looked_at], left_with, {})
