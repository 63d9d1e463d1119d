"""What the runtime makes of the first reading: where the stage came to rest from."""

import numpy as np
import pytest

from piezoid.runtime.controller import Controller
from tests.runtime.runtime_parameters import WORKED, hysteresis
from tests.runtime.runtime_reference import forward, random_model

ENDS_V = {"voltage_minimum_V": -5.0, "voltage_maximum_V": 5.0}


def rested(model, way_V):
    """Displacement at the end of a way from the model's memory, and the memory then."""
    operator = (model["r"], model["w"], model["z"], model["knot"], model["weight"])
    y, z = forward(np.asarray(way_V, dtype=float), *operator)
    return y[-1], z


def commanded(model, wanted_m, voltage_V, measured_m, **others):
    """Voltages that make these displacements, by the model, from a start with a reading."""
    controller = Controller(hysteresis(model, **ENDS_V, **others))
    controller.start(voltage_V, measured_m)
    return controller.run(wanted_m, np.full(len(wanted_m), np.nan)).voltage_V


def depoled(rng):
    """A random model with weights of one sign that has not been moved yet."""
    model = random_model(rng, plays=int(rng.integers(3, 20)), knots_each_side=3)
    return {**model, "z": np.zeros(len(model["r"])), "last": 0.0}


@pytest.mark.parametrize("polarity", [1, -1])
@pytest.mark.parametrize("precision_m", [0.0, 1e-6])
def test_a_stage_that_rests_where_one_drive_left_it_is_followed_without_feedback(
    rng, polarity, precision_m
):
    for _ in range(40):
        model = depoled(rng)
        extreme_V, rest_V = rng.uniform(-5, 5, 2)
        rest_m, z = rested(model, [extreme_V, rest_V])
        asked_V = np.clip(rest_V + np.cumsum(rng.uniform(-1, 1, 300)), -5, 5)
        operator = (model["r"], model["w"], z, model["knot"], model["weight"])
        wanted_m, _ = forward(asked_V, *operator)
        shown_m = polarity * (rest_m + precision_m)
        sent_V = commanded(model, polarity * wanted_m, rest_V, shown_m, polarity=polarity)
        made_m, _ = forward(sent_V, *operator)
        assert np.abs(made_m - wanted_m).max() < 1e-9 + 20 * precision_m


def test_without_a_reading_the_memory_is_that_of_the_parameters():
    rest_m, _ = rested(WORKED, [0.0])
    y = np.array([2.4575, -0.35, 1.52])
    assert np.array_equal(commanded(WORKED, y, 0.0, np.nan), commanded(WORKED, y, 0.0, rest_m))


def test_after_any_past_the_reading_leaves_less_error_than_no_reading(rng):
    """Turns within turns have more memory than one reading shows: less error, not none."""
    with_reading, without = [], []
    for _ in range(60):
        model = depoled(rng)
        turns_V = rng.uniform(-5, 5, 4)
        rest_m, z = rested(model, turns_V)
        operator = (model["r"], model["w"], z, model["knot"], model["weight"])
        way_V = 4.0 * np.sin(np.linspace(0, 6 * np.pi, 400))
        wanted_m, _ = forward(way_V, *operator)
        for errors, shown_m in ((with_reading, rest_m), (without, np.nan)):
            sent_V = commanded(model, wanted_m, float(turns_V[-1]), shown_m)
            made_m, _ = forward(sent_V, *operator)
            errors.append(float(np.std(made_m - wanted_m)))
    assert np.median(with_reading) < 0.3 * np.median(without)
    assert np.mean(with_reading) < 0.5 * np.mean(without)


def test_a_reading_that_no_past_explains_moves_the_zero_instead(rng):
    """The sensor was mounted anew: references count from what it shows."""
    model = depoled(rng)
    _, z = rested(model, [5.0, 0.0])
    highest_m, _ = rested(model, [5.0, 0.0])
    shift_m = 3.0
    operator = (model["r"], model["w"], z, model["knot"], model["weight"])
    asked_V = np.linspace(0.0, 2.0, 50)
    wanted_m, _ = forward(asked_V, *operator)
    sent_V = commanded(model, wanted_m + shift_m, 0.0, highest_m + shift_m)
    assert np.abs(sent_V - asked_V).max() < 1e-9


def test_the_first_step_is_bumpless_whatever_the_sensor_shows(rng):
    for _ in range(200):
        model = depoled(rng)
        rest_V, shown_m = rng.uniform(-5, 5), rng.uniform(-20, 20)
        controller = Controller(hysteresis(model, **ENDS_V))
        controller.start(rest_V, shown_m)
        assert controller.step(shown_m, shown_m) == pytest.approx(rest_V, abs=1e-9)
