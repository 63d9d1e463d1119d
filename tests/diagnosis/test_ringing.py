"""A sharp mode under a drive that repeats is found beside what plays would make of its ringing."""

import numpy as np
import pytest

from piezoid.diagnosis.candidate import evaluate
from piezoid.diagnosis.effects import resonance
from piezoid.diagnosis.refinement import initial_guess, refine
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.score_test import score_test
from piezoid.diagnosis.selection import search
from piezoid.diagnosis.signals import mode
from piezoid.numerics.arrays import Array
from piezoid.records.lab import Lab

from .bench import view_of_recordings
from .played import RINGING_NOISE as NOISE
from .played import HALF_STROKE_m, cycled, memory_after, moved, recorded_as, ringing

FREQUENCY_Hz, QUALITY = 300.0, 38.0
FAST_Hz = 20.0  # of the triangle: its 15th harmonic lies on the mode


def triangle(phase: Array) -> Array:
    return 2 / np.pi * np.arcsin(np.sin(2 * np.pi * (phase - 0.25)))


def rung(response: Array, rate_Hz: float) -> Array:
    return mode(response, FREQUENCY_Hz, QUALITY, rate_Hz)


def ringing_view() -> View:
    """Record two slow drives and the fast triangle; all of the motion passes through the mode."""
    count = np.arange(3000)
    drives = {
        ("loops", 500.0): np.linspace(1.0, 0.3, 3000) * triangle(1.1 * count / 500.0),
        ("waves", 500.0): np.linspace(0.2, 1.0, 3000) * np.sin(2 * np.pi * 0.7 * count / 500.0),
        ("fast", 5000.0): 0.8 * triangle(FAST_Hz * count / 5000.0),
    }
    return view_of_recordings(ringing(drives, rung, np.random.default_rng(1)), Lab())


def test_a_sharp_mode_on_a_harmonic_of_the_drive_is_found_at_its_frequency_and_as_sharp():
    view = ringing_view()
    seen = score_test(resonance.EFFECT, view)
    # nearer than two of the grid are to each other
    assert seen.trial.parameters["frequency_Hz"] == pytest.approx(FREQUENCY_Hz, rel=0.5 / QUALITY)
    start = initial_guess(resonance.EFFECT, seen.trial, float(seen.cv.coefficient[0]))
    one, there = refine(start, view, [])
    cause = evaluate(one, there, view, test=seen)
    assert cause.physical
    assert cause.is_significant
    assert one.parameters["frequency_Hz"] == pytest.approx(FREQUENCY_Hz, rel=0.005)
    assert one.parameters["quality"] == pytest.approx(QUALITY, rel=0.3)
    assert there.rms < 0.1 * view.rms


def noisy_drive(chance: np.random.Generator, rms: float) -> Array:
    count, lines_Hz = np.arange(12_000), np.arange(20.0, 400.0, 1.25)[:, None]
    angles = 2 * np.pi * chance.random(lines_Hz.shape)
    noisy = np.cos(2 * np.pi * lines_Hz * count / 10_000.0 + angles).sum(axis=0)
    return np.asarray(rms * noisy / np.std(noisy))


def test_ringing_behind_steps_that_no_sample_resolves_is_no_residual_of_a_mode():
    """The instants of steps recorded at 700 Hz are unknown; the noise shows the mode."""
    chance, finer, rate_Hz = np.random.default_rng(3), 20, 700.0
    levels = chance.uniform(-1.0, 1.0, 16)
    instants = np.arange(1, 16) * 500 + chance.uniform(0.2, 0.8, 15)
    fine = levels[np.searchsorted(instants, np.arange(8000 * finer) / finer)]
    drives = {
        ("loops", 1000.0): 0.9 * triangle(0.27 * np.arange(8000) / 1000.0),
        ("noise", 10_000.0): noisy_drive(chance, 0.02),
        ("steps", finer * rate_Hz): fine,
    }
    recordings = []
    for (name, fine_Hz), drive in drives.items():
        every = finer if name == "steps" else 1
        static, _ = moved(drive, memory_after(cycled, float(drive[0])))
        reading = rung(static, fine_Hz)[::every]
        reading_m = HALF_STROKE_m * (reading + NOISE * chance.normal(size=len(reading)))
        recordings.append(recorded_as(name, fine_Hz / every, drive[::every], reading_m))
    outcome = search(view_of_recordings(tuple(recordings), Lab()))
    (cause,) = [c for c in outcome.causes if c.effect.name == "resonance"]
    assert cause.selected.parameters["frequency_Hz"] == pytest.approx(FREQUENCY_Hz, rel=0.01)
    assert outcome.final.rms < 2.0 * NOISE


def test_a_mode_is_refitted_where_a_few_loops_say_nothing_of_a_noisy_drive():
    """The class that follows three loops is wild along the noise: it stood for the hysteresis."""
    count, chance = np.arange(12_000), np.random.default_rng(3)
    drives = {
        ("loops", 1000.0): 0.9 * triangle(0.27 * count[:8000] / 1000.0),
        ("middle", 4000.0): 0.95 * triangle(5.0 * count / 4000.0),
        ("noise", 10_000.0): noisy_drive(chance, 0.1),
    }

    def bent(response: Array, rate_Hz: float) -> Array:
        """Bend loops by a curve that plays follow along loops only."""
        return rung(response + 0.04 * np.sin(3.0 * response), rate_Hz)

    recordings = ringing(drives, bent, chance)
    outcome = search(view_of_recordings(recordings, Lab()))
    (cause,) = [c for c in outcome.causes if c.effect.name == "resonance"]
    assert cause.selected.parameters["frequency_Hz"] == pytest.approx(FREQUENCY_Hz, rel=0.01)
