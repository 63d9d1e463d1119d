"""What a track remembers at its rows: from rows and turns alone, as from every sample."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.diagnosis.drive_history import CHUNK, History, memory_after, states_on
from piezoid.diagnosis.nuisance import MAX_KEPT, NuisanceClass
from piezoid.diagnosis.nuisance_columns import (
    SHARED,
    THRESHOLD,
    bouc_wen_along,
    friction_along,
    initial_friction,
    write_shared_columns,
)
from piezoid.diagnosis.residual_view import with_filtered_commands
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
    return plays, friction_along(drive, initial_friction(drive, reversals))


@pytest.mark.parametrize("reversals", RANDOM_HYPOTHESES)
def test_states_at_rows_follow_from_rows_and_turns_alone(reversals) -> None:
    drive = drive_with_holds()
    place = track(drive).rows
    assert len(thinned_drive(drive, place)[0]) < len(place) + 60
    plays, friction = every_state(drive, reversals)
    found = states_on(*thinned_drive(drive, place), reversals)
    np.testing.assert_array_equal(found[0], plays[place])
    np.testing.assert_allclose(found[1], friction[place], atol=1e-11)


def test_the_bouc_wen_state_at_rows_is_that_of_every_sample() -> None:
    view = healthy_view()
    bouc_wen = (1.6, 0.6, 1.6, 0.1)
    bent = replace(view.nuisance, bouc_wen=bouc_wen)
    drive, place = drive_with_holds(), track(drive_with_holds()).rows
    every = bouc_wen_along(bouc_wen, RANDOM_HYPOTHESES[0], drive)[place]
    np.testing.assert_allclose(
        bent.bouc_wen_state_at(RANDOM_HYPOTHESES[0], drive, place), every, atol=1e-4
    )


def test_a_recording_too_long_to_keep_its_states_has_the_same_static_response() -> None:
    """Made chunk by chunk: the ends of two of them are compared, where memory is handed on."""
    weight = np.random.default_rng(5).normal(size=SHARED)
    drive = np.resize(drive_with_holds(), MAX_KEPT + 1)
    reversals = RANDOM_HYPOTHESES[2]
    long = NuisanceClass(histories=(History(track=track(drive), reversals=reversals),))
    head = drive[: 2 * CHUNK + 1000]
    columns = np.empty((len(head), SHARED), order="F")
    write_shared_columns(columns, *every_state(head, reversals), head)
    expected = columns @ weight
    static = long.static(0, weight)
    assert static.shape == drive.shape
    np.testing.assert_allclose(static[: len(head)], expected, rtol=1e-9, atol=1e-9)
    assert "states" not in vars(long.histories[0])


def test_what_ends_a_drive_ended_it_before_the_recording_as_well() -> None:
    whole = healthy_view()
    limited = with_filtered_commands(whole, lambda command, _: np.minimum(command, 0.6))
    assert limited.nuisance.reversals[0] == (whole.nuisance.reversals[0][0], 0.6)
    assert max(float(track.drive.max()) for track in limited.tracks) == pytest.approx(0.6)
    assert with_filtered_commands(whole, lambda command, _: command) is whole
