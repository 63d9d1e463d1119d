"""The convex start finds what is there, and another solver agrees with its program."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.identification.hysteresis.coordinates import Shape
from piezoid.identification.hysteresis.pieces import Piece, Rig, pieces_of, scales_of
from piezoid.identification.hysteresis.start import (
    ROWS,
    constraints_of,
    find_lag,
    kuhnen_start,
    placed_zones,
    triangle_of,
    within_bounds,
)
from piezoid.numerics.arrays import Array
from piezoid.numerics.quadratic_program import constrained_least_squares, stationarity
from piezoid.operators.filters import lagged
from piezoid.operators.play import BLOCK, play_columns
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


def whole_piece(drive: Array) -> Piece:
    return Piece(
        name="a",
        recording=0,
        sampling_rate_Hz=RATE_Hz,
        drive=drive,
        response=drive + 0.1 * drive**3,
        centre_m=0.0,
        first=0,
        last=len(drive),
    )


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


def test_a_lag_that_is_not_removed_corrupts_the_weights() -> None:
    drive = decaying()
    one = recording(drive, first_order_lag(made(drive), 0.02, RATE_Hz))
    scales = scales_of([one], "x")
    pieces = pieces_of([one], "x", scales, Rig())
    with_lag = kuhnen_start(pieces, Shape(plays=4, below=0, above=0), 0.02).operator.weight
    without = kuhnen_start(pieces, Shape(plays=4, below=0, above=0), 0.0).operator.weight
    true = WEIGHT * scales.voltage_V / abs(scales.displacement_m)
    assert np.abs(with_lag - true).max() < 0.2 * np.abs(without - true).max()


def test_weights_that_only_know_bounds_are_those_of_the_general_program(
    rng: np.random.Generator,
) -> None:
    drive = decaying()
    bent = made(drive) + 0.02 * (made(drive) ** 2) / np.ptp(made(drive))
    one = recording(drive, bent + 1e-9 * rng.normal(size=len(drive)))
    pieces = pieces_of([one], "x", scales_of([one], "x"), Rig())
    shape, threshold = Shape(plays=12, below=2, above=2), np.arange(13) / 13
    zones = placed_zones(-1.0, 1.0, shape)
    triangle = triangle_of(pieces, threshold, zones, 0.0)
    limits = constraints_of(threshold, zones, len(triangle))
    nothing = np.zeros(len(triangle))
    bounded = within_bounds(triangle, threshold, zones)
    general = constrained_least_squares(triangle, nothing, *limits)
    np.testing.assert_allclose(bounded, general.x, atol=1e-5)
    assert stationarity(triangle, bounded, nothing, limits[0], limits[1:]) < 1e-9


def test_the_rows_of_a_long_recording_are_some_of_all_its_rows() -> None:
    samples, threshold, lag_s = 2 * BLOCK + 100, np.arange(3) / 3, 3.25 / RATE_Hz
    drive = np.sin(np.linspace(0.0, 40.0, samples)) * np.linspace(1.0, 0.3, samples)
    piece = replace(whole_piece(drive), first=50, last=samples - 20)
    zones = np.zeros(1)
    triangle = triangle_of([piece], threshold, zones, lag_s)
    sample = np.arange(50, samples - 20, (samples - 70) // ROWS)
    states = play_columns(drive, threshold, np.full(3, drive[0]))[0][sample]
    place = np.arange(samples)
    advanced = np.interp(sample + 3.25, place, piece.response)
    rows = np.column_stack([states, -advanced, np.ones(len(sample))])
    np.testing.assert_allclose(triangle.T @ triangle, rows.T @ rows, rtol=1e-9, atol=1e-6)


@pytest.mark.parametrize("kind", ["none", "delay", "first_order"])
def test_the_lag_of_some_rows_is_some_rows_of_the_lag(kind: str, rng: np.random.Generator) -> None:
    columns, some = rng.standard_normal((50, 3)), slice(2, 40, 7)
    whole = lagged(columns, kind, 0.0123, 300.0)
    np.testing.assert_array_equal(lagged(columns, kind, 0.0123, 300.0, keep=some), whole[some])


def test_a_delay_holds_the_first_value_and_is_straight_between_samples() -> None:
    line = np.arange(6.0)
    np.testing.assert_allclose(lagged(line, "delay", 2.25, 1.0), np.maximum(line - 2.25, 0.0))
    np.testing.assert_array_equal(lagged(line, "delay", 60.0, 1.0), np.zeros(6))
