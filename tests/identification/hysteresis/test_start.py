"""The convex start finds what is there, and another solver agrees with its program."""

import numpy as np

from piezoid.identification.hysteresis.convex_start import (
    bounded_optimum,
    constraints_of,
    find_lag,
    kuhnen_start,
    triangle_of,
    zone_thresholds,
)
from piezoid.identification.hysteresis.coordinates import Shape
from piezoid.identification.hysteresis.pieces import Rig, pieces_of, scales_of
from piezoid.numerics.arrays import Array
from piezoid.numerics.quadratic_program import constrained_least_squares, stationarity
from piezoid.operators.filters import lagged
from tests.identification.hysteresis.stages import (
    RATE_Hz,
    decaying,
    first_order_lag,
    play_sum,
    recording,
)

THRESHOLD = 5.0 * np.arange(5) / 5.0
WEIGHT = np.array([2.0, 0.5, 0.3, 0.2, 0.1]) * 1e-6


def made(drive: Array) -> Array:
    return play_sum(drive, THRESHOLD, WEIGHT, np.full(5, drive[0]))


def test_weights_on_the_right_thresholds_are_found_exactly() -> None:
    drive = decaying()
    one = recording(drive, made(drive))
    scales = scales_of([one], "x")
    pieces = pieces_of([one], "x", scales, Rig())
    start = kuhnen_start(pieces, Shape(plays=4, below=0, above=0), 0.0)
    weight = start.operator.weight * abs(scales.displacement_m) / scales.voltage_V
    np.testing.assert_allclose(weight, WEIGHT, rtol=1e-6)
    np.testing.assert_allclose(start.operator.threshold * scales.voltage_V, THRESHOLD[1:])
    assert start.kkt_gap < 1e-9


def test_the_lag_of_the_quick_model_is_the_lag_of_the_data() -> None:
    drive = decaying(15, per_unit=30)
    for lag_s in (0.0, 0.011):
        late = first_order_lag(made(drive), max(lag_s, 1e-6), RATE_Hz)
        one = recording(drive, late)
        pieces = pieces_of([one], "x", scales_of([one], "x"), Rig())
        found = find_lag(pieces, "first_order", 0.05)
        assert abs(found - lag_s) < 5e-4


def test_weights_that_only_know_bounds_are_those_of_the_general_program(
    rng: np.random.Generator,
) -> None:
    drive = decaying()
    bent = made(drive) + 0.02 * (made(drive) ** 2) / np.ptp(made(drive))
    one = recording(drive, bent + 1e-9 * rng.normal(size=len(drive)))
    pieces = pieces_of([one], "x", scales_of([one], "x"), Rig())
    shape, threshold = Shape(plays=12, below=2, above=2), np.arange(13) / 13
    zones = zone_thresholds(-1.0, 1.0, shape)
    triangle = triangle_of(pieces, threshold, zones, 0.0)
    limits = constraints_of(threshold, zones, len(triangle))
    nothing = np.zeros(len(triangle))
    bounded = bounded_optimum(triangle, threshold, zones)
    general = constrained_least_squares(triangle, nothing, *limits)
    np.testing.assert_allclose(bounded, general.x, atol=1e-5)
    assert stationarity(triangle, bounded, nothing, limits[0], limits[1:]) < 1e-9


def test_a_delay_holds_the_first_value_and_is_straight_between_samples() -> None:
    line = np.arange(6.0)
    np.testing.assert_allclose(lagged(line, "delay", 2.25, 1.0), np.maximum(line - 2.25, 0.0))
    np.testing.assert_array_equal(lagged(line, "delay", 60.0, 1.0), np.zeros(6))
