"""What a track remembers at its rows: from rows and turns alone, as from every sample."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.diagnosis.drive_history import CHUNK, History, states_at
from piezoid.diagnosis.initial_states import memory_after
from piezoid.diagnosis.nuisance import KEPT, MEMORY, NuisanceClass
from piezoid.diagnosis.nuisance_columns import (
    SHARED,
    THRESHOLD,
    rubbed,
    rubbing,
    shape_columns,
    states_under,
)
from piezoid.diagnosis.residual_view import (
    with_filtered_commands,
    with_free_memory,
    with_reversals,
    with_tracks,
)
from piezoid.diagnosis.segments import Track
from piezoid.operators.play import play_columns, thinned_drive

from .bench import healthy_view

RANDOM_HYPOTHESES = ((-1.0, 1.0), (0.0,), (1.0, 0.3, 0.7, -0.2))


def drive_with_holds() -> np.ndarray:
    """Return a drive on a grid that turns, rests, and goes on either way."""
    way = np.round(np.sin(np.linspace(0.0, 40.0, 20_000)) ** 3, 3)
    way[3_000:3_400] = way[3_000]
    return way


def track(drive: np.ndarray) -> Track:
    place = np.unique(np.random.default_rng(3).integers(1, len(drive), 400))
    return Track(
        name="sweep",
        rate_Hz=1000.0,
        command=drive,
        drive=drive,
        sensor_Hz=None,
        response=drive,
        other_drives={},
        rows=place,
        block=place * 15 // len(drive),
    )


def every_state(drive: np.ndarray, reversals: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    plays, _ = play_columns(drive, THRESHOLD, memory_after(drive, reversals))
    return plays, rubbing(drive, rubbed(drive, reversals))


@pytest.mark.parametrize("reversals", RANDOM_HYPOTHESES)
def test_states_at_rows_follow_from_rows_and_turns_alone(reversals) -> None:
    drive = drive_with_holds()
    place = track(drive).rows
    assert len(thinned_drive(drive, place)[0]) < len(place) + 60
    plays, friction = every_state(drive, reversals)
    found = states_at(drive, reversals, place)
    np.testing.assert_array_equal(found[0], plays[place])
    np.testing.assert_allclose(found[1], friction[place], atol=1e-11)


def test_the_bouc_wen_state_at_rows_is_that_of_every_sample() -> None:
    view = healthy_view()
    bouc_wen = (1.6, 0.6, 1.6, 0.1)
    bent = replace(view.nuisance, bouc_wen=bouc_wen)
    drive, place = drive_with_holds(), track(drive_with_holds()).rows
    every = states_under(bouc_wen, RANDOM_HYPOTHESES[0], drive)[place]
    np.testing.assert_allclose(bent.bent_at(RANDOM_HYPOTHESES[0], drive, place), every, atol=1e-4)


@pytest.mark.parametrize("reversals", RANDOM_HYPOTHESES)
def test_first_states_are_kept_until_a_play_moves(reversals) -> None:
    history = History(track=track(drive_with_holds()), reversals=reversals)
    drive, place = history.track.drive, history.track.rows
    first = memory_after(drive, reversals)
    states, _ = play_columns(drive, THRESHOLD, first)
    memory = np.logical_and.accumulate(states == first, axis=0)[place].astype(float)
    groups = np.array_split(np.arange(6, 18), 4)
    expected = np.column_stack([memory[:, group].mean(axis=1) for group in groups])
    np.testing.assert_array_equal(history.retained_memory(4), expected)
    assert 0.0 < expected.mean() < 1.0


def test_the_static_response_is_the_shape_of_all_states() -> None:
    nuisance = healthy_view().nuisance
    weight = np.random.default_rng(5).normal(size=SHARED)
    history = nuisance.histories[0]
    states = every_state(history.track.drive, history.reversals)
    expected = shape_columns(*states, history.track.drive) @ weight
    np.testing.assert_allclose(nuisance.static(0, weight), expected, rtol=1e-9, atol=1e-9)


def test_a_recording_too_long_to_keep_its_states_has_the_same_static_response() -> None:
    """Made chunk by chunk: the ends of two of them are compared, where memory is handed on."""
    weight = np.random.default_rng(5).normal(size=SHARED)
    drive = np.resize(drive_with_holds(), KEPT + 1)
    reversals = RANDOM_HYPOTHESES[2]
    long = NuisanceClass(histories=(History(track=track(drive), reversals=reversals),))
    head = drive[: 2 * CHUNK + 1000]
    expected = shape_columns(*every_state(head, reversals), head) @ weight
    static = long.static(0, weight)
    assert static.shape == drive.shape
    np.testing.assert_allclose(static[: len(head)], expected, rtol=1e-9, atol=1e-9)
    assert "states" not in vars(long.histories[0])


def test_states_are_known_again_where_drive_and_past_are_the_same() -> None:
    whole = healthy_view()
    view = with_filtered_commands(
        whole, lambda command, rate_Hz: command * (1.0 if rate_Hz < 1.0 else 0.5)
    )
    first = view.nuisance.histories[0]
    assert not np.array_equal(first.states[0], whole.nuisance.histories[0].states[0])
    mended = [replace(track, response=track.response + 1.0) for track in view.tracks]
    assert with_tracks(view, mended).nuisance.histories[0].states is first.states
    other = with_reversals(view, ((0.0,),) * len(view.tracks)).nuisance.histories[0]
    assert not np.array_equal(other.states[0], first.states[0])
    assert other.with_reversals((0.0,)) is other


def test_what_ends_a_drive_ended_it_before_the_recording_as_well() -> None:
    whole = healthy_view()
    limited = with_filtered_commands(whole, lambda command, _: np.minimum(command, 0.6))
    assert limited.nuisance.reversals[0] == (whole.nuisance.reversals[0][0], 0.6)
    assert max(float(track.drive.max()) for track in limited.tracks) == pytest.approx(0.6)
    assert with_filtered_commands(whole, lambda command, _: command) is whole


def test_branches_lead_from_turns_to_where_the_drive_is_away_from_them() -> None:
    drive = np.sin(np.linspace(0.0, 40.0, 20_000))
    reversals, there = track(drive).branches
    assert len(reversals) == 13
    assert (np.abs(drive[there] - drive[reversals]) > 0.03).all()
    assert (np.abs(drive[there - 1] - drive[reversals]) <= 0.03).all()


def test_what_is_poled_for_good_grows_only_where_the_drive_comes_for_the_first_time() -> None:
    way = np.array([-1.0, -0.2, 0.3, -0.4, 0.2, 0.8, -1.0, 1.0, -1.0, 1.0])
    drive = np.interp(np.linspace(0.0, 9.0, 9_001), np.arange(10.0), way)
    history = History(track=track(drive), reversals=RANDOM_HYPOTHESES[0])
    above, far_above, *below = history.poled().T
    at = drive[history.track.rows]
    first = history.track.rows < 2_000
    np.testing.assert_allclose(above[first], np.maximum(at[first], 0.0), atol=1e-12)
    assert (above[(history.track.rows > 2_000) & (history.track.rows < 4_150)] == 0.3).all()
    np.testing.assert_allclose(above[history.track.rows > 7_000], 1.0)
    np.testing.assert_allclose(far_above, np.maximum(above - 0.5, 0.0), atol=1e-12)
    assert not np.any(below)  # it began at its lowest
    assert (np.diff(above) >= 0.0).all()


def test_each_track_corrects_its_own_memory_and_no_other() -> None:
    free = with_free_memory(healthy_view()).nuisance
    columns = free.columns[:, list(free.memory_columns)]
    assert columns.shape[1] == MEMORY * len(free.tracks)
    for k in range(len(free.tracks)):
        own = columns[:, MEMORY * k : MEMORY * (k + 1)]
        rows = np.zeros(len(own), dtype=bool)
        rows[free.edges[k] : free.edges[k + 1]] = True
        assert np.any(own[rows])
        assert not np.any(own[~rows])
