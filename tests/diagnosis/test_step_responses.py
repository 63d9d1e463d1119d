"""A mode that one jump of the drive has struck is found, however short it rings."""

from functools import cache

import numpy as np
import pytest

from piezoid.diagnosis.diagnose import view_on
from piezoid.diagnosis.effect import EffectEstimate
from piezoid.diagnosis.effects import resonance
from piezoid.diagnosis.selection import Outcome, search
from piezoid.diagnosis.step_responses import modes_after_steps, step_response_view
from piezoid.identification.extensions import LAYOUT_OF_EXTENSIONS
from piezoid.identification.extensions.extension import Extension
from piezoid.numerics.arrays import Array
from piezoid.record_json import from_json, to_json
from piezoid.records.collection import collect
from piezoid.records.lab import Lab, read_lab

from .play_stage import NOISE_m, STROKE_m, moved, recording

LAYOUTS = (LAYOUT_OF_EXTENSIONS,)
RATE_Hz = 500.0  # at which the recording that jumps was made
JUMP_AT = 4100
FINER = 40  # steps of the true motion for one sample


def jumping(late: float = 0.0) -> Array:
    """Return a drive at rest that jumps, between two samples where it is late, and goes on."""
    time = np.arange(-JUMP_AT - late, 9000 - JUMP_AT - late)
    return np.where(time < 0.0, 0.6, -0.3 + 0.5 * np.sin(2 * np.pi * np.maximum(time, 0) / 1600))


def rung(followed: Array, frequency_Hz: float, quality: float) -> Array:
    """Return what a mass on a spring makes of a motion, by small steps in time."""
    w, step_s = 2 * np.pi * frequency_Hz, 1.0 / (RATE_Hz * FINER)
    place, speed, out = followed[0], 0.0, np.empty_like(followed)
    for i, target in enumerate(followed):
        for _ in range(FINER):
            speed += step_s * (w * w * (target - place) - w / quality * speed)
            place += step_s * speed
        out[i] = place
    return out


def lagging(followed: Array, samples: float) -> Array:
    place, out = followed[0], np.empty_like(followed)
    for i, target in enumerate(followed):
        place += (target - place) * (1.0 - np.exp(-1.0 / samples))
        out[i] = place
    return out


def creeping(followed: Array) -> Array:
    """Return a motion of which a tenth comes in the course of three decades of time."""
    slow = sum(lagging(followed, samples) for samples in (10.0, 100.0, 1000.0)) / 3.0
    return 0.9 * followed + 0.1 * slow


def searched(made: Array) -> Outcome:
    noise_m = np.random.default_rng(8).normal(0.0, NOISE_m, len(made))
    recordings = [recording("sweep"), recording("walk", STROKE_m * made + noise_m, jumping())]
    return search(view_on(recordings, axis="x", lab=Lab()))


@cache
def static() -> Array:
    return moved(jumping())


def test_a_mode_that_one_jump_struck_is_named_with_its_frequency():
    late = moved(jumping(0.4))  # the stage feels a jump that lies between two samples
    ringing = 0.5 * late + 0.5 * rung(late, 61.0, 15.0)
    (cause,) = searched(ringing).causes
    assert cause.effect.name == "resonance"
    assert cause.selected.parameters["frequency_Hz"] == pytest.approx(61.0, rel=0.02)
    assert cause.selected.parameters["quality"] == pytest.approx(15.0, rel=0.3)


def humming(followed: Array) -> Array:
    """Return a motion with hum that was there before the jump."""
    return followed + 10.0 * NOISE_m / STROKE_m * np.sin(0.4 * np.arange(len(followed)))


@pytest.mark.parametrize(
    "made",
    [
        static,
        lambda: lagging(static(), 2.0),
        lambda: creeping(static()),
        lambda: humming(static()),
        lambda: static() + 0.005 * (rung(static(), 61.0, 15.0) - static()),
    ],
    ids=["at once", "late", "creeping", "humming", "ringing below the noise"],
)
def test_what_only_follows_a_jump_late_or_hums_as_before_does_not_ring(made):
    noise_m = np.random.default_rng(8).normal(0.0, NOISE_m, 9000)
    reading_m = STROKE_m * made() + noise_m
    recordings = [recording("sweep"), recording("walk", reading_m, jumping())]
    assert modes_after_steps(view_on(recordings, axis="x", lab=Lab())) == ()


def test_a_jump_behind_which_the_drive_goes_on_as_fast_tells_nothing():
    place = np.arange(9000 - JUMP_AT)
    fast = np.concatenate([np.full(JUMP_AT, 0.6), -0.3 + 0.5 * np.sin(2 * np.pi * place / 180)])
    recordings = [recording("sweep"), recording("walk", STROKE_m * moved(fast), fast)]
    assert step_response_view(view_on(recordings, axis="x", lab=Lab())) is None


def test_a_recorded_actuator_that_a_step_struck_rings_near_970_hertz(realdata, tmp_path):
    (tmp_path / "lab.toml").write_text(
        '[[recording]]\nfile = "hysteresis_v_150_1hz.csv"\naxis = "x"\n'
        "columns = { time = 2, displacement = 3, voltage = 4 }\n"
        'units = { time = "s", displacement = "um", voltage = "V" }\n'
    )
    lab = read_lab(tmp_path / "lab.toml")
    recordings = collect([realdata / "actuator_150V" / "hysteresis_v_150_1hz.csv"], lab).recordings
    (found,) = modes_after_steps(view_on(recordings, axis="x", lab=lab))
    assert found.effect.name == "resonance"
    assert found.parameters["frequency_Hz"] == pytest.approx(968.0, rel=0.01)


def test_a_model_keeps_a_struck_mode_as_the_jump_has_shown_it():
    numbers = {"frequency_Hz": 961.0, "quality": 12.0}
    found = EffectEstimate(
        effect="resonance", parameters=numbers, coefficient=np.array([0.1, 0.4]), from_jumps=True
    )
    (mode,) = resonance.EFFECT.extend(found, None)
    free = mode.free()
    np.testing.assert_array_equal(free.lower, free.upper)
    np.testing.assert_allclose(free.value, [961.0, 12.0, 0.5])
    np.testing.assert_array_equal(
        from_json(Extension, to_json(mode, LAYOUTS), LAYOUTS).free().value, free.value
    )
