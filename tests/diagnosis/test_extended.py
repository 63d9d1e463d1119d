"""Effects at work: rounds that begin near end where rounds from afar do."""

from dataclasses import replace

import pytest

from piezoid.diagnosis import extended as engine
from piezoid.diagnosis.effects import lag, slew_limit
from piezoid.diagnosis.extended import SETTLED, SelectedEffect, driven, extended
from piezoid.diagnosis.refinement import refined

from .bench import healthy_view

LAG = SelectedEffect(effect=lag.EFFECT, parameters={"time_s": 2e-4})
LATER = SelectedEffect(effect=lag.EFFECT, parameters={"time_s": 3e-4})


def limited(speed: float) -> SelectedEffect:
    return SelectedEffect(effect=slew_limit.EFFECT, parameters={"limit_per_s": speed})


def rounds_of(monkeypatch, near) -> tuple[int, float]:
    """Return how many rounds a view takes, and the error it ends with."""
    made = []
    work = engine.offset_of
    monkeypatch.setattr(engine, "offset_of", lambda *a: made.append(1) or work(*a))
    view = extended(healthy_view(), [LATER], near)
    monkeypatch.undo()
    return len(made), view.rms


def test_rounds_that_begin_near_are_fewer_and_end_at_the_same_error(monkeypatch) -> None:
    near = extended(healthy_view(), [LAG])
    from_afar, error = rounds_of(monkeypatch, None)
    from_near, same = rounds_of(monkeypatch, near)
    assert from_near < from_afar
    assert same == pytest.approx(error, rel=2.0 * SETTLED)
    assert extended(healthy_view(), [LATER], near).guess is None


def test_the_drive_behind_a_limit_is_made_once_while_it_stays_the_same() -> None:
    clean = healthy_view()
    slow = driven(clean, [limited(30.0), LAG])
    assert driven(clean, [limited(30.0), LATER]) is slow
    faster = driven(clean, [limited(40.0)])
    assert faster is not slow
    assert driven(clean, [limited(30.0)]).rms == pytest.approx(slow.rms)
    assert driven(clean, [LAG]) is clean


def test_a_refinement_begins_nearer_to_where_all_rounds_end_than_rounds_from_afar_come() -> None:
    clean, slow = healthy_view(), SelectedEffect(effect=lag.EFFECT, parameters={"time_s": 2e-3})
    from_afar = extended(clean, [slow])
    settled = from_afar
    for _ in range(8):
        settled = extended(clean, [slow], settled)
    initial_guess = refined(slow, clean, [])[1]  # nothing of it is free
    assert abs(initial_guess.rms - settled.rms) < 0.5 * abs(from_afar.rms - settled.rms)


def test_a_drive_whose_room_another_thread_takes_at_once_is_returned_all_the_same() -> None:
    class TakenAtOnce(dict[object, object]):
        def __setitem__(self, *_: object) -> None:
            """Keep nothing."""

    clean = replace(healthy_view())
    vars(clean)["driven"] = TakenAtOnce()
    assert driven(clean, [limited(30.0)]).rms == driven(clean, [limited(30.0)]).rms
