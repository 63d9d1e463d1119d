"""A mode excited by one step of the drive is found, even after short ringing."""

from functools import cache

import numpy as np
import pytest

from piezoid.diagnosis.diagnose import view_on
from piezoid.diagnosis.effect import EffectEstimate
from piezoid.diagnosis.effects import resonance
from piezoid.diagnosis.forward_selection import modes_after_steps
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.selection import search
from piezoid.diagnosis.step_responses import step_response_view
from piezoid.identification.extensions import LAYOUT_OF_EXTENSIONS
from piezoid.identification.extensions.extension import Extension
from piezoid.numerics.arrays import Array
from piezoid.record_json import from_json, to_json
from piezoid.records.collection import collect
from piezoid.records.lab import read_lab

from .bench import view_of_recordings
from .play_stage import NOISE_m, STROKE_m, recording, stroke_fraction

LAYOUTS = (LAYOUT_OF_EXTENSIONS,)
RATE_Hz = 500.0  # of the recording with the step
STEP_ROW = 4100
OVERSAMPLING = 40  # integration steps per sample


def step_drive(delay: float = 0.0) -> Array:
    """Return a drive at rest, then a step, between two samples if delayed, then slow waves."""
    time = np.arange(-STEP_ROW - delay, 9000 - STEP_ROW - delay)
    return np.where(time < 0.0, 0.6, -0.3 + 0.5 * np.sin(2 * np.pi * np.maximum(time, 0) / 1600))


def ringing_response(response: Array, frequency_Hz: float, quality: float) -> Array:
    """Return the response of a spring-mass system to a motion, integrated in small steps."""
    w, step_s = 2 * np.pi * frequency_Hz, 1.0 / (RATE_Hz * OVERSAMPLING)
    position, speed, ringing = response[0], 0.0, np.empty_like(response)
    for i, target in enumerate(response):
        for _ in range(OVERSAMPLING):
            speed += step_s * (w * w * (target - position) - w / quality * speed)
            position += step_s * speed
        ringing[i] = position
    return ringing


def lagged(response: Array, samples: float) -> Array:
    state, output = response[0], np.empty_like(response)
    for i, target in enumerate(response):
        state += (target - state) * (1.0 - np.exp(-1.0 / samples))
        output[i] = state
    return output


def with_creep(response: Array) -> Array:
    """Return a response of which a tenth creeps over three decades of time."""
    creep = sum(lagged(response, samples) for samples in (10.0, 100.0, 1000.0)) / 3.0
    return 0.9 * response + 0.1 * creep


def view_of_response(response: Array) -> View:
    """Return the view of a sweep, and of a response to the step drive."""
    noise_m = np.random.default_rng(8).normal(0.0, NOISE_m, len(response))
    walk = recording("walk", STROKE_m * response + noise_m, step_drive())
    return view_of_recordings([recording("sweep"), walk])


@cache
def static_response() -> Array:
    return stroke_fraction(step_drive())


def test_a_mode_excited_by_one_step_is_named_with_its_frequency():
    delayed = stroke_fraction(step_drive(0.4))  # the step lies between two samples
    ringing = 0.5 * delayed + 0.5 * ringing_response(delayed, 61.0, 15.0)
    (cause,) = search(view_of_response(ringing)).causes
    assert cause.effect.name == "resonance"
    assert cause.selected.parameters["frequency_Hz"] == pytest.approx(61.0, rel=0.02)
    assert cause.selected.parameters["quality"] == pytest.approx(15.0, rel=0.3)


def with_hum(response: Array) -> Array:
    """Return a response with hum that exists before the step."""
    return response + 10.0 * NOISE_m / STROKE_m * np.sin(0.4 * np.arange(len(response)))


def with_weak_ringing(response: Array) -> Array:
    return response + 0.005 * (ringing_response(response, 61.0, 15.0) - response)


@pytest.mark.parametrize(
    "response",
    [
        static_response,
        lambda: lagged(static_response(), 2.0),
        lambda: with_creep(static_response()),
        lambda: with_hum(static_response()),
        lambda: with_weak_ringing(static_response()),
    ],
    ids=["static", "lagged", "creeping", "humming", "ringing below the noise"],
)
def test_lag_creep_and_hum_after_a_step_are_not_a_mode(response):
    assert modes_after_steps(view_of_response(response())) == ()


def test_a_step_followed_by_fast_motion_shows_no_mode():
    sample = np.arange(9000 - STEP_ROW)
    drive = np.concatenate([np.full(STEP_ROW, 0.6), -0.3 + 0.5 * np.sin(2 * np.pi * sample / 180)])
    recordings = [recording("sweep"), recording("walk", STROKE_m * stroke_fraction(drive), drive)]
    assert step_response_view(view_of_recordings(recordings)) is None


def test_a_measured_actuator_rings_near_970_hertz_after_a_step(realdata, tmp_path):
    (tmp_path / "lab.toml").write_text(
        '[[recording]]\nfile = "hysteresis_v_150_1hz.csv"\naxis = "x"\n'
        "columns = { time = 2, displacement = 3, voltage = 4 }\n"
        'units = { time = "s", displacement = "um", voltage = "V" }\n'
    )
    lab = read_lab(tmp_path / "lab.toml")
    recordings = collect([realdata / "actuator_150V" / "hysteresis_v_150_1hz.csv"], lab).recordings
    (estimate,) = modes_after_steps(view_on(recordings, axis="x", lab=lab))
    assert estimate.effect.name == "resonance"
    assert estimate.parameters["frequency_Hz"] == pytest.approx(968.0, rel=0.01)


def test_a_mode_found_after_steps_is_fixed_in_the_model():
    estimate = EffectEstimate(
        effect="resonance",
        parameters={"frequency_Hz": 961.0, "quality": 12.0},
        coefficient=np.array([0.1, 0.4]),
        from_jumps=True,
    )
    (mode,) = resonance.EFFECT.extend(estimate, None)
    free = mode.free()
    np.testing.assert_array_equal(free.lower, free.upper)
    np.testing.assert_allclose(free.value, [961.0, 12.0, 0.5])
    np.testing.assert_array_equal(
        from_json(Extension, to_json(mode, LAYOUTS), LAYOUTS).free().value, free.value
    )
