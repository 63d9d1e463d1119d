"""The inverse hysteresis of the runtime, against independent closed forms."""

import numpy as np
import pytest

from piezoid.operators.dead_zone import LINEAR, DeadZones
from piezoid.operators.prandtl_ishlinskii import ModifiedPrandtlIshlinskii, PrandtlIshlinskii
from piezoid.operators.preisach_plays import PreisachPlays
from piezoid.runtime.schema import MAX_EDGES, MAX_KNOTS, MAX_PLAYS, MAX_RELAXATIONS
from tests.runtime.runtime_parameters import WIDE, hysteresis, started
from tests.runtime.runtime_reference import follow, forward, random_model


def rounding_V(model, y):
    """Return ten roundings of the largest displacement at the smallest slope, in volts."""
    up = np.cumsum(model["weight"][model["knot"] >= 0])
    down = np.cumsum(model["weight"][model["knot"] <= 0][::-1])
    flattest = np.cumsum(model["w"]).min() * min(up.min(), down.min())
    return 10 * np.finfo(float).eps * max(1.0, np.abs(y).max()) / flattest


def inverse(model, y, **overrides):
    """Return the open-loop voltages from the memory of the model, without a first reading."""
    controller = started(hysteresis(model, **overrides), model["last"], np.nan)
    return controller.run(y, np.full(len(y), np.nan)).voltage_V


@pytest.mark.parametrize("negative", [False, True])
def test_the_inverse_recovers_the_drive_of_random_models(rng, negative):
    for _ in range(40):
        model = random_model(
            rng, plays=int(rng.integers(1, 20)), knots_each_side=3, negative=negative
        )
        u = model["last"] + np.cumsum(rng.uniform(-1, 1, 300))
        y, _ = forward(u, model["r"], model["w"], model["z"], model["knot"], model["weight"])
        assert np.abs(inverse(model, y) - u).max() < rounding_V(model, y)


def codes(operator, y, memory, *, limit_V, lsb_V):
    """Return the inverse of the operators after a converter, with the memory of its output."""
    output_V = np.empty_like(y)
    for k in range(len(y)):
        u, _ = operator.inverse_run(y[k : k + 1], memory)
        output_V[k] = lsb_V * np.round(np.clip(u[0], -limit_V, limit_V) / lsb_V)
        _, memory = operator.run(output_V[k : k + 1], memory)
    return output_V


@pytest.mark.parametrize("has_envelope", [False, True])
@pytest.mark.parametrize("negative", [False, True])
def test_the_shipped_inverse_gives_the_codes_of_the_operators(has_envelope, negative, rng):
    """The two independent implementations have the same converter."""
    lsb_V = 2.0**-8
    for _ in range(4):
        model = random_model(rng, plays=16, knots_each_side=4, negative=negative)
        front = random_model(rng, plays=2, knots_each_side=4)
        envelope = {
            "envelope_count": 9,
            "envelope_knot_V": front["knot"],
            "envelope_weight": front["weight"],
        }
        operator = ModifiedPrandtlIshlinskii(
            plays=PrandtlIshlinskii(threshold=model["r"], weight=model["w"]),
            dead_zones=DeadZones(threshold=model["knot"], weight=model["weight"]),
            envelope=DeadZones(threshold=front["knot"], weight=front["weight"])
            if has_envelope
            else LINEAR,
            voltage_offset_V=0.5,
        )
        y = np.cumsum(rng.uniform(-0.3, 0.3, 1000))
        memory = follow(0.0, model["r"], model["z"])
        expected = codes(operator, y, memory, limit_V=4.0, lsb_V=lsb_V)
        parameters = hysteresis(
            model,
            **(envelope if has_envelope else {}),
            voltage_minimum_V=-4.0,
            voltage_maximum_V=4.0,
            voltage_offset_V=0.5,
            lsb_V=lsb_V,
        )
        controller = started(parameters, 0.5, np.nan)
        assert np.array_equal(controller.run(y, y).voltage_V, expected)


def without_the_lowest_kink(model):
    return {**model, "knot": model["knot"][1:], "weight": model["weight"][1:]}


@pytest.mark.parametrize("start_V", [-300.0, 0.5, 300.0])
def test_a_model_that_fills_its_tables_is_inverted(start_V, rng):
    """The table behind a full table is not read as plays or kinks."""
    model, front = (
        without_the_lowest_kink(
            random_model(rng, plays=MAX_PLAYS, knots_each_side=MAX_KNOTS // 2, negative=True)
        )
        for _ in range(2)
    )
    operator = ModifiedPrandtlIshlinskii(
        plays=PrandtlIshlinskii(threshold=model["r"], weight=model["w"]),
        dead_zones=DeadZones(threshold=model["knot"], weight=model["weight"]),
        envelope=DeadZones(threshold=front["knot"], weight=front["weight"]),
    )
    parameters = hysteresis(
        model,
        envelope_count=MAX_KNOTS,
        envelope_knot_V=front["knot"],
        envelope_weight=front["weight"],
        relaxation_count=MAX_RELAXATIONS,
        relaxation_rate=np.full(MAX_RELAXATIONS, 0.5),
    )
    u = np.cumsum(rng.uniform(-40, 40, 300))
    u = np.r_[start_V, u - u.mean()]
    y, _ = operator.run(u, model["z"])
    assert (y > model["knot"][-1]).any()
    assert (y < model["knot"][0]).any()
    controller = started(parameters, start_V, np.nan)
    assert np.abs(controller.run(y, y).voltage_V - u).max() < 1e-9


def test_the_inverse_in_single_precision_errs_by_its_rounding(rng):
    for _ in range(10):
        model = random_model(rng, plays=16, knots_each_side=4)
        y = np.cumsum(rng.uniform(-0.3, 0.3, 1000)).astype(np.float32).astype(np.float64)
        runs = [
            started(hysteresis(model), 0.0, np.nan, precision).run(y, y).voltage_V
            for precision in ("double", "float")
        ]
        ratio = np.finfo(np.float32).eps / np.finfo(np.float64).eps
        assert np.abs(runs[0] - runs[1]).max() < 2 * ratio * rounding_V(model, y)


def random_functions(rng, plays, edges, steps, step_V=0.5):
    """Draw plays behind rising functions, some of them flat between edges."""
    rise_m = rng.uniform(0.0, 1.0, (plays, edges - 1)) * (rng.random((plays, edges - 1)) < 0.7)
    rise_m[0] = rng.uniform(0.3, 1.0, edges - 1)
    value_m = np.concatenate([np.zeros((plays, 1)), np.cumsum(rise_m, axis=1)], axis=1)
    lowest_V = float(rng.uniform(-0.5, 0.0)) - 0.5 * step_V * steps * (edges - 1)
    return PreisachPlays(
        step_V=step_V,
        edge_V=lowest_V + step_V * steps * np.arange(edges),
        value_m=value_m - value_m[:, edges // 2, None],
        voltage_offset_V=0.25,
        displacement_offset_m=0.5,
    )


def function_parameters(operator, **overrides):
    return {
        **WIDE,
        "method": "mpi",
        "voltage_offset_V": operator.voltage_offset_V,
        "displacement_offset_m": operator.displacement_offset_m,
        "play_count": len(operator.value_m),
        "play_threshold_V": operator.threshold_V,
        "edge_count": len(operator.edge_V),
        "edge_V": operator.edge_V[0],
        "edge_steps": round((operator.edge_V[1] - operator.edge_V[0]) / operator.step_V),
        "play_value_m": operator.value_m,
        **overrides,
    }


def command_voltages(operator, y, precision="double", **overrides):
    parameters = function_parameters(operator, **overrides)
    controller = started(parameters, operator.voltage_offset_V, np.nan, precision)
    return controller.run(y, np.full(len(y), np.nan)).voltage_V


SIZES = [(2, 2, 1), (5, 4, 3), (16, 9, 4), (MAX_PLAYS, MAX_EDGES, 1), (MAX_PLAYS, MAX_EDGES, 32)]


@pytest.mark.parametrize(("plays", "edges", "steps"), SIZES)
def test_plays_behind_functions_are_inverted_in_any_state(plays, edges, steps, rng):
    """The drive has small steps, full ranges within a sample, and values beyond the edges."""
    for _ in range(10):
        operator = random_functions(rng, plays, edges, steps)
        reach_V = 2.0 * (np.ptp(operator.edge_V) + operator.threshold_V[-1])
        u = np.concatenate(
            [np.cumsum(rng.uniform(-0.4, 0.4, 200)), rng.uniform(-reach_V, reach_V, 200)]
        )
        y, _ = operator.run(u, operator.at_rest(operator.voltage_offset_V))
        flattest, steepest = operator.slope_sector_m_per_V
        rounding_V = 100 * plays * np.finfo(float).eps * np.abs(y).max() / flattest
        assert np.abs(command_voltages(operator, y) - u).max() < rounding_V
        slope = np.diff(y) / np.diff(u)
        assert (slope > flattest * (1.0 - 1e-6)).all()
        assert (slope < steepest * (1.0 + 1e-6)).all()


def test_functions_are_inverted_through_a_converter_as_by_halving(rng):
    """An independent implementation gets the outputs of the converter."""
    lsb_V = 2.0**-8
    for _ in range(5):
        operator = random_functions(rng, 12, 7, 3)
        memory = operator.at_rest(operator.voltage_offset_V)
        y = operator.displacement_offset_m + np.cumsum(rng.uniform(-0.3, 0.3, 300))
        limits = {"voltage_minimum_V": -4.0, "voltage_maximum_V": 4.0, "lsb_V": lsb_V}
        voltages_V = command_voltages(operator, y, **limits)
        for reference_m, applied_V in zip(y, voltages_V, strict=True):
            free_V, _ = operator.inverse_run(np.array([reference_m]), memory)
            assert applied_V == lsb_V * np.round(np.clip(free_V[0], -4.0, 4.0) / lsb_V)
            _, memory = operator.run(np.array([applied_V]), memory)


def test_functions_in_single_precision_err_by_its_rounding(rng):
    operator = random_functions(rng, 16, 9, 4)
    y = 0.5 + np.cumsum(rng.uniform(-0.3, 0.3, 1000)).astype(np.float32).astype(np.float64)
    flattest, _ = operator.slope_sector_m_per_V
    rounding_V = 100 * 16 * np.finfo(np.float32).eps * np.abs(y).max() / flattest
    assert (
        np.abs(
            command_voltages(operator, y) - command_voltages(operator, y, precision="float")
        ).max()
        < rounding_V
    )
