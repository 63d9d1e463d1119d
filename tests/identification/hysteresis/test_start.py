"""The convex start finds what is there, and another solver agrees with its program."""

import cvxpy as cp
import numpy as np

from piezoid.identification.hysteresis.coordinates import Shape
from piezoid.identification.hysteresis.pieces import Rig, pieces_of, scales_of
from piezoid.identification.hysteresis.start import (
    LEAST_INVERSE_SLOPE,
    find_lag,
    kuhnen_start,
    program_optimum,
    triangle_of,
)
from piezoid.numerics.arrays import Array
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
    drive = decaying()
    for lag_s in (0.0, 0.011):
        late = first_order_lag(made(drive), max(lag_s, 1e-6), RATE_Hz)
        one = recording(drive, late)
        pieces = pieces_of([one], "x", scales_of([one], "x"), Rig())
        found = find_lag(pieces, "first_order", 0.05)
        assert abs(found - lag_s) < 5e-4


def test_the_program_in_slopes_is_the_program_in_weights(rng: np.random.Generator) -> None:
    """Another solver, on the weights as they stand, cannot do better and finds the same."""
    drive = decaying()
    bent = made(drive) + 0.02 * (made(drive) ** 2) / np.ptp(made(drive))
    one = recording(drive, bent + 1e-9 * rng.normal(size=len(drive)))
    pieces = pieces_of([one], "x", scales_of([one], "x"), Rig())
    threshold, zones = np.arange(7) / 7, np.array([-0.75, -0.25, 0.0, 0.25, 0.75])
    triangle = triangle_of(pieces, threshold, zones, 0.0)
    found, gap = program_optimum(triangle, threshold, zones)
    x = cp.Variable(triangle.shape[1])
    inverse = x[7:12]
    slopes = [cp.sum(inverse[min(k, 2) : max(k, 2) + 1]) for k in range(5)]
    limits = [x[1:7] >= 0, *(slope >= LEAST_INVERSE_SLOPE for slope in slopes)]
    normal = x[:7] @ (1 - threshold) == 1
    problem = cp.Problem(cp.Minimize(cp.sum_squares(triangle @ x)), [*limits, normal])
    problem.solve(solver=cp.CLARABEL)
    np.testing.assert_allclose(found, x.value, atol=1e-5)
    assert gap < 1e-9


def test_a_delay_holds_the_first_value_and_is_straight_between_samples() -> None:
    line = np.arange(6.0)
    np.testing.assert_allclose(lagged(line, "delay", 2.25, 1.0), np.maximum(line - 2.25, 0.0))
    np.testing.assert_array_equal(lagged(line, "delay", 60.0, 1.0), np.zeros(6))
