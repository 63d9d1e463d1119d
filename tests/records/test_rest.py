"""A drive that looks like noise: at rest where the sensor does not follow it."""

import numpy as np
import pytest
from scipy.signal import lfilter

from piezoid.records.constant_drive import has_response, is_mostly_driven


def ringing(drive: np.ndarray, quality: float) -> np.ndarray:
    """Return a mode at a fifteenth of the sampling rate, moved by a drive."""
    turn = 2.0 * np.pi / 15.0
    radius = np.exp(-0.5 * turn / quality)
    denominator = [1.0, -2.0 * radius * np.cos(turn), radius**2]
    return lfilter([0.0, sum(denominator)], denominator, drive)


@pytest.mark.parametrize("quality", [0.5, 3.0, 10.0, 40.0])
def test_a_sensor_follows_a_drive_drawn_anew_also_where_a_mode_rings(rng, quality) -> None:
    drive = rng.standard_normal(4000)
    assert has_response(drive, ringing(drive, quality) + 0.02 * rng.standard_normal(4000))


def test_hum_that_both_channels_read_and_a_zero_that_walks_are_no_answer(rng) -> None:
    for count in (300, 1000, 8000):
        for _ in range(30):
            first, second = np.sin(
                2.0 * np.pi * (np.arange(count) / 20.0 + rng.uniform(size=(2, 1)))
            )
            drive = rng.standard_normal(count) + rng.uniform() * first
            walk = 0.05 * rng.standard_normal(count).cumsum()
            reading = rng.standard_normal(count) + rng.uniform() * second + walk
            assert not has_response(drive, reading)


@pytest.mark.parametrize("quality", [0.5, 3.0, 12.0, 40.0])
def test_a_mode_answers_a_white_drive_and_so_does_a_stage_without_one(rng, quality) -> None:
    drive, noise = rng.standard_normal((2, 8000))
    assert is_mostly_driven(drive, ringing(drive, quality) + 0.02 * noise)
    assert is_mostly_driven(drive, drive + 0.1 * noise)


@pytest.mark.parametrize("gain", [0.02, 0.05, 0.2, 0.6])
@pytest.mark.parametrize("noise", [0.0, 0.1, 1.0])
def test_a_sensor_that_a_servo_holds_answers_nothing(rng, gain, noise) -> None:
    floor = 0.02 * rng.standard_normal(8000).cumsum() + noise * rng.standard_normal(8000)
    effort, held, servo = 0.0, [], []
    for moved in floor.tolist():
        held.append(effort + moved)
        effort -= gain * held[-1]
        servo.append(effort)
    assert not is_mostly_driven(np.array(servo), np.array(held))
