"""Minor loops of ceramics that remember turning points are told, stored and inverted."""

from dataclasses import replace
from functools import cache
from itertools import pairwise

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
from piezoid.records.frames import from_arrays
from piezoid.records.recording import Recording
from piezoid.runtime.controller import Controller
from piezoid_datasets.virtual_lab.truths import ZOO
from tests.laws import _plays

NOISE_M = 8e-9
BEGINNING = 500  # samples of the cycle that wipes out what was before
CYCLE = np.concatenate([np.linspace(-1.0, 1.0, 200), np.linspace(1.0, -1.0, 200)])


def through(levels: Array) -> Array:
    runs = [np.linspace(a, b, int(120 * abs(b - a)) + 3)[1:] for a, b in pairwise(levels)]
    return np.concatenate([levels[:1], *runs])


SWEEP = through(np.concatenate([[-1.0], np.linspace(1.0, 0.05, 31) * (-1.0) ** np.arange(31)]))
WALK = through(np.r_[-1.0, 1.0, -1.0, np.random.default_rng(3).uniform(-1.0, 1.0, 30)])
TURN = np.linspace(0.0, 1.0, 3000)
SPIRAL = 0.7 * TURN * np.sin(10.0 * np.pi * TURN)


def moved_m(law: str, field: Array) -> Array:
    """Return the true motion along a drive from -1, after two cycles."""
    path = np.concatenate([np.tile(CYCLE, 2), field])
    if law == "plays":
        return 2e-5 * _plays(path)[-len(field) :]
    place = [one.name for one in ZOO].index(law)
    made = ZOO[place].draw(np.random.default_rng([5, place]))
    return 2e-5 * np.add(*made.respond(path, np.zeros(0)))[-len(field) :]


def recorded(law: str, field: Array, name: str, rate_Hz: float = 400.0) -> Recording:
    noise = NOISE_M * np.random.default_rng(len(field)).standard_normal(len(field))
    return from_arrays(
        voltage_V=5.0 * field,
        displacement_m=moved_m(law, field) + noise,
        sampling_rate_Hz=rate_Hz,
        axis="x",
        name=name,
    )


@cache
def fitted(law: str) -> tuple[AxisModel, AxisModel]:
    """Return an axis as it is fitted, and with minor loops where it has them."""
    held = [recorded(law, SWEEP, "sweep"), recorded(law, WALK, "walk")]
    plain = estimate_axis(held, "x", Rig(sensor_bandwidth_Hz=1000.0), orders=((12, 4),))
    return plain, with_minor_loops(plain, held)


def test_a_preisach_ceramic_is_followed_to_the_noise_on_a_drive_nobody_recorded():
    plain, found = fitted("preisach_lorentzian")
    assert found.minor_loops is not None
    assert "12 plays behind functions of 6 pieces" in found.verdict.remarks[-1]
    field = through(np.r_[-1.0, 1.0, -1.0, np.random.default_rng(4).uniform(-1.0, 1.0, 20)])
    other = recorded("preisach_lorentzian", field, "other")
    errors = [float(np.std(compare(axis, other).error_m[BEGINNING:])) for axis in (plain, found)]
    assert errors[1] < 3.0 * NOISE_M
    assert errors[1] < errors[0] / 1.5


def test_what_plays_and_dead_zones_follow_keeps_its_bounded_inverse():
    plain, found = fitted("plays")
    assert found.minor_loops is None
    assert found.verdict == plain.verdict
    (tried,) = found.function_orders
    assert tried.held_out_rms_m > tried.plain_rms_m  # and it is told that functions were tried


def test_functions_that_plays_beat_on_the_same_rows_are_no_shape_of_loops():
    """However badly plays predicted: here their prediction is said to be ten times worse."""
    plain, _ = fitted("plays")
    told = replace(plain, quality=replace(plain.quality, held_out_rms_m=1e-6))
    held = [recorded("plays", SWEEP, "sweep"), recorded("plays", WALK, "walk")]
    assert with_minor_loops(told, held).minor_loops is None


def led_m(axis: AxisModel, wanted_m: Array) -> Array:
    """Return where the ceramic goes when the shipped inverse drives it open-loop."""
    values = hysteresis_values(axis) | {"method": "mpi", "gain_m_per_V": 1e-6}
    limits = {
        **{"voltage_minimum_V": -5.0, "voltage_maximum_V": 5.0},
        **{"reference_minimum_m": -1e-3, "reference_maximum_m": 1e-3},
        **{"displacement_minimum_m": -1e-3, "displacement_maximum_m": 1e-3},
    }
    controller = Controller(values | limits)
    controller.start(-5.0, np.nan)
    drive_V = controller.run(wanted_m, np.full(len(wanted_m), np.nan)).voltage_V
    return moved_m("preisach_lorentzian", drive_V / 5.0)


def test_the_shipped_inverse_of_minor_loops_errs_a_third_of_that_of_plays_and_dead_zones():
    errors = []
    for axis in fitted("preisach_lorentzian"):
        ends_m = axis.simulate(5.0 * np.concatenate([np.tile(CYCLE, 2)]), 400.0)
        low_m, high_m = ends_m[-400:].min(), ends_m[-400:].max()
        middle_m, half_m = 0.5 * (low_m + high_m), 0.5 * (high_m - low_m)
        cycles = [np.linspace(a, b, 400) for a, b in ((low_m, high_m), (high_m, low_m))]
        wanted = np.concatenate([*cycles, np.linspace(low_m, middle_m, 200)])
        error = (
            led_m(axis, np.r_[wanted, middle_m + half_m * SPIRAL])
            - np.r_[wanted, middle_m + half_m * SPIRAL]
        )
        errors.append(float(np.std(error[-len(SPIRAL) :])))
    assert errors[1] < errors[0] / 3.0


def test_minor_loops_come_back_from_a_file_to_the_last_bit():
    _, found = fitted("preisach_lorentzian")
    again = from_json(AxisModel, to_json(found, LAYOUTS), LAYOUTS)
    assert again.operator.value_m.tobytes() == found.operator.value_m.tobytes()
    assert again.operator.step_V == found.operator.step_V
    assert "minor_loops" not in to_json(fitted("plays")[1], LAYOUTS)


def test_the_bound_of_what_ships_holds_and_is_no_wider_than_that_of_plays_and_dead_zones():
    """Along drives nobody recorded, against the law itself."""
    plain, found = fitted("preisach_lorentzian")
    bounds = {axis: lateral_task(axis, 20e3).bounds["inverse"] for axis in (plain, found)}
    assert bounds[found].error_m < bounds[plain].error_m
    for seed in range(4):
        levels = np.random.default_rng(seed).uniform(-1.0, 1.0, 20)
        field = through(np.r_[-1.0, 1.0, -1.0, levels])
        error_m = moved_m("preisach_lorentzian", field) - found.simulate(5.0 * field, 400.0)
        assert 0.5 * np.ptp(error_m[BEGINNING:]) < bounds[found].error_m


def test_the_inverse_of_the_model_undoes_its_simulation():
    _, found = fitted("preisach_lorentzian")
    drive_V = 4.0 * SPIRAL
    offset_m = found.hysteresis.displacement_offset_m
    start_V = found.memory_at(found.operator.threshold_V, found.virgin_memory_V)
    moved, _ = found.operator.run(drive_V, start_V)
    assert np.abs(found.inverse(found.zero_m + moved - offset_m) - drive_V).max() < 1e-9
