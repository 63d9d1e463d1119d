"""A sharp mode is found with a periodic drive, although plays absorb part of its ringing."""

import numpy as np
import pytest

from piezoid.diagnosis.candidate import evaluate
from piezoid.diagnosis.effects import delay, resonance
from piezoid.diagnosis.refinement import (
    SelectedEffect,
    initial_guess,
    parameter_tangents,
    refine,
    with_effects,
    with_step,
)
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.score_test import score_test
from piezoid.diagnosis.selection import search
from piezoid.diagnosis.signals import mode
from piezoid.numerics.arrays import Array
from piezoid.operators.filters import later

from .bench import view_of_recordings, with_fewer_rows
from .play_recordings import RINGING_NOISE as NOISE
from .play_recordings import (
    HALF_STROKE_m,
    cycled,
    drive_recording,
    memory_after,
    play_response,
    ringing,
)

FREQUENCY_Hz, QUALITY = 300.0, 38.0
FAST_Hz = 20.0  # of the triangle: its 15th harmonic lies on the mode


def triangle(phase: Array) -> Array:
    return 2 / np.pi * np.arcsin(np.sin(2 * np.pi * (phase - 0.25)))


def ringing_response(response: Array, rate_Hz: float) -> Array:
    return mode(response, FREQUENCY_Hz, QUALITY, rate_Hz)


def ringing_view() -> View:
    """Record two slow drives and a fast triangle; all motion passes through the mode."""
    count = np.arange(3000)
    drives = {
        ("loops", 500.0): np.linspace(1.0, 0.3, 3000) * triangle(1.1 * count / 500.0),
        ("waves", 500.0): np.linspace(0.2, 1.0, 3000) * np.sin(2 * np.pi * 0.7 * count / 500.0),
        ("fast", 5000.0): 0.8 * triangle(FAST_Hz * count / 5000.0),
    }
    return view_of_recordings(ringing(drives, ringing_response, np.random.default_rng(1)))


def test_a_sharp_mode_on_a_harmonic_of_the_drive_is_identified():
    view = ringing_view()
    test = score_test(resonance.EFFECT, view)
    # closer than the spacing of the grid
    assert test.trial.parameters["frequency_Hz"] == pytest.approx(FREQUENCY_Hz, rel=0.5 / QUALITY)
    start = initial_guess(resonance.EFFECT, test.trial, float(test.cv.coefficient[0]))
    (selected,), refitted = refine([start], view)
    cause = evaluate(selected, refitted, view, test=test)
    assert cause.physical
    assert cause.is_significant
    assert selected.parameters["frequency_Hz"] == pytest.approx(FREQUENCY_Hz, rel=0.005)
    assert selected.parameters["quality"] == pytest.approx(QUALITY, rel=0.3)
    assert refitted.rms < 0.1 * view.rms


def noisy_drive(rng: np.random.Generator, rms: float) -> Array:
    count, lines_Hz = np.arange(12_000), np.arange(20.0, 400.0, 1.25)[:, None]
    angles = 2 * np.pi * rng.random(lines_Hz.shape)
    noisy = np.cos(2 * np.pi * lines_Hz * count / 10_000.0 + angles).sum(axis=0)
    return np.asarray(rms * noisy / np.std(noisy))


DELAY_s = 3.7e-4
DAMPED = {"frequency_Hz": 340.0, "quality": 5.0}
SHARE = 0.4  # of the motion, through the mode


def delayed_view(share: float = SHARE, delay_s: float = DELAY_s) -> View:
    """Record slow loops and a noisy drive; a share passes through a mode, all through a delay."""
    rng, count = np.random.default_rng(8), np.arange(12_000)

    def response(static: Array, rate_Hz: float) -> Array:
        through_mode = mode(static, DAMPED["frequency_Hz"], DAMPED["quality"], rate_Hz)
        return later(static + share * (through_mode - static), delay_s * rate_Hz)

    drives = {
        ("loops", 1000.0): 0.9 * triangle(0.27 * count[:8000] / 1000.0),
        ("noise", 10_000.0): noisy_drive(rng, 0.1),
    }
    return with_fewer_rows(view_of_recordings(ringing(drives, response, rng)), 3)


def damped_mode(frequency_Hz: float) -> SelectedEffect:
    return SelectedEffect(
        effect=resonance.EFFECT,
        parameters={**DAMPED, "frequency_Hz": frequency_Hz},
        free={"frequency_Hz": 1.06, "quality": 1.6},
    )


def delayed_by(time_s: float) -> SelectedEffect:
    return SelectedEffect(
        effect=delay.EFFECT, parameters={"delay_s": time_s}, free={"delay_s": 1.5}
    )


def test_a_delay_acts_on_a_mode_and_the_fit_does_not_depend_on_its_start():
    clean, true = delayed_view(), [damped_mode(340.0), delayed_by(DELAY_s)]
    alone = with_effects(clean, [damped_mode(355.0)])
    fresh, continued = with_effects(clean, true), with_effects(clean, true, alone)
    ideal_rms = delayed_view(share=0.0, delay_s=0.0).rms
    assert fresh.rms == pytest.approx(ideal_rms, rel=0.05)
    assert continued.rms == pytest.approx(fresh.rms, rel=0.01)
    assert fresh.path.shares["resonance"] == pytest.approx(SHARE, rel=0.02)
    assert alone.rms > 3.0 * ideal_rms


def test_a_mode_and_a_delay_are_refined_together():
    clean = delayed_view()
    (found_mode, found_delay), view = refine([damped_mode(320.0), delayed_by(2e-4)], clean)
    assert found_mode.parameters["frequency_Hz"] == pytest.approx(340.0, rel=0.01)
    assert found_delay.parameters["delay_s"] == pytest.approx(DELAY_s, rel=0.02)
    assert view.rms < 1.02 * with_effects(clean, [damped_mode(340.0), delayed_by(DELAY_s)]).rms


def test_tangents_are_the_changes_of_the_residual_by_small_steps():
    clean, effects = delayed_view(), [damped_mode(345.0), delayed_by(3e-4)]
    view = with_effects(clean, effects)
    tangents = parameter_tangents(view, clean, effects)
    for k, (of_effect, name) in enumerate(((0, "frequency_Hz"), (0, "quality"), (1, "delay_s"))):
        residuals = []
        for step in (-0.02, 0.02):
            stepped = list(effects)
            stepped[of_effect] = with_step(effects[of_effect], name, step)
            residuals.append(with_effects(clean, stepped, view).null.residual)
        change = (residuals[0] - residuals[1]) / 0.04
        similarity = change @ tangents[:, k] / np.linalg.norm(change)
        assert similarity > 0.9 * np.linalg.norm(tangents[:, k])


def test_ringing_after_steps_between_samples_leaves_no_residual():
    """Instants of steps at 700 Hz are unknown; the noise identifies the mode."""
    rng, oversampling, rate_Hz = np.random.default_rng(3), 20, 700.0
    levels = rng.uniform(-1.0, 1.0, 16)
    instants = np.arange(1, 16) * 500 + rng.uniform(0.2, 0.8, 15)
    fine_drive = levels[np.searchsorted(instants, np.arange(8000 * oversampling) / oversampling)]
    drives = {
        ("loops", 1000.0): 0.9 * triangle(0.27 * np.arange(8000) / 1000.0),
        ("noise", 10_000.0): noisy_drive(rng, 0.02),
        ("steps", oversampling * rate_Hz): fine_drive,
    }
    recordings = []
    for (name, fine_Hz), drive in drives.items():
        every = oversampling if name == "steps" else 1
        static, _ = play_response(drive, memory_after(cycled, float(drive[0])))
        reading = ringing_response(static, fine_Hz)[::every]
        reading_m = HALF_STROKE_m * (reading + NOISE * rng.normal(size=len(reading)))
        recordings.append(drive_recording(name, fine_Hz / every, drive[::every], reading_m))
    outcome = search(with_fewer_rows(view_of_recordings(recordings), 3))
    (cause,) = [c for c in outcome.causes if c.effect.name == "resonance"]
    assert cause.selected.parameters["frequency_Hz"] == pytest.approx(FREQUENCY_Hz, rel=0.01)
    assert outcome.final.rms < 2.0 * NOISE


@pytest.mark.usefixtures("few_rows")
def test_a_mode_is_refitted_where_few_loops_do_not_determine_a_noisy_drive():
    """The class fitted to three loops extrapolates poorly along the noise."""
    count, rng = np.arange(12_000), np.random.default_rng(3)
    drives = {
        ("loops", 1000.0): 0.9 * triangle(0.27 * count[:8000] / 1000.0),
        ("middle", 4000.0): 0.95 * triangle(5.0 * count / 4000.0),
        ("noise", 10_000.0): noisy_drive(rng, 0.1),
    }

    def curved_response(response: Array, rate_Hz: float) -> Array:
        """Curve the response in a way that plays represent along loops only."""
        return ringing_response(response + 0.04 * np.sin(3.0 * response), rate_Hz)

    recordings = ringing(drives, curved_response, rng)
    outcome = search(with_fewer_rows(view_of_recordings(recordings), 3))
    (cause,) = [c for c in outcome.causes if c.effect.name == "resonance"]
    assert cause.selected.parameters["frequency_Hz"] == pytest.approx(FREQUENCY_Hz, rel=0.01)
