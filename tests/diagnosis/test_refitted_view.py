"""Effects at work: rounds that begin near end where rounds from afar do."""

import numpy as np
import pytest

from piezoid.diagnosis.effect import EffectEstimate, SearchScaling
from piezoid.diagnosis.effects import amplifier_saturation, lag, slew_limit
from piezoid.diagnosis.refinement import initial_guess, refine, with_step
from piezoid.diagnosis.refitted_view import SelectedEffect, with_effects, with_filtered_drive

from .bench import healthy_view

LAG = SelectedEffect(effect=lag.EFFECT, parameters={"time_s": 2e-4})


def limited(speed: float) -> SelectedEffect:
    return SelectedEffect(effect=slew_limit.EFFECT, parameters={"limit_per_s": speed})


def test_the_drive_behind_a_limit_is_made_once_while_it_stays_the_same() -> None:
    clean = healthy_view()
    slow = with_filtered_drive(clean, [limited(30.0), LAG])
    assert with_filtered_drive(clean, [limited(30.0)]) is slow
    faster = with_filtered_drive(clean, [limited(40.0)])
    assert faster is not slow
    assert with_filtered_drive(clean, [limited(30.0)]).rms == pytest.approx(slow.rms)
    assert with_filtered_drive(clean, [LAG]) is clean


def test_a_refinement_begins_nearer_to_where_all_rounds_end_than_rounds_from_afar_come() -> None:
    clean, slow = healthy_view(), SelectedEffect(effect=lag.EFFECT, parameters={"time_s": 2e-3})
    from_afar = with_effects(clean, [slow])
    settled = from_afar
    for _ in range(8):
        settled = with_effects(clean, [slow], settled)
    initial_guess = refine(slow, clean, [])[1]  # nothing of it is free
    assert abs(initial_guess.rms - settled.rms) < 0.5 * abs(from_afar.rms - settled.rms)


def test_no_limit_that_is_tried_stops_the_drive_altogether() -> None:
    """Both ends at once would meet in the middle, and steps go on from there."""
    view = healthy_view()
    width = max(float(np.ptp(track.command)) for track in view.tracks)
    effect = amplifier_saturation.EFFECT
    assert effect.trials is not None
    assert effect.drive_filter is not None
    trials = effect.trials(view)
    assert any("low" in trial.parameters for trial in trials)
    for trial in trials:
        one = initial_guess(effect, trial, 1.0)
        for name in one.free:
            for part in (-60.0, -6.0, 0.0, 6.0, 60.0):
                limits = with_step(one, name, part).parameters
                left = [effect.drive_filter(t.command, t.rate_Hz, limits) for t in view.tracks]
                assert max(map(np.ptp, left)) > 0.04 * width


def test_a_limit_that_no_drive_came_to_is_no_part_of_the_model() -> None:
    setting = SearchScaling(
        voltage_V=5.0, voltage_offset_V=5.0, half_stroke_m=1e-5, pieces=(), recordings=()
    )
    extend = amplifier_saturation.EFFECT.extend
    assert extend is not None

    def parts(**limits: float) -> list[tuple[float | None, float | None]]:
        found = EffectEstimate(
            effect="amplifier_saturation", parameters=limits, coefficient=np.ones(1)
        )
        return [(part.low_V, part.high_V) for part in extend(found, setting)]  # type: ignore[attr-defined]

    assert parts(high=0.8, low=-1.005) == [(None, 9.0)]
    assert parts(high=1.01, low=-0.6) == [(2.0, None)]
    assert parts(high=0.8, low=-0.6) == [(2.0, 9.0)]
    assert parts(high=1.01) == []
