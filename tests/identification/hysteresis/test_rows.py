"""Tangents are derivatives of the simulation with every filter and extension."""

import numpy as np
import pytest

from piezoid.identification.extensions import CreepLadder, Delay
from piezoid.identification.hysteresis.coordinates import Coordinates, Shape
from piezoid.identification.hysteresis.gauss_newton import (
    Task,
    column_indices,
    rows_of,
    simulate,
)
from piezoid.identification.hysteresis.pieces import Piece
from piezoid.numerics.arrays import Array
from tests.identification.hysteresis.stages import RATE_Hz, wandering

STEP = 1e-6
CREEP_TOLERANCE = 0.025  # of a column: columns of the hysteresis omit the creep of 2 %
KINKS = 0.02  # share of samples that may cross a kink of the model within a step


def random_piece(rng: np.random.Generator) -> Piece:
    drive = wandering(rng, 30, top=1.0)
    return Piece(
        name="a",
        recording=0,
        sampling_rate_Hz=RATE_Hz,
        drive=drive,
        response=rng.normal(0, 0.1, len(drive)),
        centre_m=0.0,
        first=7,
        last=len(drive) - 5,
    )


def random_vector(rng: np.random.Generator, coordinates: Coordinates) -> Array:
    theta = rng.uniform(0.1, 0.3, coordinates.total)
    slices = coordinates.slices
    for name in ("below_slope", "above_slope", "below_envelope", "above_envelope"):
        theta[slices[name]] = rng.uniform(0.7, 1.3, slices[name].stop - slices[name].start)
    theta[slices["lag"]] = 3.3 / RATE_Hz
    for piece in range(len(coordinates.offsets)):
        memory = coordinates.memory_slice(piece)
        theta[memory] = rng.uniform(-0.9, 0.9, memory.stop - memory.start)
    return theta


@pytest.mark.parametrize("lag", ["none", "delay", "first_order"])
@pytest.mark.parametrize(
    ("sensor_Hz", "stride", "bends"), [(None, 1, 2), (60.0, 4, 2), (60.0, 1, 0)]
)
def test_tangents_are_finite_differences_of_the_simulation(rng, lag, sensor_Hz, stride, bends):
    coordinates = Coordinates(
        shape=Shape(plays=4, below=2, above=1, lag=lag, bends=bends), offsets=(3,)
    )
    piece, theta = random_piece(rng), random_vector(rng, coordinates)
    task = Task(
        pieces=[piece],
        coordinates=coordinates,
        sensor_pole_Hz=sensor_Hz,
        samples=[piece.fitted_samples(stride)],
        longest_lag_s=1.0,
    )
    samples, blocks = zip(*rows_of(theta, task, 0), strict=True)
    sample, tangent = np.concatenate(samples), np.vstack(blocks)[:, :-1]
    assert set(np.diff(sample)) == {stride}
    for j, index in enumerate(column_indices(coordinates, 0)):
        step = STEP * np.eye(coordinates.total)[index]
        upper = simulate(theta + step, task, 0, piece)
        lower = simulate(theta - step, task, 0, piece)
        is_kink = np.abs((upper - lower)[sample] / (2 * STEP) - tangent[:, j]) > 1e-4
        assert is_kink.mean() < KINKS, f"number {index}"


def test_tangents_with_extensions_are_finite_differences_of_the_simulation(rng):
    extensions = (Delay(delay_s=1.3 / RATE_Hz), CreepLadder(time_s=(0.3,), share=(0.02,)))
    coordinates = Coordinates(
        shape=Shape(plays=4, below=2, above=1, lag="none"), offsets=(1,), numbers=(1, 1)
    )
    piece, theta = random_piece(rng), random_vector(rng, coordinates)
    theta[-2:] = [extension.free().value[0] for extension in extensions]
    task = Task(
        pieces=[piece],
        coordinates=coordinates,
        sensor_pole_Hz=None,
        samples=[piece.fitted_samples(3)],
        longest_lag_s=1.0,
        extensions=extensions,
    )
    ((sample, rows),) = rows_of(theta, task, 0)
    output = simulate(theta, task, 0, piece, sample)
    np.testing.assert_allclose(rows[:, -1], output - piece.response[sample], atol=1e-12)
    for j, index in enumerate(column_indices(coordinates, 0)):
        step = STEP * np.eye(coordinates.total)[index]
        upper = simulate(theta + step, task, 0, piece, sample)
        lower = simulate(theta - step, task, 0, piece, sample)
        difference = (upper - lower) / (2 * STEP)
        is_kink = np.abs(difference - rows[:, j]) > CREEP_TOLERANCE * np.abs(difference).max()
        assert is_kink.mean() < KINKS, f"number {index}"
