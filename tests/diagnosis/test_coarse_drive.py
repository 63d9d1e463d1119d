"""Steps of a converter are told from the lattice that a drive has because it repeats itself.

The stage bends a little and knows no hysteresis: all that is left of it is what is said here.
"""

import numpy as np
import pytest

from piezoid.diagnosis.effects import quantisation
from piezoid.diagnosis.residual_view import view_of
from piezoid.diagnosis.segments import BLOCKS, Track
from piezoid.numerics.arrays import Array

STEP = 0.03  # of half the range
ROWS = 10_000
QUIET = 1e-4 * np.random.default_rng(1).normal(size=ROWS)


def repeating(first: float) -> Array:
    """Return a triangle of 20 Hz at 5 kHz: 250 samples for a period, again and again."""
    return 2 / np.pi * np.arcsin(np.sin(2 * np.pi * (np.arange(ROWS) % 250 + first) / 250.0))


def smooth() -> Array:
    """Return a triangle whose period is no number of samples."""
    return 2 / np.pi * np.arcsin(np.sin(2 * np.pi * np.arange(ROWS) / (250.0 + np.pi / 10.0)))


def saw(drive: Array) -> Array:
    """Return what a converter of coarse steps is off by."""
    return STEP * np.round(drive / STEP) - drive


def track_of(drive: Array, left: Array) -> Track:
    place = np.arange(ROWS)
    return Track(
        name="track",
        rate_Hz=5000.0,
        command=drive,
        drive=drive,
        sensor_Hz=None,
        response=0.6 * drive + 0.3 * drive**3 + left + QUIET,
        other_drives={},
        rows=place,
        block=place * BLOCKS // ROWS,
    )


def fault_of(*seen: tuple[Array, Array]):
    """Return the fault that drives and what a smooth stage does not do behind them show."""
    tracks = [track_of(drive, left) for drive, left in seen]
    view = view_of(tracks, half_stroke_m=1e-5, voltage_V=50.0, rest_drive=-1.0)
    return quantisation.EFFECT.fault.find(view)


def staircase() -> tuple[Array, Array]:
    """Return levels that are held, and an error of each of them."""
    levels = np.repeat(np.linspace(-1.0, 1.0, 100), ROWS // 100)
    return levels, 2.0 * STEP * np.random.default_rng(3).uniform(-1.0, 1.0, 100).repeat(
        ROWS // 100
    )


@pytest.mark.parametrize(
    "beside",
    [[], [(repeating(0.3), saw(repeating(0.3)))], [staircase()]],
    ids=["alone", "beside a drive that repeats", "beside a staircase of few values"],
)
def test_steps_of_a_coarse_drive_are_found_where_the_file_has_a_smooth_one(beside):
    fault = fault_of((smooth(), saw(smooth())), *beside)
    assert fault.value == pytest.approx(1e4 * STEP, rel=0.1)
    left = fault.tracks[0].drive - STEP * np.round(smooth() / STEP)
    assert np.mean(np.abs(left) < 0.1 * STEP) > 0.9


def in_one_part() -> Array:
    left = np.zeros(ROWS)
    left[4000:4500] = 20.0 * saw(smooth())[4000:4500]
    return left


@pytest.mark.parametrize(
    ("drive", "left"),
    [
        # seen at these values only, a reading that is off every other sample has waves of a saw
        (repeating(0.5), 5e-3 * np.where(np.arange(ROWS) % 2, -1.0, 1.0)),
        (repeating(0.3), saw(repeating(0.3))),
        (smooth(), in_one_part()),
    ],
    ids=["off on a lattice", "too few values between steps", "one part of a recording"],
)
def test_what_is_no_converters_step_is_not_taken_for_one(drive, left):
    assert fault_of((drive, left)) is None
