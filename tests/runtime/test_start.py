"""The runtime estimates the memory of the hysteresis from the first reading."""

import numpy as np
import pytest

from tests.runtime.runtime_parameters import WORKED, hysteresis, started
from tests.runtime.runtime_reference import forward, random_model

ENDS_V = {"voltage_minimum_V": -5.0, "voltage_maximum_V": 5.0}


def displacement_at_rest(model, path_V):
    """Return displacement and memory of the model at the end of a path."""
    operator = (model["r"], model["w"], model["z"], model["knot"], model["weight"])
    y, z = forward(np.asarray(path_V, dtype=float), *operator)
    return y[-1], z


def command_voltages(model, reference_m, voltage_V, measured_m, **overrides):
    """Return the voltages for a reference after a start with a reading."""
    controller = started(hysteresis(model, **ENDS_V, **overrides), voltage_V, measured_m)
    return controller.run(reference_m, np.full(len(reference_m), np.nan)).voltage_V


def random_depoled_model(rng):
    """Draw a model with weights of one sign in the virgin state."""
    model = random_model(rng, plays=int(rng.integers(3, 20)), knots_each_side=3)
    return {**model, "z": np.zeros(len(model["r"])), "last": 0.0}


@pytest.mark.parametrize("polarity", [1, -1])
@pytest.mark.parametrize("precision_m", [0.0, 1e-6])
def test_the_first_reading_determines_the_memory_after_a_single_extreme(
    rng, polarity, precision_m
):
    for _ in range(40):
        model = random_depoled_model(rng)
        extreme_V, rest_V = rng.uniform(-5, 5, 2)
        rest_m, z = displacement_at_rest(model, [extreme_V, rest_V])
        drive_V = np.clip(rest_V + np.cumsum(rng.uniform(-1, 1, 300)), -5, 5)
        operator = (model["r"], model["w"], z, model["knot"], model["weight"])
        reference_m, _ = forward(drive_V, *operator)
        reading_m = polarity * (rest_m + precision_m)
        sent_V = command_voltages(
            model, polarity * reference_m, rest_V, reading_m, polarity=polarity
        )
        displacement_m, _ = forward(sent_V, *operator)
        assert np.abs(displacement_m - reference_m).max() < 1e-9 + 20 * precision_m


def test_without_a_reading_the_memory_comes_from_the_parameters():
    rest_m, _ = displacement_at_rest(WORKED, [0.0])
    y = np.array([2.4575, -0.35, 1.52])
    assert np.array_equal(
        command_voltages(WORKED, y, 0.0, np.nan), command_voltages(WORKED, y, 0.0, rest_m)
    )


def test_a_reading_reduces_the_error_after_any_drive_history(rng):
    """Nested turning points hold more memory than a single reading determines."""
    with_reading, without_reading = [], []
    for _ in range(60):
        model = random_depoled_model(rng)
        turns_V = rng.uniform(-5, 5, 4)
        rest_m, z = displacement_at_rest(model, turns_V)
        operator = (model["r"], model["w"], z, model["knot"], model["weight"])
        path_V = 4.0 * np.sin(np.linspace(0, 6 * np.pi, 400))
        reference_m, _ = forward(path_V, *operator)
        for errors, reading_m in ((with_reading, rest_m), (without_reading, np.nan)):
            sent_V = command_voltages(model, reference_m, float(turns_V[-1]), reading_m)
            displacement_m, _ = forward(sent_V, *operator)
            errors.append(float(np.std(displacement_m - reference_m)))
    assert np.median(with_reading) < 0.3 * np.median(without_reading)
    assert np.mean(with_reading) < 0.5 * np.mean(without_reading)


def test_an_unexplained_reading_shifts_the_zero(rng):
    """After remounting the sensor, references count from its reading."""
    model = random_depoled_model(rng)
    _, z = displacement_at_rest(model, [5.0, 0.0])
    highest_m, _ = displacement_at_rest(model, [5.0, 0.0])
    shift_m = 3.0
    operator = (model["r"], model["w"], z, model["knot"], model["weight"])
    drive_V = np.linspace(0.0, 2.0, 50)
    reference_m, _ = forward(drive_V, *operator)
    sent_V = command_voltages(model, reference_m + shift_m, 0.0, highest_m + shift_m)
    assert np.abs(sent_V - drive_V).max() < 1e-9


def test_the_first_step_has_no_bump_for_any_reading(rng):
    for _ in range(200):
        model = random_depoled_model(rng)
        rest_V, reading_m = rng.uniform(-5, 5), rng.uniform(-20, 20)
        controller = started(hysteresis(model, **ENDS_V), rest_V, reading_m)
        assert controller.step(reading_m, reading_m) == pytest.approx(rest_V, abs=1e-9)
