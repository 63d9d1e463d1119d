"""Minor loops of ceramics with memory of turning points are fitted, stored and inverted."""

from dataclasses import replace
from functools import cache

import numpy as np

from piezoid.design.lateral_task import lateral_task
from piezoid.export.export_stage import hysteresis_values
from piezoid.identification.hysteresis.estimate import estimate_axis
from piezoid.identification.hysteresis.pieces import Rig
from piezoid.identification.minor_loops_fit import with_minor_loops
from piezoid.identification.model import AxisModel
from piezoid.identification.simulation import compare
from piezoid.identification.store import LAYOUTS
from piezoid.numerics.arrays import Array
from piezoid.record_json import from_json, to_json
from piezoid.runtime.controller import Controller
from tests.identification.test_loop_shape import NOISE_M, SWEEP, law_of, recorded, walk

BEGINNING = 300  # samples of the cycle that erases the initial state
CYCLE = np.concatenate([np.linspace(-1.0, 1.0, 200), np.linspace(1.0, -1.0, 200)])
TURN = np.linspace(0.0, 1.0, 3000)
SPIRAL = 0.7 * TURN * np.sin(10.0 * np.pi * TURN)


def true_displacement_m(law: str, field: Array) -> Array:
    """Return the true displacement along a drive from -1, after two cycles."""
    path = np.concatenate([np.tile(CYCLE, 2), field])
    return 2e-5 * law_of(law)(path)[-len(field) :]


@cache
def fitted(law: str) -> tuple[AxisModel, AxisModel]:
    """Return the fitted axis without and with minor loops."""
    recordings = [recorded(law, SWEEP, "sweep"), recorded(law, walk(3), "walk")]
    plays = estimate_axis(recordings, "x", Rig(sensor_bandwidth_Hz=1000.0), orders=((12, 4),))
    return plays, with_minor_loops(plays, recordings)


def test_minor_loops_predict_a_new_drive_of_a_preisach_ceramic_to_the_noise():
    plays, axis = fitted("preisach_lorentzian")
    assert axis.minor_loops is not None
    assert "plays behind functions of" in axis.verdict.remarks[-1]
    unseen = recorded("preisach_lorentzian", walk(4), "other")
    errors = [float(np.std(compare(model, unseen).error_m[BEGINNING:])) for model in (plays, axis)]
    assert errors[1] < 3.0 * NOISE_M
    assert errors[1] < errors[0] / 1.5


def test_a_stage_of_plays_gets_no_minor_loops():
    plays, axis = fitted("plays")
    assert axis.minor_loops is None
    assert axis.verdict == plays.verdict
    (order,) = axis.function_orders
    assert order.held_out_rms_m > order.plain_rms_m  # evaluated and stated


def test_minor_loops_are_rejected_if_plays_predict_better():
    """The stated held-out error of the plays does not matter: here it is ten times too large."""
    plays, _ = fitted("plays")
    inaccurate = replace(plays, quality=replace(plays.quality, held_out_rms_m=1e-6))
    recordings = [recorded("plays", SWEEP, "sweep"), recorded("plays", walk(3), "walk")]
    assert with_minor_loops(inaccurate, recordings).minor_loops is None


def led_displacement_m(axis: AxisModel, reference_m: Array) -> Array:
    """Return the true displacement under open-loop control with the shipped inverse."""
    values = hysteresis_values(axis) | {"method": "mpi", "gain_m_per_V": 1e-6}
    limits = {
        **{"voltage_minimum_V": -5.0, "voltage_maximum_V": 5.0},
        **{"reference_minimum_m": -1e-3, "reference_maximum_m": 1e-3},
        **{"displacement_minimum_m": -1e-3, "displacement_maximum_m": 1e-3},
    }
    controller = Controller(values | limits)
    controller.start(-5.0, np.nan)
    drive_V = controller.run(reference_m, np.full(len(reference_m), np.nan)).voltage_V
    return true_displacement_m("preisach_lorentzian", drive_V / 5.0)


def test_the_shipped_inverse_of_minor_loops_has_a_third_of_the_error_of_plays():
    errors = []
    for axis in fitted("preisach_lorentzian"):
        cycle_m = axis.simulate(5.0 * np.concatenate([np.tile(CYCLE, 2)]), 400.0)
        low_m, high_m = cycle_m[-400:].min(), cycle_m[-400:].max()
        middle_m, half_m = 0.5 * (low_m + high_m), 0.5 * (high_m - low_m)
        cycles = [np.linspace(a, b, 400) for a, b in ((low_m, high_m), (high_m, low_m))]
        path_m = np.concatenate([*cycles, np.linspace(low_m, middle_m, 200)])
        error = (
            led_displacement_m(axis, np.r_[path_m, middle_m + half_m * SPIRAL])
            - np.r_[path_m, middle_m + half_m * SPIRAL]
        )
        errors.append(float(np.std(error[-len(SPIRAL) :])))
    assert errors[1] < errors[0] / 3.0


def test_minor_loops_survive_their_file_bit_by_bit():
    _, axis = fitted("preisach_lorentzian")
    restored = from_json(AxisModel, to_json(axis, LAYOUTS), LAYOUTS)
    assert restored.operator.value_m.tobytes() == axis.operator.value_m.tobytes()
    assert restored.operator.step_V == axis.operator.step_V
    assert "minor_loops" not in to_json(fitted("plays")[1], LAYOUTS)


def test_the_bound_with_minor_loops_holds_and_is_smaller_than_that_of_plays():
    """New drives, compared with the true law."""
    plays, axis = fitted("preisach_lorentzian")
    bounds = {model: lateral_task(model, 20e3).bounds["inverse"] for model in (plays, axis)}
    assert bounds[axis].error_m < bounds[plays].error_m
    for seed in range(4):
        field = walk(seed)
        error_m = true_displacement_m("preisach_lorentzian", field) - axis.simulate(
            5.0 * field, 400.0
        )
        assert 0.5 * np.ptp(error_m[BEGINNING:]) < bounds[axis].error_m


def test_the_inverse_undoes_the_simulation():
    _, axis = fitted("preisach_lorentzian")
    drive_V = 4.0 * SPIRAL
    offset_m = axis.hysteresis.displacement_offset_m
    start_V = axis.memory_at(axis.operator.threshold_V, axis.virgin_memory_V)
    displacement_m, _ = axis.operator.run(drive_V, start_V)
    assert np.abs(axis.inverse(axis.zero_m + displacement_m - offset_m) - drive_V).max() < 1e-9
