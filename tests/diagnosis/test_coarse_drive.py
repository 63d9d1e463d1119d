"""Quantisation of the drive is distinguished from the lattice of a periodic drive.

The stage has a slight curvature and no hysteresis.
"""

import numpy as np
import pytest

from piezoid.diagnosis.effects import quantisation
from piezoid.diagnosis.residual_view import view_of
from piezoid.diagnosis.segments import BLOCKS, Track
from piezoid.numerics.arrays import Array

STEP = 0.03  # of half the range
ROWS = 10_000
NOISE = 1e-4 * np.random.default_rng(1).normal(size=ROWS)


def repeating(first: float) -> Array:
    """Return a triangle of 20 Hz at 5 kHz with exactly 250 samples in a period."""
    return 2 / np.pi * np.arcsin(np.sin(2 * np.pi * (np.arange(ROWS) % 250 + first) / 250.0))


def smooth() -> Array:
    """Return a triangle with a non-integer number of samples in a period."""
    return 2 / np.pi * np.arcsin(np.sin(2 * np.pi * np.arange(ROWS) / (250.0 + np.pi / 10.0)))


def saw(drive: Array) -> Array:
    """Return the rounding error of a coarse converter."""
    return STEP * np.round(drive / STEP) - drive


def track_of(drive: Array, error: Array) -> Track:
    sample = np.arange(ROWS)
    return Track(
        name="track",
        rate_Hz=5000.0,
        command=drive,
        drive=drive,
        sensor_Hz=None,
        response=0.6 * drive + 0.3 * drive**3 + error + NOISE,
        other_drives={},
        rows=sample,
        block=sample * BLOCKS // ROWS,
    )


def fault_of(*recordings: tuple[Array, Array]):
    """Return the fault found in pairs of drive and response error of a smooth stage."""
    tracks = [track_of(drive, error) for drive, error in recordings]
    view = view_of(tracks, half_stroke_m=1e-5, voltage_V=50.0, rest_drive=-1.0)
    return quantisation.EFFECT.fault.find(view)


def staircase() -> tuple[Array, Array]:
    """Return a staircase and a random error of each level."""
    levels = np.repeat(np.linspace(-1.0, 1.0, 100), ROWS // 100)
    return levels, 2.0 * STEP * np.random.default_rng(3).uniform(-1.0, 1.0, 100).repeat(
        ROWS // 100
    )


@pytest.mark.parametrize(
    "further_recordings",
    [[], [(repeating(0.3), saw(repeating(0.3)))], [staircase()]],
    ids=["alone", "with a periodic drive", "with a staircase"],
)
def test_a_coarse_drive_is_detected_from_a_smooth_command(further_recordings):
    fault = fault_of((smooth(), saw(smooth())), *further_recordings)
    assert fault.value == pytest.approx(1e4 * STEP, rel=0.1)
    deviation = fault.tracks[0].drive - STEP * np.round(smooth() / STEP)
    assert np.mean(np.abs(deviation) < 0.1 * STEP) > 0.9


def local_error() -> Array:
    error = np.zeros(ROWS)
    error[4000:4500] = 20.0 * saw(smooth())[4000:4500]
    return error


@pytest.mark.parametrize(
    ("drive", "error"),
    [
        # sampled at these values only, an alternating error resembles a saw
        (repeating(0.5), 5e-3 * np.where(np.arange(ROWS) % 2, -1.0, 1.0)),
        (repeating(0.3), saw(repeating(0.3))),
        (smooth(), local_error()),
    ],
    ids=["alternating error", "too few values between steps", "one segment of a recording"],
)
def test_other_errors_are_not_attributed_to_quantisation(drive, error):
    assert fault_of((drive, error)) is None
