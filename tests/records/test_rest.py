"""A drive that looks like noise is at rest if the sensor does not respond."""

import numpy as np
import pytest
from scipy.signal import lfilter

from piezoid.records.drive_signal import has_response, is_mostly_driven


def ringing(drive: np.ndarray, quality: float) -> np.ndarray:
    """Return the response of a mode at a fifteenth of the sampling rate."""
    turn = 2.0 * np.pi / 15.0
    radius = np.exp(-0.5 * turn / quality)
    denominator = [1.0, -2.0 * radius * np.cos(turn), radius**2]
    return lfilter([0.0, sum(denominator)], denominator, drive)


@pytest.mark.parametrize("quality", [0.5, 3.0, 10.0, 40.0])
def test_a_random_drive_has_a_response_with_any_mode(rng, quality):
    drive = rng.standard_normal(4000)
    assert has_response(drive, ringing(drive, quality) + 0.02 * rng.standard_normal(4000))


def test_common_hum_and_a_drifting_zero_are_no_response(rng):
    for count in (300, 1000, 8000):
        for _ in range(30):
            hum_of_drive, hum_of_reading = np.sin(
                2.0 * np.pi * (np.arange(count) / 20.0 + rng.uniform(size=(2, 1)))
            )
            drive = rng.standard_normal(count) + rng.uniform() * hum_of_drive
            walk = 0.05 * rng.standard_normal(count).cumsum()
            reading = rng.standard_normal(count) + rng.uniform() * hum_of_reading + walk
            assert not has_response(drive, reading)


@pytest.mark.parametrize("quality", [0.5, 3.0, 12.0, 40.0])
def test_a_white_drive_has_a_response_with_and_without_a_mode(rng, quality):
    drive, noise = rng.standard_normal((2, 8000))
    assert is_mostly_driven(drive, ringing(drive, quality) + 0.02 * noise)
    assert is_mostly_driven(drive, drive + 0.1 * noise)


@pytest.mark.parametrize("gain", [0.02, 0.05, 0.2, 0.6])
@pytest.mark.parametrize("noise", [0.0, 0.1, 1.0])
def test_a_servo_output_is_no_drive(rng, gain, noise):
    floor = 0.02 * rng.standard_normal(8000).cumsum() + noise * rng.standard_normal(8000)
    command, readings, commands = 0.0, [], []
    for disturbance in floor.tolist():
        readings.append(command + disturbance)
        command -= gain * readings[-1]
        commands.append(command)
    assert not is_mostly_driven(np.array(commands), np.array(readings))
