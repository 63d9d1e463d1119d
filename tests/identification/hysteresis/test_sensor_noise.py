"""The noise of the sensor is estimated correctly even for drives that jump at every sample."""

import numpy as np
import pytest

from piezoid.identification.hysteresis.sensor_noise import sensor_noise
from piezoid_datasets.virtual_lab.signals import coloured_noise
from tests.identification.hysteresis.stages import piece_of
from tests.laws import LAWS, recorded, triangles

NOISE_um = 0.02


def random_steps(samples: int) -> np.ndarray:
    return np.repeat(np.random.default_rng(1).uniform(-1.0, 1.0, samples // 4), 4)


def random_drive(samples: int) -> np.ndarray:
    return np.random.default_rng(2).uniform(-1.0, 1.0, samples)


def quantised_triangles(samples: int) -> np.ndarray:
    return np.round(triangles(samples // 300, 300) / 0.05) * 0.05


@pytest.mark.parametrize("law", ["preisach", "duhem", "plays"])
@pytest.mark.parametrize(
    "drive", [random_steps, random_drive, quantised_triangles, lambda n: triangles(n // 300, 300)]
)
def test_repeated_periods_measure_the_noise(tmp_path, law, drive):
    period = drive(1200)
    field = np.tile(period, 3)
    displacement_um = 10.0 * LAWS[law](field)
    reading_um = displacement_um + NOISE_um * np.random.default_rng(3).standard_normal(len(field))
    piece, unit_m = piece_of(recorded(tmp_path, field, reading_um))
    for residual in (np.zeros(len(field)), -piece.response):  # independent of the model error
        noise_m = abs(unit_m) * sensor_noise(piece, residual)[0]
        assert 1e6 * noise_m == pytest.approx(NOISE_um, rel=0.15)


def test_without_periods_the_residual_of_the_model_gives_the_noise(tmp_path):
    field, noise_um = random_drive(3000), NOISE_um * np.random.default_rng(3).standard_normal(3000)
    piece, unit_m = piece_of(recorded(tmp_path, field, 10.0 * LAWS["duhem"](field) + noise_um))
    residual = -noise_um * 1e-6 / unit_m
    noise_m = abs(unit_m) * sensor_noise(piece, residual)[0]
    assert 1e6 * noise_m == pytest.approx(NOISE_um, rel=0.1)


@pytest.mark.parametrize("rate_Hz", [500.0, 20e3])
@pytest.mark.parametrize("amplitude_um", [0.0, 0.3])
def test_coloured_noise_is_estimated_completely(tmp_path, rate_Hz, amplitude_um):
    """Within 10 %: 1/f noise slower than the model error is not separable from it."""
    field = np.sin(np.linspace(0.0, 20.0, 12000) ** 1.3)  # not periodic
    noise_um = NOISE_um * coloured_noise(12000, rate_Hz, 4e3, 0.4, np.random.default_rng(4))
    motion_um = 10.0 * LAWS["duhem"](field)
    piece, unit_m = piece_of(recorded(tmp_path, field, motion_um + noise_um))
    model_error_um = amplitude_um * np.sin(np.arange(12000) / 500.0)
    residual = (model_error_um - noise_um) * 1e-6 / unit_m
    noise_m = abs(unit_m) * sensor_noise(piece, residual)[0]
    assert 1e6 * noise_m == pytest.approx(np.std(noise_um), rel=0.1)


def test_invalid_readings_do_not_affect_the_noise(tmp_path):
    field, rng = np.sin(np.linspace(0.0, 20.0, 12000) ** 1.3), np.random.default_rng(5)
    reading_um = 10.0 * LAWS["duhem"](field) + NOISE_um * rng.standard_normal(12000)
    reading_um[rng.random(12000) < 0.1] = -1000.0
    piece, unit_m = piece_of(recorded(tmp_path, field, reading_um))
    assert len(piece.invalid) > 1000
    noise_m = abs(unit_m) * sensor_noise(piece, -piece.response)[0]
    assert 1e6 * noise_m == pytest.approx(NOISE_um, rel=0.1)
